"""The stacks of a set, or a single stack; names of stacks and images within a set."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from benchmarks.sets.read.labelled_set import SetError, SetStack, read_set
from estimator import Stack
from estimator.files import inside

_DESCRIPTION = ("stack.toml", "metadata.jsonl", "microscope.json", "kinematics.csv")
"""Files of a stack other than images; kinematics.csv may be missing."""


def stacks_of(folder: str | Path) -> list[SetStack]:
    """The stacks of a set, sorted by split. A single stack counts as a set of one.

    Args:
        folder: a set, or a stack (whose split is then empty).

    Raises:
        SetError: the folder is neither, or the set is incomplete.
    """
    folder = Path(folder)
    if (folder / "stack.toml").is_file():
        place = folder.resolve()
        return [SetStack(split="", name=place.name, condition=None, parameters={}, folder=place)]
    if not (folder / "set.json").is_file():
        raise SetError(
            f"{folder} is neither a set (set.json is missing) nor a stack (stack.toml is missing). "
            "Give a folder that `eyespot dataset` or `eyespot render` wrote."
        )
    labelled = read_set(folder)
    if missing := labelled.missing:
        raise SetError(
            f"{folder} is incomplete: {len(missing)} of {len(labelled.stacks)} stacks are missing. "
            "Run `eyespot dataset` with its spec and this folder again."
        )
    return sorted(labelled.stacks, key=lambda stack: stack.split)


def qualified_name(stack: SetStack) -> str:
    """SPLIT/STACK, or STACK for a single stack."""
    return f"{stack.split}/{stack.name}" if stack.split else stack.name


def split_name(stack: SetStack) -> str:
    """Name for the files of a split: SPLIT, or STACK for a single stack."""
    return stack.split or stack.name


def image_name(stack: SetStack, file_name: str) -> str:
    """Path of an image from the set (SPLIT/STACK/frames/000000.png), or from a single stack."""
    return f"{qualified_name(stack)}/{file_name}" if stack.split else file_name


def set_files(stacks: Sequence[SetStack]) -> list[Path]:
    """set.json and LICENSE of the stacks' set; nothing for a single stack."""
    folder = stacks[0].folder.parents[1]
    files = [inside(folder, name) for name in ("set.json", "LICENSE") if stacks[0].split]
    return [path for path in files if path.is_file()]


def copy_description(stack: SetStack, folder: Path) -> None:
    """Copy the files of a stack other than images into a new folder."""
    folder.mkdir(parents=True)
    for name in _DESCRIPTION:
        # A link in the place of a file could lead to any file of whoever exports the stack.
        if (path := inside(stack.folder, name)).is_file():
            shutil.copyfile(path, folder / name)


def exposures_of(stack: Stack) -> tuple[str, ...]:
    """Kinds of exposure in a stack, in its order."""
    return tuple(dict.fromkeys(row.exposure for row in stack.labels))
