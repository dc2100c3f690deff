"""What is looked at: a frame, and what the robot says of it."""

from __future__ import annotations

from typing import NamedTuple

from estimator.image import Outline
from estimator.pixels.beam import Sweep
from estimator.pixels.frame_state import Direction
from estimator.pixels.picture import Picture
from estimator.pixels.robot import RobotPose

REACH = (2.0, 1.2)
"""Of the window over the half-maximum ellipse, for light without and with a sharp edge: farther out
there is hardly any light. The smaller the cells, the less texture averages out within them."""
_BESIDE_PX, _BESIDE_EDGE = 6.0, 2.5  # beside it, px, and in widths of the edge


class Look(NamedTuple):
    """A frame, and what the robot says of it.

    Attributes:
        picture: the pixels.
        direction: of the beam, from the robot.
        sweep: motion during the exposure, from the robot; None if unknown.
        robot: where the robot says the tool is; None if it does not.
    """

    picture: Picture
    direction: Direction | None
    sweep: Sweep | None
    robot: RobotPose | None


def reach_px(spot: Outline, *, sharp: bool) -> float:
    """From a spot's centre to where there is hardly any light."""
    beside = _BESIDE_PX + _BESIDE_EDGE * spot.edge_width_px * sharp
    return REACH[sharp] * spot.semi_major_px + beside
