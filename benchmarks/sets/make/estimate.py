"""Estimates number of images, size and time of a set from a few rendered frames."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import scenes
from benchmarks.sets.read.labelled_set import SetError
from benchmarks.sets.spec.planning import PlannedStack
from scenes.world import World

_TIMED = 5  # frames rendered of a stack


class Estimate(NamedTuple):
    """Expected cost of a set.

    Attributes:
        size_bytes: size on disk without the data card.
        processor_s: processor time of all cores.
        tried: number of images rendered for the estimate.
    """

    stacks: int
    images: int
    size_bytes: float
    processor_s: float
    tried: int


class _Enough(Exception):
    """Ends the rendering of a trial stack."""


def estimate(planned: Sequence[PlannedStack]) -> Estimate:
    """Check every scene, render a few frames of each condition, and scale up.

    One stack per condition is tried, and one without condition. Processor time is measured, because
    it hardly depends on other processes.

    Args:
        planned: the stacks of the set or of a shard.

    Raises:
        SetError: some scenes cannot be rendered; the message lists them with the reasons.
    """
    images = image_counts(planned)
    groups: dict[str | None, list[PlannedStack]] = {}
    for stack in planned:
        groups.setdefault(stack.condition, []).append(stack)
    size = seconds = 0.0
    tried = 0
    for stacks in groups.values():
        _Trial.of(stacks[-1].scene, images=1)  # compiles kernels, which a worker does once
        trial = _Trial.of(stacks[0].scene, images=_TIMED)
        counts = [images[stack.split, stack.name] for stack in stacks]
        seconds += sum(trial.first_s + (count - 1) * trial.next_s for count in counts)
        size += sum(count * trial.image_bytes for count in counts)
        tried += trial.images
    return Estimate(len(planned), sum(images.values()), size, seconds, tried)


class _Trial(NamedTuple):
    """Processor seconds and bytes of the first images of a stack."""

    images: int
    first_s: float  # from the scene to its first image
    next_s: float  # each image after that
    image_bytes: float

    @classmethod
    def of(cls, scene: scenes.Scene, *, images: int) -> _Trial:
        """Render the first images of a scene."""
        moments: list[float] = []

        def image_done() -> None:
            moments.append(time.process_time())
            if len(moments) == images:
                raise _Enough

        with tempfile.TemporaryDirectory() as folder:
            begin = time.process_time()
            with suppress(_Enough):
                scenes.render_stack(scene, Path(folder) / "stack", progress=image_done)
            # Other threads write the images, so writing ends after the last `image_done`.
            rest = time.process_time() - moments[0]
            files = [path for path in Path(folder).rglob("*") if path.is_file()]
            size = sum(path.stat().st_size for path in files)
            written = sum(path.parent.name == "frames" for path in files)
        later = max(len(moments) - 1, 1)
        return cls(len(moments), moments[0] - begin, rest / later, size / max(written, 1))


def image_counts(planned: Sequence[PlannedStack]) -> dict[tuple[str, str], int]:
    """Number of images of every stack, by split and name, after a check of its geometry.

    Raises:
        SetError: some scenes cannot be rendered; the message lists them with the reasons.
    """
    found, problems = {}, []
    for stack in planned:
        try:
            world = World(stack.scene)
            world.check()
        except scenes.SceneError as error:
            problems.append(f"{stack.split}/{stack.name}: {error}")
            continue
        exposures = len(stack.scene.exposures.kinds)
        found[stack.split, stack.name] = world.times.size * exposures
    if problems:
        raise SetError("\n".join(problems))
    return found
