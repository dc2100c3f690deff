"""What a worker does: one stack. Apart, so that workers import little else."""

from __future__ import annotations

import importlib.metadata
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import scenes

_PACKAGES = ("eyespot", "mitsuba", "drjit", "jax", "numpy", "opencv-python-headless", "scipy")

# A worker of several threads gives them all to the stack that it renders.
_one_at_a_time = threading.Lock()


def versions() -> dict[str, str]:
    """Versions of the packages that the bytes of a set depend on."""
    return {name: importlib.metadata.version(name) for name in _PACKAGES}


def render_planned(scene: Mapping[str, Any], folder: str, wanted: Mapping[str, str]) -> None:
    """Render one stack, unless it is there already.

    Args:
        scene: content of its scene file.
        folder: of the stack, on a disk that all workers see.
        wanted: versions that the set is made with.

    Raises:
        ValueError: this worker has other versions.
    """
    if versions() != wanted:
        raise ValueError(
            f"a worker has other versions than the set is made with: {versions()} instead of "
            f"{dict(wanted)}. Give all workers one environment."
        )
    with _one_at_a_time:
        if not Path(folder).is_dir():
            scenes.render_stack(scenes.Scene.model_validate(scene), Path(folder))
