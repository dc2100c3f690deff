"""Renders one stack; a separate file, so that workers import little else."""

from __future__ import annotations

import importlib.metadata
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import scenes
from optics import InputError

_PACKAGES = ("eyespot", "mitsuba", "drjit", "jax", "numpy", "opencv-python-headless", "scipy")

# A worker with several threads uses them all for one stack.
_one_at_a_time = threading.Lock()


def versions() -> dict[str, str]:
    """Versions of the packages that affect the bytes of a set."""
    return {name: importlib.metadata.version(name) for name in _PACKAGES}


def render_planned(scene: Mapping[str, Any], folder: str, wanted: Mapping[str, str]) -> None:
    """Render one stack, unless it already exists.

    Args:
        scene: content of its scene file.
        folder: folder of the stack, on a disk that all workers can access.
        wanted: versions that the set was started with.

    Raises:
        InputError: this worker has other versions, or the scene is impossible.
        BeingWrittenError: another run is rendering it.
    """
    if versions() != wanted:
        raise InputError(
            f"a worker has other versions than the set: {versions()} instead of {dict(wanted)}. "
            "Use the same environment for all workers."
        )
    out = Path(folder)
    with _one_at_a_time:
        if out.is_dir():
            return
        try:
            scenes.render_stack(scenes.Scene.model_validate(scene), out)
        except InputError:
            if not out.is_dir():  # else another run has just finished it
                raise
