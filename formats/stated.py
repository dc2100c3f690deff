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
    """Standard uncertainties that no measurement of eyespot contains (type B)."""

    model_config = ConfigDict(frozen=True)

    scale_sigma: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.0,
        description="Of the microscope's scale, relative; a calibration with a scale of its own, "
        "made with the same microscope and zoom, has its own.",
    )
    eye_radius_sigma_mm: _Sigma = Field(
        0.0, description="Of the eye's radius; a calibration with a radius of its own has its own."
    )
    shape: Annotated[float, Field(ge=0, le=100)] = Field(
        0.0,
        description="Of the wall's shape, in units of what eyes differ from the sphere on which "
        "their spots are read; 0 for a phantom.",
    )
    clear_layer_mm: _Sigma = Field(
        0.0, description="Thickness of a clear layer over the wall that sends the light back."
    )
    clear_layer_sigma_mm: _Sigma = Field(0.0, description="Of that thickness.")
    inverse_working_distance_sigma: _Sigma = Field(
        0.0,
        description="Of 1/(z_F + r), 1/mm: where the pinhole is; a calibration with one of its own "
        "has its own.",
    )
    size_per_mm: _Sigma = Field(
        0.0,
        description="Part by which the viewing path changes the size of a spot beyond the pinhole, "
        "per mm of c. 0.00065 behind a flat contact lens after `eyespot fit --model eye`.",
    )
    touch_sigma_mm: _Sigma = Field(
        0.0,
        description="Of the tip's distance when the calibration's withdrawals began, if the fit "
        "took it as exact. Fits of a cone or a lens contain it.",
    )
    axis_sigma_deg: _Degrees = Field(
        1.0, description="Of the beam's axis that the robot reports, across itself."
    )
    incidence_deg: Annotated[tuple[_Degrees, _Degrees], StrictType(False)] = Field(
        (0.0, 32.0),
        description="Least and largest incidence of the beam, in any direction, if no axis is "
        "known. A trocar allows 32 degrees up to c = 3 mm.",
    )
    clock_sigma_s: _Sigma = Field(
        0.0, description="Of the offset between the clocks of camera and robot."
    )
    shake_px: _Sigma = Field(
        USUAL_SHAKE_PX,
        description="Standard deviation of the image's shake along each side, px, where the mode "
        "pixels has not seen it yet: in the first frame nobody sees where the image should be. "
        "0 for a microscope that stands still.",
    )
    calibration_freedom: Annotated[float, Field(gt=0)] | None = Field(
        None,
        description="Degrees of freedom of the calibration: data minus parameters of its fit "
        "(default: infinite, as of a fit to many frames).",
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        low, high = self.incidence_deg
        if low > high:
            raise InputError(f"the least incidence, {low:g} deg, exceeds the largest, {high:g}")
        return self
