"""The table [viewing] of the scene file: what the microscope looks through."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

_FileName = Annotated[str, Field(max_length=4096)]
_Aside = Annotated[float, Field(ge=-1e3, le=1e3)]
_Nanometres = Annotated[float, Field(ge=100, le=2000)]


class Viewing(BaseModel):
    """What the microscope looks through: nothing, or a viewing lens and the eye's own optics."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    eye: _FileName = Field(
        "none",
        description="'none', an eye (navarro, liou-brennan, atchison), or the path of an eye file. "
        "An eye brings the shape of its retina. source.medium fills it; 'vitreous' is its own.",
    )
    form: Literal["phakic", "aphakic", "pseudophakic"] = Field(
        "phakic", description="With the crystalline lens, without it, or with an artificial lens."
    )
    refraction_d: float = Field(
        0.0, ge=-30, le=30, description="Refraction in dioptres, for eyes that depend on it."
    )
    lens: _FileName = Field(
        "none",
        description="'none', a viewing lens (flat, biconcave, wide-field-60, -90, -120, -130), or "
        "the path of a lens file.",
    )
    pupil_mm: float = Field(7.0, ge=0.1, le=100, description="Diameter of the dilated pupil.")
    upright: bool = Field(
        False,
        description="Turn the image of a wide-field lens, which is inverted, as a stereo inverter "
        "does.",
    )
    wavelengths_nm: tuple[_Nanometres, _Nanometres, _Nanometres] = Field(
        (610.0, 550.0, 465.0),
        description="Wavelengths of red, green and blue. Labels are those of green, and say how "
        "far the spot's centre is shifted in red and blue.",
    )
    colours: Literal["green", "own"] = Field(
        "green",
        description="Lines of sight of red and blue: green's, or their own, which takes three "
        "renderings.",
    )
    reflexes: bool = Field(
        False,
        description="Show the lamp of the microscope's coaxial light as the surfaces of the path "
        "reflect it, each once.",
    )
    lamp_mm: tuple[_Aside, _Aside] = Field(
        (21.0, 0.0),
        description="Place of that lamp in the plane of the pinhole, X and Y; for its reflexes "
        "only. The default is 6 degrees beside the axis, 200 mm above the eye.",
    )
    lamp_radius_mm: float = Field(5.0, ge=0.1, le=100, description="Radius of that lamp.")

    @property
    def through_an_eye(self) -> bool:
        """Whether the microscope looks through an eye, not through a pinhole alone."""
        return self.eye != "none"


def retina_of(content: dict[str, Any]) -> dict[str, Any]:
    """Keys of [phantom] that an eye determines: radius_mm along z, and stretch.

    Args:
        content: the table [viewing] as read; keys may be missing or wrong.

    Raises:
        InputError: no such eye, or a wrong eye file.
    """
    from optics.viewing import load_eye

    given = {key: content.get(key, Viewing.model_fields[key].default) for key in _OF_THE_EYE}
    green = given["wavelengths_nm"][1]
    eye = load_eye(given["eye"], wavelength_nm=green, refraction_d=given["refraction_d"])
    x, y, z = eye.retina_semi_axes.tolist()
    return dict(zip(OF_THE_RETINA, (z, (x / z, y / z)), strict=True))


_OF_THE_EYE = ("eye", "refraction_d", "wavelengths_nm")
OF_THE_RETINA = ("radius_mm", "stretch")
"""Keys of [phantom] that an eye determines."""
