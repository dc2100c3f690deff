"""Arrays that take long to compute, kept in the user's cache folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from estimator.files.whole_files import damage_reported, sweep, written_whole
from optics import InputError


def cache_file(folder: str, key: str) -> Path:
    """Where arrays are kept.

    Args:
        folder: name of a folder of the cache.
        key: of all that the arrays depend on, hexadecimal.
    """
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return caches / "eyespot" / folder / f"{key}.npz"


def kept_arrays(path: Path, compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Arrays by name from a file; if it is missing or damaged, they are computed and written."""
    with suppress(InputError), damage_reported(f"{path}", "It is written anew."):
        with path.open("rb") as file:
            return dict(np.load(file))
    values = compute()
    # A cache that cannot be written costs time, not results; another process may be writing it.
    with suppress(OSError, InputError):
        path.parent.mkdir(parents=True, exist_ok=True)
        sweep(path.parent)
        with written_whole(path, replace=True) as partial:
            np.savez(partial, **values)
    return values
