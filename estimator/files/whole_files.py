"""Files that are written whole or not at all, and damaged files that are reported in one error."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from optics import InputError


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Write a file or folder under another name; it gets its own name when it is whole.

    A file of that name is replaced in one step. If the block raises, its partial file is removed.

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
def damage_reported(where: str, remedy: str) -> Iterator[None]:
    """Turn any error of a third party's decoder about a damaged file into one ValueError.

    Decoders raise all kinds of errors for damage: struct.error, KeyError, zlib.error and others.

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
        raise InputError(f"{where}: cannot be read: {said}. {remedy}") from error


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
