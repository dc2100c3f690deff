"""The small labelled set that comes with eyespot."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from optics import InputError

NAME = "sample-v2"
"""Name of the set; `eyespot dataset sample-v2` renders it anew."""


def sample_folder() -> Path:
    """Folder of the set, for `read_set` and `stacks_of`.

    Raises:
        InputError: eyespot was installed without its data.
    """
    folder = Path(str(resources.files("benchmarks.sets.score"))) / NAME
    if not (folder / "set.json").is_file():
        raise InputError(f"{folder} is missing. Install eyespot again from its wheel.")
    return folder
