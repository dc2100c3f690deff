"""Time of lines of sight, of exact spots and of frames through a contact lens into an eye."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from rich.table import Table

import optics
from benchmarks.bench.output import processor_seconds, show, table
from optics.viewing import PathCamera, load_eye, load_viewing_lens, path_camera, viewing_path
from scenes import Renderer, Scene, load_mitsuba

_WIDTH, _HEIGHT, _SCALE = 640, 480, 0.0067
_SPOTS, _BATCH = 100_000, 512
_RAYS_MS, _SPOTS_S = 50.0, 30.0
"""Limits on two idle cores, after compilation (`docs/viewing.md`)."""
_FRAMES, _FRAME_RATE = 20, 0.8
_SCENE = {
    "source": {"kind": "cone", "medium": "vitreous"},
    "spot": {"eccentricity_mm": 2.0},
    "motion": {"start_mm": 1.0, "travel_mm": 3.0, "frames": _FRAMES},
    "microscope": {"pinhole_height_mm": 200.0, "scale_mm_px": _SCALE},
}
_RANGES = {
    "eccentricity": (0.0, 3.5),
    "azimuth": (0.0, 6.28),
    "distance": (0.3, 6.0),
    "incidence": (0.0, 0.5),
    "incidence_azimuth": (0.0, 6.28),
}


def run(*, full: bool) -> None:
    """Print the times of lines of sight, of 100,000 spots, and of frames (`full` adds nothing)."""
    load_mitsuba()
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
    show(_frames(), f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def _frames() -> Table:
    """Noise-free frames through the lens beside those of a pinhole."""
    made = table(
        f"a moving spot at c = 2 mm, {_WIDTH} x {_HEIGHT} px, noise-free",
        *("seen through", "processor time a frame", "frames/s of the pinhole"),
        caption=f"The limit is {_FRAME_RATE:g} of the pinhole's frames per second.",
    )
    eye: dict[str, object] = {"eye": "navarro", "lens": "flat"}
    ways: dict[str, dict[str, object]] = {
        "a pinhole": {},
        "the lens": eye,
        "the lens, with reflexes": eye | {"reflexes": True},
        "the lens, each colour on its own lines": eye | {"colours": "own"},
    }
    first = 0.0
    for name, viewing in ways.items():
        scene = Scene.model_validate(_SCENE | {"viewing": viewing})
        renderer = Renderer(scene)
        numbers = itertools.cycle(range(len(renderer.world.times)))
        each = processor_seconds(partial(_next_frame, renderer, numbers), repeats=_FRAMES)
        first = first or each
        made.add_row(name, f"{1e3 * each:.1f} ms", f"{first / each:.2f}")
    return made


def _next_frame(renderer: Renderer, numbers: Iterator[int]) -> object:
    return renderer.render(next(numbers))


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
