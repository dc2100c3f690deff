"""The table [rig_errors]: what the rig of a rendered stack states wrongly, and by how much.

A lab knows its microscope and its robot to a tolerance. A stack whose scene has such tolerances
states a scale, a pinhole, a radius, poses and a first distance that are drawn from them, and the
tolerances. Its images and labels have the true values.
"""

from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from eyespot.scenes.description.scene_keys import SceneTable, Seed

_Part = Annotated[float, Field(ge=0, le=0.2)]
_Length = Annotated[float, Field(ge=0, le=50)]
_SEED = 3
"""Of the drawn errors, beside the seeds 1 and 2 of the clocks."""


class DrawnErrors(NamedTuple):
    """What is added to true values; of scales a part of them. In the order of `RigErrors`."""

    scale: float
    robot_scale: float
    pinhole_height_mm: float
    eye_radius_mm: float
    touch_mm: float
    clock_s: float


class RigErrors(SceneTable):
    """What the rig file of the stack states wrongly: standard deviations of what is drawn.

    The rig file states these tolerances, too; images and labels have the true values. Stacks whose
    seed, scale and tolerance are equal name one microscope (`microscope.id`).
    """

    scale: _Part = Field(0.0, description="Relative, of microscope.scale_mm_px.")
    robot_scale: _Part = Field(0.0, description="Relative, of the distances that the robot moves.")
    pinhole_height_mm: _Length = Field(0.0, description="Of microscope.pinhole_height_mm.")
    eye_radius_mm: _Length = Field(0.0, description="Of phantom.radius_mm.")
    touch_mm: _Length = Field(
        0.0, description="Of the first distance, which the rig file states as robot.touch."
    )
    clock_s: Annotated[float, Field(ge=0, le=10)] = Field(
        0.0, description="Of the offset of the robot's clock."
    )
    seed: Seed = Field(0, description="Random seed of what is drawn.")

    @property
    def of_the_view(self) -> tuple[str, ...]:
        """Keys above zero that change what the microscope's file states."""
        names = ("scale", "pinhole_height_mm", "eye_radius_mm")
        return tuple(name for name in names if getattr(self, name))

    def drawn(self) -> DrawnErrors:
        """The errors of this stack, normally distributed."""
        rng = np.random.default_rng([self.seed, _SEED])
        sigmas = [getattr(self, name) for name in DrawnErrors._fields]
        return DrawnErrors(*(rng.standard_normal(len(sigmas)) * sigmas).tolist())
