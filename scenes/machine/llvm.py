"""Finds a libLLVM that Dr.Jit can use. This module needs only the standard library.

Dr.Jit loads the first libLLVM that it finds. Debian 12 has versions 14 to 16: Dr.Jit refuses 14,
and 15 and 16 abort the whole process ("Cannot select: fmaximum"). So a child process first loads
each file and reports its version; Dr.Jit gets only a version that is new enough. 19 and 22 work; 17
and 18 have not been tried and count as too old.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

OLDEST_USABLE = 19
ENVIRONMENT_VARIABLE = "DRJIT_LIBLLVM_PATH"
# Dr.Jit also needs libatomic, which a minimal Debian lacks; one command installs both.
DEBIAN_COMMAND = "apt-get install libllvm19 libatomic1"
REMEDY = (
    f"Install LLVM {OLDEST_USABLE} or newer (Debian, as root: `{DEBIAN_COMMAND}`), or set "
    f"{ENVIRONMENT_VARIABLE} to the libLLVM of such a version."
)

LIBRARY_FOLDERS = (
    f"{sys.prefix}/lib",
    "/usr/local/lib",
    "/usr/lib/*-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/lib/llvm-*/lib",
)

# libLLVM.so, libLLVM-14.so.1, libLLVM-14.0.6.so.1, libLLVM.so.19.1, libLLVM.dylib
_FILE_NAME = re.compile(
    r"libLLVM(?:-(?P<before>\d+)[\d.]*)?\.(?:so|dylib)(?:\.(?P<after>\d+)[\d.]*)?"
)

# LLVMGetVersion exists since LLVM 16; a library without it is older.
_ASK_VERSION = """
import ctypes, sys
library = ctypes.CDLL(sys.argv[1])
numbers = [ctypes.c_uint() for _ in range(3)]
library.LLVMGetVersion(*map(ctypes.byref, numbers))
print(*(number.value for number in numbers))
"""


@dataclass(frozen=True)
class Refused:
    """A libLLVM that must not be used, with the reason."""

    path: Path
    reason: str


@dataclass(frozen=True)
class Llvm:
    """The libLLVM for Dr.Jit; falsy, with reasons and remedy as its text, if none can be used.

    Attributes:
        path: the library file, which a child process could load.
        version: major, minor, patch.
        refused: other files that were found and must not be used, each with its reason.
        remedy: what to do if no file is usable.
    """

    path: Path | None = None
    version: tuple[int, ...] = ()
    refused: tuple[Refused, ...] = ()
    remedy: str = REMEDY

    def __bool__(self) -> bool:
        return self.path is not None

    def __str__(self) -> str:
        found = "; ".join(f"{item.path}: {item.reason}" for item in self.refused) or "none"
        return f"no usable libLLVM (found: {found}). {self.remedy}"


def find_llvm(
    *,
    environment: Mapping[str, str] = os.environ,
    folders: Iterable[str] = LIBRARY_FOLDERS,
) -> Llvm:
    """The libLLVM to use: the one in DRJIT_LIBLLVM_PATH, else the newest usable one.

    If the path in DRJIT_LIBLLVM_PATH cannot be used, no other file is tried, so that nobody works
    with an unexpected version.

    Args:
        environment: where to look up DRJIT_LIBLLVM_PATH.
        folders: library folders to search, with shell wildcards.
    """
    if asked := environment.get(ENVIRONMENT_VARIABLE):
        candidates = [Path(asked)]
        remedy = f"{ENVIRONMENT_VARIABLE} names this file. Unset it, or: {REMEDY}"
    else:
        candidates = _candidates(folders)
        remedy = REMEDY

    outcomes = [_examine(path) for path in candidates]
    refused = tuple(outcome for outcome in outcomes if isinstance(outcome, Refused))
    usable = [outcome for outcome in outcomes if isinstance(outcome, Llvm)]
    newest = max(usable, key=lambda llvm: llvm.version, default=Llvm(remedy=remedy))
    return replace(newest, refused=refused)


def _candidates(folders: Iterable[str]) -> list[Path]:
    """Every libLLVM in the folders; one path for all links to the same file."""
    names: dict[Path, Path] = {}
    for pattern in folders:
        anchor = Path(pattern).anchor
        for folder in sorted(Path(anchor).glob(pattern.removeprefix(anchor))):
            for path in sorted(folder.glob("libLLVM*")):
                if _FILE_NAME.fullmatch(path.name) and path.exists():
                    names.setdefault(path.resolve(), path)
    return list(names.values())


def _examine(path: Path) -> Llvm | Refused:
    """Whether one file can be used. If its name shows an old version, it is not loaded."""
    if not path.is_file():
        return Refused(path, "there is no such file")
    if match := _FILE_NAME.fullmatch(path.resolve().name):
        # A single ".1" after .so is the revision of the library, not LLVM's version.
        major = match["before"] or match["after"]
        if major and int(major) < OLDEST_USABLE:
            return Refused(path, _too_old(f"LLVM {major}"))
    child = subprocess.run(
        [sys.executable, "-I", "-c", _ASK_VERSION, str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    if child.returncode != 0:
        problem = child.stderr.strip().splitlines()[-1:] or [f"exit code {child.returncode}"]
        if "LLVMGetVersion" in problem[0]:
            return Refused(path, _too_old("older than LLVM 16"))
        return Refused(path, f"cannot be loaded ({problem[0]})")
    major, minor, patch = (int(number) for number in child.stdout.split())
    if major < OLDEST_USABLE:
        return Refused(path, _too_old(f"LLVM {major}"))
    return Llvm(path, (major, minor, patch))


def _too_old(version: str) -> str:
    return f"{version}, but Dr.Jit needs {OLDEST_USABLE} or newer"
