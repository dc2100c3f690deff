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

PHOTOGRAPH = Path(__file__).with_name("fundus_photograph.png")
"""A part of "Fundus photograph of normal left eye" (CC0 1.0), from Häggström, Mikael: Medical
gallery of Mikael Häggström 2014. WikiJournal of Medicine 1 (2), doi 10.15347/wjm/2014.008."""
PHOTOGRAPH_MM = 4.9
"""Its width: 510 px of a field of 45°, of which a pixel is 9.6 um of retina. It is 8.7 mm high."""


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
    if phantom.wall == "image":
        path, width_mm = Path(phantom.wall_image), phantom.wall_image_mm
    elif phantom.wall == "photograph":
        path, width_mm = PHOTOGRAPH, PHOTOGRAPH_MM
    else:
        return _fundus(phantom.texture_seed, phantom.wall)
    return wall_image(
        path,
        width_mm=width_mm,
        white=phantom.reflectance,
        extent_mm=PICTURE_MM,
        pixels=PICTURE_PX,
    )


@functools.lru_cache(maxsize=2)
def _fundus(seed: int, palette: Any) -> np.ndarray:
    # All trials of a run have the same wall.
    return fundus(seed=seed, extent_mm=PICTURE_MM, pixels=PICTURE_PX, palette=palette)
