"""The scene file: every key with its unit and default, validated before anything is rendered."""

from __future__ import annotations

import difflib
import math
import tomllib
from pathlib import Path
from typing import Any, Literal, get_args

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from scenes.exposure import CameraSettings

SCHEMA = 1
MEDIA = {"air": 1.0, "water": 1.333, "vitreous": 1.336}
"""Refractive index by name; vitreous after DESIGN's 1.336 (Gullstrand's schematic eye)."""

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
    wall: Literal["printed paper", "retina", "uniform"] = "printed paper"
    reflectance: float = Field(0.5, ge=0, lt=1, description="Of the uniform wall.")
    texture_seed: int = Field(1, ge=0, description="Seed of the fundus drawn on the wall.")
    indirect: Literal["closed form", "off"] = Field(
        "closed form", description="Light scattered back by the closed eyeball."
    )


class Source(_Settings):
    """The fibre's light."""

    kind: Literal["lens", "cone"] = "lens"
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


class Withdrawal(_Settings):
    """The tip withdraws along the beam at constant speed."""

    start_mm: float | Literal["contact"] = Field(
        "contact", description="First distance along the beam; contact: the tip's rim touches."
    )
    travel_mm: float = Field(6.0, gt=0)
    frames: int = Field(61, ge=1)
    speed_mm_s: float = Field(0.1, gt=0)


class Instrument(_Settings):
    """Shaft with a bare fibre that reaches past it."""

    visible: bool = Field(True, description="Seen, and hiding what lies behind it.")
    gauge: Literal[20, 23, 25] = 23
    fibre_diameter_mm: float = Field(0.5, gt=0)
    fibre_length_mm: float = Field(6.0, gt=0, description="Of bare fibre past the shaft.")


class MicroscopeSettings(_Settings):
    """Pinhole microscope; its window is centred on the spot."""

    pinhole_height_mm: float = Field(11.5, description="z_F above the eye's centre; inf allowed.")
    scale_mm_px: float = Field(0.0067, gt=0, description="At the pole.")
    width_px: int = Field(640, ge=16, le=8192)
    height_px: int = Field(480, ge=16, le=8192)
    illumination_mw_mm2: float = Field(
        0.05, ge=0, description="Irradiance of the coaxial light at the pole."
    )
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


class Scene(_Settings):
    """One trial: everything that an image stack depends on."""

    schema_version: Literal[1] = Field(1, alias="schema")
    seed: int = Field(0, ge=0, description="Of the camera's noise.")
    phantom: Phantom = Phantom()
    source: Source = Source()
    spot: Spot = Spot()
    withdrawal: Withdrawal = Withdrawal()
    instrument: Instrument = Instrument()
    microscope: MicroscopeSettings = MicroscopeSettings()
    camera: CameraSettings = CameraSettings()
    exposures: Exposures = Exposures()

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
        if self.phantom.kind == "eyeball":
            self._tip_stays_inside()
        elif math.radians(self.phantom.tilt_deg + self.spot.incidence_deg) >= math.pi / 2:
            raise ValueError(
                "phantom.tilt_deg + spot.incidence_deg must stay below 90; got "
                f"{self.phantom.tilt_deg:g} + {self.spot.incidence_deg:g} deg, so the beam may "
                "miss the plane. Lower one."
            )
        return self

    def _tip_stays_inside(self) -> None:
        r, iota = self.phantom.radius_mm, math.radians(self.spot.incidence_deg)
        if self.phantom.tilt_deg:
            raise ValueError(
                f"phantom.tilt_deg tilts the plane phantom only; got {self.phantom.tilt_deg:g} deg "
                "with kind 'eyeball'. Set it to 0 or choose kind = 'plane'."
            )
        start = self.withdrawal.start_mm
        start_mm = 0.0 if isinstance(start, str) else start
        last, chord = start_mm + self.withdrawal.travel_mm, 2 * r * math.cos(iota)
        if start_mm < 0 or last >= chord:
            raise ValueError(
                "withdrawal must keep the tip inside the eye: distances along the beam must lie in "
                f"[0, {chord:.3f}) mm at incidence {self.spot.incidence_deg:g} deg; got "
                f"{start_mm:g} to {last:g} mm. Change start_mm or lower travel_mm."
            )


def load_scene(path: Path) -> Scene:
    """Read and validate a scene file (TOML).

    Raises:
        SceneError: the file is missing, is no TOML, has unknown keys (the nearest known one is
            named) or describes an impossible geometry.
    """
    path = Path(path)
    try:
        content = tomllib.loads(path.read_text())
    except OSError as error:
        raise SceneError(
            f"{path}: cannot be read ({error.strerror}). `eyespot scene init {path}` writes one."
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: not a TOML file: {error}.") from error
    try:
        return Scene.model_validate(content)
    except ValidationError as error:
        problems = "\n".join(f"{path}: {_sentence(problem)}" for problem in error.errors())
        raise SceneError(problems) from error


def scene_toml(scene: Scene) -> str:
    """The scene as the text of a scene file."""
    return tomli_w.dumps(scene.model_dump(mode="json", by_alias=True))


def scene_template() -> str:
    """A scene file with every key at its default, each explained."""
    lines = [
        "# eyespot scene: lengths in mm, angles in degrees, inf allowed where it makes sense",
        f"schema = {SCHEMA}",
        f"seed = 0  # {Scene.model_fields['seed'].description}",
    ]
    for name, field in Scene.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            lines += ["", f"# {(field.annotation.__doc__ or '').splitlines()[0]}", f"[{name}]"]
            lines += [_documented(key, f) for key, f in field.annotation.model_fields.items()]
    return "\n".join(lines) + "\n"


def _documented(key: str, field: Any) -> str:
    text = tomli_w.dumps({key: field.default}).strip()
    default = text.replace("\n    ", " ").replace(",\n]", " ]")
    choices = get_args(field.annotation)
    names = [repr(c) for c in choices if isinstance(c, str | int)]
    notes = [n for n in (" | ".join(names), field.description) if n]
    return f"{default}  # {'. '.join(notes)}" if notes else default


def _sentence(problem: Any) -> str:
    where = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        near = difflib.get_close_matches(str(problem["loc"][-1]), _siblings(problem["loc"]), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        return f"unknown key {where!r}{hint}"
    message = problem["msg"].removeprefix("Value error, ")
    return f"{where}: {message}; got {problem['input']!r}" if where else message


def _siblings(location: tuple[int | str, ...]) -> list[str]:
    model: type[BaseModel] = Scene
    for part in location[:-1]:
        annotation = model.model_fields[str(part)].annotation
        if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            return []
        model = annotation
    return [field.alias or name for name, field in model.model_fields.items()]
