"""The learned estimator as an entry: ellipse and distance, each straight from the frame."""

from __future__ import annotations

from pathlib import Path

from benchmarks.rivals.entry import NO_SPOT, Answer, Entry, Recording, plain_spot
from benchmarks.rivals.learned import WEIGHTS, LearnedEstimator
from estimator import Frame, Range


class LearnedEntry(Entry):
    """The network, frame by frame. Its distance does not go by its ellipse.

    Args:
        weights: a file of weights.
        direct: whether the distance is the network's own; else it follows from its ellipse.
    """

    def __init__(self, weights: Path = WEIGHTS, *, direct: bool) -> None:
        self.own_distance = direct
        self._estimator = LearnedEstimator.load(weights)

    def begin(self, recording: Recording) -> None:
        """Note the microscope."""
        self._microscope = recording.microscope

    def read(self, frame: Frame) -> Answer:
        """Measure a frame."""
        said = self._estimator.measure(frame.image, self._microscope)
        if said is None:
            return NO_SPOT
        x, y, first, second, angle = said.ellipse.tolist()
        spot = plain_spot(x, y, first, second, angle, said.covariance)
        if not self.own_distance:
            return Answer(spot)
        return Answer(spot, Range(distance_mm=said.distance_mm, sigma_mm=said.sigma_distance_mm))
