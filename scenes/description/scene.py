"""A whole scene: its tables, and the rules that they must meet together.

The table [unrest] comes first: what else does not keep still while the tip moves.
"""

import html
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from pydantic import Field, ValidationError, model_validator

from eyespot.formats.inputs import InputError
from eyespot.scenes.description.rig_errors import RigErrors
from eyespot.scenes.description.scene_keys import (
    CONE_AT_THE_TIP,
    REAL_PINHOLE_HEIGHT_MM,
    CameraSettings,
    Clocks,
    Exposures,
    Instrument,
    MicroscopeSettings,
    Motion,
    Phantom,
    SceneTable,
    SecondTool,
    Seed,
    SourceSettings,
    SpotSettings,
    Viewing,
    Withdrawal,
    retina_of,
)

_Velocity = Annotated[float, Field(ge=-100, le=100)]
_Turning = Annotated[float, Field(ge=-90, le=90)]


class Unrest(SceneTable):
    """What else does not keep still: the view, the eye and the source's power."""

    drift_mm_s: tuple[_Velocity, _Velocity] = Field(
        (0.0, 0.0),
        description="Velocity at which the whole image drifts, X and Y, measured at the pole.",
    )
    shake_px: Annotated[float, Field(ge=0, le=100)] = Field(
        0.0, description="Standard deviation of the image's shake in x and y; new in each frame."
    )
    rotation_deg_s: tuple[_Turning, _Turning, _Turning] = Field(
        (0.0, 0.0, 0.0),
        description="Angular velocity of the eyeball around its centre, as a vector. The wall's "
        "picture turns, the tip does not. Only for a sphere that is seen without [viewing].",
    )
    power_swing: Annotated[float, Field(ge=0, le=0.3)] = Field(
        0.0, description="Relative standard deviation of the source's power; new in each frame."
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


_EFFECTIVE: tuple[tuple[str, str, str, tuple[object, ...]], ...] = (
    ("lens", "source", "kind", ("lens", "photons")),
    (f"cone_k {' '.join(CONE_AT_THE_TIP)}", "source", "kind", ("cone",)),
    ("photons_per_pixel", "source", "kind", ("photons",)),
    ("wall_image wall_image_mm", "phantom", "wall", ("image",)),
    ("spread_mm", "phantom", "spread", ("own",)),
    ("gauge tip_mm trocar_azimuth_deg trocar_polar_deg", "second_tool", "visible", (True,)),
    ("paper_level paper_distance_mm", "exposures", "kinds", ("paper",)),
    ("metered_peak", "exposures", "kinds", ("metered",)),
)
"""Keys of a table, and the values of another of its keys with which they have an effect."""


_OLD_APEX_OFFSET_MM = -5.117
"""b of a scene of format 1 that does not give it, whatever its k."""

WIDEST_CORE = 1.03
"""Largest radius of a cone at the tip over the fibre's. The paper's k 20 and b -5.117 mm give
0.256 mm for its fibre of 0.5 mm. At 30 degrees that moves the touch by 3 um, a sixth of its
sigma."""


class Scene(SceneTable):
    """One trial: all settings that an image stack depends on."""

    schema_version: Literal[1, 2] = Field(2, alias="schema")
    seed: Seed = Field(0, description="Random seed of the camera noise.")
    phantom: Phantom = Phantom()
    source: SourceSettings = SourceSettings()
    spot: SpotSettings = SpotSettings()
    motion: Motion = Withdrawal()
    clocks: Clocks = Clocks()
    unrest: Unrest = Unrest()
    instrument: Instrument = Instrument()
    second_tool: SecondTool = SecondTool()
    microscope: MicroscopeSettings = MicroscopeSettings()
    viewing: Viewing = Viewing()
    camera: CameraSettings = CameraSettings()
    exposures: Exposures = Exposures()
    rig_errors: RigErrors = RigErrors()

    def _repr_html_(self) -> str:
        """Its file, for notebooks."""
        content = self.model_dump(mode="json", by_alias=True)
        return f"<pre>{html.escape(tomli_w.dumps(content))}</pre>"

    @property
    def approximations(self) -> list[str]:
        """What is only approximate in the images of this scene, one sentence each."""
        phantom, found = self.phantom, []
        if phantom.coat != "none" and self.source.kind == "lens":
            found.append("highlights are computed for the mean direction of the lens's light")
        if phantom.coat != "none" and phantom.kind == "eyeball":
            if phantom.indirect == "closed form":
                found.append("indirect light is computed for a wall without coat")
        if phantom.stretched and phantom.indirect == "closed form":
            found.append("indirect light is computed for a sphere of the eyeball's area")
        if self.viewing.through_an_eye and self.viewing.colours == "green":
            found.append("all colours are seen along green's lines of sight")
        if self.viewing.reflexes:
            found.append("reflexes are those of a round lamp, reflected once")
        return found

    @property
    def without_effect(self) -> list[str]:
        """Keys that differ from their defaults but change nothing, one sentence each."""
        found = []
        for keys, table, switch, choices in _EFFECTIVE:
            value = getattr(getattr(self, table), switch)
            chosen = value if isinstance(value, tuple) else (value,)
            if not {*choices} & {*chosen}:
                for key in keys.split():
                    given = getattr(self, table)
                    field = type(given).model_fields[key]
                    usual = field.get_default(call_default_factory=True, validated_data=vars(given))
                    if getattr(given, key) != usual:
                        found.append(
                            f"{table}.{key} has no effect with {table}.{switch} = {value!r}"
                        )
        return found

    @model_validator(mode="before")
    @classmethod
    def _old_cone(cls, content: Any) -> Any:
        """The b of a scene of format 1, where it did not follow from the core."""
        if not isinstance(content, Mapping) or content.get("schema", 2) != 1:
            return content
        source = content.get("source", {})
        if not isinstance(source, Mapping) or {*CONE_AT_THE_TIP} & {*source}:
            return content
        return {**content, "source": {**source, "cone_apex_offset_mm": _OLD_APEX_OFFSET_MM}}

    @model_validator(mode="before")
    @classmethod
    def _eye_brings_its_retina(cls, content: Any) -> Any:
        """Fill [phantom] with the retina of [viewing]'s eye; refuse one that contradicts it.

        A scene file of `scene init` holds every default, so a default is not what anyone has set;
        the default pinhole, which would lie in the cornea, moves up to a real microscope's.
        """
        if not isinstance(content, Mapping):
            return content
        tables = (content.get(name, {}) for name in ("viewing", "phantom", "microscope"))
        viewing, phantom, microscope = (
            table.model_dump(exclude_unset=True) if isinstance(table, SceneTable) else table
            for table in tables
        )
        if not (isinstance(viewing, Mapping) and isinstance(phantom, Mapping)):
            return content
        if viewing.get("eye", "none") == "none":
            return content
        try:
            Viewing.model_validate(viewing)
        except ValidationError:  # which the validation of [viewing] will report
            return content
        retina = retina_of(dict(viewing))
        for key, own in retina.items():
            said, usual = phantom.get(key, own), Phantom.model_fields[key].default
            if not any(np.allclose(said, value, rtol=1e-6) for value in (own, usual)):
                raise InputError(
                    f"phantom.{key} contradicts the eye {viewing['eye']!r}, whose retina has "
                    f"{key} {own}; got {said}. Remove it, or choose another eye."
                )
        usual = MicroscopeSettings.model_fields["pinhole_height_mm"].default
        if isinstance(microscope, Mapping) and microscope.get("pinhole_height_mm", usual) == usual:
            microscope = {**microscope, "pinhole_height_mm": REAL_PINHOLE_HEIGHT_MM}
        return {**content, "phantom": {**phantom, **retina}, "microscope": microscope}

    @model_validator(mode="after")
    def _cone_leaves_the_fibre(self) -> "Scene":
        source, fibre = self.source, self.instrument.fibre_diameter_mm / 2
        wide = source.cone_core_radius_mm > WIDEST_CORE * fibre
        if self.schema_version > 1 and source.kind == "cone" and wide:
            raise InputError(
                "the cone must not be wider at the tip than the fibre it comes from; got a radius "
                f"of {source.cone_core_radius_mm:.3f} mm (-b/k) in a fibre of {fibre:.3f} mm. "
                "Remove source.cone_apex_offset_mm, lower source.cone_core_radius_mm, or raise "
                "instrument.fibre_diameter_mm. A scene or set of eyespot 0.2 says schema = 1."
            )
        return self

    @model_validator(mode="after")
    def _looks_through_what_it_can(self) -> "Scene":
        viewing, height = self.viewing, self.microscope.pinhole_height_mm
        distortion, lit = self.microscope.distortion, self.microscope.light
        if not viewing.through_an_eye:
            if viewing.reflexes:
                raise InputError(
                    "viewing.reflexes needs an eye whose surfaces reflect; got eye 'none'. Set "
                    "viewing.eye, for example to navarro."
                )
            if viewing.lens != "none":
                raise InputError(
                    f"viewing.lens needs an eye behind it; got lens {viewing.lens!r} with eye "
                    "'none'. Set viewing.eye, for example to navarro."
                )
            return self
        needs: list[tuple[bool, str, object]] = [
            (self.phantom.kind == "eyeball", "phantom.kind = 'eyeball'", self.phantom.kind),
            (not any(distortion), "microscope.distortion = zeros", list(distortion)),
            (self.source.kind != "photons", "source.kind = 'lens' or 'cone'", self.source.kind),
        ]
        if viewing.reflexes:
            finite = "a finite microscope.pinhole_height_mm for viewing.reflexes"
            coaxial = "microscope.light = 'coaxial' for viewing.reflexes"
            needs += [(math.isfinite(height), finite, height), (lit == "coaxial", coaxial, lit)]
        for met, need, got in needs:
            if not met:
                raise InputError(
                    f"viewing.eye = {viewing.eye!r} needs {need}; got {got!r}. Set it, or "
                    "viewing.eye = 'none'."
                )
        return self

    @model_validator(mode="after")
    def _is_possible(self) -> "Scene":
        phantom, microscope, tool = self.phantom, self.microscope, self.second_tool
        r, c, height = phantom.radius_mm, self.spot.eccentricity_mm, microscope.pinhole_height_mm
        is_sphere = phantom.kind == "eyeball" and not phantom.stretched
        if self.unrest.turns and (not is_sphere or self.viewing.through_an_eye):
            raise InputError(
                "unrest.rotation_deg_s turns a spherical eyeball that is seen without [viewing]; "
                f"got phantom.kind {phantom.kind!r}, stretch {list(phantom.stretch)} and "
                f"viewing.eye {self.viewing.eye!r}. Set rotation_deg_s to zeros; drift_mm_s and "
                "shake_px work with all of them."
            )
        narrowest = r * min(1.0, *phantom.stretch)
        if c >= narrowest:
            raise InputError(
                "spot.eccentricity_mm must be smaller than the eyeball's radius; got "
                f"{c:g} mm with radius {narrowest:g} mm. Lower eccentricity_mm."
            )
        if abs(height + r) < r * 0.5:
            raise InputError(
                f"microscope.pinhole_height_mm must lie {r / 2:g} mm or more (half a radius) above "
                f"or below the retina, which is at {-r:g} mm; got {height:g} mm. Raise or lower it."
            )
        if math.isinf(height) and any(microscope.distortion):
            raise InputError(
                "microscope.distortion is measured in focal lengths, and a telecentric "
                f"microscope has none; got {list(microscope.distortion)} with "
                "pinhole_height_mm = inf. Set it to zeros or lower pinhole_height_mm."
            )
        if phantom.wall == "image" and not phantom.wall_image:
            raise InputError(
                "phantom.wall = 'image' needs phantom.wall_image. Set it to the path of the image."
            )
        traced = self.source.kind == "photons" or phantom.indirect == "traced"
        if phantom.spread != "none" and traced:
            raise InputError(
                f"phantom.spread does not apply to traced light; got spread {phantom.spread!r} "
                f"with source.kind {self.source.kind!r} and indirect {phantom.indirect!r}. Set "
                "spread = 'none', or the other two to 'lens' and 'closed form'."
            )
        if phantom.pupil_radius_mm and phantom.kind == "plane":
            raise InputError(
                "phantom.pupil_radius_mm applies to the eyeball phantom only; got "
                f"{phantom.pupil_radius_mm:g} mm with kind 'plane'. Set it to 0."
            )
        if phantom.pupil_radius_mm >= r:
            raise InputError(
                "phantom.pupil_radius_mm must be smaller than phantom.radius_mm; got "
                f"{phantom.pupil_radius_mm:g} mm with radius {r:g} mm. Lower it."
            )
        if tool.visible and math.hypot(*tool.tip_mm) >= r:
            raise InputError(
                f"second_tool.tip_mm must lie inside the eye of radius {r:g} mm; got "
                f"{list(tool.tip_mm)}, {math.hypot(*tool.tip_mm):.2f} mm from its centre. Move it."
            )
        if is_sphere and (phantom.tilt_deg or any(phantom.shift_mm)):
            raise InputError(
                "phantom.tilt_deg and shift_mm apply to a plane or a stretched eyeball; got "
                f"{phantom.tilt_deg:g} deg and {list(phantom.shift_mm)} mm with a sphere. Set them "
                "to 0, or choose kind = 'plane'."
            )
        if self.viewing.through_an_eye and (wrong := self.rig_errors.of_the_view):
            raise InputError(
                f"rig_errors.{wrong[0]} is that of a pinhole without [viewing]; got viewing.eye "
                f"{self.viewing.eye!r}. Set it to 0."
            )
        if phantom.clear_layer_mm >= narrowest:
            raise InputError(
                f"phantom.clear_layer_mm must be smaller than the eyeball's radius; got "
                f"{phantom.clear_layer_mm:g} mm with radius {narrowest:g} mm. Lower it."
            )
        if phantom.stretched and phantom.spread != "none":
            raise InputError(
                "phantom.spread does not apply to a stretched eyeball; got spread "
                f"{phantom.spread!r} with stretch {list(phantom.stretch)}. Set spread = 'none'."
            )
        steepest = phantom.tilt_deg + self.spot.incidence_deg
        if phantom.kind == "plane" and math.radians(steepest) >= math.pi / 2:
            raise InputError(
                f"phantom.tilt_deg + spot.incidence_deg must be below 90; got {phantom.tilt_deg:g} "
                f"+ {self.spot.incidence_deg:g} deg, so the beam may miss the plane. Lower one of "
                "them."
            )
        return self
