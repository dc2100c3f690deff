"""Radiance along given lines of sight: a loaded scene as any other camera sees it.

Import after `load_mitsuba`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


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
