"""The tables of a scene file, each key with its unit, range and default."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AllowInfNan, BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

from eyespot.formats.inputs import InputError, shortened

MOST_FRAMES = 100_000
"""Most frames of a scene. Their labels take a minute and 1 GB, their images days."""
MOST_HZ = 1e5
_MAX_LENGTH_MM = 1e4  # larger than any room; squares of it are exact to a nanometre
_MOST_S = 1e6
_MAX_HAND_S = 600.0  # its top speed is sought at steps of 1 ms, in 1 GB
_MIN_DIVISOR = 1e-6  # least length or speed that something is divided by

Positive = Annotated[float, Field(ge=_MIN_DIVISOR, le=_MAX_LENGTH_MM)]
"""A length in mm, or a speed in mm/s."""
_Seconds = Annotated[float, Field(ge=0, le=_MOST_S)]
_Hertz = Annotated[float, Field(ge=_MIN_DIVISOR, le=MOST_HZ)]
_Share = Annotated[float, Field(ge=0, le=1)]
_Part = Annotated[float, Field(ge=0, lt=1)]
"""A share below 1."""
_Any = Annotated[float, Field(ge=1e-9, le=1e9)]
"""A positive number that has no other limits."""
Angle = Annotated[float, Field(ge=-3600, le=3600)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


class SceneTable(BaseModel):
    """A table of a scene file: frozen, without other keys, with finite numbers.

    No value is converted: `true` is no number, and "off" is not false.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)

    @model_validator(mode="before")
    @classmethod
    def _lists_are_tuples(cls, content: Any) -> Any:
        """TOML and JSON have lists for our tuples."""
        if not isinstance(content, Mapping):
            return content
        return {key: tuple(v) if isinstance(v, list) else v for key, v in content.items()}


class Withdrawal(SceneTable):
    """The tip withdraws along the beam at constant speed."""

    kind: Literal["withdrawal"] = Field(
        "withdrawal",
        description="'withdrawal' | 'scan' | 'hand' | 'recorded'; the others follow below.",
    )
    start_mm: Annotated[float, Field(ge=0, le=_MAX_LENGTH_MM)] | Literal["contact"] = Field(
        "contact",
        description="First distance along the beam; 'contact': the tip's rim touches the wall.",
    )
    travel_mm: Positive = Field(6.0, description="Distance that the tip withdraws.")
    frames: int = Field(
        61, ge=1, le=MOST_FRAMES, description="Number of frames, evenly spaced over the travel."
    )
    speed_mm_s: Positive = Field(0.1, description="Speed of the tip.")


class _NamedMotion(SceneTable):
    """A motion that needs the key `kind`; without that key the motion is a withdrawal."""

    model_config = ConfigDict(json_schema_extra={"required": ["kind"]})


_TROCAR = (
    "Distance along the beam from the spot to the point about which the instrument pivots; inf: "
    "the beam keeps its direction."
)


class Scan(_NamedMotion):
    """The spot moves along the wall in a line through [spot], at constant distance."""

    kind: Literal["scan"] = "scan"
    distance_mm: Positive = Field(3.0, description="Distance along the beam.")
    length_mm: Positive = Field(1.5, description="Length of the spot's path.")
    direction_deg: Angle = Field(
        0.0, description="Direction of the path; 0: towards larger eccentricity."
    )
    speed_mm_s: Positive = Field(1.0, description="Speed of the spot.")
    trocar_mm: Annotated[float, AllowInfNan(), Field(gt=0)] = Field(20.0, description=_TROCAR)


class Hand(_NamedMotion):
    """A synthetic hand moves the tip near [spot]; the robot damps its tremor.

    Tremor: 0.18 mm RMS in total (Singh and Riviere 2002) at 8-12 Hz (Wells et al. 2013). Voluntary
    motion: 99 % of its power lies below 2 Hz (Riviere, Rader and Khosla 1997). The damping by the
    robot is an assumption.
    """

    kind: Literal["hand"] = "hand"
    distance_mm: Positive = Field(3.0, description="Mean distance along the beam.")
    duration_s: float = Field(
        6.0, ge=_MIN_DIVISOR, le=_MAX_HAND_S, description="Duration of the trial."
    )
    top_speed_mm_s: Positive = Field(
        5.0, description="Highest speed of the tip; the slow motion is scaled to reach it."
    )
    tremor_rms_mm: float = Field(
        0.18, ge=0, le=_MAX_LENGTH_MM, description="Tremor before the robot damps it."
    )
    damping: _Share = Field(
        0.95, description="Fraction of the tremor that the robot removes (an assumption)."
    )
    trocar_mm: Annotated[float, AllowInfNan(), Field(gt=0)] = Field(20.0, description=_TROCAR)
    seed: Seed = Field(0, description="Random seed of the motion.")


