"""A scene: every key with its unit and default, validated before anything is rendered."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from scenes.description.camera_settings import CameraSettings
from scenes.description.motion_settings import Clocks, Motion, Withdrawal

GAUGE_DIAMETER_MM = {20: 0.91, 23: 0.64, 25: 0.51}
"""Outer diameter of vitrectomy instruments by gauge, mm."""


class SceneError(ValueError):
    """A scene is missing, broken, or describes what cannot be; the text says what to change."""


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Phantom(_Settings):
    """The wall that the light falls on."""

    kind: Literal["eyeball", "plane"] = "eyeball"
    radius_mm: float = Field(11.5, gt=0, description="r; the plane passes through the pole too.")
    tilt_deg: float = Field(0.0, ge=0, lt=60, description="Of the plane phantom about the pole.")
    tilt_azimuth_deg: float = Field(0.0, description="Towards which the plane's normal leans.")
    pupil_radius_mm: float = Field(
        0.0, ge=0, description="Of the eyeball's opening, where light is lost; 0: closed."
    )
    wall: Literal["printed paper", "retina", "uniform", "image"] = "printed paper"
    reflectance: float = Field(
        0.5, ge=0, lt=1, description="Of the uniform wall, or of an image's white."
    )
    wall_image: str = Field(
        "", description="File of wall 'image', sRGB; its middle at the pole, its top towards +Y."
    )
    wall_image_mm: float = Field(
        24.0, gt=0, description="Width of the image: along the wall, as an arc through the pole."
    )
    texture_seed: int = Field(1, ge=0, description="Seed of the fundus drawn on the wall.")
    coat: Literal["none", "wet", "glossy"] = Field(
        "none",
        description="On the matt wall: wet, a film of water, or glossy, a varnish. Approximate "
        "with source.kind 'lens', whose light has no directions, and with the closed form.",
    )
    indirect: Literal["closed form", "traced", "off"] = Field(
        "closed form",
        description="Light scattered back by the closed eyeball; traced: seconds a frame, with "
        "the instrument's shadow and the wall's picture in it.",
    )


class Source(_Settings):
    """The fibre's light."""

    kind: Literal["lens", "cone", "photons"] = Field(
        "lens", description="photons: the lens as real glass, noisy and slow; the lens's referee."
    )
    photons_per_pixel: int = Field(256, ge=1, description="Traced for a frame of kind photons.")
    lens: str = Field("paper-candidate", description="Preset name or path of a lens file.")
    cone_k: float = Field(20.0, gt=0, description="1/tan(half-angle) of the ideal cone.")
    cone_apex_offset_mm: float = Field(-5.117, description="b of the ideal cone.")
    power_mw: float = Field(1.0, gt=0, description="Leaving the fibre's core.")
    medium: Literal["air", "water", "vitreous"] = "air"


class Spot(_Settings):
    """Where the beam's axis meets the wall, and from which direction."""

    eccentricity_mm: float = Field(0.0, ge=0, description="c of the spot.")
    azimuth_deg: float = 0.0
    incidence_deg: float = Field(30.0, ge=0, lt=80)
    incidence_azimuth_deg: float = Field(
        90.0, description="0: the beam travels towards growing eccentricity."
    )


class Instrument(_Settings):
    """Shaft with a bare fibre that reaches past it."""

    visible: bool = Field(True, description="Seen, and hiding what lies behind it.")
    gauge: Literal[20, 23, 25] = 23
    fibre_diameter_mm: float = Field(0.5, gt=0)
    fibre_length_mm: float = Field(6.0, gt=0, description="Of bare fibre past the shaft.")


class SecondTool(_Settings):
    """A passive tool through another trocar: it hides and shades, and gives no light."""

    visible: bool = Field(False, description="In the eye at all.")
    gauge: Literal[20, 23, 25] = 23
    tip_mm: tuple[float, float, float] = Field(
        (-1.5, 1.0, -9.0), description="X, Y, Z in the eye's frame."
    )
    trocar_azimuth_deg: float = Field(135.0, description="Of the trocar about the axis; 0: +X.")
    trocar_polar_deg: float = Field(
        48.0, ge=0, lt=90, description="Of the trocar from the axis, seen from the eye's centre."
    )


class MicroscopeSettings(_Settings):
    """Pinhole microscope; its window is centred on the place of [spot]."""

    pinhole_height_mm: float = Field(11.5, description="z_F above the eye's centre; inf allowed.")
    scale_mm_px: float = Field(0.0067, gt=0, description="At the pole.")
    width_px: int = Field(640, ge=16, le=8192)
    height_px: int = Field(480, ge=16, le=8192)
    window_offset_px: tuple[float, float] = Field(
        (0.0, 0.0),
        description="Of the window's middle from that place, in x and y; other than zero, the "
        "border may cut the spot.",
    )
    light: Literal["coaxial", "ambient"] = Field(
        "coaxial", description="From the pinhole, without shadows; or from all sides alike."
    )
    illumination_mw_mm2: float = Field(0.05, ge=0, description="Its irradiance at the pole.")
    vignetting: float = Field(
        0.0,
        ge=0,
        lt=1,
        description="Part of the light lost in the window's corners; grows with the square of the "
        "distance from its middle.",
    )
    distortion: tuple[float, float, float, float, float] = Field(
        (0.0, 0.0, 0.0, 0.0, 0.0),
        description="k1, k2, p1, p2, k3 of Brown's lens, as OpenCV has them.",
    )
    numerical_aperture: float = Field(
        0.0,
        ge=0,
        le=0.3,
        description="On the eye's side; 0: a pinhole, sharp everywhere. Above, walls out of focus "
        "are blurred, and samples counts lines of sight through the lens too: take 64.",
    )
    focus_mm: float = Field(0.0, description="Height in focus above the retinal pole.")
    samples: int = Field(4, ge=1, description="Per pixel, on a regular grid: 1, 4, 9, 16 …")


