"""The wall for Mitsuba: its shape and the picture on it. Import after `load_mitsuba`.

A stretched eyeball is a mesh, because Mitsuba's sphere cannot be stretched.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import mitsuba as mi
import numpy as np

import optics
from scenes.description import Phantom, Scene
from scenes.rendering.placement import rigid_transform
from scenes.walls import PICTURE_MM, PICTURE_PX, wall_picture
from scenes.world import World

_RINGS, _SECTORS = 400, 800
"""Facets of 0.1 mm lie within 0.1^2 / (8 r) = 1e-4 mm of the wall for r = 12 mm, which moves a
spot's contour by less than 1e-3 px."""


def ellipsoid_mesh(wall: optics.Ellipsoid, surface: dict[str, Any]) -> Any:
    """The wall seen from inside, with the ellipsoid's own normals.

    The picture is laid round the pole: its x and y are the direction from the pole and the
    distance on a sphere of the same pole, as on a spherical eyeball.

    Args:
        wall: the ellipsoid.
        surface: dictionary of its material.
    """
    polar = np.pi * np.arange(1, _RINGS) / _RINGS
    azimuth = 2 * np.pi * np.arange(_SECTORS) / _SECTORS
    around = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    rings = np.concatenate(
        [
            np.sin(polar)[:, None, None] * around,
            np.broadcast_to(-np.cos(polar)[:, None, None], (_RINGS - 1, _SECTORS, 1)),
        ],
        axis=-1,
    )
    unit = np.vstack([rings.reshape(-1, 3), [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
    semi_axes, turn = np.asarray(wall.semi_axes), np.asarray(wall.turn)
    points = (semi_axes * unit) @ turn.T + np.asarray(wall.centre)
    inward = (-unit / semi_axes) @ turn.T
    radius = float(semi_axes[2])
    distance = radius * np.arctan2(np.hypot(*points.T[:2]), -(points[:, 2]))
    direction = points[:, :2] / np.maximum(np.hypot(*points.T[:2]), 1e-12)[:, None]
    place = 0.5 + distance[:, None] * direction / PICTURE_MM
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(surface)
    faces = _faces()
    mesh = mi.Mesh(
        "wall",
        len(points),
        len(faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = points.astype(np.float32).ravel()
    normals = inward / np.linalg.norm(inward, axis=-1, keepdims=True)
    parameters["vertex_normals"] = normals.astype(np.float32).ravel()
    parameters["vertex_texcoords"] = place.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    mesh.set_id("wall")
    return mesh


def _faces() -> np.ndarray:
    """Triangles of the rings and, at the end, of the two poles; they face inwards."""
    here = np.arange((_RINGS - 1) * _SECTORS).reshape(_RINGS - 1, _SECTORS)
    beside = np.roll(here, -1, axis=1)
    below, above = np.full(_SECTORS, here.size), np.full(_SECTORS, here.size + 1)
    corners = (
        (here[:-1], beside[:-1], beside[1:]),
        (here[:-1], beside[1:], here[1:]),
        (below, beside[0], here[0]),
        (above, here[-1], beside[-1]),
    )
    return np.concatenate([np.stack(c, axis=-1).reshape(-1, 3) for c in corners])


_COATS = {"wet": (optics.MEDIA["water"], 0.05), "glossy": (1.5, 0.2)}
"""Refractive index, and Beckmann's roughness (an assumption)."""


def wall(world: World) -> Any:
    """The wall, as `mi.load_dict` takes it in a scene. Call it after `load_mitsuba`."""
    scene = world.scene
    if scene.phantom.wall == "uniform":
        reflectance = {"type": "rgb", "value": scene.phantom.reflectance}
    else:
        round_wall = scene.phantom.kind == "eyeball" and not scene.phantom.stretched
        texture = (_on_sphere if round_wall else wall_picture)(scene.phantom)
        reflectance = {
            "type": "bitmap",
            # Row 0 of the map is at +Y, but Mitsuba puts row 0 at v = 0.
            "bitmap": mi.Bitmap(np.ascontiguousarray(texture[::-1], dtype=np.float32)),
            "raw": True,
            "wrap_mode": "clamp",
        }
    surface = _surface(scene, reflectance)
    if scene.phantom.kind == "plane":
        pole = world.wall.frame_at(eccentricity=0.0, azimuth=0.0)
        place = rigid_transform(np.asarray(pole.origin), -np.asarray(pole.outward))
        half = np.diag([PICTURE_MM / 2, PICTURE_MM / 2, 1.0, 1.0])
        return {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(place @ half),
            "bsdf": surface,
        }
    if isinstance(world.wall, optics.Ellipsoid):
        return ellipsoid_mesh(world.wall, surface)
    if "bitmap" in reflectance:
        reflectance["to_uv"] = _longitude_latitude_to_uv(radius=scene.phantom.radius_mm)
    return {
        "type": "sphere",
        "radius": scene.phantom.radius_mm,
        "flip_normals": True,
        "to_world": mi.ScalarTransform4f(_EQUATOR_AT_POLE),
        "bsdf": surface,
    }


def _surface(scene: Scene, reflectance: dict[str, Any]) -> dict[str, Any]:
    medium = optics.MEDIA[scene.source.medium]
    index, roughness = _COATS.get(scene.phantom.coat, (medium, 0.0))
    if index == medium:  # no coat, or water on a wall under water
        return {"type": "diffuse", "reflectance": reflectance}
    return {
        "type": "roughplastic",
        "diffuse_reflectance": reflectance,
        "int_ior": index,
        "ext_ior": medium,
        "alpha": roughness,
    }


# Textures on Mitsuba's sphere are distorted at its z axis and have a seam at +x. The sphere is
# turned so that its -x axis points to the retinal pole and its -z axis along Y. So the centre of
# the map lies on the retina.
_EQUATOR_AT_POLE = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def _on_sphere(phantom: Phantom) -> np.ndarray:
    """The picture, mapped from azimuthal-equidistant coordinates to longitude and latitude."""
    texture, radius = wall_picture(phantom), phantom.radius_mm
    half = 0.5 * PICTURE_MM / radius
    centres = half * ((np.arange(PICTURE_PX) + 0.5) / PICTURE_PX * 2 - 1)
    longitude, latitude = centres, -centres[:, None]
    x = np.cos(latitude) * np.sin(longitude)
    y = np.sin(latitude)
    aside = np.hypot(x, y)
    arc = np.arctan2(aside, np.cos(latitude) * np.cos(longitude))
    stretch = radius * arc / np.maximum(aside, 1e-12)
    # From mm to pixels of the picture, whose rows point downwards.
    per_mm, middle = PICTURE_PX / PICTURE_MM, (PICTURE_PX - 1) / 2
    columns, rows = middle + per_mm * x * stretch, middle - per_mm * y * stretch
    return np.asarray(
        cv2.remap(
            texture,
            columns.astype(np.float32),
            rows.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
    )


def _longitude_latitude_to_uv(*, radius: float) -> Any:
    """Transform from (longitude/2pi, colatitude/pi) to the coordinates of the texture."""
    extent = PICTURE_MM / radius
    scale_u, scale_v = 2 * math.pi / extent, math.pi / extent
    return mi.ScalarTransform3f(
        [[scale_u, 0.0, 0.5 - 0.5 * scale_u], [0.0, scale_v, 0.5 - 0.5 * scale_v], [0.0, 0.0, 1.0]]
    )