class Recorded(_NamedMotion):
    """The tip follows recorded poses: a CSV file, or a ROS bag in the eye's frame."""

    kind: Literal["recorded"] = "recorded"
    file: str = Field(
        "kinematics.csv",
        max_length=4096,
        description="File with the columns time_s, x_mm, y_mm, z_mm (tip), axis_x, axis_y, axis_z "
        "in the eye's frame.",
    )


UNNAMED = "withdrawal"
"""The motion of a scene without `motion.kind`."""

MOTIONS: dict[str, type[SceneTable]] = {
    model.model_fields["kind"].default: model for model in (Withdrawal, Scan, Hand, Recorded)
}


def _kind_of_motion(motion: Any) -> str:
    """The kind of a motion: a withdrawal if none is given."""
    kind = getattr(motion, "kind", UNNAMED)
    if isinstance(motion, dict):
        kind = motion.get("kind", UNNAMED)
    return kind if isinstance(kind, str) else shortened(kind)


Motion = Annotated[
    Annotated[Withdrawal, Tag("withdrawal")]
    | Annotated[Scan, Tag("scan")]
    | Annotated[Hand, Tag("hand")]
    | Annotated[Recorded, Tag("recorded")],
    Discriminator(_kind_of_motion),
]


class Clocks(SceneTable):
    """Clocks of the camera and of the robot. Times are those of the camera's clock."""

    camera_hz: _Hertz = Field(
        10.0, description="Frame rate; a withdrawal sets its own number of frames."
    )
    camera_jitter_s: _Seconds = Field(
        0.0, description="Standard deviation of the times at which frames are taken."
    )
    kinematics_hz: _Hertz = Field(200.0, description="Poses per second from the robot.")
    kinematics_offset_s: Annotated[float, Field(ge=-_MOST_S, le=_MOST_S)] = Field(
        0.0, description="Time by which the robot's clock is ahead of the camera's."
    )
    kinematics_jitter_s: _Seconds = Field(
        0.0, description="Standard deviation of the time stamps of poses."
    )
    seed: Seed = Field(0, description="Random seed of both jitters.")


# A full well of 1e15 electrons makes a camera without noise.
_NonNegative = Annotated[float, Field(ge=0, le=1e15)]
_Positive = Annotated[float, Field(ge=1e-3, le=1e15)]