class Exposures(_Settings):
    """How each linear frame is exposed."""

    kinds: tuple[Literal["paper", "metered"], ...] = ("paper", "metered")
    paper_level: float = Field(
        0.48,
        gt=0,
        description="Grey level 200 of the fixed exposure lies at this part of the beam's peak "
        "irradiance at paper_distance_mm.",
    )
    paper_distance_mm: float = Field(5.0, gt=0)
    metered_peak: float = Field(0.8, gt=0, le=1, description="Spot's peak as part of full scale.")
    sensitivity_mm2_sr_mj: float = Field(
        200.0, gt=0, description="Full wells per mW/(mm2 sr) of radiance and second."
    )
    keep_linear: bool = Field(
        False, description="Keep noise-free frames, to expose again without rendering."
    )


class Scene(_Settings):
    """One trial: everything that an image stack depends on."""

    schema_version: Literal[1] = Field(1, alias="schema")
    seed: int = Field(0, ge=0, description="Of the camera's noise.")
    phantom: Phantom = Phantom()
    source: Source = Source()
    spot: Spot = Spot()
    motion: Motion = Withdrawal()
    clocks: Clocks = Clocks()
    instrument: Instrument = Instrument()
    second_tool: SecondTool = SecondTool()
    microscope: MicroscopeSettings = MicroscopeSettings()
    camera: CameraSettings = CameraSettings()
    exposures: Exposures = Exposures()

    @property
    def approximations(self) -> list[str]:
        """What about its images is not exact, for those who use them."""
        phantom, found = self.phantom, []
        if phantom.coat != "none" and self.source.kind == "lens":
            found.append("the lens's light has no directions: highlights are those of its mean one")
        if phantom.coat != "none" and phantom.kind == "eyeball":
            if phantom.indirect == "closed form":
                found.append("indirect light is that of the wall without its coat")
        return found

    @model_validator(mode="after")
    def _is_possible(self) -> Scene:
        r, c = self.phantom.radius_mm, self.spot.eccentricity_mm
        if c >= r:
            raise ValueError(
                f"spot.eccentricity_mm must be smaller than phantom.radius_mm; got {c:g} mm with "
                f"radius {r:g} mm. Lower eccentricity_mm."
            )
        if self.microscope.pinhole_height_mm < -r * 0.5:
            raise ValueError(
                "microscope.pinhole_height_mm must lie well above the retina; got "
                f"{self.microscope.pinhole_height_mm:g} mm with radius {r:g} mm. Raise it."
            )
        if math.isinf(self.microscope.pinhole_height_mm) and any(self.microscope.distortion):
            raise ValueError(
                "microscope.distortion counts in units of the focal length, which a telecentric "
                f"microscope lacks; got {list(self.microscope.distortion)} with pinhole_height_mm "
                "= inf. Set it to zeros or lower pinhole_height_mm."
            )
        if self.phantom.wall == "image" and not self.phantom.wall_image:
            raise ValueError("phantom.wall 'image' needs phantom.wall_image, the file's path.")
        if self.phantom.pupil_radius_mm and self.phantom.kind == "plane":
            raise ValueError(
                "phantom.pupil_radius_mm opens the eyeball phantom only; got "
                f"{self.phantom.pupil_radius_mm:g} mm with kind 'plane'. Set it to 0."
            )
        if self.phantom.pupil_radius_mm >= r:
            raise ValueError(
                "phantom.pupil_radius_mm must be smaller than phantom.radius_mm; got "
                f"{self.phantom.pupil_radius_mm:g} mm with radius {r:g} mm. Lower it."
            )
        if self.second_tool.visible and math.hypot(*self.second_tool.tip_mm) >= r:
            raise ValueError(
                f"second_tool.tip_mm must lie inside the eye of radius {r:g} mm; got "
                f"{list(self.second_tool.tip_mm)}, {math.hypot(*self.second_tool.tip_mm):.2f} mm "
                "from its centre. Move it."
            )
        if self.phantom.kind == "eyeball":
            if self.phantom.tilt_deg:
                raise ValueError(
                    "phantom.tilt_deg tilts the plane phantom only; got "
                    f"{self.phantom.tilt_deg:g} deg with kind 'eyeball'. Set it to 0 or choose "
                    "kind = 'plane'."
                )
        elif math.radians(self.phantom.tilt_deg + self.spot.incidence_deg) >= math.pi / 2:
            raise ValueError(
                "phantom.tilt_deg + spot.incidence_deg must stay below 90; got "
                f"{self.phantom.tilt_deg:g} + {self.spot.incidence_deg:g} deg, so the beam may "
                "miss the plane. Lower one."
            )
        return self
