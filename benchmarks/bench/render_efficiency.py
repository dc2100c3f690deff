"""Noise and time of a rendered spot, compared with common ways to render it.

Times are processor times of all threads, which hardly depend on other processes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from benchmarks.bench.output import processor_seconds, show, table
from scenes import Renderer, Scene, load_mitsuba

_SEEDS = 4
_WANTED_NOISE = 0.005
_CONVERGED = 256
"""Samples per pixel of the image that counts as the truth."""
_SPOT: dict[str, Any] = {
    "schema": 1,
    "spot": {"eccentricity_mm": 2.0},
    "motion": {"start_mm": 3.0, "travel_mm": 0.001, "frames": 1},
    "microscope": {"illumination_mw_mm2": 0.0},
}


class Measured(NamedTuple):
    """One way to render the spot: CPU s per frame, noise of a pixel, mean relative to the truth."""

    name: str
    seconds: float
    noise: float
    level: float

    @property
    def efficiency(self) -> float:
        """1/(time × variance), 1/s."""
        return 1 / (self.seconds * self.noise**2)


def run(*, full: bool) -> None:
    """Print the table (`full` changes nothing)."""
    load_mitsuba()
    show(_efficiency_table(_ours(), _rivals()))


def _scene(**parts: Any) -> Scene:
    content = dict(_SPOT)
    for name, values in parts.items():
        content[name] = {**content.get(name, {}), **values}
    return Scene.model_validate(content)


def _ours() -> list[Measured]:
    """Our integrator with several numbers of samples, and with indirect light."""
    from scenes.rendering import rivals

    truth = Renderer(_scene(microscope={"samples": _CONVERGED})).render(0).radiance
    found = []
    for samples in (1, 4, 16):
        renderer = Renderer(_scene(microscope={"samples": samples}))
        image = renderer.render(0).radiance
        spot = renderer.mask(0, renderer.render(0))
        # Samples on a grid do not depend on the seed, so the error replaces the noise.
        error = np.sqrt(np.mean((image[spot] / truth[spot] - 1) ** 2))
        level = image[spot].mean() / truth[spot].mean()
        seconds = processor_seconds(partial(renderer.render, 0))
        found.append(Measured(f"ours, {samples} on a grid", seconds, error, level))
    at_random = _renderer_of(rivals.randomly_sampled_scene(_scene()))
    found.append(_over_seeds("ours, 4 at random", at_random, spot=spot, truth=truth))
    traced = Renderer(_scene(phantom={"indirect": "traced"}))
    traced.render(0)
    render = _renderer_of(traced.mitsuba_scene)
    found.append(_over_seeds("ours, 4, indirect traced", render, spot=spot, truth=truth))
    return found


def _rivals() -> list[Measured]:
    """Mitsuba's tracers on the same spot, with direct light only, which favours them."""
    from scenes.rendering import rivals

    mi = load_mitsuba()

    lens = Renderer(_scene(phantom={"indirect": "off"}, microscope={"samples": _CONVERGED}))
    linear = lens.render(0)
    truth, spot = linear.radiance, lens.mask(0, linear)
    found = []
    photons = _scene(phantom={"indirect": "off"}, source={"kind": "photons"})
    direct = mi.load_dict({"type": "ptracer", "max_depth": 2, "hide_emitters": True})
    for reconstruction in ("box", "tent", "gaussian"):
        scene = rivals.particle_tracer_scene(photons, reconstruction=reconstruction)
        for count in (4, 16, 64):
            render = _renderer_of(scene, integrator=direct, sensor=1, spp=count)
            name = f"ptracer, {reconstruction}, {count}"
            found.append(_over_seeds(name, render, spot=spot, truth=truth))
    scene = rivals.cap_scene(_scene(phantom={"indirect": "off"}))
    path = mi.load_dict({"type": "path", "max_depth": 2})
    for count in (4, 16):
        render = _renderer_of(scene, integrator=path, spp=count)
        name = f"path to the cap, {count}"
        found.append(_over_seeds(name, render, spot=spot, truth=truth))
    return found


def _renderer_of(scene: Any, **options: Any) -> Callable[[int], np.ndarray]:
    return lambda seed: _image(scene, seed=seed, **options)


def _image(scene: Any, **options: Any) -> np.ndarray:
    return np.array(load_mitsuba().render(scene, **options))[..., :3]


def _over_seeds(
    name: str, render: Callable[[int], np.ndarray], *, spot: np.ndarray, truth: np.ndarray
) -> Measured:
    """Time and noise of one way; the noise is the standard deviation over seeds in the spot."""
    render(0)
    seconds, images = [], []
    for seed in range(_SEEDS):
        began = time.process_time()
        image = render(seed + 1)
        seconds.append(time.process_time() - began)
        images.append(image[spot] / truth[spot])
    noise = float(np.sqrt(np.mean(np.var(images, axis=0, ddof=1))))
    return Measured(name, float(np.median(seconds)), noise, float(np.mean(images)))


def _efficiency_table(ours: list[Measured], rivals: list[Measured]) -> Table:
    tracers = [way for way in rivals if way.name.startswith("ptracer")]
    best = max(tracers, key=lambda way: way.efficiency)
    made = table(
        "a spot at 640 x 480 px; ours includes indirect light, the others do not",
        *("method, samples per pixel", "CPU ms", "noise", "mean", "1/(s var)"),
        *("CPU s to 0.5%", "ratio"),
        caption="noise: standard deviation of a pixel over seeds; on a grid, which has no noise, "
        f"the error relative to {_CONVERGED} samples. on a grid: as in stacks; only pixels that a "
        "pose can change are rendered. at random: random samples in all pixels. mean: relative to "
        "the truth. ratio: relative to the best ptracer (*). ptracer: photons through the glass. "
        "path: the cap as a light source.",
    )
    for way in (*ours, *rivals):
        made.add_row(
            way.name + (" *" if way is best else ""),
            f"{1e3 * way.seconds:.0f}",
            f"{way.noise:.3%}",
            f"{way.level:.4f}",
            f"{way.efficiency:.3g}",
            f"{_to_wanted_noise(way):.2g}",
            f"{way.efficiency / best.efficiency:.3g}",
        )
    return made


def _to_wanted_noise(way: Measured) -> float:
    """Seconds to reach a noise of 0.5 %: one frame, or the mean of several."""
    return way.seconds * max((way.noise / _WANTED_NOISE) ** 2, 1.0)
