"""How fast frames are made: beside the usual ways to render a spot, and from scene to disk."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from estimator import StackWriter
from scenes import Renderer, Scene, frame_count, load_mitsuba, render_stack
from scenes.exposure import POISSON_BELOW_E, expose, fixed_patterns, metered_exposure
from scenes.labels import spot_labels

_SEEDS, _REPEATS = 4, 10
_FRAME = 10
_WANTED_NOISE = 0.005
_CONVERGED = 1024
"""Samples of a pixel whose mean stands for the truth."""
_SPOT: dict[str, Any] = {
    "schema": 1,
    "spot": {"eccentricity_mm": 2.0},
    "motion": {"start_mm": 3.0, "travel_mm": 0.001, "frames": 1},
    "microscope": {"illumination_mw_mm2": 0.0},
}


class Measured(NamedTuple):
    """One way to render the spot: s a frame, relative noise of a pixel, mean over the truth's."""

    name: str
    seconds: float
    noise: float
    level: float

    @property
    def efficiency(self) -> float:
        """1/(time × variance), 1/s."""
        return 1 / (self.seconds * self.noise**2)


def main() -> None:
    """Print the tables, all from this run."""
    load_mitsuba()
    console = Console()
    console.print(_stacks())  # first: peak memory never falls, and tracing photons takes much of it
    console.print(_steps())
    console.print(_efficiency_table(_ours(), _rivals()))


def _scene(**parts: Any) -> Scene:
    content = dict(_SPOT)
    for name, values in parts.items():
        content[name] = {**content.get(name, {}), **values}
    return Scene.model_validate(content)


def _ours() -> list[Measured]:
    """Our integrator at some sample counts, closed-form indirect light included."""
    from scenes import rivals

    truth = Renderer(_scene(microscope={"samples": _CONVERGED})).render(0).radiance
    found = []
    for samples in (1, 4, 16):
        renderer = Renderer(_scene(microscope={"samples": samples}))
        image = renderer.render(0).radiance
        spot = renderer.mask(0, renderer.render(0))
        # Its samples lie on a grid: seeds change nothing, so its error stands for noise.
        error = np.sqrt(np.mean((image[spot] / truth[spot] - 1) ** 2))
        level = image[spot].mean() / truth[spot].mean()
        seconds = _seconds(partial(_image, renderer.mitsuba_scene))
        found.append(Measured(f"ours, {samples} on a grid", seconds, error, level))
    at_random = _renderer_of(rivals.randomly_sampled_scene(_scene()))
    found.append(_over_seeds("ours, 4 at random", at_random, spot=spot, truth=truth))
    traced = Renderer(_scene(phantom={"indirect": "traced"}))
    traced.render(0)
    render = _renderer_of(traced.mitsuba_scene)
    found.append(_over_seeds("ours, 4, indirect traced", render, spot=spot, truth=truth))
    return found


def _rivals() -> list[Measured]:
    """Direct light alone, in the rivals' favour: Mitsuba's tracers on the same scene and spot."""
    from scenes import rivals

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
    """Time and noise of one way; the noise is the seeds' scatter in a pixel, over the spot."""
    render(0)
    seconds, images = [], []
    for seed in range(_SEEDS):
        began = time.perf_counter()
        image = render(seed + 1)
        seconds.append(time.perf_counter() - began)
        images.append(image[spot] / truth[spot])
    noise = float(np.sqrt(np.mean(np.var(images, axis=0, ddof=1))))
    return Measured(name, float(np.median(seconds)), noise, float(np.mean(images)))


def _efficiency_table(ours: list[Measured], rivals: list[Measured]) -> Table:
    best = max(rivals, key=lambda way: way.efficiency)
    table = Table(
        "way, per pixel",
        "ms",
        "noise",
        "mean",
        "1/(s var)",
        "s to 0.5%",
        "ratio",
        title="the spot at 640 x 480, ours with indirect light, the rivals without",
        caption="noise: scatter of a pixel over seeds; of a grid, error against "
        f"{_CONVERGED} samples. mean: over theirs. ratio: to the best rival, *. ptracer: "
        "photons led through the glass, none aimed past it. path: the cap as a lamp, refracted "
        "backwards.",
    )
    for way in (*ours, *rivals):
        table.add_row(
            way.name + (" *" if way is best else ""),
            f"{1e3 * way.seconds:.0f}",
            f"{way.noise:.3%}",
            f"{way.level:.4f}",
            f"{way.efficiency:.3g}",
            f"{_to_wanted_noise(way):.2g}",
            f"{way.efficiency / best.efficiency:.3g}",
        )
    return table


def _to_wanted_noise(way: Measured) -> float:
    """Seconds to 0.5 %: less than one frame cannot be rendered, more are averaged."""
    return way.seconds * max((way.noise / _WANTED_NOISE) ** 2, 1.0)


