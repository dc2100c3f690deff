"""Radiance of a loaded Mitsuba scene: along lines of sight, in pixels and within them.

Import after `load_mitsuba`. Pixels and places within pixels lie on a regular grid.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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


def _seen_at(mitsuba_scene: Any, place: Any) -> tuple[Any, Any]:
    """Radiance at places of the image, px, and 1 where the wall is seen."""
    sensor = mitsuba_scene.sensors()[0]
    on_film = mi.Point2f(place / mi.Vector2f(sensor.film().size()))
    ray, part = sensor.sample_ray(0.0, 0.5, on_film, mi.Point2f(0.5))
    light, _, seen = mitsuba_scene.integrator().sample(mitsuba_scene, sensor.sampler(), ray)
    return light * part, seen[0]


def pixel_means(
    mitsuba_scene: Any, *, samples: int, smooth: bool
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Function of n pixels' indices: means of radiance over them, by samples on a square grid.

    On an even grid the values are those of `mi.render` with a box filter and a stratified sampler
    without jitter. The squares that its n x n samples stand for lie within the pixel, so it suits
    light that each sample has the mean of over its square. For light at points, its samples lack
    1/n² of the variance of places within the pixel, and the image seems that much sharper. Farther
    apart by a factor of (1 - 1/n²)^-1/2 they give the mean of any polynomial of the third degree;
    two by two are Gauss and Legendre's.

    Args:
        mitsuba_scene: a scene with `SpotIntegrator`.
        samples: samples per pixel, rounded up to a square as in Mitsuba's sampler.
        smooth: whether the samples are spread like that.

    Returns:
        The function. It takes indices that count along rows from the top left, and gives the
        radiance, n x 3, and the fraction of each pixel that shows the wall, n.
    """
    side = math.isqrt(samples - 1) + 1
    apart = 1 / math.sqrt(side**2 - 1) if smooth and side > 1 else 1 / side

    # So Python traces the plugins once for all poses, which is a fifth of a pose's time. Numbers of
    # the plugins that no pose changes are constants of the recording, which serves one scene.
    recorded = dr.freeze(_means)

    def means(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        radiance, wall = recorded(mitsuba_scene, mi.UInt32(pixels), side, apart)
        return np.array(radiance).T, np.array(wall)

    return means


@dr.syntax
def _means(mitsuba_scene: Any, index: Any, side: int, apart: float) -> tuple[Any, Any]:
    """Mean radiance of pixels by side x side samples, and the mean of where the wall is seen."""
    width = mitsuba_scene.sensors()[0].film().size()[0]
    middle = mi.Vector2f(index % width, index // width) + 0.5
    wall = mi.Float(index) * 0
    radiance, sample = mi.Color3f(wall), mi.UInt32(0)
    while sample < side * side:
        place = middle + apart * (mi.Vector2f(sample % side, sample // side) + 0.5 - side / 2)
        light, seen = _seen_at(mitsuba_scene, place)
        radiance += light
        wall += seen
        sample += 1
    return radiance / side**2, wall / side**2


def fine_image(
    mitsuba_scene: Any, window: tuple[int, int, int, int], *, factor: int
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance at several places of each pixel of a window.

    Args:
        mitsuba_scene: a scene with `SpotIntegrator`.
        window: top, bottom, left and right, px.
        factor: places along a side of a pixel.

    Returns:
        Radiance, rows x columns x 3, and 1 where the wall is seen, rows x columns; both float32.
    """
    top, bottom, left, right = window
    rows, columns = (bottom - top) * factor, (right - left) * factor
    index, corner = dr.arange(mi.UInt32, rows * columns), mi.Vector2f(left, top)
    # As data, so that every window uses the same kernel.
    side = mi.UInt32(columns)
    dr.make_opaque(side, corner)
    place = (mi.Vector2f(index % side, index // side) + 0.5) / factor + corner
    light, seen = _seen_at(mitsuba_scene, place)
    colours, wall = dr.ravel(light), mi.Float(seen)
    dr.eval(colours, wall)
    return np.array(colours).reshape(rows, columns, 3), np.array(wall).reshape(rows, columns)


@contextmanager
def more_even_light(mitsuba_scene: Any, added: float) -> Iterator[None]:
    """Add irradiance from all sides to every surface within a block."""
    parameters = mi.traverse(mitsuba_scene)
    even = mi.Color3f(parameters["integrator.uniform"])
    more = even + added
    dr.make_opaque(even, more)
    parameters["integrator.uniform"] = more
    parameters.update()
    try:
        yield
    finally:
        parameters["integrator.uniform"] = even
        parameters.update()
