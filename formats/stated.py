"""Stated uncertainties: what a lab knows of its eye, robot and clocks.

A rig file has them; in eyespot 0.1 and 0.2 they were a file of their own, which `read_rig` reads.
"""

from typing import Annotated, Self

from pydantic import ConfigDict, Field, model_validator
from pydantic import Strict as StrictType

from eyespot.formats.inputs import InputError, Strict

_Sigma = Annotated[float, Field(ge=0, le=1e6)]
_Degrees = Annotated[float, Field(ge=0, lt=90)]

USUAL_SHAKE_PX = 0.5
"""Of a microscope of which nothing is known (an assumption): a few micrometres in the eye."""


class Stated(Strict):
    """Standard uncertainties that no measurement of eyespot contains (type B).

    The rig file has a key of the same meaning for each, which it describes;
    `inverse_working_distance_sigma` is that of 1/(z_F + r), 1/mm.
    """

    model_config = ConfigDict(frozen=True)

    scale_sigma: Annotated[float, Field(ge=0, lt=1)] = 0.0
    eye_radius_sigma_mm: _Sigma = 0.0
    shape: Annotated[float, Field(ge=0, le=100)] = 0.0
    clear_layer_mm: _Sigma = 0.0
    clear_layer_sigma_mm: _Sigma = 0.0
    inverse_working_distance_sigma: _Sigma = 0.0
    size_per_mm: _Sigma = 0.0
    touch_sigma_mm: _Sigma = 0.0
    axis_sigma_deg: _Degrees = 1.0
    incidence_deg: Annotated[tuple[_Degrees, _Degrees], StrictType(False)] = (0.0, 32.0)
    clock_sigma_s: _Sigma = 0.0
    shake_px: _Sigma = USUAL_SHAKE_PX
    calibration_freedom: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        low, high = self.incidence_deg
        if low > high:
            raise InputError(f"the least incidence, {low:g} deg, exceeds the largest, {high:g}")
        return self