class CameraSettings(SceneTable):
    """The camera: its data sheet (EMVA 1288) and its image format.

    The defaults describe an 8-bit USB microscope with a full well of 5,000 electrons. Its temporal
    noise is 3 DN per channel at 180 DN.
    """

    full_well_e: _Positive = Field(5000.0, description="Full well: electrons at full scale.")
    read_noise_e: _NonNegative = Field(
        10.0, description="Read noise: temporal standard deviation of a dark pixel, electrons."
    )
    dark_signal_e: _NonNegative = Field(
        0.0, description="Dark signal: mean thermal electrons per pixel and exposure."
    )
    prnu: _Part = Field(
        0.0, description="PRNU: standard deviation of the pixels' gain, relative to its mean."
    )
    dsnu_e: _NonNegative = Field(
        0.0, description="DSNU: standard deviation of the pixels' dark signal, electrons."
    )
    black_level_dn: _NonNegative = Field(
        4.0, description="Mean value of a dark image before the response curve, DN."
    )
    bit_depth: int = Field(8, ge=8, le=16, description="Bits per channel in the file.")
    response: Literal["linear", "srgb"] | Annotated[float, Field(ge=0.01, le=100)] = Field(
        "linear",
        description='Response curve: "linear", "srgb" (IEC 61966-2-1), or a number g for x^(1/g).',
    )
    bayer: Literal["none", "RGGB", "BGGR", "GRBG", "GBRG"] = Field(
        "none",
        description="Bayer filter: colours of the first two rows. Other colours are interpolated.",
    )
    jpeg_quality: Annotated[int, Field(ge=0, le=100)] = Field(
        0, description="JPEG quality, with 4:2:2 colour as in USB video; 0: no JPEG."
    )

    @property
    def dark_variance_e2(self) -> float:
        """Variance of a pixel without electrons, electrons²: of reading and of rounding."""
        return self.read_noise_e**2 + 1 / (12 * self.system_gain**2)

    @model_validator(mode="after")
    def _is_possible(self) -> "CameraSettings":
        if self.black_level_dn >= self.full_scale_dn:
            raise InputError(
                f"CameraSettings(black_level_dn=...) must lie below full scale; got black_level_dn="
                f"{self.black_level_dn:g} DN, full scale {self.full_scale_dn} DN at bit_depth="
                f"{self.bit_depth}. Lower black_level_dn or raise bit_depth."
            )
        if self.jpeg_quality and self.bit_depth != 8:
            raise InputError(
                f"CameraSettings(jpeg_quality=...) needs 8 bits; got jpeg_quality="
                f"{self.jpeg_quality} at bit_depth={self.bit_depth}. Set bit_depth to 8 or "
                "jpeg_quality to 0."
            )
        return self

    @property
    def full_scale_dn(self) -> int:
        """Largest digital number (DN)."""
        return (1 << self.bit_depth) - 1

    @property
    def system_gain(self) -> float:
        """Overall system gain K before the response curve, DN per electron."""
        return (self.full_scale_dn - self.black_level_dn) / self.full_well_e

    def sensor_shape(self, *, height: int, width: int) -> tuple[int, ...]:
        """Shape of the raw frames: one value per pixel with a Bayer filter, otherwise three."""
        return (height, width, 3) if self.bayer == "none" else (height, width)


FileName = Annotated[str, Field(max_length=4096)]
_Aside = Annotated[float, Field(ge=-1e3, le=1e3)]
_Nanometres = Annotated[float, Field(ge=100, le=2000)]


