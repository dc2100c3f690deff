"""Bayer mosaic, demosaicing and JPEG."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from optics import InputError


def mosaic(linear: NDArray[Any], *, bayer: str) -> NDArray[Any]:
    """The light behind a Bayer filter: for every pixel the channel that its filter transmits.

    Args:
        linear: H x W x 3 (R, G, B), H and W even.
        bayer: colours of the first two pixels of the first two rows, such as "RGGB".

    Returns:
        H x W.

    Raises:
        InputError: the image does not have that shape.
    """
    if linear.ndim != 3 or linear.shape[2] != 3 or linear.shape[0] % 2 or linear.shape[1] % 2:
        raise InputError(
            "a Bayer mosaic needs an image of H x W x 3 with even H and W; got shape "
            f"{linear.shape}. Set bayer to 'none' or the size to even numbers."
        )
    raw = np.empty(linear.shape[:2], linear.dtype)
    for position, colour in enumerate(bayer):
        row, column = divmod(position, 2)
        raw[row::2, column::2] = linear[row::2, column::2, "RGB".index(colour)]
    return raw


def demosaiced(raw: NDArray[Any], *, bayer: str) -> NDArray[Any]:
    """Colours from a Bayer mosaic; a pixel's two missing colours are means of its neighbours.

    Args:
        raw: H x W, uint8 or uint16.
        bayer: as for `mosaic`.

    Returns:
        H x W x 3 (R, G, B). The outermost pixels repeat those next to them.
    """
    return np.asarray(cv2.cvtColor(raw, getattr(cv2, f"COLOR_Bayer{bayer}2RGB")))


def after_jpeg(image: NDArray[Any], *, quality: int) -> NDArray[Any]:
    """An image after JPEG with 4:2:2 colour (half of the columns).

    Args:
        image: H x W x 3 (R, G, B), uint8.
        quality: 1 to 100, libjpeg's scale.
    """
    sampling = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    _, encoded = cv2.imencode(".jpg", image[..., ::-1], options)
    return np.ascontiguousarray(np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR))[..., ::-1])
