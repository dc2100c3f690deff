"""eyespot's own three modes as entries: literal, sub-pixel and pixels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.rivals.entry import Answer, Entry, Recording
from benchmarks.sets.read import Mode, own_reader
from estimator import Frame


class EyespotMode(Entry):
    """A mode of eyespot, which follows the spot from frame to frame.

    The mode pixels gets the beam. The literal mode starts at a click on the spot, as the paper's
    operator does. No mode gets the robot's poses.

    Args:
        mode: as of `eyespot track`.
        constants: of `LiteralSettings` or `SubpixelSettings`; those that are not given are the
            product's.
    """

    def __init__(self, mode: Mode, constants: Mapping[str, Any]) -> None:
        self.own_distance = mode == "pixels"
        self._mode = mode
        self._constants = constants

    def begin(self, recording: Recording) -> None:
        """Start a new reader."""
        self._reader = own_reader(
            self._mode,
            recording.microscope,
            click=recording.click,
            beam=recording.beam,
            constants=self._constants,
        )

    def read(self, frame: Frame) -> Answer:
        """Measure the next frame."""
        reading = self._reader.read(
            frame.image, time_s=frame.time_s, exposure_s=frame.exposure_s, name=frame.file_name
        )
        return Answer(reading.result, reading.range)
