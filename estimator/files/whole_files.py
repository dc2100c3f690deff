"""Files: written whole or not at all, and one clear error where a reader finds damage."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Lend another name to write a file or folder under; it gets its own name when it is whole.

    A file of that name is replaced in one step. What a block that raises leaves is removed.

    Args:
        path: of the finished file or folder.

    Yields:
        A path beside it with the same suffix; nothing is there yet.
    """
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    _remove(partial)
    try:
        yield partial
        os.replace(partial, path)
    finally:
        _remove(partial)


@contextmanager
def damage_told(where: str, remedy: str) -> Iterator[None]:
    """Turn whatever a third party's decoder raises over a damaged file into one ValueError.

    Decoders trip over damage in as many ways as there are: struct.error, KeyError, zlib.error.

    Args:
        where: of the damage: the file, and the frame where there is one.
        remedy: what to do about it.
    """
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        said = " ".join(f"{error}".split()).rstrip(".") or type(error).__name__
        raise ValueError(f"{where}: cannot be read: {said}. {remedy}") from error


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
