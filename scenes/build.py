"""The scene as a Mitsuba dictionary, and how its moving parts are set for a moment."""

from __future__ import annotations

import functools
import math
from typing import Any

import mitsuba as mi
import numpy as np

import optics
import scenes.plugins  # noqa: F401  (registers the plugins by name)
from scenes import geometry
from scenes.fundus import fundus
from scenes.settings import GAUGE_DIAMETER_MM, Scene

_TEXTURE_MM, _TEXTURE_PX = 24.0, 2048
_SHAFT_MM = 40.0
_NEAR_MM = 0.01
_FIBRE_REFLECTANCE, _SHAFT_REFLECTANCE = 0.15, 0.3
# The end face lies this far behind the plane of the tip, so that it never swallows its own beam
# (Mitsuba's float32 self-intersection margin is about 1 um at 11 mm).
_FACE_GAP_MM = 0.003


def mitsuba_dict(
    scene: Scene, *, table: optics.IrradianceTable | None, uniform: np.ndarray
) -> dict[str, Any]:
    """Everything that Mitsuba needs for a scene.

    Args:
        scene: the scene.
        table: vector irradiance of the lens, or None for the cone.
        uniform: indirect irradiance per colour channel, mW/mm2.
    """
    microscope = geometry.microscope(scene)
    return {
        "type": "scene",
        "wall": _wall(scene),
        **(_instrument(scene) if scene.instrument.visible else {}),
        "source": _source(scene, table),
        "sensor": _sensor(scene, microscope),
        "integrator": {
            "type": "eyespot_spot",
            "uniform": mi.ScalarColor3f(uniform),
            "coaxial": scene.microscope.illumination_mw_mm2,
            "pinhole_height": scene.microscope.pinhole_height_mm,
            "pole_height": -scene.phantom.radius_mm,
        },
    }


def pose_parameters(scene: Scene, *, tip: Any, axis: Any, apex: Any) -> dict[str, Any]:
    """Values of the Mitsuba parameters that place the tip, the axis and the virtual apex."""
    tip, axis, apex = np.asarray(tip), np.asarray(axis), np.asarray(apex)
    values: dict[str, Any] = {}
    if scene.instrument.visible:
        values["instrument.to_world"] = mi.Transform4f(_frame(tip, axis))
    values["source.tip"], values["source.axis"] = mi.Point3f(tip), mi.Vector3f(axis)
    if scene.source.kind == "cone":
        values["source.light.to_world"] = mi.Transform4f(_frame(apex, axis))
    return values


def wall_colour(scene: Scene) -> np.ndarray:
    """Mean linear reflectance of the wall per colour channel."""
    if scene.phantom.wall == "uniform":
        return np.full(3, scene.phantom.reflectance)
    return _texture(scene).mean(axis=(0, 1), dtype=float)


def _texture(scene: Scene) -> np.ndarray:
    return _fundus(scene.phantom.texture_seed, scene.phantom.wall)


@functools.lru_cache(maxsize=2)
def _fundus(seed: int, palette: Any) -> np.ndarray:
    # All trials of a run share one wall.
    return fundus(seed=seed, extent_mm=_TEXTURE_MM, pixels=_TEXTURE_PX, palette=palette)


