"""Frames, size and time of a set before it is made, from a few of its frames rendered now."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import scenes
from benchmarks.sets.read import SetError
from benchmarks.sets.spec import PlannedStack
from scenes.world import World

_TIMED = 5  # frames of a stack that is tried


class Estimate(NamedTuple):
    """What a set will take.

    Attributes:
        stacks: their number.
        images: their number.
        size_bytes: on disk, but for the data card.
        processor_s: of all cores together.
        tried: images that were rendered to know it.
    """

    stacks: int
    images: int
    size_bytes: float
    processor_s: float
    tried: int


class _Enough(Exception):
    """Ends a stack that is only tried."""


def estimate(planned: Sequence[PlannedStack]) -> Estimate:
    """Check every scene, render a few frames of each kind, and scale up.

    The frames are those of one stack of each condition, and of one without. Processor time is
    counted, which hardly depends on what else the machine does.

    Args:
        planned: the stacks of the set, or of a shard of it.

    Raises:
        SetError: naming the scenes that cannot be rendered, and why.
    """
    images = image_counts(planned)
    groups: dict[str | None, list[PlannedStack]] = {}
    for stack in planned:
        groups.setdefault(stack.condition, []).append(stack)
    size = seconds = 0.0
    tried = 0
    for stacks in groups.values():
        _Trial.of(stacks[-1].scene, images=1)  # compiles, which a worker does once
        trial = _Trial.of(stacks[0].scene, images=_TIMED)
        counts = [images[stack.split, stack.name] for stack in stacks]
        seconds += sum(trial.first_s + (count - 1) * trial.next_s for count in counts)
        size += sum(count * trial.image_bytes for count in counts)
        tried += trial.images
    return Estimate(len(planned), sum(images.values()), size, seconds, tried)


class _Trial(NamedTuple):
    """What the beginning of a stack took: processor seconds and bytes."""

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
            # Images are written beside the rendering; the last one's writing ends after its moment.
            rest = time.process_time() - moments[0]
            files = [path for path in Path(folder).rglob("*") if path.is_file()]
            size = sum(path.stat().st_size for path in files)
            written = sum(path.parent.name == "frames" for path in files)
        later = max(len(moments) - 1, 1)
        return cls(len(moments), moments[0] - begin, rest / later, size / max(written, 1))


def image_counts(planned: Sequence[PlannedStack]) -> dict[tuple[str, str], int]:
    """Images of every stack, by split and name; their geometry is found possible on the way.

    Raises:
        SetError: naming the scenes that cannot be rendered, and why.
    """
    found, problems = {}, []
    for stack in planned:
        try:
            world = World(stack.scene)
            world.truth  # noqa: B018 - deriving it refuses what cannot be rendered
        except scenes.SceneError as error:
            problems.append(f"{stack.split}/{stack.name}: {error}")
            continue
        exposures = len(stack.scene.exposures.kinds)
        found[stack.split, stack.name] = world.times.size * exposures
    if problems:
        raise SetError("\n".join(problems))
    return found
