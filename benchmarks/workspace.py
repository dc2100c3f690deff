"""A rig as studies take it: its geometry, where its tip works, and the scene that it states."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from eyespot import optics
from eyespot.benchmarks.model_error import Geometry
from eyespot.formats.calibration import CONE_MODELS, LENS_PARAMETERS, Calibration, read_calibration
from eyespot.formats.camera_sheet import CameraSheet
from eyespot.formats.inputs import InputError, Strict
from eyespot.formats.rig import Rig
from eyespot.formats.rig_keys import WorkspaceKeys
from eyespot.scenes import Scene
from eyespot.scenes.description.scene_keys import CameraSettings

USUAL_SCALE_MM_PX = 0.0067
"""Scale of a rig that states none. Without noise no error depends on it."""

LENS_RANGE_MM = (0.5, 6.0)
"""Distances over which a lens is taken for a cone; as in the paper's trials."""

_USUAL_REACH = 0.7
"""Largest eccentricity over the eye's radius, if the rig states none: 8 mm in an eye of 11.5 mm."""
USUAL_REACH_MM = 8.0
"""Largest eccentricity of studies."""
_LARGEST_REACH = 0.95
"""Farther out the wall is seen at a grazing angle, and a spot extends beyond the equator."""
_LARGEST_LEAN_DEG = 85.0
"""Largest angle between the edge of a tilted cone and the wall's normal at O."""
_AZIMUTH_STEP_DEG = 30.0


def geometry_of_rig(rig: Rig) -> Geometry:
    """Pinhole, eye and cone of a rig, with a beam square to the wall.

    Raises:
        InputError: the rig lacks a number, or has no cone.
    """
    own, scale = rig.microscope, rig.microscope.scale_mm_px
    if rig.wall.kind == "plane":
        raise InputError(
            "wall.kind is 'plane', where all models agree. Set wall.kind = 'eyeball' and "
            "wall.radius_mm."
        )
    needed = {
        "microscope.pinhole_height_mm": own.pinhole_height_mm,
        "wall.radius_mm": rig.wall.radius_mm,
    }
    if own.calibration is not None and (view := rig.view) is not None:
        needed = dict(zip(needed, (view.pinhole_height_mm, view.eye_radius_mm), strict=True))
        scale = view.scale_mm_px
        if view.viewing_path is not None:
            raise InputError(
                f"{own.calibration} looks through a viewing lens, behind which the errors are "
                "those of `eyespot study eye`. State a microscope without one."
            )
    known = _known(needed | _needed_of_the_cone(rig), "a model's error")
    half_angle, b = cone_of_rig(rig)
    return Geometry(
        scale=scale or USUAL_SCALE_MM_PX,
        pinhole_height=known["microscope.pinhole_height_mm"],
        eye_radius=known["wall.radius_mm"],
        half_angle=half_angle,
        apex_offset=b,
        incidence=0.0,
        incidence_azimuth=0.0,
    )


def cone_of_rig(rig: Rig) -> tuple[float, float]:
    r"""Half-angle (rad) and b (mm) of a rig's cone.

    The cone is that of `beam.half_angle_deg` or `beam.numerical_aperture` with the core's radius a:
    $b = -a/\tan\alpha$, so that the light is as wide as the core at the tip; or else that of the
    calibration.

    Raises:
        InputError: the rig has no cone.
    """
    beam, known = rig.beam, _known(_needed_of_the_cone(rig), "the cone")
    if beam.calibration is not None and not known:
        file = rig.folder / beam.calibration
        return calibrated_cone(read_calibration(file))[:2]
    if beam.half_angle_deg is not None:
        half_angle = math.radians(beam.half_angle_deg)
    else:
        half_angle = math.asin(known["beam.numerical_aperture"] / known["wall.medium"])
    return half_angle, -known["instrument.core_radius_mm"] / math.tan(half_angle)


def _needed_of_the_cone(rig: Rig) -> dict[str, float | None]:
    """The keys that a stated cone needs, with their values; none for a calibrated one."""
    beam = rig.beam
    needed = {"instrument.core_radius_mm": rig.instrument.core_radius_mm}
    if beam.half_angle_deg is not None:
        return needed
    if beam.numerical_aperture is None and beam.calibration is not None:
        return {}
    index = None if rig.wall.medium is None else optics.MEDIA[rig.wall.medium]
    return needed | {"beam.numerical_aperture": beam.numerical_aperture, "wall.medium": index}