def _steps() -> Table:
    """Where the time of one labelled frame goes, each step alone."""
    scene = Scene.model_validate({"schema": 1, "motion": {"frames": 20}})
    coarse = scene.model_copy(
        update={"microscope": scene.microscope.model_copy(update={"samples": 1})}
    )
    renderer, faster, camera = Renderer(scene), Renderer(coarse), scene.camera
    linear = renderer.render(_FRAME)
    mask = renderer.mask(_FRAME, linear)
    gain = metered_exposure(linear.radiance, settings=camera, mask=mask)
    patterns = fixed_patterns(settings=camera, shape=linear.radiance.shape, seed=0)

    def photograph() -> np.ndarray:
        rng = np.random.default_rng(0)
        return expose(linear.radiance, exposure=gain, settings=camera, rng=rng, patterns=patterns)

    image = photograph()
    table = Table("step", "ms", "CPU ms", title="a 640 x 480 frame, step by step")
    with tempfile.TemporaryDirectory() as folder:
        row = render_stack(scene, Path(folder) / "stack").labels[_FRAME]
        with StackWriter(Path(folder) / "steps") as writer:
            writer.describe(stack={}, microscope={})
            steps: dict[str, Callable[[], object]] = {
                "render": partial(renderer.render, _FRAME),
                "mask": partial(renderer.mask, _FRAME, linear),
                "meter": partial(metered_exposure, linear.radiance, settings=camera, mask=mask),
                "camera noise": photograph,
                "labels": partial(spot_labels, scene, renderer.moments, _FRAME),
                "PNG files of frame and mask": partial(
                    writer.add, image, row, np.uint8(255) * mask
                ),
            }
            total = 0.0
            for name, step in steps.items():
                cpu = _cpu_seconds(step)
                total += cpu
                table.add_row(name, f"{1e3 * _seconds(step):.1f}", f"{1e3 * cpu:.1f}")
    table.add_section()
    table.add_row("all", "", f"{1e3 * total:.1f}")
    table.add_row("frames/s of two idle cores", "", f"{2 / total:.1f}")
    table.add_section()
    step = partial(faster.render, _FRAME)
    table.add_row(
        "render, 1 sample a pixel", f"{1e3 * _seconds(step):.1f}", f"{1e3 * _cpu_seconds(step):.1f}"
    )
    assert renderer.table is not None  # the default source is a lens
    reach = float(renderer.table.envelope(renderer.truth.distance[_FRAME]))
    lit = np.pi * (reach / scene.microscope.scale_mm_px) ** 2 / mask.size
    counted = np.mean(linear.radiance * gain * camera.full_well_e < POISSON_BELOW_E)
    table.add_row("part of the frame that the beam reaches", f"{lit:.0%}", "")
    table.add_row(f"samples below {POISSON_BELOW_E:g} electrons", f"{counted:.0%}", "")
    return table


def _stacks() -> Table:
    """Labelled stacks with camera noise, from the scene to files on disk."""
    table = Table(
        "stack",
        "images",
        "s",
        "images/s",
        "CPU ms each",
        "two idle cores",
        "peak MB",
        title="scene to PNG files, masks, labels and checksums on disk",
        caption="two idle cores: images/s if nothing else ran and all work were shared.",
    )
    one: dict[str, Any] = {"exposures": {"kinds": ["metered"]}}
    wide: dict[str, Any] = {"width_px": 1280, "height_px": 960, "scale_mm_px": 0.00335}
    stacks: dict[str, dict[str, Any]] = {
        "640 x 480, compiling": {"motion": {"frames": 10}, **one},
        "640 x 480": {"motion": {"frames": 100}, **one},
        "640 x 480, long": {"motion": {"frames": 1000}, **one},
        "640 x 480, two exposures": {"motion": {"frames": 100}},
        "1280 x 960": {"motion": {"frames": 50}, "microscope": wide, **one},
    }
    for name, parts in stacks.items():
        scene = Scene.model_validate({"schema": 1, **parts})
        images = frame_count(scene) * len(scene.exposures.kinds)
        with tempfile.TemporaryDirectory() as folder:
            wall, cpu = time.perf_counter(), time.process_time()
            render_stack(scene, Path(folder) / "stack")
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        table.add_row(
            name,
            str(images),
            f"{wall:.1f}",
            f"{images / wall:.1f}",
            f"{1e3 * cpu / images:.0f}",
            f"{2 * images / cpu:.1f}",
            f"{peak:.0f}",
        )
    return table


def _seconds(step: Callable[[], object]) -> float:
    """Median wall-clock time of a step."""
    step()
    return float(np.median([_timed(step, time.perf_counter) for _ in range(_REPEATS)]))


def _cpu_seconds(step: Callable[[], object]) -> float:
    """Median processor time of a step, all threads together: other work does not change it."""
    return float(np.median([_timed(step, time.process_time) for _ in range(_REPEATS)]))


def _timed(step: Callable[[], object], clock: Callable[[], float]) -> float:
    began = clock()
    step()
    return clock() - began


if __name__ == "__main__":
    main()
