"""An image as a file contains it, once it is decoded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optics import InputError

MOST_PIXELS = 2**26
"""Most pixels of an image: 8192 x 8192, the largest that a scene file can ask for."""


class DecodedImage(NamedTuple):
    """An image as a file contains it.

    Attributes:
        image: (H, W) or RGB (H, W, 3); uint8, uint16, float32 or float64.
        full_scale: value at which the samples end, if the file states fewer bits than its samples
            have room for; None otherwise.
        orientation: 1, or the number of the Exif orientation in which the file is to be shown. The
            image itself is as it is stored.
    """

    image: np.ndarray
    full_scale: float | None = None
    orientation: int = 1


def check_pixels(width: float, height: float) -> None:
    """Refuse an image before memory is taken for it.

    Raises:
        InputError: more than `MOST_PIXELS`.
    """
    if width * height > MOST_PIXELS:
        raise InputError(
            f"has {width:.0f} x {height:.0f} pixels; at most {MOST_PIXELS:,} are read. Cut it, or "
            "save it smaller"
        )


def over_black(image: np.ndarray, alpha: np.ndarray, opaque: float) -> np.ndarray:
    """An image over black: what lies under alpha 0 is not in it.

    An alpha that is the same everywhere says nothing about the image, and changes nothing.

    Args:
        image: (H, W) or (H, W, 3).
        alpha: (H, W).
        opaque: alpha of what hides the black.

    Raises:
        InputError: it is transparent everywhere.
    """
    if not alpha.any():
        raise InputError("is transparent everywhere (alpha 0)")
    if alpha.min() == alpha.max():
        return image
    seen = image * (alpha / opaque).reshape(alpha.shape + (1,) * (image.ndim - 2))
    return (seen if image.dtype.kind == "f" else np.rint(seen)).astype(image.dtype)
