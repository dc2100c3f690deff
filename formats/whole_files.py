"""Files that are written whole or not at all, and damage as one error.

Until it is whole, a file or folder NAME lies in the folder `.NAME.unfinished` beside it, which its
writer has locked. A lock ends with its process, so what a killed writer has left is recognised: it
can be locked, and the next writer of NAME starts with an empty folder.
"""

import errno
import fcntl
import functools
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from eyespot.formats.inputs import InputError

UNFINISHED = ".unfinished"
STOPPED = ".partial"  # a stopped stack, which `StackWriter` continues

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_TAKEN = {errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR, errno.EISDIR}
# File systems such as exFAT have no hard links, and some on networks no locks.
_NO_LINKS = {errno.EPERM, errno.ENOTSUP, errno.ENOSYS}
_NO_LOCKS = {errno.ENOTSUP, errno.ENOSYS, errno.ENOLCK, errno.EBADF, errno.EINVAL}


class BeingWrittenError(InputError):
    """Another process is writing the same file or folder."""


@contextmanager
def written_whole(path: Path, *, replace: bool | None = None) -> Iterator[Path]:
    """Write a file or folder in another place; it gets its name when it is whole.

    Enter this before long work, not after it: it fails at once if the file could not be written,
    and no other process can start to write the same file. If the block raises, nothing is left.

    Args:
        replace: replace a file of this name in one step; only for a file that eyespot itself has
            written. Otherwise an existing file or folder is an error, also if it appears while the
            block runs; None if the caller offers nobody to replace it.

    Yields:
        A path with the same name in another folder; nothing is there yet.

    Raises:
        InputError: something of this name exists, or is no file where one is to be replaced.
        BeingWrittenError: another process is writing it.
        OSError: it cannot be written; the error has the finished file's name.
    """
    path = Path(path)
    offered = replace is False
    check = refuse_foreign if replace else functools.partial(refuse_existing, offered=offered)
    place = hidden_beside(path, UNFINISHED)
    handle = lock(place, of=path)
    try:
        check(path)
        empty(place)
        with errors_named(place / path.name, path):
            yield place / path.name
            check(path)
            give_name(place / path.name, path, replace=bool(replace))
    finally:
        shutil.rmtree(place, ignore_errors=True)
        os.close(handle)


def write_text(path: Path, text: str, *, replace: bool | None = None) -> None:
    """Write a text file in UTF-8, as `written_whole` does."""
    with written_whole(path, replace=replace) as partial:
        partial.write_text(text, encoding="utf-8")


def hidden_beside(path: Path, ending: str) -> Path:
    """Where a file or folder is written.

    Raises:
        InputError: the path has no name, as "." and "..", and so exists.
    """
    if path.name in ("", ".."):
        raise _taken(path)
    return path.with_name(f".{path.name}{ending}")


def refuse_existing(path: Path, *, offered: bool = False) -> None:
    """Raise an InputError if there is a file, folder or link of this name.

    Args:
        offered: whether the caller could have been told to replace it.
    """
    if os.path.lexists(path):
        raise _taken(path, offered=offered)


def refuse_foreign(path: Path) -> None:
    """Raise an InputError if there is a link or folder, which cannot be a file that we wrote."""
    if os.path.lexists(path) and (path.is_symlink() or not path.is_file()):
        raise InputError(f"{path} is a link or no file, and is not replaced. Move it away.")


def require_space(path: Path, needed_bytes: float) -> None:
    """Raise an InputError if a file or folder of this size does not fit on its disk."""
    folder = next(parent for parent in Path(path).absolute().parents if parent.is_dir())
    free = shutil.disk_usage(folder).free
    if free < needed_bytes:
        raise InputError(
            f"{path} needs at least {needed_bytes / 1e6:,.1f} MB, but its disk has "
            f"{free / 1e6:,.1f} MB left. Free some space, or choose another disk."
        )


