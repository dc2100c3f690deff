"""pupil-detectors as an entry: the negative of the frame, made smaller, is searched for a pupil."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2

from benchmarks.rivals.entry import NO_SPOT, Answer, Entry, plain_spot
from benchmarks.rivals.pupil import PupilDetector
from estimator import Frame


class Constants(NamedTuple):
    """Free constants; the others are the package's own.

    Attributes:
        smaller: factor by which the frame is made smaller.
        intensity_range: grey values above the darkest that count as pupil.
        blur_size: px, of its median filter.
        largest: diameter, px of the smaller frame.
        least_confidence: below which an ellipse is a miss.
    """

    smaller: int = 2
    intensity_range: int = 23
    blur_size: int = 5
    largest: int = 400
    least_confidence: float = 0.0


class Pupil(Entry):
    """The 2D detector of pupil-detectors."""

    def __init__(self, constants: Mapping[str, Any]) -> None:
        self._constants = Constants(**constants)
        self._detector = PupilDetector(
            {
                "pupil_size_min": 10,
                "pupil_size_max": self._constants.largest,
                "intensity_range": self._constants.intensity_range,
                "blur_size": self._constants.blur_size,
            }
        )

    def read(self, frame: Frame) -> Answer:
        """The ellipse of the brightest region, if the detector trusts it."""
        n = self._constants.smaller
        grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
        size = grey.shape[1] // n, grey.shape[0] // n
        found = self._detector.ellipse(cv2.resize(grey, size, interpolation=cv2.INTER_AREA))
        if found is None or found.confidence < self._constants.least_confidence:
            return NO_SPOT
        x, y = ((at + 0.5) * n - 0.5 for at in (found.x, found.y))
        return Answer(plain_spot(x, y, n * found.first, n * found.second, found.angle))

    @property
    def seconds_elsewhere(self) -> float:
        """Processor time of the detector's process, s."""
        return self._detector.seconds

    def close(self) -> None:
        """End the detector's process."""
        self._detector.close()