def _wall(scene: Scene) -> dict[str, Any]:
    if scene.phantom.wall == "uniform":
        reflectance = {"type": "rgb", "value": scene.phantom.reflectance}
    else:
        texture = _texture(scene)
        if scene.phantom.kind == "eyeball":
            texture = _on_sphere(
                scene.phantom.texture_seed, scene.phantom.wall, scene.phantom.radius_mm
            )
        reflectance = {
            "type": "bitmap",
            # Mitsuba puts row 0 at v = 0, the map has it at +Y.
            "bitmap": mi.Bitmap(np.ascontiguousarray(texture[::-1], dtype=np.float32)),
            "raw": True,
            "wrap_mode": "clamp",
        }
    matt = {"type": "diffuse", "reflectance": reflectance}
    if scene.phantom.kind == "plane":
        pole = geometry.wall(scene).frame_at(eccentricity=0.0, azimuth=0.0)
        place = _frame(np.asarray(pole.origin), -np.asarray(pole.outward))
        half = np.diag([_TEXTURE_MM / 2, _TEXTURE_MM / 2, 1.0, 1.0])
        return {"type": "rectangle", "to_world": mi.ScalarTransform4f(place @ half), "bsdf": matt}
    if "bitmap" in reflectance:
        reflectance["to_uv"] = _longitude_latitude_to_uv(radius=scene.phantom.radius_mm)
    return {
        "type": "sphere",
        "radius": scene.phantom.radius_mm,
        "flip_normals": True,
        "to_world": mi.ScalarTransform4f(_EQUATOR_AT_POLE),
        "bsdf": matt,
    }


# Mitsuba's sphere has its coordinate poles on its own z axis, where a map is pinched, and the seam
# of its longitude at +x. Turned so that its -x axis points to the retinal pole and its -z axis
# along Y, the middle of the map lies on the retina.
_EQUATOR_AT_POLE = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


@functools.lru_cache(maxsize=2)
def _on_sphere(seed: int, palette: Any, radius: float) -> np.ndarray:
    """The fundus, azimuthal-equidistant about the pole, on longitude and latitude."""
    texture = _fundus(seed, palette)
    half = 0.5 * _TEXTURE_MM / radius
    centres = half * ((np.arange(_TEXTURE_PX) + 0.5) / _TEXTURE_PX * 2 - 1)
    longitude, latitude = np.meshgrid(centres, -centres)
    x = np.cos(latitude) * np.sin(longitude)
    y = np.sin(latitude)
    arc = np.arctan2(np.hypot(x, y), np.cos(latitude) * np.cos(longitude))
    stretch = radius * arc / np.maximum(np.hypot(x, y), 1e-12)
    return _bilinear(texture, x * stretch, y * stretch)


def _bilinear(texture: np.ndarray, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
    column = np.clip((x_mm / _TEXTURE_MM + 0.5) * _TEXTURE_PX - 0.5, 0, _TEXTURE_PX - 1.001)
    row = np.clip((0.5 - y_mm / _TEXTURE_MM) * _TEXTURE_PX - 0.5, 0, _TEXTURE_PX - 1.001)
    i, j = row.astype(np.int32), column.astype(np.int32)
    fi = (row - i).astype(np.float32)[..., None]
    fj = (column - j).astype(np.float32)[..., None]
    upper = texture[i, j] * (1 - fj) + texture[i, j + 1] * fj
    lower = texture[i + 1, j] * (1 - fj) + texture[i + 1, j + 1] * fj
    return upper * (1 - fi) + lower * fi


def _longitude_latitude_to_uv(*, radius: float) -> Any:
    """Maps the sphere's (longitude/2pi, colatitude/pi) so that the texture covers its extent."""
    extent = _TEXTURE_MM / radius
    scale_u, scale_v = 2 * math.pi / extent, math.pi / extent
    return mi.ScalarTransform3f(
        [[scale_u, 0.0, 0.5 - 0.5 * scale_u], [0.0, scale_v, 0.5 - 0.5 * scale_v], [0.0, 0.0, 1.0]]
    )


def _source(scene: Scene, table: optics.IrradianceTable | None) -> dict[str, Any]:
    placed = {"tip": mi.ScalarPoint3f(0, 0, 0), "axis": mi.ScalarVector3f(0, 0, 1)}
    if table is None:
        half_angle = geometry.cone(scene, None).half_angle
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
    }


