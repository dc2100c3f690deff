"""Readers of our estimator for the frames of a stack, by mode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from estimator import Calibration, LiteralSettings, MicroscopeFile, Reader, SubpixelSettings

Mode = Literal["literal", "subpixel", "pixels"]
"""As of `eyespot track`."""


def own_reader(
    mode: Mode,
    microscope: MicroscopeFile,
    *,
    click: tuple[float, float],
    beam: Calibration | None = None,
    constants: Mapping[str, Any] | None = None,
) -> Reader:
    """A reader that knows nothing of the robot.

    Args:
        click: (x, y) of the first spot, px, where the literal mode starts, as the paper's operator
            clicks on it. The other modes find the spot themselves.
        constants: of `LiteralSettings` or `SubpixelSettings`; those that are not given are the
            product's.

    Raises:
        InputError: the mode pixels cannot read the stack; the text says why.
    """
    given = {"response": microscope.response} | dict(constants or {})
    if mode == "literal":
        return Reader(LiteralSettings(**given), start=click)
    pixels = None
    if mode == "pixels":
        from estimator.pixels import PixelRanger

        assert beam is not None, "the mode pixels needs the beam"
        pixels = PixelRanger(beam, microscope)
    return Reader(SubpixelSettings(**given), pixel_ranger=pixels)
