"""The rig file (TOML): microscope, camera, wall, instrument, robot and what is known of them.

A person writes it once for a rig; `eyespot rig init` gives every key with its default and meaning.
A rendered stack contains one. A microscope.json, a camera calibration or a file of stated
uncertainties of eyespot 0.1 and 0.2 is taken where a rig file is asked for.
"""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import tomli_w
from pydantic import ConfigDict, Field, ValidationError, model_validator
from pydantic.json_schema import SkipJsonSchema

from eyespot.formats.camera_sheet import CameraSheet, Response
from eyespot.formats.inputs import (
    InputError,
    Strict,
    check_schema,
    in_file,
    object_in,
    read_text,
    read_toml,
    validated,
)
from eyespot.formats.microscope import MicroscopeFile, read_microscope, response_of
from eyespot.formats.poses import RobotKeys
from eyespot.formats.rig_keys import (
    RETINA,
    BeamKeys,
    CameraKeys,
    InstrumentKeys,
    MicroscopeKeys,
    UnrestKeys,
    ViewingKeys,
    WallKeys,
    WorkspaceKeys,
)
from eyespot.formats.settings_files import (
    change_of,
    merged,
    parsed_change,
    problems_of,
    table_lines,
)
from eyespot.formats.stated import Stated

SCHEMA = 1
HISTORY = {1: "the format of eyespot 0.3"}
EXACT: dict[str, dict[str, Any]] = {
    "microscope": {"scale_sigma": 0.0, "pinhole_height_sigma_mm": 0.0},
    "wall": {"radius_sigma_mm": 0.0},
    "instrument": {"glue_index_sigma": 0.0, "rim_height_sigma_mm": 0.0},
    "robot": {"scale_sigma": 0.0, "clock_sigma_s": 0.0},
}
"""Tolerances of a rig that is known exactly, as a rendered one is."""

_CORE_OVER_FIBRE = 1.03
"""What data sheets allow of a fibre's diameter, as in a scene."""


