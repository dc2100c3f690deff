"""The tables of a scene file: every key with its unit and default."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AllowInfNan, BaseModel, ConfigDict, Field

from optics import InputError
from scenes.description.motion_settings import Angle, Positive, Seed

GAUGE_DIAMETER_MM = {20: 0.91, 23: 0.64, 25: 0.51}
"""Outer diameter of vitrectomy instruments by gauge, mm."""


class SceneError(InputError):
    """A scene file is missing, invalid or impossible to render; the text says what to change."""


Length = Annotated[float, Field(ge=0, le=1e4)]
Place = Annotated[float, Field(ge=-1e4, le=1e4)]
"""A coordinate, or another length with a sign, mm."""
Pixels = Annotated[float, Field(ge=-1e6, le=1e6)]
_Coefficient = Annotated[float, Field(ge=-1e6, le=1e6)]
_Spread = Annotated[float, Field(ge=1e-4, le=1)]
_Ratio = Annotated[float, Field(ge=0.5, le=2)]
FileName = Annotated[str, Field(max_length=4096)]


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Phantom(_Settings):
    """The wall that the light falls on."""

    kind: Literal["eyeball", "plane"] = "eyeball"
    radius_mm: float = Field(
        11.5,
        ge=0.1,
        le=1000,
        description="r, radius of the eyeball, or its semi-axis along Z. The plane passes through "
        "its pole.",
    )
    stretch: tuple[_Ratio, _Ratio] = Field(
        (1.0, 1.0),
        description="Semi-axes of the eyeball along X and Y, over radius_mm; (1, 1) is a sphere.",
    )
    shift_mm: tuple[Place, Place] = Field(
        (0.0, 0.0),
        description="Shift of a stretched eyeball across the axis, X and Y.",
    )
    tilt_deg: float = Field(
        0.0, ge=0, lt=60, description="Tilt of the plane phantom, or of a stretched eyeball."
    )
    tilt_azimuth_deg: Angle = Field(
        0.0, description="Direction in which the plane's normal or the eyeball's Z leans; 0: +X."
    )
    pupil_radius_mm: Length = Field(
        0.0, description="Radius of the opening of the eyeball; 0: closed eyeball."
    )
    wall: Literal["printed paper", "retina", "uniform", "image", "photograph"] = Field(
        "printed paper",
        description="What the wall shows: a drawn fundus, one grey, wall_image, or a photograph of "
        "a fundus, 4.9 x 8.7 mm about the pole.",
    )
    reflectance: float = Field(
        0.5, ge=0, lt=1, description="Reflectance of the uniform wall, or of white in an image."
    )
    wall_image: FileName = Field(
        "",
        description="Image file (sRGB) for wall 'image'. Its centre lies at the pole, its top "
        "towards +Y.",
    )
    wall_image_mm: float = Field(
        24.0,
        ge=1e-3,
        le=1e4,
        description="Width of the image, measured along the wall through the pole.",
    )
    texture_seed: Seed = Field(1, description="Random seed of the fundus drawn on the wall.")
    coat: Literal["none", "wet", "glossy"] = Field(
        "none",
        description="Coat on the matt wall: wet, a film of water; glossy, a varnish. The result is "
        "approximate with source.kind 'lens' and with indirect 'closed form'.",
    )
    spread: Literal["none", "printed paper", "own"] = Field(
        "none",
        description="Light that the wall scatters sideways before it leaves: none, as measured on "
        "paper (0.024 mm), or own, with spread_mm. No measured length of the whole retina was "
        "found.",
    )
    spread_mm: tuple[_Spread, _Spread, _Spread] = Field(
        (0.05, 0.05, 0.05),
        description="Length L of spread 'own' for red, green and blue: light leaves the wall at a "
        "distance r from where it arrives with the weight exp(-r/L).",
    )
    indirect: Literal["closed form", "traced", "off"] = Field(
        "closed form",
        description="Light that the eyeball scatters back onto its wall. Tracing it takes seconds "
        "per frame and includes the instrument's shadow and the wall's picture.",
    )

    @property
    def stretched(self) -> bool:
        """Whether the eyeball is an ellipsoid."""
        return self.kind == "eyeball" and self.stretch != (1.0, 1.0)

    @property
    def mean_radius_mm(self) -> float:
        """Radius of the sphere that has the eyeball's area (Thomsen 2004, within 1.1 %)."""
        a, b = self.stretch
        p = 1.6075
        mean = ((a * b) ** p + a**p + b**p) / 3
        return self.radius_mm * mean ** (0.5 / p)


class SourceSettings(_Settings):
    """The fibre's light."""

    kind: Literal["lens", "cone", "photons"] = Field(
        "lens",
        description="lens: irradiance computed in advance; cone: ideal cone of light; photons: "
        "photons traced through the glass, noisy and slow, to check the lens.",
    )
    photons_per_pixel: int = Field(
        256, ge=1, le=2**24, description="Photons traced per pixel and frame with kind 'photons'."
    )
    lens: FileName = Field(
        "paper-candidate", description="Name of a preset, or path of a lens file."
    )
    cone_k: float = Field(
        20.0, ge=0.1, le=1000, description="k = 1/tan(half-angle) of the ideal cone."
    )
    cone_apex_offset_mm: Place = Field(
        -5.117, description="b, from the tip to the apex of the ideal cone along the beam."
    )
    power_mw: float = Field(
        1.0, ge=1e-9, le=1e9, description="Optical power that leaves the fibre's core."
    )
    medium: Literal["air", "water", "vitreous"] = Field(
        "air", description="Medium between the fibre and the wall."
    )


