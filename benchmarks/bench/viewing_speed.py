"""Time of lines of sight and of exact spots through a contact lens into an eye."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

import optics
from benchmarks.bench.output import processor_seconds, show, table
from optics.viewing import PathCamera, load_eye, load_viewing_lens, path_camera, viewing_path

_WIDTH, _HEIGHT, _SCALE = 640, 480, 0.0067
_SPOTS, _BATCH = 100_000, 512
_RAYS_MS, _SPOTS_S = 50.0, 30.0
"""Limits on two idle cores, after compilation (`docs/viewing.md`)."""
_RANGES = {
    "eccentricity": (0.0, 3.5),
    "azimuth": (0.0, 6.28),
    "distance": (0.3, 6.0),
    "incidence": (0.0, 0.5),
    "incidence_azimuth": (0.0, 6.28),
}


def run(*, full: bool) -> None:
    """Print the times of a frame's lines of sight and of 100,000 spots (`full` adds nothing)."""
    eye = load_eye("navarro", wavelength_nm=555.0)
    path = viewing_path(eye, load_viewing_lens("flat"))
    camera = path_camera(path, scale=_SCALE)
    retina = optics.Ellipsoid(eye.retina_semi_axes)
    made = table(
        "phakic eye behind a flat contact lens, after compilation",
        "task",
        "time",
        "processor time",
        "limit",
    )
    for name, step, unit, per_s, limit, repeats in (
        (f"{_WIDTH} x {_HEIGHT} points", _points(camera, retina), "ms", 1e3, _RAYS_MS, 20),
        (f"{_SPOTS:,} spots", _spots(camera, retina), "s", 1.0, _SPOTS_S, 1),
    ):
        worked = processor_seconds(step, repeats=repeats)
        seconds = min(_elapsed(step) for _ in range(repeats))
        made.add_row(
            name,
            f"{per_s * seconds:.1f} {unit}",
            f"{per_s * worked:.1f} {unit}",
            f"{limit:g} {unit}",
        )
    show(made, f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def _points(camera: PathCamera, retina: optics.Surface) -> Callable[[], object]:
    """Every pixel's point on the retina."""
    v, u = np.mgrid[:_HEIGHT, :_WIDTH]
    pixels = jnp.stack([u - _WIDTH / 2, v - _HEIGHT / 2], axis=-1)
    seen = jax.jit(lambda pixels: retina.intersect(*camera.ray(pixels)).point)
    return lambda: jax.block_until_ready(seen(pixels))


def _spots(camera: PathCamera, retina: optics.Surface) -> Callable[[], object]:
    """Exact spots: 128 points of each contour, and their ellipse."""
    rng = np.random.default_rng(0)
    poses = {name: jnp.asarray(rng.uniform(*ends, _SPOTS)) for name, ends in _RANGES.items()}

    def one(pose: dict[str, jax.Array]) -> optics.Ellipse:
        beam = optics.beam_at_spot(retina, half_angle=0.05, apex_offset=-5.117, **pose)
        return optics.spot_ellipse(beam, retina, camera)

    every = jax.jit(lambda poses: jax.lax.map(one, poses, batch_size=_BATCH))
    return lambda: jax.block_until_ready(every(poses))


def _elapsed(step: Callable[[], object]) -> float:
    began = time.perf_counter()
    step()
    return time.perf_counter() - began