def _known(needed: Mapping[str, float | None], what: str) -> dict[str, float]:
    """The values of keys, all of which must be there."""
    known = {name: float(value) for name, value in needed.items() if value is not None}
    if missing := [name for name in needed if name not in known]:
        raise InputError(
            f"{what} depends on {', '.join(missing)}, which the rig does not state. Add "
            f"{'it' if len(missing) == 1 else 'them'} to the rig file or by --set."
        )
    return known


def calibrated_cone(calibration: Calibration) -> tuple[float, float, Float[np.ndarray, "2 2"]]:
    """Half-angle (rad) and b (mm) of a calibrated beam, and their covariance.

    Of a lens those of its effective cone over the paper's distances, 0.5 to 6 mm (Zhou et al. 2020,
    equation 1), to first order in the errors of the lens.
    """
    if calibration.model in CONE_MODELS:
        return calibration.cone
    values = calibration.values

    def cone(of: Mapping[str, float]) -> np.ndarray:
        known: Any = {
            name: np.asarray(of[name]) if name in of else None for name in LENS_PARAMETERS
        }
        glass = optics.GlueLens(**known)
        light = optics.LensField(glass, calibration.medium.index)
        low, high = LENS_RANGE_MM
        found = optics.effective_cone(light, from_distance=low, to_distance=high)
        return np.array([found.half_angle, found.b])

    own, slopes = cone(values), np.zeros((2, len(values)))
    for column, (name, value) in enumerate(values.items()):
        # Steps of one standard error: the quadrature's own error exceeds the effect of small ones.
        step = calibration.sigma(name)
        if name in LENS_PARAMETERS and step > 0:
            slopes[:, column] = (cone({**values, name: value + step}) - own) / step
    half_angle, b = own.tolist()
    return half_angle, b, slopes @ calibration.covariance @ slopes.T


def workspace_of(rig: Rig, geometry: Geometry) -> WorkspaceKeys:
    """The ranges in which the tip of a rig works, with its eccentricities.

    Raises:
        InputError: no tip, or no spot, can be there; the text has the nearest value that works.
    """
    own, r = rig.workspace, geometry.eye_radius
    c = own.eccentricity_mm or (0.0, _USUAL_REACH * r)
    if c[1] > _LARGEST_REACH * r:
        raise InputError(
            f"workspace.eccentricity_mm reaches {c[1]:g} mm in an eye of {r:g} mm radius, whose "
            f"wall ends there. It may reach {_rounded_down(_LARGEST_REACH * r)} mm."
        )
    tilt = math.radians(own.tilt_deg[1])
    lean = own.tilt_deg[1] + math.degrees(geometry.half_angle)
    if lean > _LARGEST_LEAN_DEG:
        raise InputError(
            f"workspace.tilt_deg reaches {own.tilt_deg[1]:g} degrees with a cone of half-angle "
            f"{math.degrees(geometry.half_angle):.3g} degrees, whose edge then misses the wall. It "
            f"may reach {_rounded_down(_LARGEST_LEAN_DEG - lean + own.tilt_deg[1])} degrees."
        )
    # The tip lies in the eye: r^2 + d^2 - 2 r d cos(tilt) < r^2.
    if own.distance_mm[1] > (longest := 0.99 * 2 * r * math.cos(tilt)):
        raise InputError(
            f"workspace.distance_mm reaches {own.distance_mm[1]:g} mm; at a tilt of "
            f"{own.tilt_deg[1]:g} degrees the tip is then outside an eye of {r:g} mm radius. It "
            f"may reach {_rounded_down(longest)} mm."
        )
    # The wall below the pinhole is seen; the spot's edge lies at most its own width higher.
    height = -math.sqrt(r**2 - c[1] ** 2)
    reach = (own.distance_mm[1] - geometry.apex_offset) * math.tan(geometry.half_angle)
    if geometry.pinhole_height > -r and height + reach > geometry.pinhole_height - 0.1 * r:
        raise InputError(
            f"workspace.eccentricity_mm reaches {c[1]:g} mm, where a spot of {reach:.3g} mm radius "
            f"lies as high as the pinhole at {geometry.pinhole_height:g} mm. Lower it, or "
            "workspace.distance_mm."
        )
    return own.model_copy(update={"eccentricity_mm": c})


