"""The scene as a Mitsuba dictionary, and how its moving parts are set for a moment."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

import scenes.rendering.plugins
import scenes.rendering.sensor  # noqa: F401
from scenes.description import GAUGE_DIAMETER_MM, Scene
from scenes.rendering.placement import rigid_transform
from scenes.rendering.wall import wall
from scenes.world import World

_SHAFT_MM = 40.0
_NEAR_MM = 0.01
_FIBRE_REFLECTANCE, _SHAFT_REFLECTANCE = 0.15, 0.3
# The end face lies this far behind the plane of the tip, so that it never swallows its own beam
# (Mitsuba's float32 self-intersection margin is about 1 um at 11 mm).
_FACE_GAP_MM = 0.003


def mitsuba_dict(world: World, *, uniform: np.ndarray) -> dict[str, Any]:
    """Everything that Mitsuba needs for a scene.

    Args:
        world: what the scene means.
        uniform: indirect irradiance per colour channel, mW/mm2.
    """
    scene = world.scene
    photons = scene.source.kind == "photons"
    on_a_grid = {
        "type": "stratified",
        "sample_count": scene.microscope.samples,
        # Traced light needs numbers that are random within their strata.
        "jitter": scene.phantom.indirect == "traced",
    }
    at_random = {"type": "independent", "sample_count": scene.source.photons_per_pixel}
    coaxial = scene.microscope.light == "coaxial"
    # Ambient light comes from all sides alike, as the light that the eyeball scatters back.
    ambient = 0.0 if coaxial else scene.microscope.illumination_mw_mm2
    return {
        "type": "scene",
        "wall": wall(world),
        **(_instrument(scene) if scene.instrument.visible else {}),
        **(_second_tool(scene) if scene.second_tool.visible else {}),
        "source": _source(world),
        "sensor": _sensor(world, on_a_grid),
        # A second one for photons that come to it, with as many of them a pixel as samples.
        **({"photon_camera": _sensor(world, at_random)} if photons else {}),
        "integrator": {
            "type": "eyespot_spot",
            # Photons bring the direct light in a pass of their own.
            "direct": not photons,
            "bounces": _traced_bounces(world),
            "uniform": mi.ScalarColor3f(uniform + ambient),
            "coaxial": scene.microscope.illumination_mw_mm2 if coaxial else 0.0,
            "pinhole_height": scene.microscope.pinhole_height_mm,
            "pole_height": -scene.phantom.radius_mm,
            "pupil_height": _pupil_height(scene),
        },
    }


def _pupil_height(scene: Scene) -> float:
    """Height from which on the eyeball's wall is open; beyond all walls if it is closed."""
    r, pupil = scene.phantom.radius_mm, scene.phantom.pupil_radius_mm
    return math.sqrt(r * r - pupil * pupil) if pupil else math.inf


def mover(scene: Scene, mitsuba_scene: Any) -> Callable[[np.ndarray, np.ndarray], None]:
    """What puts the tip and the axis of a scene that is loaded somewhere."""
    parameters = mi.traverse(mitsuba_scene)

    def move(tip: np.ndarray, axis: np.ndarray) -> None:
        apex = tip + scene.source.cone_apex_offset_mm * axis
        for name, value in pose_parameters(scene, tip=tip, axis=axis, apex=apex).items():
            parameters[name] = value
        parameters.update()

    return move


def pose_parameters(scene: Scene, *, tip: Any, axis: Any, apex: Any) -> dict[str, Any]:
    """Values of the Mitsuba parameters that place the tip, the axis and the virtual apex."""
    tip, axis, apex = np.asarray(tip), np.asarray(axis), np.asarray(apex)
    values: dict[str, Any] = {}
    if scene.instrument.visible:
        values["instrument.to_world"] = mi.Transform4f(rigid_transform(tip, axis))
    values["source.tip"], values["source.axis"] = mi.Point3f(tip), mi.Vector3f(axis)
    if scene.source.kind == "cone":
        values["source.light.to_world"] = mi.Transform4f(rigid_transform(apex, axis))
    return values


def _source(world: World) -> dict[str, Any]:
    scene, table = world.scene, world.table
    placed = {"tip": mi.ScalarPoint3f(0, 0, 0), "axis": mi.ScalarVector3f(0, 0, 1)}
    if table is None:
        half_angle = world.cone.half_angle
        intensity = scene.source.power_mw / (2 * math.pi * (1 - math.cos(half_angle)))
        light = {
            "type": "spot",
            "cutoff_angle": math.degrees(half_angle),
            "beam_width": math.degrees(half_angle),
            "intensity": {"type": "rgb", "value": intensity},
        }
        return {"type": "eyespot_cone", **placed, "light": light}
    return {
        "type": "eyespot_lens",
        **placed,
        "values": mi.TensorXf(np.asarray(table.values, dtype=np.float32)),
        "contact_radius": float(table.contact_radius),
        "slope": float(table.slope),
        "nearest": float(table.nearest),
        "farthest": float(table.farthest),
        "power": scene.source.power_mw,
        "lens": scene.source.lens,
        "medium_index": world.medium_index,
    }


