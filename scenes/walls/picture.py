"""The picture that a scene selects for its wall, and its mean colour."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from scenes.description import Phantom
from scenes.walls.fundus_image import fundus
from scenes.walls.image_file import wall_image

PICTURE_MM, PICTURE_PX = 24.0, 2048
"""Width and height of the picture, in mm along the wall and in pixels."""


def wall_colour(phantom: Phantom) -> np.ndarray:
    """Mean linear reflectance of the wall per colour channel."""
    if phantom.wall == "uniform":
        return np.full(3, phantom.reflectance)
    return wall_picture(phantom).mean(axis=(0, 1), dtype=float)


def wall_picture(phantom: Phantom) -> np.ndarray:
    """Linear reflectance on a plane about the pole, `PICTURE_PX` x `PICTURE_PX` x 3; row 0 at +Y.

    Raises:
        SceneError: phantom.wall_image cannot be read.
    """
    if phantom.wall != "image":
        return _fundus(phantom.texture_seed, phantom.wall)
    return wall_image(
        Path(phantom.wall_image),
        width_mm=phantom.wall_image_mm,
        white=phantom.reflectance,
        extent_mm=PICTURE_MM,
        pixels=PICTURE_PX,
    )


@functools.lru_cache(maxsize=2)
def _fundus(seed: int, palette: Any) -> np.ndarray:
    # All trials of a run have the same wall.
    return fundus(seed=seed, extent_mm=PICTURE_MM, pixels=PICTURE_PX, palette=palette)