class Rig(Strict):
    """A rig, as its file describes it.

    Relative names of files are those beside the rig file (`folder`).
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    schema_version: int = Field(SCHEMA, alias="schema")
    microscope: MicroscopeKeys = MicroscopeKeys()
    camera: CameraKeys = CameraKeys()
    wall: WallKeys = WallKeys()
    instrument: InstrumentKeys = InstrumentKeys()
    beam: BeamKeys = BeamKeys()
    robot: RobotKeys = RobotKeys()
    unrest: UnrestKeys = UnrestKeys()
    viewing: ViewingKeys = ViewingKeys()
    workspace: WorkspaceKeys = WorkspaceKeys()
    folder: SkipJsonSchema[Path] = Field(Path(), exclude=True, repr=False)
    where: SkipJsonSchema[str] = Field("rig", exclude=True, repr=False)
    """Name of the file, for messages."""
    seen: SkipJsonSchema[MicroscopeFile | None] = Field(None, exclude=True, repr=False)
    """A microscope that was read before; [microscope] is then empty."""

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        low, high = self.robot.incidence_deg
        if not 0 <= low <= high < 90:
            raise InputError(
                f"robot.incidence_deg must be two angles from 0 to 90 degrees; got {[low, high]}"
            )
        if isinstance(self.robot.touch, tuple) and not self.robot.touch[1] > 0:
            raise InputError(f"robot.touch needs a positive sigma; got {list(self.robot.touch)} mm")
        fibre, wall, work = self.instrument, self.wall, self.workspace
        core, fibre_mm = fibre.core_radius_mm or 0.0, fibre.fibre_diameter_mm / 2
        if core > _CORE_OVER_FIBRE * fibre_mm:
            raise InputError(
                f"instrument.core_radius_mm = {core:g} is wider than the fibre, whose radius is "
                f"{fibre_mm:g} mm. Correct it, or instrument.fibre_diameter_mm"
            )
        touch = self.robot.touch[0] if isinstance(self.robot.touch, tuple) else 0.0
        if touch < 0:
            raise InputError(f"robot.touch must not be negative; got {touch:g} mm")
        if wall.radius_mm is not None and wall.kind != "plane":
            most = {
                "wall.clear_layer_mm": (wall.clear_layer_mm or 0.0, wall.radius_mm),
                "workspace.eccentricity_mm": ((work.eccentricity_mm or (0, 0))[1], wall.radius_mm),
                "robot.touch": (touch, 2 * wall.radius_mm),
            }
            if "distance_mm" in work.model_fields_set:  # the default is for eyes of people
                most["workspace.distance_mm"] = (work.distance_mm[1], 2 * wall.radius_mm)
            for name, (value, limit) in most.items():
                if not value < limit:
                    raise InputError(
                        f"{name} must lie below {limit:g} mm in an eye of wall.radius_mm = "
                        f"{wall.radius_mm:g}; got {value:g} mm"
                    )
        beam = self.beam
        if beam.half_angle_deg is not None and beam.numerical_aperture is not None:
            raise InputError(
                f"beam.half_angle_deg = {beam.half_angle_deg:g} and beam.numerical_aperture = "
                f"{beam.numerical_aperture:g} both state the cone. Remove one of them"
            )
        return self

    @cached_property
    def view(self) -> MicroscopeFile | None:
        """The microscope and the wall, for the estimator; None if the file has no microscope.

        Raises:
            InputError: a number is missing, contradicts another, or is impossible.
            OSError: the calibration file cannot be read.
        """
        with in_file(self.where):
            return self._view()

    def _view(self) -> MicroscopeFile | None:
        own, wall = self.microscope, self.wall
        height, radius = own.pinhole_height_mm, wall.radius_mm
        if self.seen is not None:
            found = self.seen
        elif own.calibration is not None:
            for name in ("width_px", "height_px", "scale_mm_px", "principal_point_px"):
                if getattr(own, name) is not None:
                    raise InputError(
                        f"microscope.{name} is that of {own.calibration}. Leave one of them out."
                    )
            found = read_microscope(
                self.folder / own.calibration, pinhole_height_mm=height, eye_radius_mm=radius
            )
        elif own.scale_mm_px is None:
            return None
        else:
            for name in ("width_px", "height_px", "pinhole_height_mm"):
                if getattr(own, name) is None:
                    raise InputError(f"microscope.{name} is missing. Add it, or a calibration.")
            if radius is None or height is None:
                raise InputError("wall.radius_mm is missing. Add it; the pole lies at -radius_mm.")
            found = _pinhole(own, radius, height)
        normal, stated = found.plane_normal, self.camera.noise
        if wall.kind == "eyeball":
            normal = None
        elif wall.kind == "plane" and (normal is None or "normal" in wall.model_fields_set):
            normal = wall.normal
        return found.changed(
            plane_normal=normal,
            **self._response(found),
            noise=stated if isinstance(stated, CameraSheet) else None if stated else found.noise,
        )

    @property
    def response(self) -> Response:
        """Relation of the images' values to light."""
        return response_of(**self._response(None)) if self.view is None else self.view.response

    def _response(self, of_file: MicroscopeFile | None) -> dict[str, Any]:
        own = self.camera
        full_scale = own.full_scale or (None if of_file is None else of_file.full_scale)
        if full_scale is None and own.bit_depth > 8:
            full_scale = float((1 << own.bit_depth) - 1)
        return {
            "curve": own.response or ("linear" if of_file is None else of_file.curve),
            "full_scale": full_scale,
            "limited_range": own.limited_range,
        }

    @property
    def calibration_file(self) -> Path | None:
        """The beam's calibration; None if the rig has none."""
        return None if self.beam.calibration is None else self.folder / self.beam.calibration

    @property
    def stated(self) -> Stated:
        """The uncertainties that no measurement contains, as a budget takes them."""
        robot, wall, sigma = self.robot, self.wall, 0.0
        eye = RETINA if wall.tissue == "retina" else dict.fromkeys(RETINA, 0.0)
        known = {name: getattr(wall, name) for name in eye}
        of_wall = {name: eye[name] if own is None else own for name, own in known.items()}
        if self.microscope.pinhole_height_sigma_mm and self.view is not None:
            sigma = self.microscope.pinhole_height_sigma_mm * self.view.inverse_working_distance**2
        return Stated(
            **of_wall,
            scale_sigma=self.microscope.scale_sigma,
            eye_radius_sigma_mm=wall.radius_sigma_mm,
            inverse_working_distance_sigma=sigma,
            size_per_mm=self.viewing.size_per_mm,
            touch_sigma_mm=robot.touch_sigma_mm
            if "touch_sigma_mm" in robot.model_fields_set
            else 0,
            axis_sigma_deg=robot.axis_sigma_deg,
            incidence_deg=robot.incidence_deg,
            clock_sigma_s=robot.clock_sigma_s,
            shake_px=self.unrest.shake_px,
            calibration_freedom=self.beam.calibration_freedom,
        )

    def over(self, base: "Rig") -> "Rig":
        """This rig, with the keys that it does not set from another one, such as a stack's own."""
        own, other = (rig._content(rig.folder.absolute().joinpath) for rig in (self, base))
        content = merged(other, own)
        whole = self.microscope.calibration or self.microscope.scale_mm_px or self.seen
        if whole:
            content["microscope"] = own.get("microscope", {})
        seen = self.seen if whole else base.seen
        return rig_in(content | {"seen": seen}, where=self.where, folder=Path())

    def _content(self, path_of: Callable[[str], object] = str) -> dict[str, Any]:
        """The keys that were set, with other names of files."""
        content = self.model_dump(mode="json", by_alias=True, exclude_unset=True, exclude_none=True)
        for table in ("microscope", "beam"):
            if name := content.get(table, {}).get("calibration"):
                content[table]["calibration"] = str(path_of(name))
        return content

    def toml(self, folder: Path) -> str:
        """The text of a rig file in a folder, with the keys that were set.

        Raises:
            InputError: the microscope was given as an object, which has no file.
        """
        if self.seen is not None:
            raise InputError("a rig whose microscope is an object has no file. State its numbers.")
        content = self._content(lambda name: os.path.relpath(self.folder / name, folder))
        return tomli_w.dumps({"schema": SCHEMA} | content)

    def with_noise(self, sheet: CameraSheet) -> "Rig":
        """The rig with a camera of this noise."""
        content = self._content() | {"seen": self.seen}
        content["camera"] = content.get("camera", {}) | {"noise": sheet.model_dump()}
        return rig_in(content, where=self.where, folder=self.folder)

    def changed(self, changes: Sequence[str] | Mapping[str, Any]) -> "Rig":
        """The rig with other values: "table.key=value", or {"table.key": value}.

        Raises:
            InputError: an unknown key, or a value that no rig has.
        """
        if not changes:
            return self
        content = self._content()
        if isinstance(changes, Mapping):
            changes = [change_of(*item) for item in changes.items()]
        for change in changes:
            content = merged(content, parsed_change(change))
        return rig_in(content | {"seen": self.seen}, where=self.where, folder=self.folder)