class SpotSettings(_Settings):
    """Where the beam's axis meets the wall, and from which direction."""

    eccentricity_mm: Length = Field(0.0, description="c, distance of the spot from the eye's axis.")
    azimuth_deg: Angle = Field(0.0, description="Direction of the spot from the axis; 0: +X.")
    incidence_deg: float = Field(
        30.0, ge=0, lt=80, description="Angle between the beam and the wall's normal."
    )
    incidence_azimuth_deg: Angle = Field(
        90.0, description="Direction of the beam along the wall; 0: towards larger eccentricity."
    )


class Instrument(_Settings):
    """The lighting instrument: a shaft with a bare fibre at its end."""

    visible: bool = Field(True, description="Whether the instrument is in the images.")
    gauge: Literal[20, 23, 25] = Field(23, description="Diameter of the shaft, as a gauge number.")
    fibre_diameter_mm: float = Field(0.5, ge=1e-3, le=10, description="Diameter of the bare fibre.")
    fibre_length_mm: float = Field(
        6.0, ge=1e-3, le=1e4, description="Length of bare fibre in front of the shaft."
    )


class SecondTool(_Settings):
    """A second tool without light in another trocar; it hides the wall and casts shadows."""

    visible: bool = Field(False, description="Whether the second tool is in the eye.")
    gauge: Literal[20, 23, 25] = Field(23, description="Diameter of the tool, as a gauge number.")
    tip_mm: tuple[Place, Place, Place] = Field(
        (-1.5, 1.0, -9.0), description="Position of the tool's tip, X, Y, Z in the eye's frame."
    )
    trocar_azimuth_deg: Angle = Field(
        135.0, description="Direction of the trocar from the eye's axis; 0: +X."
    )
    trocar_polar_deg: float = Field(
        48.0,
        ge=0,
        lt=90,
        description="Angle between the trocar and the eye's axis, seen from the eye's centre.",
    )


REAL_PINHOLE_HEIGHT_MM = 200.0
"""Of a microscope over an eye: `scene init --microscope real`, and every view into an eye."""


class MicroscopeSettings(_Settings):
    """The microscope: a pinhole camera whose window is centred on the position of [spot]."""

    pinhole_height_mm: Annotated[float, AllowInfNan()] = Field(
        11.5,
        gt=-1e4,
        description="z_F, height of the pinhole above the eye's centre. 11.5, on the eye's sphere, "
        "is the paper's equation; a real microscope is at about 200 (`scene init --microscope "
        "real`). With viewing.eye 11.5 becomes 200. inf: telecentric. Below the retina, "
        "magnification grows with depth, as through a contact lens.",
    )
    scale_mm_px: float = Field(
        0.0067, ge=1e-6, le=10, description="Size of a pixel on the wall at the pole."
    )
    width_px: int = Field(640, ge=16, le=8192, description="Width of the images.")
    height_px: int = Field(480, ge=16, le=8192, description="Height of the images.")
    window_offset_px: tuple[Pixels, Pixels] = Field(
        (0.0, 0.0),
        description="Shift of the window in x and y. The principal point shifts with it, so a "
        "camera calibration with a centred one is wrong. The border may cut the spot.",
    )
    light: Literal["coaxial", "ambient"] = Field(
        "coaxial",
        description="Microscope light: coaxial, from the pinhole and without shadows; ambient, "
        "equal from all sides.",
    )
    illumination_mw_mm2: float = Field(
        0.05, ge=0, le=1e9, description="Irradiance of the microscope light at the pole."
    )
    vignetting: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="Fraction of light lost in the corners of the image. The loss grows with the "
        "square of the distance from the image centre.",
    )
    distortion: tuple[_Coefficient, _Coefficient, _Coefficient, _Coefficient, _Coefficient] = Field(
        (0.0, 0.0, 0.0, 0.0, 0.0),
        description="Distortion coefficients k1, k2, p1, p2, k3 after Brown, as in OpenCV.",
    )
    numerical_aperture: float = Field(
        0.0,
        ge=0,
        le=0.3,
        description="Numerical aperture in air, towards the eye; 0: a pinhole, sharp at all "
        "heights. Above 0 the wall is blurred where it is out of focus; set samples to 64 then.",
    )
    focus_mm: Place = Field(0.0, description="Height above the pole that is in focus.")
    samples: int = Field(
        4, ge=1, le=4096, description="Samples per pixel, on a regular grid: 1, 4, 9, 16 ..."
    )


class Exposures(_Settings):
    """Exposure: how bright the images are."""

    kinds: tuple[Literal["paper", "metered"], ...] = Field(
        ("paper", "metered"),
        description="Exposures of each frame: paper, one fixed exposure; metered, by the peak of "
        "the spot in each frame.",
    )
    paper_level: float = Field(
        0.48,
        ge=1e-6,
        le=1e6,
        description="The fixed exposure gives grey level 200 at this fraction of the beam's peak "
        "irradiance at paper_distance_mm.",
    )
    paper_distance_mm: Positive = Field(5.0, description="Distance that paper_level refers to.")
    metered_peak: float = Field(
        0.8,
        ge=1e-6,
        le=1,
        description="Peak of the spot in metered frames, as a fraction of full scale.",
    )
    sensitivity_mm2_sr_mj: float = Field(
        200.0, ge=1e-9, le=1e9, description="Full wells per second and per mW/(mm2 sr) of radiance."
    )
    bound: bool = Field(
        False,
        description="Also label each image with the Cramer-Rao bound of its ellipse and distance.",
    )
    keep_linear: bool = Field(
        False,
        description="Also keep noise-free frames, so that other exposures need no new rendering.",
    )
