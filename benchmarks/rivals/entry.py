"""What an entry is: a frame goes in, an ellipse or a miss comes out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from estimator import Calibration, Frame, FrameLabels, MicroscopeFile, NoSpot, Range, Reason, Spot


class Recording(NamedTuple):
    """What is known about the frames of one stack before the first is seen.

    Attributes:
        beam: calibration of the light source: the true one, as a good fit would give it.
        click: (x, y) of the spot in the first frame, px, on which an operator would click.
    """

    microscope: MicroscopeFile
    beam: Calibration
    click: tuple[float, float]

    @classmethod
    def of(cls, microscope: MicroscopeFile, beam: Calibration, first: FrameLabels) -> Recording:
        """The recording that begins with a labelled frame."""
        return cls(microscope, beam, (first.half_max_x_px, first.half_max_y_px))


class Answer(NamedTuple):
    """What an entry says about a frame.

    Attributes:
        result: the spot, or why there is none.
        range: the distance, of an entry that has its own way to it.
    """

    result: Spot | NoSpot
    range: Range | None = None


class Entry(ABC):
    """A way to measure spots. Its frames come in their order, after `begin`.

    Attributes:
        own_distance: whether its answers contain distances. Those of other entries follow from
            their ellipses by the true beam, the same way for all.
    """

    own_distance = False

    def begin(self, recording: Recording) -> None:
        """Get ready for the frames of a stack; an entry without a memory has nothing to do."""
        return

    @abstractmethod
    def read(self, frame: Frame) -> Answer:
        """Measure a frame."""

    @property
    def seconds_elsewhere(self) -> float:
        """Processor time that it has used in other processes so far, s."""
        return 0.0

    def close(self) -> None:
        """End what it has started."""
        return


NO_SPOT = Answer(NoSpot(Reason.NONE_FOUND))


def plain_spot(
    x: float, y: float, first: float, second: float, angle: float, covariance: object = math.nan
) -> Spot:
    """A spot that is an ellipse and nothing else.

    Args:
        x: centre, to the right, px.
        y: centre, downwards, px.
        first: a semi-axis, px.
        second: the other one; either may be the longer one.
        angle: of the first one, from +u towards +v, rad.
        covariance: 5 x 5, order `estimator.image.PARAMETERS`; NaN if unknown.
    """
    if second > first:
        first, second, angle = second, first, angle + math.pi / 2
    angle = math.pi / 2 - (math.pi / 2 - angle) % math.pi
    return Spot(
        x_px=float(x),
        y_px=float(y),
        semi_major_px=float(first),
        semi_minor_px=float(second),
        angle_rad=float(angle),
        covariance=np.broadcast_to(np.asarray(covariance, float), (5, 5)).copy(),
        edge_width_px=math.nan,
        coverage=math.nan,
        inlier_fraction=math.nan,
        saturated=math.nan,
    )