def workspace_of_scene(scene: Scene, rig: Rig | None, geometry: Geometry) -> WorkspaceKeys:
    """The ranges of a study: those that a rig states, at the scene's tilt if it states none.

    Raises:
        InputError: the wall is no eyeball, or no tip or spot can be there.
    """
    if scene.phantom.kind != "eyeball":
        raise InputError("the study varies c in an eyeball. Set phantom.kind=eyeball.")
    reach = min(_USUAL_REACH * scene.phantom.radius_mm, USUAL_REACH_MM)
    tilt = (0.0, scene.spot.incidence_deg)
    given = WorkspaceKeys() if rig is None else rig.workspace
    usual = {"eccentricity_mm": (0.0, reach), "tilt_deg": tilt}
    stated = given.model_dump(include=given.model_fields_set)
    return workspace_of(Rig(workspace=WorkspaceKeys(**usual | stated)), geometry)


def azimuths_deg(workspace: WorkspaceKeys) -> tuple[float, ...]:
    """Directions of a tilt within the workspace, degrees in [0, 180].

    Beams that lean to either side of the meridian make mirrored spots.
    """
    low, high = workspace.azimuth_deg
    inner = np.arange(math.ceil(low / _AZIMUTH_STEP_DEG), high / _AZIMUTH_STEP_DEG + 1e-9)
    every = np.array([low, *(_AZIMUTH_STEP_DEG * inner), high])
    return tuple(np.unique(np.abs((every + 180.0) % 360.0 - 180.0).round(9)).tolist())


def _rounded_down(value: float) -> str:
    return f"{math.floor(10 * value) / 10:g}"


# The scene of a rig, for studies that render.

_SAME_IN_A_SCENE = {
    "wall.kind": "phantom.kind",
    "wall.radius_mm": "phantom.radius_mm",
    "wall.medium": "source.medium",
} | {
    key: key
    for key in (
        "microscope.width_px",
        "microscope.height_px",
        "microscope.scale_mm_px",
        "microscope.pinhole_height_mm",
        "microscope.distortion",
        "instrument.fibre_diameter_mm",
        "instrument.fibre_length_mm",
        "instrument.visible",
        "camera.bit_depth",
        "camera.black_level_dn",
        "camera.response",
        "unrest.shake_px",
    )
}
"""Keys of a rig file, and those of a scene that mean the same."""
_OF_THE_CONE = {
    "beam.half_angle_deg",
    "beam.numerical_aperture",
    "beam.calibration",
    "instrument.core_radius_mm",
}
_OF_THE_WORKSPACE = {f"workspace.{name}" for name in WorkspaceKeys.model_fields}


def scene_of_rig(rig: Rig) -> tuple[dict[str, object], list[str]]:
    """What a rig states of a scene, and what it states that no scene has.

    Returns:
        Changes of a scene's keys; and the rig's own keys that have no part in them.
    """
    stated = _stated(rig)
    changes = {_SAME_IN_A_SCENE[key]: stated[key] for key in _SAME_IN_A_SCENE if key in stated}
    read = {*_SAME_IN_A_SCENE, *_OF_THE_CONE, *_OF_THE_WORKSPACE, "camera.noise", "schema"}
    if rig.microscope.calibration is not None and (view := rig.view) is not None:
        read.add("microscope.calibration")
        for name in ("width_px", "height_px", "scale_mm_px", "pinhole_height_mm"):
            changes[f"microscope.{name}"] = getattr(view, name)
        changes["phantom.radius_mm"] = view.eye_radius_mm
    if isinstance(sheet := rig.camera.noise, CameraSheet):
        known = CameraSettings.model_fields.keys() & sheet.model_fields_set - {"bayer"}
        changes |= {f"camera.{name}": getattr(sheet, name) for name in known}
    if _OF_THE_CONE & stated.keys() - {"instrument.core_radius_mm"}:
        half_angle, b = cone_of_rig(rig)
        changes |= {"source.kind": "cone", "source.cone_k": 1.0 / math.tan(half_angle)}
        changes["source.cone_apex_offset_mm"] = b
    if "workspace.tilt_deg" in stated:
        changes["spot.incidence_deg"] = rig.workspace.tilt_deg[1]
    return changes, sorted(stated.keys() - read)


def _stated(rig: Rig) -> dict[str, object]:
    """The keys that a rig sets, with their values."""
    given = rig.model_fields_set - {"folder", "seen", "where"}
    tables = ((name, getattr(rig, name)) for name in given)
    return {
        f"{name}.{key}": getattr(table, key)
        for name, table in tables
        if isinstance(table, Strict)
        for key in table.model_fields_set
    }
