"""Time of a labelled frame, from the scene to files on disk.

Processor times include all threads and hardly depend on other processes; images per second are also
given by wall time.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.bench.output import processor_seconds, show, table
from estimator import StackWriter
from scenes import Renderer, Scene, frame_count, load_mitsuba, render_stack
from scenes.camera import Camera
from scenes.world import spot_labels

_FRAME = 10


def run(*, full: bool) -> None:
    """Print the tables.

    Args:
        full: 5,000 instead of 1,000 frames in the longest stack.
    """
    load_mitsuba()
    show(_stacks(5000 if full else 1000), _steps())


def _steps() -> Table:
    """Time of each step of one labelled frame."""
    scene = Scene.model_validate({"schema": 1, "motion": {"frames": 20}})
    renderer, camera = Renderer(scene), Camera(scene)
    linear = renderer.render(_FRAME)
    mask = renderer.mask(_FRAME, linear)
    meter = partial(camera.metered_s, linear.radiance, mask)
    photograph = partial(camera.raw, linear.radiance, exposure_s=meter(), noise_seed=[0])
    image = photograph()
    made = table("a 640 x 480 image, step by step", "step", "CPU ms")
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
                cpu = processor_seconds(step)
                total += cpu
                made.add_row(name, f"{1e3 * cpu:.1f}")
    made.add_section()
    made.add_row("all steps", f"{1e3 * total:.1f}")
    made.add_row("images/s on two idle cores", f"{2 / total:.1f}")
    made.add_section()
    # The array waits for the image, which Mitsuba computes when it is needed.
    whole = processor_seconds(lambda: np.array(load_mitsuba().render(renderer.mitsuba_scene)))
    made.add_row("the whole frame by mi.render", f"{1e3 * whole:.1f}")
    (tip,), (axis,) = renderer.world.motion.at(renderer.world.times[[_FRAME]])
    assert renderer.images.reach is not None  # the default scene has no random light
    changed = renderer.images.reach.pixels(tip=tip, axis=axis).size / mask.size
    made.add_row("fraction of the frame that is rendered again", f"{changed:.0%}")
    return made


def _stacks(longest: int) -> Table:
    """Times of labelled stacks with camera noise, from the scene to files on disk."""
    made = table(
        "from the scene to PNG files, masks, labels and checksums on disk",
        *("stack", "images", "s", "images/s", "CPU ms each", "first fifth", "last fifth"),
        *("two idle cores", "MB, first fifth", "MB, end"),
        caption="CPU ms each: the whole call with set-up and checksums. fifths: CPU ms of the "
        "frames alone. two idle cores: expected images/s without other processes.",
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
        # The spot grows during a withdrawal, so compare the fifths of different stacks.
        first = (log[fifth][0] - log[0][0]) / (kinds * fifth)
        last = (log[-1][0] - log[-1 - fifth][0]) / (kinds * fifth)
        images = each * kinds
        made.add_row(
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
    return made


def _memory() -> float:
    """Memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1e6