def _pinhole(own: MicroscopeKeys, radius_mm: float, height_mm: float) -> MicroscopeFile:
    """The microscope of numbers."""
    width, height = own.width_px or 0, own.height_px or 0
    scale = own.scale_mm_px or math.nan
    u, v = own.principal_point_px or ((width - 1) / 2, (height - 1) / 2)
    telecentric = math.isinf(height_mm)
    focal = math.inf if telecentric else (height_mm + radius_mm) / scale
    if telecentric and any(own.distortion):
        raise InputError(
            f"microscope.distortion needs a pinhole at a finite height; got {list(own.distortion)} "
            "with pinhole_height_mm = inf. Undistort the images first."
        )
    matrix = None if telecentric else [[focal, 0.0, u], [0.0, focal, v], [0.0, 0.0, 1.0]]
    values = {
        "width_px": width,
        "height_px": height,
        "camera_matrix": matrix,
        "distortion": own.distortion or (0.0,) * 5,
        "scale_mm_px": scale,
        "principal_point_px": (u, v),
        "pinhole_height_mm": height_mm,
        "eye_radius_mm": radius_mm,
        "curve": "linear",
    }
    return validated(MicroscopeFile, values, remedy="Correct the key of [microscope] or [wall].")


def rig_in(content: Mapping[str, Any], *, where: str, folder: Path = Path()) -> Rig:
    """The rig that the content of a file describes.

    Raises:
        InputError: an unknown key, or a value that no rig has; the text suggests the nearest key.
    """
    with in_file(where):
        check_schema(content.get("schema", SCHEMA), HISTORY, remedy=f"Write {SCHEMA}.")
    try:
        return Rig.model_validate({**content, "folder": folder, "where": where})
    except ValidationError as error:
        raise InputError(problems_of(error, where, Rig)) from error