def sweep(folder: Path) -> None:
    """Remove what killed writers have left in a folder of eyespot's; stopped stacks are kept."""
    for left in folder.glob(f".*{UNFINISHED}"):
        with suppress(InputError):  # it is being written, or is not ours
            handle = lock(left, of=left)
            shutil.rmtree(left, ignore_errors=True)
            os.close(handle)


def lock(folder: Path, *, of: Path) -> int:
    """Lock a folder for this process; it is made if it does not exist.

    Args:
        folder: the folder; a link is refused.

    Returns:
        A file descriptor. `os.close` removes the lock, and so does the end of the process.

    Raises:
        BeingWrittenError: another process has locked it.
        InputError: it is no folder.
    """
    while True:
        try:
            try:
                folder.mkdir()
            except FileExistsError:
                pass
            except FileNotFoundError as error:  # also where the working folder was removed
                why = f"{folder.parent} is no folder. Make it, or choose another."
                raise InputError(why) from error
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except FileNotFoundError:
            continue  # its writer has just finished
        except OSError as error:
            if os.path.lexists(folder) and error.errno in (errno.ENOTDIR, errno.ELOOP):
                raise InputError(f"{folder} is no folder. Move it away.") from error
            raise OSError(error.errno, error.strerror, f"{of}") from error
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(handle)
                raise BeingWrittenError(
                    f"{of} is being written by another process. Wait for it to end, or choose "
                    "another name."
                ) from error
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), folder.lstat()):
                return handle
        os.close(handle)  # the folder that was locked has another name now, or none


def give_name(made: Path, path: Path, *, replace: bool = False) -> None:
    """Give a finished file or folder its name; an error if there is one of this name already.

    Raises:
        InputError: something of this name exists, and is not to be replaced.
    """
    if replace:
        os.replace(made, path)
        return
    try:
        if made.is_dir():
            refuse_existing(path)
            os.rename(made, path)  # fails if anything but an empty folder has just appeared
            return
        try:
            os.link(made, path)
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            os.rename(made, path)
    except OSError as error:
        if error.errno in _TAKEN:
            raise _taken(path) from error
        raise


def append_line(file: FileIO, line: str) -> None:
    """Append a line to an unbuffered file, wholly or not at all."""
    end, data = file.seek(0, os.SEEK_END), line.encode()
    try:
        while data:
            data = data[file.write(data) :]
    except BaseException:
        file.truncate(end)
        file.seek(end)
        raise


def empty(folder: Path) -> None:
    """Remove what is in a folder, but not the folder."""
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


@contextmanager
def errors_named(made: Path, path: Path) -> Iterator[None]:
    """Give errors of writing the name of the file that the user knows.

    An error of `write` has no name, one of `shutil.copyfile` that of the source first.
    """
    try:
        yield
    except OSError as error:
        for name in (error.filename2, error.filename):
            if isinstance(name, str | os.PathLike) and Path(name).is_relative_to(made):
                known = path / Path(name).relative_to(made)
                raise OSError(error.errno, error.strerror, f"{known}") from error
        if error.filename is None and error.errno in _FULL:
            raise OSError(error.errno, error.strerror, f"{path}") from error
        raise


@contextmanager
def damage_reported(where: str, remedy: str) -> Iterator[None]:
    """Turn any error of a third party's decoder about a damaged file into one ValueError.

    Decoders raise all kinds of errors for damage: struct.error, KeyError, zlib.error and others. An
    InputError goes on with what is wrong, after the place.

    Args:
        where: of the damage: the file, and the frame where there is one.
    """
    try:
        yield
    except MemoryError:
        raise
    except InputError as error:
        raise InputError(f"{where} {error}. {remedy}") from error
    except Exception as error:
        said = (
            " ".join((getattr(error, "strerror", None) or f"{error}").split()).rstrip(".")
            or type(error).__name__
        )
        raise InputError(f"{where}: cannot be read: {said}. {remedy}") from error


def _taken(path: Path, *, offered: bool = False) -> InputError:
    way_out = (
        "delete it, or replace it (--overwrite; in Python overwrite=True)"
        if offered
        else "or delete it"
    )
    return InputError(f"{path} already exists. Choose another name, {way_out}.")
