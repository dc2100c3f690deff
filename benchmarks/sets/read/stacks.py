"""The stacks that export and score go through, and what a set calls them and their images."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from benchmarks.sets.read.labelled_set import SetError, SetStack, read_set
from estimator import Stack

_DESCRIPTION = ("stack.toml", "metadata.jsonl", "microscope.json", "kinematics.csv")
"""What a stack holds besides images; kinematics.csv may be missing."""


def stacks_of(folder: str | Path) -> list[SetStack]:
    """The stacks of a set, split by split; a stack by itself counts as a set of one.

    Args:
        folder: a set, or a stack, whose split is then empty.

    Raises:
        SetError: it is neither, or the set is not whole.
    """
    folder = Path(folder)
    if (folder / "stack.toml").is_file():
        place = folder.resolve()
        return [SetStack(split="", name=place.name, condition=None, parameters={}, folder=place)]
    if not (folder / "set.json").is_file():
        raise SetError(
            f"{folder} is neither a set (set.json is missing) nor a stack (stack.toml is missing). "
            "Name the folder that `eyespot dataset` or `eyespot render` has made."
        )
    labelled = read_set(folder)
    if missing := labelled.missing:
        raise SetError(
            f"{folder} is not whole: {len(missing)} of {len(labelled.stacks)} stacks are missing. "
            "Run `eyespot dataset` with its spec and this folder once more."
        )
    return sorted(labelled.stacks, key=lambda stack: stack.split)


def qualified_name(stack: SetStack) -> str:
    """SPLIT/STACK, or STACK for a stack by itself."""
    return f"{stack.split}/{stack.name}" if stack.split else stack.name


def split_name(stack: SetStack) -> str:
    """What files of a whole split are named after: SPLIT, or STACK for a stack by itself."""
    return stack.split or stack.name


def image_name(stack: SetStack, file_name: str) -> str:
    """An image as seen from the set: SPLIT/STACK/frames/000000.png; from the stack by itself."""
    return f"{qualified_name(stack)}/{file_name}" if stack.split else file_name


def set_files(stacks: Sequence[SetStack]) -> list[Path]:
    """set.json and LICENSE of the set that stacks belong to; none for a stack by itself."""
    folder = stacks[0].folder.parents[1]
    files = [folder / name for name in ("set.json", "LICENSE") if stacks[0].split]
    return [path for path in files if path.is_file()]


def copy_description(stack: SetStack, folder: Path) -> None:
    """Copy what a stack holds besides images into a new folder."""
    folder.mkdir(parents=True)
    for name in _DESCRIPTION:
        if (stack.folder / name).is_file():
            shutil.copyfile(stack.folder / name, folder / name)


def exposures_of(stack: Stack) -> tuple[str, ...]:
    """Kinds of exposure that a stack holds, in its order."""
    return tuple(dict.fromkeys(row.exposure for row in stack.labels))
