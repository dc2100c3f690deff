"""eyespot's own three modes as entries: literal, sub-pixel and pixels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from benchmarks.rivals.entry import Answer, Entry, Recording
from estimator import Frame, LiteralSettings, Reader, SubpixelSettings


class EyespotMode(Entry):
    """A mode of eyespot, which follows the spot from frame to frame.

    The mode pixels gets the beam. The literal mode starts at a click on the spot, as the paper's
    operator does. No mode gets the robot's poses.

    Args:
        mode: as of `eyespot track`.
        constants: of `LiteralSettings` or `SubpixelSettings`; those that are not given are the
            product's.
    """

    def __init__(
        self, mode: Literal["literal", "subpixel", "pixels"], constants: Mapping[str, Any]
    ) -> None:
        self.own_distance = mode == "pixels"
        self._mode = mode
        self._constants = constants

    def begin(self, recording: Recording) -> None:
        """Start a new reader."""
        response = recording.microscope.response
        if self._mode == "literal":
            settings = LiteralSettings(response=response, **self._constants)
            self._reader = Reader(settings, start=recording.click)
            return
        pixels = None
        if self._mode == "pixels":
            from estimator.pixels import PixelRanger

            pixels = PixelRanger(recording.beam, recording.microscope)
        self._reader = Reader(
            SubpixelSettings(response=response, **self._constants), pixel_ranger=pixels
        )

    def read(self, frame: Frame) -> Answer:
        """Measure the next frame."""
        reading = self._reader.read(
            frame.image, time_s=frame.time_s, exposure_s=frame.exposure_s, name=frame.file_name
        )
        return Answer(reading.result, reading.range)
