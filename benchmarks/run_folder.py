"""The folder of a run: whom it belongs to, how results appear there, and what they came from."""

import importlib.metadata
import json
import math
import os
import platform
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from eyespot.formats.inputs import InputError, in_file, object_in, read_text, shortened
from eyespot.formats.settings_files import by_dotted_name
from eyespot.formats.whole_files import errors_named, refuse_foreign, sweep, write_text

_PACKAGES = (
    "eyespot mitsuba drjit jax equinox optimistix numpy opencv-python-headless scikit-image "
    "matplotlib"
).split()
_MAX_KEYS_IN_MESSAGE = 2


def claim(file: Path, settings: Mapping[str, Any], *, of: str, command: str) -> None:
    """Use an empty folder, or one of the same settings, and write these into one of its files.

    The caller has locked the folder. `of` and the command are for the message.

    Raises:
        InputError: the folder has a run with other settings, or other files.
    """
    out, wanted = file.parent, json.loads(json.dumps(settings))
    if file.exists():
        with in_file(file):
            found = object_in(read_text(file))
        if found != wanted:
            raise InputError(
                f"{out} has {of} with other settings: {_difference(found, wanted)}. Choose another "
                "--out, or remove the folder."
            )
    sweep(out)
    if not file.exists():
        if any(out.iterdir()):
            raise InputError(
                f"{out} has files that are not from `{command}`. Choose another --out."
            )
        write_text(file, json.dumps(settings, indent=1) + "\n")


def _difference(found: Mapping[str, Any], asked: Mapping[str, Any]) -> str:
    """The first keys in which two requests differ, each with both values."""
    there, here = by_dotted_name(found), by_dotted_name(asked)
    keys = [key for key in {**there, **here} if there.get(key) != here.get(key)]
    said = [
        f"{shortened(key)}: {shortened(there.get(key))} instead of {shortened(here.get(key))}"
        for key in keys[:_MAX_KEYS_IN_MESSAGE]
    ]
    more = f", and {len(keys)} in all" if len(keys) > _MAX_KEYS_IN_MESSAGE else ""
    return ", ".join(said) + more


@contextmanager
def published(out: Path) -> Iterator[Path]:
    """A folder whose files move into `out`, which is claimed, if the block ends without an error.

    The files of an earlier report are replaced.

    Raises:
        InputError: a link, or no file, has the name of a file of the report.
    """
    folder = out / ".report.unfinished"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        with errors_named(folder, out):
            yield folder
            for path in sorted(folder.rglob("*")):
                target = out / path.relative_to(folder)
                if path.is_dir() and not target.is_symlink():
                    target.mkdir(exist_ok=True)
                else:
                    refuse_foreign(target)
                    os.replace(path, target)
    finally:
        shutil.rmtree(folder)


def write_json(path: Path, value: Any) -> None:
    """Write JSON, with null for numbers that are not finite."""
    text = json.dumps(_finite(value), indent=1, allow_nan=False, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8", errors="backslashreplace")


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    found = {"python": platform.python_version()}
    return found | {name: importlib.metadata.version(name) for name in _PACKAGES}
