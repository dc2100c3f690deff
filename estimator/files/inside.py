"""Names of files that come from a file: they must stay within its folder."""

from __future__ import annotations

import re
import stat
from pathlib import Path

from optics import InputError, shortened

FOLDER_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,79}$"
"""Pattern of a name that becomes a folder: no separator, and no dot in front."""

_LONGEST = 100  # characters; a name in a tar file may not have more


def inside(folder: Path, name: str) -> Path:
    """The path of a name that a file contains, if it lies inside the folder.

    Whoever sends a stack or a set writes the names in it. A name that leaves the folder would read
    or pack a file of the one who opens it.

    Args:
        folder: that the name is relative to.
        name: with `/` between its parts; the file or folder need not exist.

    Raises:
        InputError: the name is absolute, has `..`, `.`, an empty part, a backslash or NUL; leads
            out of the folder by a symbolic link; or is neither a file nor a folder.
    """
    parts = name.split("/")
    wrong = any(part in ("", ".", "..") for part in parts) or re.search(r"[\\\0]", name)
    if wrong or len(name) > _LONGEST:
        raise InputError(
            f"a name of a file must stay within its folder: relative, without `..` and backslash; "
            f"got {shortened(name)}. Do not use files from this sender unseen."
        )
    path = Path(folder, *parts)
    try:
        if not path.resolve().is_relative_to(Path(folder).resolve()):
            raise InputError(
                f"{shortened(name)} is a link that leads out of {folder}. Replace it by the file."
            )
        kind = path.stat().st_mode
    except FileNotFoundError:
        return path
    except RuntimeError as error:  # links that lead to each other
        raise InputError(f"{shortened(name)} is a link without an end. Remove it.") from error
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        raise InputError(f"{shortened(name)} is a pipe, device or socket, not a file. Remove it.")
    return path
