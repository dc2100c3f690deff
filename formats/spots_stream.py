"""Writes a spots file record by record, so that nothing measured is lost however a run ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

from formats.inputs import InputError
from formats.spots import SpotRecord, csv_line, is_parquet, parquet_of_csv, pyarrow
from formats.whole_files import give_name, refuse_existing, refuse_foreign, written_whole


@contextmanager
def spots_stream(path: Path, *, replace: bool = False) -> Iterator[Callable[[SpotRecord], None]]:
    """Write a spots file record by record; it gets its name when the block ends, also by an error.

    Until then its lines are in a CSV file beside it, `NAME.partial.csv`. It is left behind only by
    a process that is killed, then with a whole line for each record that was written, and by one
    that cannot make the spots file of it. A run that finds one is refused, because its lines may be
    the only ones.

    Args:
        replace: whether it may exist; it is then replaced at the end.

    Yields:
        A function that writes a record. It raises OSError if the disk is full; the lines before
        stay.

    Raises:
        InputError: the file or a partial one exists, or Parquet without pyarrow installed.
        OSError: nothing can be written there.
    """
    if is_parquet(path):
        pyarrow()
    (refuse_foreign if replace else refuse_existing)(path)
    partial = path.with_name(f"{path.stem}.partial.csv")
    try:
        file = partial.open("xb", buffering=0)
    except FileExistsError as error:
        raise InputError(
            f"{partial} exists: a run into {path.name} was killed and left there what it had"
            " measured, or is still writing it. Rename it to keep it, or remove it."
        ) from error
    written = 0

    def write(record: SpotRecord) -> None:
        nonlocal written
        _append(file, csv_line(record), path)
        written += 1

    try:
        with file:
            _append(file, csv_line(None), path)
            yield write
    finally:
        if written:
            _finish(partial, path, replace=replace)
        else:
            partial.unlink()


def _append(file: FileIO, line: str, path: Path) -> None:
    """Write a line wholly or not at all."""
    end, data = file.tell(), line.encode()
    try:
        while data:
            data = data[file.write(data) :]
    except BaseException as error:
        file.truncate(end)
        file.seek(end)
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror, f"{path}") from error
        raise


def _finish(partial: Path, path: Path, *, replace: bool) -> None:
    """Make the spots file of the partial one."""
    kept = f"What was measured is in {partial}"
    try:
        if is_parquet(path):
            with written_whole(path, replace=replace) as whole:
                parquet_of_csv(partial, whole)
        else:
            give_name(partial, path, replace=replace)
    except InputError as error:
        raise InputError(f"{error} {kept}.") from error
    except OSError as error:
        raise OSError(error.errno, f"{error.strerror}. {kept}", f"{path}") from error
    partial.unlink(missing_ok=True)
