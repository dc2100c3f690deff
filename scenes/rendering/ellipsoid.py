"""A stretched eyeball as a mesh: Mitsuba's sphere cannot be stretched.

Import after `load_mitsuba`.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

import optics
from scenes.walls import PICTURE_MM

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
