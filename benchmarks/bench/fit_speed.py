"""Time of a thousand of the paper's fits: one batch, SciPy, NumPy.

SciPy and NumPy fit one after the other. For planes (delta k, b) and spheres (c), the table gives
the time of each method, its ratio to the batch, and the largest difference of the results.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial

import jax
import numpy as np
from rich.table import Table
from scipy.optimize import least_squares

import optics
from benchmarks.bench.output import show, table
from calibration.spots import plane_solution, sphere_solution

_FITS, _SPOTS, _REPEATS = 1_000, 61, 5
_NOISE_MM = 0.05
_CONE = {"delta_k": 20.0 * 0.0067, "b": -5.117, "scale": 0.0067, "eye_radius": 11.5}
_SETTINGS = {"xtol": 1e-12, "ftol": 1e-12, "gtol": 1e-12}


def run(*, full: bool) -> None:
    """Print the table (`full` changes nothing)."""
    rng = np.random.default_rng(0)
    axis = np.linspace(38.0, 83.0, _SPOTS) + rng.uniform(-2.0, 2.0, (_FITS, 1))
    weight = np.ones_like(axis)
    times = table(
        f"{_FITS} fits of {_SPOTS} spots; load {os.getloadavg()[0]:.1f}",
        *("fits", "method", "CPU seconds", "ratio to batch", "largest difference"),
    )

    noise = rng.normal(0.0, _NOISE_MM, axis.shape)
    distance = _CONE["delta_k"] * axis + _CONE["b"] + noise
    batch = _batch(plane_solution)
    seconds, planes = _fastest(lambda: batch(axis, distance, weight))
    times.add_row("plane", "one batch", f"{seconds:.4f}", "", "")
    for name, way in (("scipy least_squares", _plane_scipy), ("numpy lstsq", _plane_lstsq)):
        taken, theirs = _timed(partial(_one_by_one, way, axis, distance))
        _row(times, "plane", name, taken, seconds, planes, theirs)

    eccentricity = rng.uniform(1.0, 6.0, (_FITS, 1))
    distance = noise + np.asarray(
        optics.small_plane_distance(
            semi_minor_px=axis,
            scale=_CONE["scale"],
            k=_CONE["delta_k"] / _CONE["scale"],
            b=_CONE["b"],
            eccentricity=eccentricity,
            eye_radius=_CONE["eye_radius"],
        )
    )
    batch = _batch(partial(sphere_solution, **_CONE))
    seconds, spheres = _fastest(lambda: batch(axis, distance, weight))
    times.add_row("sphere", "one batch", f"{seconds:.4f}", "", "")
    taken, theirs = _timed(partial(_one_by_one, _sphere_scipy, axis, distance))
    _row(times, "sphere", "scipy least_squares", taken, seconds, spheres, theirs)
    show(times)


def _batch(solve: Callable) -> Callable[..., np.ndarray]:
    """A function that solves many fits at once."""
    return jax.jit(jax.vmap(lambda *data: solve(*data).parameters))


def _one_by_one(
    way: Callable[[np.ndarray, np.ndarray], np.ndarray], axis: np.ndarray, distance: np.ndarray
) -> np.ndarray:
    return np.array([*map(way, axis, distance)])


def _fastest(solve: Callable[[], np.ndarray]) -> tuple[float, np.ndarray]:
    """Least CPU seconds of several runs after compilation, and the result."""
    result = np.asarray(jax.block_until_ready(solve()))
    return min(_timed(lambda: jax.block_until_ready(solve()))[0] for _ in range(_REPEATS)), result


def _timed(solve: Callable[[], np.ndarray]) -> tuple[float, np.ndarray]:
    # CPU time of all threads hardly depends on other processes.
    began = time.process_time()
    result = solve()
    return time.process_time() - began, result


def _row(
    times: Table,
    fits: str,
    way: str,
    seconds: float,
    batch: float,
    ours: np.ndarray,
    theirs: np.ndarray,
) -> None:
    difference = f"{np.abs(ours - theirs).max():.1e}"
    times.add_row(fits, way, f"{seconds:.4f}", f"{seconds / batch:.0f}", difference)


def _plane_scipy(axis: np.ndarray, distance: np.ndarray) -> np.ndarray:
    design = np.column_stack([axis, np.ones(axis.size)])
    return least_squares(
        lambda p: design @ p - distance, [0.1, 0.0], jac=lambda p: design, **_SETTINGS
    ).x


def _plane_lstsq(axis: np.ndarray, distance: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(np.column_stack([axis, np.ones(axis.size)]), distance, rcond=None)[0]


def _sphere_scipy(axis: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Fit of cos(phi) with the model and its derivative in NumPy."""
    k, r = _CONE["delta_k"] / _CONE["scale"], _CONE["eye_radius"]
    radius = _CONE["scale"] * axis

    def misfit(p: np.ndarray) -> np.ndarray:
        e = radius * p[0]
        return k * e + _CONE["b"] + r - np.sqrt(r * r - e * e) - distance

    def slope(p: np.ndarray) -> np.ndarray:
        e = radius * p[0]
        return (radius * (k + e / np.sqrt(r * r - e * e)))[:, None]

    return least_squares(misfit, [1.0], jac=slope, **_SETTINGS).x
