"""Arrays that were computed once and are kept in the user's cache for the next run."""

import hashlib
import math
import zipfile
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from eyespot.formats.cache_folder import cache_folder
from eyespot.formats.inputs import InputError
from eyespot.formats.whole_files import damage_reported, sweep, written_whole


def kept_arrays(
    kind: str,
    names: Collection[str],
    compute: Callable[[], dict[str, Any]],
    *,
    inputs: object,
    code: Collection[Path],
) -> dict[str, Any]:
    """Finite arrays by name from the cache; they are computed and written if it lacks them.

    Args:
        kind: name of their folder in the cache.
        names: of the arrays that `compute` returns.
        inputs: the values that they depend on, all of which stand in its `repr`.
        code: source files that they depend on.
    """
    key = hashlib.sha256(repr(inputs).encode())
    for file in code:
        key.update(file.read_bytes())
    path = Path(cache_folder(), "eyespot", kind, f"{key.hexdigest()}.npz")
    with suppress(InputError), damage_reported(f"{path}", "It is written anew."):
        return _arrays_in(path, names)
    values = compute()
    # A cache that cannot be written costs time, not results; another process may be writing it.
    with suppress(OSError, InputError):
        path.parent.mkdir(parents=True, exist_ok=True)
        sweep(path.parent)
        with written_whole(path, replace=True) as partial:
            np.savez(partial, **values)
    return values


def _arrays_in(path: Path, names: Collection[str]) -> dict[str, Any]:
    """The arrays of an .npz file that `np.savez` wrote, if they are these and all finite."""
    with zipfile.ZipFile(path) as file:
        for member in file.infolist():
            # NumPy would take the memory that a header announces before it reads.
            with file.open(member) as data:
                np.lib.format.read_magic(data)
                shape, _, kind = np.lib.format.read_array_header_1_0(data)
            if math.prod(shape) * kind.itemsize > member.file_size:
                raise InputError(f"has an array of {shape} in {member.file_size} bytes")
    with np.load(path) as arrays:
        found = dict(arrays)
    if found.keys() != {*names} or not all(np.isfinite(array).all() for array in found.values()):
        raise InputError("has other arrays, or numbers that are not finite")
    return found
