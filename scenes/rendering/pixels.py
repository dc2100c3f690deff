"""Renders a subset of the pixels of an image, sampled on a regular grid.

Import after `load_mitsuba`.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


@dr.syntax
def pixel_means(
    mitsuba_scene: Any, pixels: np.ndarray, *, samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """The same values as `mi.render` with a box filter and a stratified sampler without jitter.

    Args:
        mitsuba_scene: a scene with `SpotIntegrator`.
        pixels: indices of n pixels, counted along rows from the top left.
        samples: samples per pixel, rounded up to a square as in Mitsuba's sampler.

    Returns:
        Radiance, n x 3, and the fraction of each pixel that shows the wall, n.
    """
    sensor, integrator = mitsuba_scene.sensors()[0], mitsuba_scene.integrator()
    size = mi.Vector2f(sensor.film().size())
    side = math.isqrt(samples - 1) + 1
    index, width = mi.UInt32(pixels), sensor.film().size()[0]
    corner = mi.Vector2f(index % width, index // width)
    radiance, wall = dr.zeros(mi.Color3f, pixels.size), dr.zeros(mi.Float, pixels.size)
    sample = mi.UInt32(0)
    while sample < side * side:
        place = corner + (mi.Vector2f(sample % side, sample // side) + 0.5) / side
        ray, part = sensor.sample_ray(0.0, 0.5, mi.Point2f(place / size), mi.Point2f(0.5))
        light, _, seen = integrator.sample(mitsuba_scene, sensor.sampler(), ray)
        radiance += light * part
        wall += seen[0]
        sample += 1
    colours, part = dr.ravel(radiance / side**2), wall / side**2
    dr.eval(colours, part)  # in one kernel
    return np.array(colours).reshape(-1, 3), np.array(part)
