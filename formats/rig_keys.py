"""The tables of a rig file: microscope, camera, wall, instrument, beam, unrest, viewing, workspace.

Each key has its range, its default and its meaning, from which `eyespot rig init` and the reference
are made.
"""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, AllowInfNan, Field, model_validator
from pydantic import Strict as StrictType

from eyespot.formats.camera_sheet import CameraSheet
from eyespot.formats.inputs import InputError, Strict
from eyespot.formats.settings_files import DirectionKey, NumberKey, PairKey, ShareKey, SigmaKey
from eyespot.formats.stated import USUAL_SHAKE_PX

Medium = Literal["air", "water", "vitreous"]
_Length = Annotated[float, Field(gt=0, le=1000)]
_Scale = Annotated[float, Field(gt=0, le=100)]
_Pixels = Annotated[int, Field(ge=1, le=2**20)]


def _rising(values: tuple[float, float]) -> tuple[float, float]:
    if values[0] > values[1]:
        raise InputError(f"must be the least and the largest value; got {list(values)}")
    return values


class MicroscopeKeys(Strict):
    """The microscope: numbers of a pinhole, or a file that has them."""

    id: str = Field(
        "",
        max_length=80,
        description="Name of microscope and zoom. What a calibration and a reading share cancels "
        "in distances, so that scale_sigma counts only where no name is given or the names differ.",
    )
    calibration: str | None = Field(
        None,
        examples=['"camera.yaml"'],
        description="Camera file of OpenCV, ROS or Kalibr, or a microscope.json; relative to this "
        "file. The keys below complete it.",
    )
    width_px: _Pixels | None = Field(None, examples=["640"], description="Width of the images.")
    height_px: _Pixels | None = Field(None, examples=["480"], description="Height of the images.")
    scale_mm_px: _Scale | None = Field(
        None, examples=["0.0067"], description="Size of a pixel at the height of the retinal pole."
    )
    scale_sigma: ShareKey = Field(
        0.01, description="Relative standard uncertainty of scale_mm_px; 0: taken as exact."
    )
    principal_point_px: PairKey | None = Field(
        None,
        examples=["[319.5, 239.5]"],
        description="Where the microscope's axis meets the image, right and down from the centre "
        "of the first pixel (default: the middle). A cropped image shifts it.",
    )
    distortion: Annotated[tuple[NumberKey, ...], StrictType(False)] = Field(
        (), description="Coefficients of the lens's distortion in OpenCV's order."
    )
    pinhole_height_mm: Annotated[float, AllowInfNan()] | None = Field(
        None,
        examples=["200.0"],
        description="Height of the pinhole above the eyeball's centre; inf: telecentric.",
    )
    pinhole_height_sigma_mm: SigmaKey = Field(
        5.0, description="Standard uncertainty of the height."
    )


class CameraKeys(Strict):
    """The camera: what the images' values mean, and their noise."""

    bit_depth: Annotated[int, Field(ge=8, le=16)] = Field(
        8, description="Bits that the camera uses per channel."
    )
    full_scale: Annotated[float, Field(gt=0, le=1e12)] | None = Field(
        None,
        examples=["4095.0"],
        description="Largest value (default: of the bit depth, if this is above 8).",
    )
    black_level_dn: Annotated[float, Field(ge=0, le=1e5)] = Field(
        0.0, description="Mean value of a dark image."
    )
    response: Literal["linear", "srgb"] | Annotated[float, Field(gt=0, le=100)] | None = Field(
        None,
        examples=['"linear"'],
        description="'linear' | 'srgb' | the exponent of a gamma curve (default: the file's, else "
        "linear).",
    )
    limited_range: bool = Field(
        False, description="Whether black is at 16 and white at 235 of 255, as in video."
    )
    noise: Literal["recording"] | CameraSheet | None = Field(
        None,
        examples=['"recording"'],
        description="'recording': measured in the images themselves; or a table "
        "[camera.noise] with full_well_e, read_noise_e, ..., as `eyespot camera` measures it "
        "(default: of the microscope.json if it has one, else recording).",
    )


class WallKeys(Strict):
    """The wall that the light falls on, and the medium before it."""

    kind: Literal["eyeball", "plane"] | None = Field(
        None, examples=['"eyeball"'], description="Shape of the wall (default: the file's)."
    )
    normal: DirectionKey = Field(
        (0.0, 0.0, 1.0),
        description="Normal of a plane, towards the microscope; 0, 0, 1 is square to its axis.",
    )
    radius_mm: _Length | None = Field(
        None,
        examples=["12.0"],
        description="Radius of the eyeball (of the layer that sends the light back); the pole of "
        "any wall lies at -radius_mm.",
    )
    radius_sigma_mm: SigmaKey = Field(0.3, description="Standard uncertainty of the radius.")
    tissue: Literal["phantom", "retina"] = Field(
        "phantom", description="Of a retina, shape and clear layer are those of eyes."
    )
    shape: Annotated[float, Field(ge=0, le=100)] | None = Field(
        None,
        examples=["1.0"],
        description="Uncertainty of the eyeball's shape, in units of what healthy eyes differ from "
        "a sphere (default: 0 of a phantom, 1 of a retina).",
    )
    clear_layer_mm: SigmaKey | None = Field(
        None,
        examples=["0.25"],
        description="Thickness of a clear layer of index 1.36 over the wall that sends the light "
        "back. Distances reach through it (default: 0 of a phantom, 0.25 of a retina).",
    )
    clear_layer_sigma_mm: SigmaKey | None = Field(
        None,
        examples=["0.06"],
        description="Standard uncertainty of it (default: 0 of a phantom, 0.06 of a retina).",
    )
    medium: Medium | None = Field(
        None, examples=['"vitreous"'], description="Medium between the tip and the wall."
    )


