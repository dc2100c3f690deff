"""The instrument behind the tip, which hides a part of the wall from the microscope."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# 20 gauge, the thickest shaft in use. With a thinner shaft a few visible pixels are left out.
_SHAFT_RADIUS_MM = 0.455


class BareFibre(NamedTuple):
    """Bare fibre at the end of a shaft: the fibre's radius and length, mm."""

    fibre_radius: float
    fibre_length: float

    def hides(
        self,
        origin: Float[np.ndarray, "*n 3"],
        sight: Float[np.ndarray, "*n 3"],
        *,
        tip: Float[np.ndarray, "3"],
        axis: Float[np.ndarray, "3"],
        margin: float,
    ) -> Bool[np.ndarray, "*n"]:
        """Whether lines of sight meet the instrument, enlarged by a margin.

        Args:
            origin: a point on each line, mm.
            sight: unit directions of the lines.
            tip: S, mm.
            axis: unit vector from the tip towards the wall.
            margin: mm.
        """
        rods = (
            (self.fibre_radius, -self.fibre_length, 0.0),
            (_SHAFT_RADIUS_MM, -math.inf, -self.fibre_length),
        )
        offset = origin - tip
        height, rise = offset @ axis, sight @ axis
        foot, aside = offset - height[..., None] * axis, sight - rise[..., None] * axis
        # A line meets a rod if its sections inside the cylinder and between the ends overlap.
        a, b = np.sum(aside**2, axis=-1), np.sum(foot * aside, axis=-1)
        hidden = np.zeros(a.shape, bool)
        for radius, back, front in rods:
            with np.errstate(divide="ignore", invalid="ignore"):
                inside = b**2 - a * (np.sum(foot**2, axis=-1) - (radius + margin) ** 2)
                root = np.sqrt(inside)
                planes = [(end - height) / rise for end in (back - margin, front + margin)]
                first = np.maximum((-b - root) / a, np.minimum(*planes))
                last = np.minimum((-b + root) / a, np.maximum(*planes))
            hidden |= (inside > 0) & (first < last)
        return hidden