def _instrument(scene: Scene) -> dict[str, Any]:
    """The instrument in the tip's frame, whose +z is the beam's axis, and its one moving instance.

    Moved as a rigid whole: a cylinder stretched and turned by one float32 matrix is not free of
    shear to the 1e-6 that Mitsuba asks for.
    """
    fibre = scene.instrument.fibre_diameter_mm / 2
    shaft = GAUGE_DIAMETER_MM[scene.instrument.gauge] / 2
    end = -scene.instrument.fibre_length_mm
    shapes: dict[str, Any] = {"type": "shapegroup"}
    for name, radius, back, front, reflectance in (
        ("fibre", fibre, end, -_FACE_GAP_MM, _FIBRE_REFLECTANCE),
        ("shaft", shaft, end - _SHAFT_MM, end, _SHAFT_REFLECTANCE),
    ):
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
    return {
        "instrument_shapes": shapes,
        "instrument": {"type": "instance", "shapes": {"type": "ref", "id": "instrument_shapes"}},
    }


def _sensor(scene: Scene, microscope: optics.Microscope) -> dict[str, Any]:
    settings = scene.microscope
    width, height, scale = settings.width_px, settings.height_px, settings.scale_mm_px
    # Mitsuba's pixel i spans [i, i + 1), hence the half.
    u0, v0 = np.asarray(microscope.principal_point) + 0.5
    film = {
        "type": "hdrfilm",
        "width": width,
        "height": height,
        "rfilter": {"type": "box"},
        "component_format": "float32",
        "pixel_format": "rgb",
    }
    sampler = {"type": "stratified", "sample_count": settings.samples, "jitter": False}
    shared = {"film": film, "sampler": sampler, "far_clip": 1e4}
    r, z_f = scene.phantom.radius_mm, settings.pinhole_height_mm
    if math.isinf(z_f):
        start = _inside_the_eye(scene, microscope)
        half = scale * width / 2
        x, y = (width / 2 - u0) * scale, (v0 - height / 2) * scale
        place = np.diag([-half, half, -1.0, 1.0])
        place[:3, 3] = x, y, start + _NEAR_MM
        return {
            "type": "orthographic",
            "to_world": mi.ScalarTransform4f(place),
            "near_clip": _NEAR_MM,
            **shared,
        }
    focal = (z_f + r) / scale
    place = np.diag([-1.0, 1.0, -1.0, 1.0])
    place[2, 3] = z_f
    return {
        "type": "perspective",
        "fov": math.degrees(2 * math.atan(width / 2 / focal)),
        "fov_axis": "x",
        "principal_point_offset_x": (width / 2 - u0) / width,
        "principal_point_offset_y": (height / 2 - v0) / height,
        "to_world": mi.ScalarTransform4f(place),
        "near_clip": max(z_f - _inside_the_eye(scene, microscope), _NEAR_MM),
        **shared,
    }


def _inside_the_eye(scene: Scene, microscope: optics.Microscope) -> float:
    """Height at which every line of sight of the window is inside the eyeball.

    A microscope above the eye looks through the pupil; rays start below the wall's upper half.
    """
    settings, r = scene.microscope, scene.phantom.radius_mm
    if scene.phantom.kind == "plane":
        return 3 * r if math.isinf(settings.pinhole_height_mm) else settings.pinhole_height_mm
    right, bottom = settings.width_px - 0.5, settings.height_px - 0.5
    corners = np.array([(u, v) for u in (-0.5, right) for v in (-0.5, bottom)])
    point, direction = (np.asarray(a) for a in microscope.ray(corners))
    along = -np.sum(point * direction, axis=-1)
    chord = along**2 + r**2 - np.sum(point * point, axis=-1)
    if chord.min() <= 0:
        raise ValueError(
            f"the window of {settings.width_px} x {settings.height_px} px looks past the eyeball "
            f"of radius {r:g} mm. Lower spot.eccentricity_mm or the window's size."
        )
    entry = point[:, 2] + (along - np.sqrt(chord)) * direction[:, 2]
    return min(float(entry.min()) - 1e-3 * r, settings.pinhole_height_mm - _NEAR_MM)


def _frame(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Rigid transform that takes the origin to `origin` and +z to `direction`."""
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(direction))
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = first, second, direction, origin
    return matrix