RETINA = {"shape": 1.0, "clear_layer_mm": 0.25, "clear_layer_sigma_mm": 0.06}
"""Of `wall.tissue` "retina": most light comes back from the pigment epithelium and what lies below
it. The retina over it is 0.2 to 0.3 mm thick, thinner at the fovea's centre, thicker at its rim."""


class InstrumentKeys(Strict):
    """The instrument: the fibre that carries the light."""

    fibre_diameter_mm: Annotated[float, Field(gt=0, le=50)] = Field(
        0.5, description="Diameter of the tip's face, whose rim touches the wall first."
    )
    fibre_length_mm: _Length = Field(6.0, description="Length of bare fibre before the shaft.")
    core_radius_mm: _Length | None = Field(
        None,
        examples=["0.25"],
        description="Radius of the core that the light fills; a lens's fit begins with it. With "
        "robot.touch = 'free' the distances rest on it.",
    )
    core_radius_sigma: ShareKey = Field(0.01, description="Relative uncertainty of core_radius_mm.")
    glue_index: Annotated[float, Field(ge=1, le=4)] = Field(
        1.49, description="Refractive index of the drop of glue, where no lens is named."
    )
    glue_index_sigma: ShareKey = Field(0.002, description="Standard uncertainty of it.")
    rim_height_sigma_mm: SigmaKey = Field(
        0.05,
        description="By how much the drop's rim may stand above the core's face, where no lens is "
        "named; 0: they are level.",
    )
    visible: bool = Field(True, description="Whether the images show the instrument.")


class BeamKeys(Strict):
    """The beam: a calibration, or for studies a cone that leaves instrument.core_radius_mm."""

    half_angle_deg: Annotated[float, Field(ge=0.01, le=80)] | None = Field(
        None,
        examples=["2.86"],
        description="Half-angle of the cone in wall.medium. Studies take it; its apex lies "
        "core_radius_mm / tan(half_angle) behind the tip.",
    )
    numerical_aperture: Annotated[float, Field(ge=1e-3, le=0.95)] | None = Field(
        None,
        examples=["0.12"],
        description="Numerical aperture of the light that leaves the fibre, instead of the "
        "half-angle.",
    )
    calibration: str | None = Field(
        None,
        examples=['"beam.json"'],
        description="File of `eyespot fit`, relative to this file; gives distances.",
    )
    calibration_freedom: Annotated[float, Field(gt=0)] | None = Field(
        None,
        examples=["20.0"],
        description="Degrees of freedom of the calibration (default: infinite).",
    )


class UnrestKeys(Strict):
    """What does not keep still."""

    shake_px: SigmaKey = Field(
        USUAL_SHAKE_PX,
        description="Standard deviation of the image's shake along each side, where the mode "
        "pixels has not seen it yet.",
    )


class ViewingKeys(Strict):
    """What a viewing lens and the eye's optics add."""

    size_per_mm: SigmaKey = Field(
        0.0,
        description="Part by which the viewing path changes the size of a spot beyond the pinhole, "
        "per mm of eccentricity; 0.00065 behind a flat contact lens after `fit --model eye`.",
    )


_Range = Annotated[PairKey, AfterValidator(_rising)]


class WorkspaceKeys(Strict):
    """Where the tip works: ranges for studies and maps."""

    eccentricity_mm: _Range | None = Field(
        None,
        examples=["[0.0, 5.0]"],
        description="c, distance of the spot from the microscope's axis (default: 0 to 0.7 "
        "wall.radius_mm).",
    )
    distance_mm: _Range = Field((0.5, 6.0), description="d, from the tip to the wall.")
    tilt_deg: _Range = Field(
        (0.0, 30.0), description="Angle between the beam and the wall's normal."
    )
    azimuth_deg: _Range = Field(
        (0.0, 360.0),
        description="Direction of the beam along the wall; 0: towards larger eccentricity.",
    )

    @model_validator(mode="after")
    def _lies_in_an_eye(self) -> Self:
        for name in ("eccentricity_mm", "distance_mm", "tilt_deg"):
            if (values := getattr(self, name)) is not None and values[0] < 0:
                raise InputError(f"{name} must not be negative; got {list(values)}")
        if not self.distance_mm[0] > 0:
            raise InputError(
                f"distance_mm must be above 0; got {list(self.distance_mm)}. At 0 the tip touches"
            )
        if self.tilt_deg[1] >= 80:
            raise InputError(f"tilt_deg must lie below 80 degrees; got {list(self.tilt_deg)}")
        return self
