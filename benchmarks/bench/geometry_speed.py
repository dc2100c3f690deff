"""Time of a million exact spots (128-point contour, ellipse, distance), and of single inverses."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import optics
from benchmarks.bench.output import show, table

_COUNT = 1_000_000
_NUMPY_COUNT = 2_000
_BATCH = 512
_REPEATS = 300
_EYE, _SCALE, _HEIGHT, _APEX = 11.5, 0.0067, 200.0, -5.117
_LIMITS = {
    "eccentricity": (0.0, 6.0),
    "azimuth": (0.0, 6.28),
    "distance": (0.3, 6.0),
    "incidence": (0.0, 0.6),
    "incidence_azimuth": (0.0, 6.28),
    "half_angle": (0.03, 0.08),
}


def run(*, full: bool) -> None:
    """Print times by JAX and by NumPy, and of inverses (`full` changes nothing)."""
    rng = np.random.default_rng(0)
    poses = {name: jnp.asarray(rng.uniform(*ends, _COUNT)) for name, ends in _LIMITS.items()}
    distances = jax.jit(lambda poses: jax.lax.map(_distance, poses, batch_size=_BATCH))
    distances(poses).block_until_ready()
    began = time.perf_counter()
    ours = distances(poses).block_until_ready()
    seconds = time.perf_counter() - began

    columns = {name: np.asarray(values[:_NUMPY_COUNT]) for name, values in poses.items()}
    began = time.perf_counter()
    theirs = [
        _numpy_distance(**{name: values[i] for name, values in columns.items()})
        for i in range(_NUMPY_COUNT)
    ]
    numpy_seconds = (time.perf_counter() - began) * _COUNT / _NUMPY_COUNT
    times = table("contour, ellipse, distance", "method", "s per million", "ratio")
    times.add_row("optics, jit", f"{seconds:.1f}", "1")
    times.add_row(
        f"NumPy, one geometry at a time ({_NUMPY_COUNT} timed)",
        f"{numpy_seconds:.0f}",
        f"{numpy_seconds / seconds:.0f}",
    )
    worst = np.max(np.abs(np.asarray(ours[:_NUMPY_COUNT]) - theirs))
    show(times, f"largest difference between the two: {worst:.1e} mm")
    _print_inverses()


def _print_inverses() -> None:
    """Print the time of one inverse after compilation."""
    sphere = optics.Sphere(_EYE)
    camera = optics.microscope(scale=_SCALE, pinhole_height=_HEIGHT, eye_radius=_EYE)
    cone = {"half_angle": jnp.asarray(0.05), "apex_offset": jnp.asarray(_APEX)}
    place = {"eccentricity": jnp.asarray(3.0), "incidence": jnp.asarray(0.4)}
    beam = optics.beam_at_spot(sphere, distance=4.0, **place, **cone)
    noise = np.random.default_rng(0).normal(0.0, 0.05, (128, 2))
    contour = optics.spot_contour(beam, sphere, camera) + noise
    ellipse = optics.ellipse_of_contour(contour)
    prior = optics.DirectionPrior(beam.axis, jnp.asarray(0.1))
    covariance = jnp.diag(jnp.array([0.01, 0.01, 0.01, 0.01, 0.001]) ** 2)
    distance = jax.jit(partial(optics.exact_distance, sphere, camera, **place, **cone))
    ways: dict[str, Callable[[], object]] = {
        "distance, axis known": lambda: distance(semi_minor_px=ellipse.semi_minor),
        "tip from a contour, axis known": lambda: optics.tip_from_contour(
            contour, sphere, camera, axis=beam.axis, sigma_px=0.05, **cone
        ),
        "pose and mirror from a contour": lambda: optics.pose_from_contour(
            contour, sphere, camera, sigma_px=0.05, prior=prior, **cone
        ),
        "pose and mirror from an ellipse": lambda: optics.pose_from_ellipse(
            ellipse, sphere, camera, covariance=covariance, prior=prior, **cone
        ),
    }
    made = table(f"one spot, {_REPEATS} times", "inverse", "ms, median", "ms, best")
    for name, way in ways.items():
        jax.block_until_ready(way())
        times = []
        for _ in range(_REPEATS):
            began = time.perf_counter()
            jax.block_until_ready(way())
            times.append(1e3 * (time.perf_counter() - began))
        made.add_row(name, f"{np.median(times):.2f}", f"{min(times):.2f}")
    show(made)


def _distance(pose: dict[str, jax.Array]) -> jax.Array:
    sphere = optics.Sphere(_EYE)
    camera = optics.microscope(scale=_SCALE, pinhole_height=_HEIGHT, eye_radius=_EYE)
    beam = optics.beam_at_spot(sphere, apex_offset=_APEX, **pose)
    return optics.corrected_distance(
        semi_minor_px=optics.spot_ellipse(beam, sphere, camera).semi_minor,
        scale=_SCALE,
        k=optics.slope(pose["half_angle"]),
        b=_APEX,
        eccentricity=pose["eccentricity"],
        eye_radius=_EYE,
        inverse_working_distance=camera.inverse_working_distance,
    )


def _numpy_distance(
    *,
    eccentricity: float,
    azimuth: float,
    distance: float,
    incidence: float,
    incidence_azimuth: float,
    half_angle: float,
) -> float:
    """The same in plain NumPy for one geometry, as the alternative."""
    sin_phi = eccentricity / _EYE
    cos_phi = np.sqrt(1 - sin_phi**2)
    ca, sa = np.cos(azimuth), np.sin(azimuth)
    outward = np.array([sin_phi * ca, sin_phi * sa, -cos_phi])
    meridional = np.array([cos_phi * ca, cos_phi * sa, sin_phi])
    sideways = np.cos(incidence_azimuth) * meridional + np.sin(incidence_azimuth) * np.array(
        [-sa, ca, 0.0]
    )
    axis = np.cos(incidence) * outward + np.sin(incidence) * sideways
    apex = _EYE * outward - (distance - _APEX) * axis
    first = np.cross(axis, outward if incidence > 1e-3 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    t = np.arange(128) * (2 * np.pi / 128)
    around = np.cos(t)[:, None] * first + np.sin(t)[:, None] * second
    direction = np.cos(half_angle) * axis + np.sin(half_angle) * around
    along = direction @ apex
    reach = np.sqrt(along**2 + _EYE**2 - apex @ apex) - along
    points = apex + reach[:, None] * direction
    depth = 1 - (points[:, 2] + _EYE) / (_HEIGHT + _EYE)
    image = points[:, :2] * [1.0, -1.0] / (_SCALE * depth[:, None])
    weights = np.ones(128)
    for _ in range(3):
        centre = weights @ image / weights.sum()
        x, y = (image - centre).T
        size = np.sqrt(weights @ (x * x + y * y) / weights.sum())
        x, y = x / size, y / size
        design = np.stack([x * x, x * y, y * y, x, y], axis=1)
        a, b, c, d, e = np.linalg.solve(design.T @ (weights[:, None] * design), design.T @ weights)
        x0, y0 = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
        level = 1 + a * x0 * x0 + b * x0 * y0 + c * y0 * y0
        (small, large), vectors = np.linalg.eigh([[a, b / 2], [b / 2, c]])
        major, minor = np.sqrt(level / small), np.sqrt(level / large)
        p, q = (np.stack([x - x0, y - y0], axis=1) @ vectors / [major, minor]).T
        dp, dq = (
            sum(
                w * (np.roll(x, -n) - np.roll(x, n))
                for n, w in enumerate((4 / 5, -1 / 5, 4 / 105, -1 / 280), 1)
            )
            for x in (p, q)
        )
        weights = np.abs(p * dq - q * dp) / (p * p + q * q)
    kappa = 1 / (_HEIGHT + _EYE)
    near = 1 - kappa * _EYE * (1 - cos_phi)
    factor = near / min(1.0, cos_phi + kappa * _EYE * sin_phi**2 / near)
    radius = _SCALE * minor * size * factor
    sagitta = _EYE - np.sqrt(_EYE**2 - radius**2)
    return radius / np.tan(half_angle) + _APEX + sagitta