def _instrument(scene: Scene) -> dict[str, Any]:
    """The instrument in the tip's frame, whose +z is the beam's axis, and its one moving instance.

    Moved as a rigid whole: a cylinder stretched and turned by one float32 matrix is not free of
    shear to the 1e-6 that Mitsuba asks for.
    """
    fibre = scene.instrument.fibre_diameter_mm / 2
    shaft = GAUGE_DIAMETER_MM[scene.instrument.gauge] / 2
    end = -scene.instrument.fibre_length_mm
    return {
        "instrument_shapes": _rods(
            ("fibre", fibre, end, -_FACE_GAP_MM, _FIBRE_REFLECTANCE),
            ("shaft", shaft, end - _SHAFT_MM, end, _SHAFT_REFLECTANCE),
        ),
        "instrument": {"type": "instance", "shapes": {"type": "ref", "id": "instrument_shapes"}},
    }


def _second_tool(scene: Scene) -> dict[str, Any]:
    """A shaft that ends at its tip and lies on the line to its trocar."""
    tool = scene.second_tool
    polar, azimuth = math.radians(tool.trocar_polar_deg), math.radians(tool.trocar_azimuth_deg)
    across = math.sin(polar)
    trocar = scene.phantom.radius_mm * np.array(
        [across * math.cos(azimuth), across * math.sin(azimuth), math.cos(polar)]
    )
    inwards = np.array(tool.tip_mm) - trocar
    place = rigid_transform(np.array(tool.tip_mm), inwards / np.linalg.norm(inwards))
    radius = GAUGE_DIAMETER_MM[tool.gauge] / 2
    return {
        "tool_shapes": _rods(("tool", radius, -_SHAFT_MM, 0.0, _SHAFT_REFLECTANCE)),
        "tool": {
            "type": "instance",
            "to_world": mi.ScalarTransform4f(place),
            "shapes": {"type": "ref", "id": "tool_shapes"},
        },
    }


def _rods(*rods: tuple[str, float, float, float, float]) -> dict[str, Any]:
    """Matt rods along z: name, radius, back and front in mm, reflectance."""
    shapes: dict[str, Any] = {"type": "shapegroup"}
    for name, radius, back, front, reflectance in rods:
        matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}}
        twosided = {"type": "twosided", "bsdf": matt}
        place = np.diag([radius, radius, 1.0, 1.0])
        place[2, 3] = front
        shapes[f"{name}_side"] = {
            "type": "cylinder",
            "p0": [0.0, 0.0, back],
            "p1": [0.0, 0.0, front],
            "radius": radius,
            "bsdf": twosided,
        }
        shapes[f"{name}_face"] = {
            "type": "disk",
            "to_world": mi.ScalarTransform4f(place),
            "bsdf": twosided,
        }
    return shapes


def _sensor(world: World, sampler: dict[str, Any]) -> dict[str, Any]:
    scene, microscope = world.scene, world.microscope
    # Mitsuba's pixel i spans [i, i + 1), hence the half.
    u0, v0 = np.asarray(microscope.principal_point) + 0.5
    names = ("k1", "k2", "p1", "p2", "k3")
    return {
        "type": "eyespot_microscope",
        "film": _film(scene),
        "sampler": sampler,
        "scale": scene.microscope.scale_mm_px,
        "inverse_working_distance": float(microscope.inverse_working_distance),
        "pole_height": -scene.phantom.radius_mm,
        "principal_point": mi.ScalarPoint2f(u0, v0),
        "entry_height": _inside_the_eye(world),
        "vignetting": scene.microscope.vignetting,
        "aperture_slope": _aperture_slope(scene),
        "focus_height": scene.microscope.focus_mm - scene.phantom.radius_mm,
        **dict(zip(names, scene.microscope.distortion, strict=True)),
    }


def _aperture_slope(scene: Scene) -> float:
    return math.tan(math.asin(scene.microscope.numerical_aperture))


def _film(scene: Scene) -> dict[str, Any]:
    return {
        "type": "hdrfilm",
        "width": scene.microscope.width_px,
        "height": scene.microscope.height_px,
        "rfilter": {"type": "box"},
        "component_format": "float32",
        "pixel_format": "rgb",
    }


def _traced_bounces(world: World) -> int:
    """Reflections that traced indirect light takes, so that less than 0.1 % of it is missing."""
    if world.scene.phantom.indirect != "traced":
        return 0
    return math.ceil(math.log(1e-3) / math.log(max(world.wall_colour.max(), 1e-3)))


def _inside_the_eye(world: World) -> float:
    """Height at which every line of sight of the window is inside the eyeball.

    A microscope above the eye looks through the pupil; rays start below the wall's upper half.
    """
    scene = world.scene
    settings, r = scene.microscope, scene.phantom.radius_mm
    if scene.phantom.kind == "plane":
        return 3 * r if math.isinf(settings.pinhole_height_mm) else settings.pinhole_height_mm
    border = world.window_border
    point, direction = (np.asarray(a) for a in world.microscope.ray(border))
    if slope := _aperture_slope(scene):
        # The outermost lines of sight that a thin lens adds cross these in the plane in focus.
        aside = slope * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
        below = (settings.focus_mm - r - point[:, 2:]) / direction[:, 2:]
        point, direction = point + below * direction, direction / -direction[:, 2:]
        direction = (direction + aside[:, None]).reshape(-1, 3)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        point = np.tile(point, (len(aside), 1))
    along = -np.sum(point * direction, axis=-1)
    chord = along**2 + r**2 - np.sum(point * point, axis=-1)
    if chord.min() <= 0:
        raise ValueError(
            f"the window of {settings.width_px} x {settings.height_px} px looks past the eyeball "
            f"of radius {r:g} mm. Lower spot.eccentricity_mm or the window's size."
        )
    entry = point[:, 2] + (along - np.sqrt(chord)) * direction[:, 2]
    return min(float(entry.min()) - 1e-3 * r, settings.pinhole_height_mm - _NEAR_MM)
