"""The light of a calibrated beam on the cells of a window, with its derivatives. Loads JAX."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.files import MicroscopeFile
from estimator.pixels.cells import COUNT, Window

if TYPE_CHECKING:
    from optics.wall_light import Lattice

POSE = 5
"""Numbers of a pose's change, as `optics.wall_light.BeamFrame` has them: two shifts of the spot
along the wall, mm; a growth of the distance, mm; and two turns of the beam about the spot, rad."""
NODES, SHARES = np.array([-0.5, 0.0, 0.5]) * math.sqrt(0.6), np.array([5.0, 8.0, 5.0]) / 18.0
"""Nodes of Gauss's rule of three points over an interval of length 1, and their weights. The light
of a tip that moves during the exposure is averaged with them."""


class Pose(NamedTuple):
    """A beam that meets the wall; see `optics.wall_light.BeamFrame`, which has the same fields."""

    tip: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    distance: Float[np.ndarray, ""]
    right: Float[np.ndarray, "3"]
    down: Float[np.ndarray, "3"]
    first: Float[np.ndarray, "3"]
    second: Float[np.ndarray, "3"]

    @property
    def spot(self) -> Float[np.ndarray, "3"]:
        """O, where the beam meets the wall, mm."""
        return self.tip + self.distance * self.axis

    def moved(self, change: Float[np.ndarray, "5"]) -> tuple[np.ndarray, np.ndarray]:
        """Tip and axis after a change."""
        axis = self.axis + change[3] * self.first + change[4] * self.second
        axis /= np.linalg.norm(axis)
        spot = self.spot + change[0] * self.right + change[1] * self.down
        return spot - (self.distance + change[2]) * axis, axis


class BeamLight:
    """Irradiance of the wall by one beam under one microscope.

    Args:
        mean: the beam's light, see `optics.wall_light.MeanLight`.
        microscope: the camera and the wall.
        spread: turns independent numbers of variance 1 into errors of the beam's own parameters.
    """

    def __init__(
        self, mean: Any, microscope: MicroscopeFile, spread: Float[np.ndarray, "p q"]
    ) -> None:
        self.mean, self.spread = mean, spread
        self.camera = microscope.ideal_microscope()
        self.wall = microscope.wall()
        self.scale_mm_px = microscope.scale_mm_px

    def pose(self, tip: np.ndarray, axis: np.ndarray) -> Pose | None:
        """The pose of a tip and an axis; None if the beam meets no wall ahead of the tip."""
        from optics.wall_light import beam_meets

        point, normal, distance = map(np.asarray, beam_meets(self.wall, tip, axis))
        if not (distance > 0 and np.isfinite(point).all()):
            return None
        right, down = _across(normal)
        first, second = _across(np.asarray(axis))
        return Pose(tip, axis, distance, right, down, first, second)

    def wall_points(self, pixels: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
        """Wall points that pixels see, and the inward normals there, (n, 3)."""
        from optics.wall_light import pixels_see

        point, normal = pixels_see(self.camera, self.wall, np.asarray(pixels, float))
        return np.asarray(point), np.asarray(normal)

    def lattice(self, window: Window) -> Lattice:
        """The wall behind a window's cells."""
        from optics.wall_light import square_lattice

        corner, side = window.corner_px, np.asarray(float(window.side))
        return square_lattice(self.camera, self.wall, corner=corner, side=side, count=COUNT)

    def irradiance(
        self,
        lattice: Lattice,
        pose: Pose,
        own: Float[np.ndarray, "q"],
        path: Float[np.ndarray, "3 3"] | None = None,
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "5+q n"]]:
        """Irradiance of the cells per unit power, 1/mm², and its derivatives by pose and beam.

        Args:
            lattice: from `lattice`.
            pose: the pose.
            own: changes of the beam's own parameters, in the terms of `spread`.
            path: where the tip is at `NODES` of the exposure, relative to its middle, mm; None for
                a tip at rest.
        """
        from optics.wall_light import BeamFrame, irradiance_alone, irradiance_and_slopes

        given: dict[str, Any] = {"own": own, "spread": self.spread}
        begin, middle, end = np.zeros((3, 3)) if path is None else path
        parts = lattice, self.mean, BeamFrame(*pose)
        value, slopes = map(np.asarray, irradiance_and_slopes(*parts, **given, aside=middle))
        if path is not None:
            # The derivatives at the middle are good enough to find where the light fits.
            ends = sum(
                np.asarray(irradiance_alone(*parts, **given, aside=at)) for at in (begin, end)
            )
            value = SHARES[1] * value + SHARES[0] * ends
        return value, slopes

    def irradiance_alone(
        self, lattice: Lattice, pose: Pose, own: Float[np.ndarray, "q"]
    ) -> Float[np.ndarray, "n"]:
        """Irradiance of the cells for a tip at rest, without derivatives."""
        from optics.wall_light import BeamFrame, irradiance_alone

        return np.asarray(
            irradiance_alone(
                lattice,
                self.mean,
                BeamFrame(*pose),
                own=own,
                spread=self.spread,
                aside=np.zeros(3),
            )
        )


def _across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to a unit vector and to each other."""
    least = np.eye(3)[np.argmin(np.abs(axis))]
    first = np.cross(axis, least)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)
