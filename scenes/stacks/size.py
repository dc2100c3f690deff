"""Least size of a stack on disk, to see before rendering that a disk is too full."""

from __future__ import annotations

from scenes.description import Scene
from scenes.world import frame_count

# A noisy 8-bit image takes 0.4 to 0.5 bytes a sample as PNG, one without noise far less.
_BYTES_PER_SAMPLE = 0.2
_BYTES_PER_LINEAR_SAMPLE = 4.0  # float32, not compressed


def least_bytes(scene: Scene) -> float:
    """Least size of a scene's stack on disk."""
    images = frame_count(scene) * len(scene.exposures.kinds)
    samples = 3 * scene.microscope.width_px * scene.microscope.height_px
    linear = _BYTES_PER_LINEAR_SAMPLE if scene.exposures.keep_linear else 0.0
    return images * samples * (_BYTES_PER_SAMPLE + linear)