def read_rig(path: str | Path, changes: Sequence[str] = ()) -> Rig:
    """Read a rig file, or a file of an older version that has a part of it.

    Args:
        path: a rig file (TOML); a microscope.json or a camera calibration; or a file of stated
            uncertainties (TOML).
        changes: "table.key=value", as of `--set`.

    Raises:
        InputError: none of these, or wrong; the text names file, key, value and remedy.
        OSError: the file cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() != ".toml":
        known = EXACT if _is_written_by_eyespot(path) else {}
        content = merged(known, {"microscope": {"calibration": path.name}})
        return rig_in(content, where=f"{path}", folder=path.parent).changed(changes)
    with in_file(path):
        content = read_toml(path)
        if content and content.keys() <= Stated.model_fields.keys():
            content = _of_stated(content)
    return rig_in(content, where=f"{path}", folder=path.parent).changed(changes)


def _is_written_by_eyespot(path: Path) -> bool:
    """Whether a file is a microscope.json, not a camera calibration of another program."""
    with suppress(InputError):
        return "schema" in object_in(read_text(path))
    return False


RIG = "rig.toml"
"""Name of a stack's rig file."""


def rig_of_stack(folder: Path, description: Mapping[str, Any], *, medium: str) -> Rig:
    """The rig of a stack: its rig file, or of stacks of eyespot 0.1 and 0.2 what stands elsewhere.

    Args:
        description: the content of stack.toml.
        medium: by the labels, where the description has no scene.

    Raises:
        InputError: a file is damaged.
        OSError: a file cannot be read.
    """
    if (folder / RIG).is_file():
        return read_rig(folder / RIG)
    scene, where = description.get("scene", {}), f"{folder / 'stack.toml'}"
    try:
        content, camera = rig_of_scene(scene), scene.get("camera", {})
        content["wall"] = {"medium": medium} | content["wall"]
        # The microscope.json of eyespot 0.1 has no camera.
        sheet = {name: camera[name] for name in CameraSheet.model_fields if name in camera}
        sheet |= {"bayer": camera.get("bayer", "none") != "none"}
        sheet |= {"jpeg": camera.get("jpeg_quality", 0) > 0}
    except (AttributeError, ArithmeticError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{where}: [scene] is damaged. Render the stack again.") from error
    if not (folder / "microscope.json").is_file():
        del content["microscope"]
    rig = rig_in(content, where=where, folder=folder)
    if "full_well_e" not in camera or rig.view is None or rig.view.noise is not None:
        return rig
    with in_file(where):
        return rig.with_noise(validated(CameraSheet, sheet, remedy="Render the stack again."))


def rig_of_scene(
    scene: Mapping[str, Any], *, touch: tuple[float, float] | None = None
) -> dict[str, Any]:
    """The content of the rig file of a rendered scene, which knows everything exactly.

    A lens of somebody's own is as little known as a drop on a rig: its rim may be above the core.

    Args:
        scene: the scene's tables, as stack.toml has them; those of eyespot 0.1 may lack keys.
        touch: stated first distance and its standard uncertainty, mm; None: as the scene says.
    """

    def some(table: str, **names: str) -> dict[str, Any]:
        found = scene.get(table, {})
        return {name: found[key] for name, key in names.items() if key in found}

    motion = scene.get("motion", {})
    at_contact = (motion.get("kind"), motion.get("start_mm")) == ("withdrawal", "contact")
    source, instrument = scene.get("source", {}), dict(scene.get("instrument", {}))
    own_lens = f"{source.get('lens', '')}".endswith(".toml")
    if source.get("kind") == "cone" and scene.get("schema", 1) == 1 and "cone_k" in source:
        # In scenes of format 1 a cone could be wider than its fibre, and touched with its own rim.
        rim = -source["cone_apex_offset_mm"] / source["cone_k"]
        instrument["fibre_diameter_mm"] = max(instrument["fibre_diameter_mm"], 2 * rim)
    errors, named = scene.get("rig_errors", {}), {}
    if errors.get("scale"):
        # Stacks with equal errors were taken with one microscope.
        scale = scene["microscope"]["scale_mm_px"]
        named = {"id": f"rig {errors['seed']}, {scale:g} mm/px, {100 * errors['scale']:g} %"}
    return {
        "schema": SCHEMA,
        "microscope": EXACT["microscope"]
        | named
        | some("rig_errors", scale_sigma="scale", pinhole_height_sigma_mm="pinhole_height_mm")
        | {"calibration": "microscope.json"},
        "wall": EXACT["wall"]
        | some("phantom", kind="kind", clear_layer_mm="clear_layer_mm")
        | some("source", medium="medium")
        | some("rig_errors", radius_sigma_mm="eye_radius_mm"),
        "instrument": ({} if own_lens else EXACT["instrument"])
        | {
            name: instrument[name]
            for name in ("fibre_diameter_mm", "fibre_length_mm", "visible")
            if name in instrument
        },
        "robot": EXACT["robot"]
        | some("rig_errors", scale_sigma="robot_scale", clock_sigma_s="clock_s")
        | {
            "eye_from_robot": [0.0, 0.0, 0.0, 1.0],
            "touch": list(touch) if touch else "contact" if at_contact else "free",
        },
    }


_OF_STATED = {
    "eye_radius_sigma_mm": "wall.radius_sigma_mm",
    "size_per_mm": "viewing.size_per_mm",
    "axis_sigma_deg": "robot.axis_sigma_deg",
    "incidence_deg": "robot.incidence_deg",
    "clock_sigma_s": "robot.clock_sigma_s",
    "touch_sigma_mm": "robot.touch_sigma_mm",
    "shake_px": "unrest.shake_px",
    "calibration_freedom": "beam.calibration_freedom",
}
"""Where the keys of a file of stated uncertainties (eyespot 0.1 and 0.2) stand in a rig file."""


def _of_stated(content: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {table: dict(keys) for table, keys in EXACT.items()}
    for name, value in content.items():
        if name not in _OF_STATED:
            raise InputError(
                f"{name} has no place in a rig file. State microscope.pinhole_height_sigma_mm."
            )
        table, key = _OF_STATED[name].split(".")
        found.setdefault(table, {})[key] = value
    return found


def rig_template() -> str:
    """A rig file with every key, its default and its meaning; what has no default is a comment."""
    lines = [
        "# A rig for eyespot. Lengths are in mm, angles in degrees, times in s.",
        "# `eyespot rig check RIG RECORDING` compares it with a recording.",
        f"schema = {SCHEMA}",
    ]
    for name, field in Rig.model_fields.items():
        if isinstance(field.default, Strict):
            lines += table_lines(name, type(field.default))
    return "\n".join(lines) + "\n"