class Viewing(SceneTable):
    """What the microscope looks through: nothing, or a viewing lens and the eye's own optics."""

    eye: FileName = Field(
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
    lens: FileName = Field(
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
    from eyespot.optics.viewing.schematic_eye import load_eye

    given = {key: content.get(key, Viewing.model_fields[key].default) for key in _OF_THE_EYE}
    green = given["wavelengths_nm"][1]
    eye = load_eye(given["eye"], wavelength_nm=green, refraction_d=given["refraction_d"])
    x, y, z = eye.retina_semi_axes.tolist()
    return dict(zip(OF_THE_RETINA, (z, (x / z, y / z)), strict=True))


_OF_THE_EYE = ("eye", "refraction_d", "wavelengths_nm")
OF_THE_RETINA = ("radius_mm", "stretch")
"""Keys of [phantom] that an eye determines."""


GAUGE_DIAMETER_MM = {20: 0.91, 23: 0.64, 25: 0.51}
"""Outer diameter of vitrectomy instruments by gauge, mm."""


class SceneError(InputError):
    """A scene file is missing, invalid or impossible to render; the text says what to change."""


class OutsideWindow(SceneError):
    """A spot leaves the microscope's window.

    Attributes:
        needed_px: width and height of a window that shows it whole.
    """

    def __init__(self, message: str, needed_px: tuple[int, int]) -> None:
        super().__init__(message)
        self.needed_px = needed_px


Length = Annotated[float, Field(ge=0, le=1e4)]
Place = Annotated[float, Field(ge=-1e4, le=1e4)]
"""A coordinate, or another length with a sign, mm."""
Pixels = Annotated[float, Field(ge=-1e6, le=1e6)]
_Coefficient = Annotated[float, Field(ge=-1e6, le=1e6)]
_Spread = Annotated[float, Field(ge=1e-4, le=1)]
_Ratio = Annotated[float, Field(ge=0.5, le=2)]


class Phantom(SceneTable):
    """The wall that the light falls on."""

    kind: Literal["eyeball", "plane"] = "eyeball"
    radius_mm: Annotated[float, Field(ge=0.1, le=1000)] = Field(
        11.5,
        description="r, radius of the eyeball, or its semi-axis along Z. The plane passes through "
        "its pole.",
    )
    stretch: tuple[_Ratio, _Ratio] = Field(
        (1.0, 1.0),
        description="Semi-axes of the eyeball along X and Y, over radius_mm; (1, 1) is a sphere.",
    )
    shift_mm: tuple[Place, Place] = Field(
        (0.0, 0.0), description="Shift of a stretched eyeball across the axis, X and Y."
    )
    tilt_deg: float = Field(
        0.0, ge=0, lt=60, description="Tilt of the plane phantom, or of a stretched eyeball."
    )
    tilt_azimuth_deg: Angle = Field(
        0.0, description="Direction in which the plane's normal or the eyeball's Z leans; 0: +X."
    )
    clear_layer_mm: Length = Field(
        0.0,
        description="Thickness of a clear layer over the wall, as a retina's: a tip at contact "
        "touches its surface. Its refraction, 3 um at 30 degrees, is left out.",
    )
    pupil_radius_mm: Length = Field(
        0.0, description="Radius of the opening of the eyeball; 0: closed eyeball."
    )
    wall: Literal["printed paper", "retina", "uniform", "image", "photograph"] = Field(
        "printed paper",
        description="What the wall shows: a drawn fundus, one grey, wall_image, or a photograph of "
        "a fundus, 4.9 x 8.7 mm about the pole.",
    )
    reflectance: _Part = Field(
        0.5, description="Reflectance of the uniform wall, or of white in an image."
    )
    wall_image: FileName = Field(
        "",
        description="Image file (sRGB) for wall 'image'. Its centre lies at the pole, its top "
        "towards +Y.",
    )
    wall_image_mm: Annotated[float, Field(ge=1e-3, le=1e4)] = Field(
        24.0, description="Width of the image, measured along the wall through the pole."
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


PAPER_CORE_MM = 0.25585
"""-b/k of the default cone, whose k 20 and b -5.117 mm are the paper's."""
CONE_AT_THE_TIP = ("cone_core_radius_mm", "cone_apex_offset_mm")
"""Two keys for one fact; the one that is not given follows from the other."""


def _apex_offset_mm(
    *, cone_k: float = 0.0, cone_core_radius_mm: float = 0.0, **rest: object
) -> float:
    """b of a cone that leaves a core, mm; 0 if a key that it follows from is refused."""
    return round(-cone_k * cone_core_radius_mm, 9)


class SourceSettings(SceneTable):
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
    cone_core_radius_mm: Annotated[float, Field(ge=0, le=10)] = Field(
        PAPER_CORE_MM, description="Radius of the ideal cone at the tip, -b/k."
    )
    cone_apex_offset_mm: Place = Field(
        default_factory=lambda known: _apex_offset_mm(**known),
        examples=[-5.117],
        description="b, from the tip to the apex of the ideal cone along the beam. Without this "
        "key it follows from the core: -cone_k * cone_core_radius_mm.",
    )
    power_mw: _Any = Field(1.0, description="Optical power that leaves the fibre's core.")
    medium: Literal["air", "water", "vitreous"] = Field(
        "air", description="Medium between the fibre and the wall."
    )

    @model_validator(mode="after")
    def _core_and_apex_agree(self) -> "SourceSettings":
        """Derive the core's radius from a given b; refuse two that contradict each other."""
        core = max(0.0, -self.cone_apex_offset_mm / self.cone_k)
        if self.model_fields_set >= {*CONE_AT_THE_TIP}:
            if not math.isclose(core, self.cone_core_radius_mm, rel_tol=1e-6, abs_tol=1e-9):
                raise InputError(
                    "cone_core_radius_mm and cone_apex_offset_mm contradict each other; got "
                    f"{self.cone_core_radius_mm:g} mm and b = {self.cone_apex_offset_mm:g} mm, "
                    f"which is {core:g} mm at the tip for cone_k = {self.cone_k:g}. Remove one of "
                    "them."
                )
        elif "cone_apex_offset_mm" in self.model_fields_set:
            self.__dict__["cone_core_radius_mm"] = core  # the instance is frozen from here on
        return self


class SpotSettings(SceneTable):
    """Where the beam's axis meets the wall, and from which direction."""

    eccentricity_mm: Length = Field(0.0, description="c, distance of the spot from the eye's axis.")
    azimuth_deg: Angle = Field(0.0, description="Direction of the spot from the axis; 0: +X.")
    incidence_deg: float = Field(
        30.0, ge=0, lt=80, description="Angle between the beam and the wall's normal."
    )
    incidence_azimuth_deg: Angle = Field(
        90.0, description="Direction of the beam along the wall; 0: towards larger eccentricity."
    )


class Instrument(SceneTable):
    """The lighting instrument: a shaft with a bare fibre at its end."""

    visible: bool = Field(True, description="Whether the instrument is in the images.")
    gauge: Literal[20, 23, 25] = Field(23, description="Diameter of the shaft, as a gauge number.")
    fibre_diameter_mm: float = Field(0.5, ge=1e-3, le=10, description="Diameter of the bare fibre.")
    fibre_length_mm: float = Field(
        6.0, ge=1e-3, le=1e4, description="Length of bare fibre in front of the shaft."
    )


class SecondTool(SceneTable):
    """A second tool without light in another trocar; it hides the wall and casts shadows."""

    visible: bool = Field(False, description="Whether the second tool is in the eye.")
    gauge: Literal[20, 23, 25] = Field(23, description="Diameter of the tool, as a gauge number.")
    tip_mm: tuple[Place, Place, Place] = Field(
        (-1.5, 1.0, -9.0), description="Position of the tool's tip, X, Y, Z in the eye's frame."
    )
    trocar_azimuth_deg: Angle = Field(
        135.0, description="Direction of the trocar from the eye's axis; 0: +X."
    )
    trocar_polar_deg: Annotated[float, Field(ge=0, lt=90)] = Field(
        48.0, description="Angle between the trocar and the eye's axis, seen from the eye's centre."
    )


REAL_PINHOLE_HEIGHT_MM = 200.0
"""Of a microscope over an eye: `scene init --microscope real`, and every view into an eye."""


class MicroscopeSettings(SceneTable):
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
    vignetting: _Part = Field(
        0.0,
        description="Fraction of light lost in the corners of the image. The loss grows with the "
        "square of the distance from the image centre.",
    )
    distortion: tuple[_Coefficient, _Coefficient, _Coefficient, _Coefficient, _Coefficient] = Field(
        (0.0, 0.0, 0.0, 0.0, 0.0),
        description="Distortion coefficients k1, k2, p1, p2, k3 after Brown, as in OpenCV.",
    )
    numerical_aperture: Annotated[float, Field(ge=0, le=0.3)] = Field(
        0.0,
        description="Numerical aperture in air, towards the eye; 0: a pinhole, sharp at all "
        "heights. Above 0 the wall is blurred where it is out of focus; set samples to 64 then.",
    )
    focus_mm: Place = Field(0.0, description="Height above the pole that is in focus.")
    samples: Annotated[int, Field(ge=1, le=4096)] = Field(
        4,
        description="Samples per pixel, on a square grid: 1, 4, 9, 16 ... From 4 on, the mean of "
        "a lens's light over a pixel is exact up to the third degree.",
    )


class Exposures(SceneTable):
    """Exposure: how bright the images are."""

    kinds: tuple[Literal["paper", "metered"], ...] = Field(
        ("paper", "metered"),
        description="Exposures of each frame: paper, one fixed exposure; metered, by the peak of "
        "the spot in each frame.",
    )
    paper_level: Annotated[float, Field(ge=1e-6, le=1e6)] = Field(
        0.48,
        description="The fixed exposure gives grey level 200 at this fraction of the beam's peak "
        "irradiance at paper_distance_mm.",
    )
    paper_distance_mm: Positive = Field(5.0, description="Distance that paper_level refers to.")
    metered_peak: Annotated[float, Field(ge=1e-6, le=1)] = Field(
        0.8, description="Peak of the spot in metered frames, as a fraction of full scale."
    )
    sensitivity_mm2_sr_mj: _Any = Field(
        200.0, description="Full wells per second and per mW/(mm2 sr) of radiance."
    )
    bound: bool = Field(
        False,
        description="Also label each image with the Cramer-Rao bound of its ellipse and distance.",
    )
    keep_linear: bool = Field(
        False,
        description="Also keep noise-free frames, so that other exposures need no new rendering.",
    )
