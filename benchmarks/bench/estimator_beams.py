"""Light of a glue lens as a profile for synthetic frames."""

from __future__ import annotations

import functools

import numpy as np

from benchmarks.bench.estimator_frames import Profile

_FURTHEST_RADIUS = 8.0  # half-maximum radii: beyond, the light does not count
_SAMPLES = 4000


@functools.cache
def lens_profile(preset: str, medium_index: float, distance_mm: float) -> Profile:
    """Irradiance of a plane square to the axis, by its vector irradiance; 1 on the half maximum.

    Args:
        preset: of the lens, see `optics.lens_names`.
        medium_index: of what is in front of it.
        distance_mm: of the plane from the tip.
    """
    import optics

    table = optics.irradiance_table(optics.load_lens(preset), medium_index=medium_index)
    half_radius = float(optics.half_maximum_radius(table, distance=distance_mm))
    radii = np.linspace(0, _FURTHEST_RADIUS, _SAMPLES)
    _, light = table(radius=radii * half_radius, distance=distance_mm)
    relative = np.asarray(light / light.max())
    return lambda t, distance: np.interp(t, radii, relative, right=0.0)
