"""The table [unrest] of the scene file: what else does not keep still while the tip moves."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from scenes.description.motion_settings import Seed

_Velocity = Annotated[float, Field(ge=-100, le=100)]
_Turning = Annotated[float, Field(ge=-90, le=90)]


class Unrest(BaseModel):
    """What else does not keep still: the view, the eye and the source's power."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    drift_mm_s: tuple[_Velocity, _Velocity] = Field(
        (0.0, 0.0),
        description="Velocity at which the whole image drifts, X and Y, measured at the pole.",
    )
    shake_px: float = Field(
        0.0,
        ge=0,
        le=100,
        description="Standard deviation of the image's shake in x and y; new in each frame.",
    )
    rotation_deg_s: tuple[_Turning, _Turning, _Turning] = Field(
        (0.0, 0.0, 0.0),
        description="Angular velocity of the eyeball around its centre, as a vector. The wall's "
        "picture turns, the tip does not. Only for a sphere that is seen without [viewing].",
    )
    power_swing: float = Field(
        0.0,
        ge=0,
        le=0.3,
        description="Relative standard deviation of the source's power; new in each frame.",
    )
    seed: Seed = Field(0, description="Random seed of shake and power.")

    @property
    def turns(self) -> bool:
        """Whether the eyeball turns."""
        return any(self.rotation_deg_s)

    @property
    def shifts(self) -> bool:
        """Whether the view moves."""
        return any(self.drift_mm_s) or self.shake_px > 0

    @property
    def still(self) -> bool:
        """Whether everything but the tip keeps still."""
        return not (self.turns or self.shifts or self.power_swing)
