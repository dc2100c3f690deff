"""Where the time of a labelled frame goes, and what a frame costs beside Mitsuba's usual set-up."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from estimator import LiteralSettings, SubpixelSettings, TrackState, measure
from scenes import Renderer, Scene, load_mitsuba, render_stack
from scenes.exposure import expose, metered_exposure

_REPEATS = 10


def main() -> None:
    """Print the cost of every step of a frame, and of a whole stack, in one run."""
    mi = load_mitsuba()
    scene = Scene.model_validate(
        {"schema": 1, "spot": {"eccentricity_mm": 5.0}, "withdrawal": {"frames": 20}}
    )
    renderer = Renderer(scene)
    linear = renderer.render(5)
    gain = metered_exposure(linear.radiance, settings=scene.camera, mask=renderer.mask(5, linear))
    rng = np.random.default_rng(0)
    image = expose(linear.radiance, exposure=gain, settings=scene.camera, rng=rng)
    path = mi.load_dict({"type": "path", "max_depth": 2})
    start = TrackState()
    steps: dict[str, Callable[[], object]] = {
        f"render, our integrator, {scene.microscope.samples} samples": lambda: renderer.render(5),
        "the same by Mitsuba's path integrator": lambda: np.asarray(
            mi.render(renderer.mitsuba_scene, integrator=path, seed=0)
        ),
        "mask": lambda: renderer.mask(5, linear),
        "expose": lambda: expose(linear.radiance, exposure=gain, settings=scene.camera, rng=rng),
        "measure, sub-pixel, first frame": lambda: measure(image, start, SubpixelSettings()),
        "measure, literal, first frame": lambda: measure(image, start, LiteralSettings()),
    }
    table = Table("step", "ms", title="one 640 x 480 frame")
    for name, step in steps.items():
        table.add_row(name, f"{1e3 * _median_seconds(step):.1f}")
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        render_stack(scene, Path(folder) / "stack")
        seconds = time.perf_counter() - began
    images = scene.withdrawal.frames * len(scene.exposures.kinds)
    table.add_row("stack on disk, per image, loading included", f"{1e3 * seconds / images:.1f}")
    Console().print(table)


def _median_seconds(step: Callable[[], object]) -> float:
    step()
    seconds = []
    for _ in range(_REPEATS):
        began = time.perf_counter()
        step()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


if __name__ == "__main__":
    main()
