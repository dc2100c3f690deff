"""The folder of a run, which the same request resumes; files appear only when complete."""

from __future__ import annotations

import importlib.metadata
import json
import math
import os
import platform
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import scenes
from estimator import Stack, read_stack
from estimator.files import (
    errors_named,
    lock,
    object_in,
    refuse_foreign,
    sweep,
    written_whole,
)
from optics import InputError, in_file, read_text, shortened
from scenes import Scene

_PACKAGES = (
    "eyespot",
    "mitsuba",
    "drjit",
    "jax",
    "equinox",
    "optimistix",
    "numpy",
    "opencv-python-headless",
    "scikit-image",
    "matplotlib",
)
_MOST_KEYS = 2  # that a message names


def claim(out: Path, settings: Mapping[str, Any], *, command: str) -> int:
    """Use an empty folder, or one of an earlier run with the same settings, and write run.json.

    Args:
        out: the folder; created if missing.
        command: command of the run, for the message.

    Returns:
        A file descriptor; until `os.close`, or the end of this process, no other run may use the
        folder.

    Raises:
        BeingWrittenError: another process uses the folder.
        InputError: the folder has a run with other settings, or other files.
    """
    out.mkdir(parents=True, exist_ok=True)
    handle = lock(out.resolve(), of=out)
    try:
        _claim(out, settings, command=command)
    except BaseException:
        os.close(handle)
        raise
    return handle


def _claim(out: Path, settings: Mapping[str, Any], *, command: str) -> None:
    file = out / "run.json"
    if file.exists():
        with in_file(file):
            found = object_in(read_text(file))
        if found != settings:
            raise InputError(
                f"{out} has a run with other settings: {_difference(found, settings)}. "
                "Choose another --out, or remove the folder."
            )
    sweep(out)
    if not file.exists():
        if any(out.iterdir()):
            raise InputError(
                f"{out} has files that are not from `{command}`. Choose another --out."
            )
        with written_whole(file) as partial:
            partial.write_text(json.dumps(settings) + "\n")


def finished_stack(
    scene: Scene, folder: Path, *, progress: Callable[[], None] = lambda: None
) -> Stack:
    """The scene's stack, rendered unless an earlier run finished it.

    Args:
        progress: called once for each frame.

    Raises:
        InputError: the folder has a stack of another scene.
    """
    if not folder.is_dir():
        return scenes.render_stack(scene, folder, progress=progress)
    stack = read_stack(folder)
    if stack.description["scene"] != scene.model_dump(mode="json", by_alias=True):
        raise InputError(
            f"{folder} was rendered from another scene than this version would render. Remove it, "
            "or choose another --out."
        )
    for _ in range(scenes.frame_count(scene)):
        progress()
    return stack


@contextmanager
def published(out: Path) -> Iterator[Path]:
    """A folder whose files move into `out` if the block ends without an error.

    Args:
        out: a folder that this run has claimed; the files of its earlier report are replaced.

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


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on."""
    found = {"python": platform.python_version()}
    return found | {name: importlib.metadata.version(name) for name in _PACKAGES}


def _difference(found: Mapping[str, Any], asked: Mapping[str, Any]) -> str:
    """The first keys in which two requests differ, each with both values."""
    keys = [key for key in {**found, **asked} if found.get(key) != asked.get(key)]
    said = [
        f"{shortened(key)}: {shortened(found.get(key))} instead of {shortened(asked.get(key))}"
        for key in keys[:_MOST_KEYS]
    ]
    return ", ".join(said) + ("" if len(keys) <= _MOST_KEYS else f", and {len(keys)} in all")


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
