"""A loaded Mitsuba scene: rigid transforms, its wall, and radiance along lines of sight."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import optics


def rigid_transform(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Rigid transform, 4 x 4, that maps the origin to `origin` and +z to `direction`."""
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(direction))
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = first, second, direction, origin
    return matrix


def wall_shape(mitsuba_scene: Any) -> Any:
    """The wall of a Mitsuba scene."""
    return next(shape for shape in mitsuba_scene.shapes() if shape.id() == "wall")


def radiance_along(mitsuba_scene: Any, *, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Radiance that arrives along lines of sight, as the scene's own camera would see it.

    Args:
        mitsuba_scene: a scene with `SpotIntegrator`, as `Images.mitsuba_scene` is.
        start: where the lines start, inside the eyeball, n x 3, mm.
        direction: unit vectors away from the camera, n x 3.

    Returns:
        n x 3, mW/(mm2 sr).
    """
    point, towards = (np.ascontiguousarray(a.T, dtype=np.float32) for a in (start, direction))
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(point), mi.Vector3f(towards)))
    sampler = mitsuba_scene.sensors()[0].sampler()
    light, _, _ = mitsuba_scene.integrator().sample(mitsuba_scene, sampler, ray)
    colours = dr.ravel(light)
    dr.eval(colours)
    return np.array(colours).reshape(-1, 3)
