"""The light on the wall in a part of an image, apart from the wall's picture, finer than pixels.

Import after `load_mitsuba`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from scenes.rendering.images import DOWN, PARKED_MM, ColourImages, Images
from scenes.world import Moment

_LEAST_REFLECTANCE = 1e-3  # darker places give no light to measure
_ALL_SIDES = np.pi  # irradiance with which radiance equals reflectance


class Window(NamedTuple):
    """A part of an image: rows [top, bottom) and columns [left, right)."""

    top: int
    bottom: int
    left: int
    right: int


class Pose(NamedTuple):
    """Tip (mm) and axis of the beam, and what [unrest] moves at that time."""

    tip: np.ndarray
    axis: np.ndarray
    moment: Moment | None


class FineLight(NamedTuple):
    """Light and wall at `factor` x `factor` places of each pixel of a window.

    Attributes:
        direct: light of the beam that the wall reflects, divided by the reflectance, in the unit of
            radiance, rows x columns x 3; 0 where something else than the wall is seen.
        reflectance: of the wall, rows x columns x 3; 0 elsewhere.
        window: the window.
        factor: number of places along a side of a pixel.
    """

    direct: np.ndarray
    reflectance: np.ndarray
    window: Window
    factor: int


def fine_light(
    images: Images | ColourImages, poses: Sequence[Pose], *, window: Window, factor: int
) -> FineLight:
    """The light of the beam in a window, as its mean over some poses.

    The reflectance follows from two images without the beam, of which one has even light from all
    sides added. It is that of the middle pose.

    Args:
        images: the images of a scene whose light is not sampled randomly.
        poses: poses during an exposure, in order of time.
        window: the window.
        factor: places along a side of a pixel.
    """
    if isinstance(images, ColourImages):
        seen = [_seen(own, poses, window, factor) for own in images.by_colour]
        direct, reflectance = (
            np.stack([each[part][..., k] for k, each in enumerate(seen)], axis=-1)
            for part in (0, 1)
        )
    else:
        direct, reflectance = _seen(images, poses, window, factor)
    return FineLight(direct, reflectance, window, factor)


def _seen(
    images: Images, poses: Sequence[Pose], window: Window, factor: int
) -> tuple[np.ndarray, np.ndarray]:
    def radiance() -> tuple[np.ndarray, np.ndarray]:
        return _fine_image(images.mitsuba_scene, window, factor)

    middle = poses[len(poses) // 2]
    images.place(tip=PARKED_MM, axis=DOWN, moment=middle.moment)
    unlit, _ = radiance()
    parameters = mi.traverse(images.mitsuba_scene)
    even = mi.Color3f(parameters["integrator.uniform"])
    brighter = even + _ALL_SIDES
    dr.make_opaque(even, brighter)
    parameters["integrator.uniform"] = brighter
    parameters.update()
    reflectance = radiance()[0] - unlit
    parameters["integrator.uniform"] = even
    parameters.update()
    usable = reflectance > _LEAST_REFLECTANCE
    direct = np.zeros_like(unlit)
    for pose in poses:
        images.place(tip=pose.tip, axis=pose.axis, moment=pose.moment)
        lit, wall = radiance()
        usable &= wall[..., None] > 0
        direct += lit - unlit
    reflectance = np.where(usable, reflectance, 0.0)
    share = np.where(usable, len(poses) * reflectance, 1.0)
    return np.where(usable, direct, 0.0) / share, reflectance


def _fine_image(mitsuba_scene: Any, window: Window, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """Radiance and whether the wall is seen, at the places of a regular grid."""
    sensor, integrator = mitsuba_scene.sensors()[0], mitsuba_scene.integrator()
    width, height = sensor.film().size()
    rows, columns = (window.bottom - window.top) * factor, (window.right - window.left) * factor
    index = dr.arange(mi.UInt32, rows * columns)
    place = (mi.Point2f(index % columns, index // columns) + 0.5) / factor
    place = (place + mi.Point2f(window.left, window.top)) / mi.Point2f(width, height)
    ray, part = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    light, _, seen = integrator.sample(mitsuba_scene, sensor.sampler(), ray)
    colours, wall = dr.ravel(light * part), mi.Float(seen[0])
    dr.eval(colours, wall)
    return (
        np.array(colours).reshape(rows, columns, 3),
        np.array(wall).reshape(rows, columns),
    )
