"""How fast frames are made: from scene to disk, and beside the usual ways to render a spot.

Times are the processor's, of all threads together, so that other work on the machine matters less;
frames a second from scene to disk are counted by the clock on the wall too.
"""

from __future__ import annotations

import argparse
import os
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
from scenes.camera import Camera
from scenes.world import spot_labels

_SEEDS, _REPEATS = 4, 10
_FRAME = 10
_WANTED_NOISE = 0.005
_CONVERGED = 256
"""Samples of a pixel whose mean stands for the truth."""
_SPOT: dict[str, Any] = {
    "schema": 1,
    "spot": {"eccentricity_mm": 2.0},
    "motion": {"start_mm": 3.0, "travel_mm": 0.001, "frames": 1},
    "microscope": {"illumination_mw_mm2": 0.0},
}


class Measured(NamedTuple):
    """One way to render the spot: CPU s a frame, noise of a pixel, mean over the truth's."""

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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="5,000 frames in the longest stack.")
    longest = 5000 if parser.parse_args().full else 1000
    load_mitsuba()
    console = Console()
    console.print(_stacks(longest))
    console.print(_steps())
    console.print(_efficiency_table(_ours(), _rivals()))


def _scene(**parts: Any) -> Scene:
    content = dict(_SPOT)
    for name, values in parts.items():
        content[name] = {**content.get(name, {}), **values}
    return Scene.model_validate(content)


def _ours() -> list[Measured]:
    """Our integrator at some sample counts, closed-form indirect light included."""
    from scenes.rendering import rivals

    truth = Renderer(_scene(microscope={"samples": _CONVERGED})).render(0).radiance
    found = []
    for samples in (1, 4, 16):
        renderer = Renderer(_scene(microscope={"samples": samples}))
        image = renderer.render(0).radiance
        spot = renderer.mask(0, renderer.render(0))
        # Its samples lie on a grid: seeds change nothing, so its error stands for noise.
        error = np.sqrt(np.mean((image[spot] / truth[spot] - 1) ** 2))
        level = image[spot].mean() / truth[spot].mean()
        seconds = _cpu_seconds(partial(renderer.render, 0))
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
    """Time and noise of one way; the noise is the seeds' scatter in a pixel, over the spot."""
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
    table = Table(
        "way, per pixel",
        "CPU ms",
        "noise",
        "mean",
        "1/(s var)",
        "CPU s to 0.5%",
        "ratio",
        title="the spot at 640 x 480, ours with indirect light, the rivals without",
        caption="noise: scatter of a pixel over seeds. Stacks are rendered on a grid, which has "
        f"none: there it is the whole error against {_CONVERGED} samples, and what no pose changes "
        "was rendered before. at random: all of the same scene with points at random in each "
        "pixel. mean: over theirs. ratio: to the best ptracer, *. ptracer: photons led through the "
        "glass, none aimed past it. path: the cap as a lamp, refracted backwards.",
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
    renderer, camera = Renderer(scene), Camera(scene)
    linear = renderer.render(_FRAME)
    mask = renderer.mask(_FRAME, linear)
    meter = partial(camera.metered_s, linear.radiance, mask)
    photograph = partial(camera.raw, linear.radiance, exposure_s=meter(), noise_seed=[0])
    image = photograph()
    table = Table("step", "CPU ms", title="a 640 x 480 image, step by step")
    with tempfile.TemporaryDirectory() as folder:
        row = render_stack(scene, Path(folder) / "stack").labels[_FRAME]
        with StackWriter(Path(folder) / "steps") as writer:
            writer.describe(stack={}, microscope={})
            steps: dict[str, Callable[[], object]] = {
                "render": partial(renderer.render, _FRAME),
                "mask": partial(renderer.mask, _FRAME, linear),
                "meter": meter,
                "camera noise": photograph,
                "labels": partial(spot_labels, renderer.world, _FRAME),
                "PNG files of frame and mask": partial(
                    writer.add, image, row, np.uint8(255) * mask
                ),
            }
            total = 0.0
            for name, step in steps.items():
                cpu = _cpu_seconds(step)
                total += cpu
                table.add_row(name, f"{1e3 * cpu:.1f}")
    table.add_section()
    table.add_row("all", f"{1e3 * total:.1f}")
    table.add_row("images/s of two idle cores", f"{2 / total:.1f}")
    table.add_section()
    whole = _cpu_seconds(partial(_image, renderer.mitsuba_scene))
    table.add_row("the whole frame by mi.render", f"{1e3 * whole:.1f}")
    (tip,), (axis,) = renderer.world.motion.at(renderer.world.times[[_FRAME]])
    assert renderer.images.reach is not None  # nothing in the default scene is random
    changed = renderer.images.reach.pixels(tip=tip, axis=axis).size / mask.size
    table.add_row("part of the frame that is rendered anew", f"{changed:.0%}")
    return table


def _stacks(longest: int) -> Table:
    """Labelled stacks with camera noise, from the scene to files on disk."""
    table = Table(
        "stack",
        "images",
        "s",
        "images/s",
        "CPU ms each",
        "first fifth",
        "last fifth",
        "two idle cores",
        "MB then",
        "and then",
        title="scene to PNG files, masks, labels and checksums on disk",
        caption="CPU ms each: of the whole call, set-up and checksums included; fifths: of the "
        "frames alone, with the memory at their ends. two idle cores: images/s if nothing else "
        "ran and all work were shared.",
    )
    one: dict[str, Any] = {"exposures": {"kinds": ["metered"]}}
    wide: dict[str, Any] = {"width_px": 1280, "height_px": 960, "scale_mm_px": 0.00335}
    stacks: dict[str, dict[str, Any]] = {
        "640 x 480, compiling": {"motion": {"frames": 10}, **one},
        "640 x 480": {"motion": {"frames": 100}, **one},
        "640 x 480, long": {"motion": {"frames": longest}, **one},
        "640 x 480, two exposures": {"motion": {"frames": 100}},
        "1280 x 960": {"motion": {"frames": 50}, "microscope": wide, **one},
    }
    for name, parts in stacks.items():
        scene = Scene.model_validate({"schema": 1, **parts})
        each, kinds = frame_count(scene), len(scene.exposures.kinds)
        log: list[tuple[float, float]] = []

        def note(log: list[tuple[float, float]] = log) -> None:
            log.append((time.process_time(), _memory()))

        with tempfile.TemporaryDirectory() as folder:
            wall, cpu = time.perf_counter(), time.process_time()
            render_stack(scene, Path(folder) / "stack", progress=note)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        fifth = each // 5
        # A withdrawal's spot grows, so that fifths of one stack differ; stacks are to be compared.
        first = (log[fifth][0] - log[0][0]) / (kinds * fifth)
        last = (log[-1][0] - log[-1 - fifth][0]) / (kinds * fifth)
        images = each * kinds
        table.add_row(
            name,
            str(images),
            f"{wall:.1f}",
            f"{images / wall:.1f}",
            f"{1e3 * cpu / images:.0f}",
            f"{1e3 * first:.0f}",
            f"{1e3 * last:.0f}",
            f"{2 * images / cpu:.1f}",
            f"{log[fifth][1]:.0f}",
            f"{log[-1][1]:.0f}",
        )
    return table


def _memory() -> float:
    """What this process holds now, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1e6


def _cpu_seconds(step: Callable[[], object]) -> float:
    """Median processor time of a step."""
    step()
    seconds = []
    for _ in range(_REPEATS):
        began = time.process_time()
        step()
        seconds.append(time.process_time() - began)
    return float(np.median(seconds))


if __name__ == "__main__":
    main()
