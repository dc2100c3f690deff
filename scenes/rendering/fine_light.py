"""The light on the wall in a part of an image, apart from the wall's picture, finer than pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

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


class FineWall(NamedTuple):
    """The wall without the beam, at `factor` x `factor` places of each pixel of a window.

    Attributes:
        unlit: radiance without the beam, rows x columns x 3.
        reflectance: of the wall, rows x columns x 3.
        window: the window.
        factor: number of places along a side of a pixel.
    """

    unlit: np.ndarray
    reflectance: np.ndarray
    window: Window
    factor: int

    def part(self, window: Window) -> FineWall:
        """The same in a part of the window."""
        rows = slice(*(self.factor * (row - self.window.top) for row in window[:2]))
        columns = slice(*(self.factor * (column - self.window.left) for column in window[2:]))
        return FineWall(
            self.unlit[rows, columns], self.reflectance[rows, columns], window, self.factor
        )


class FineLight(NamedTuple):
    """Light and wall at the same places.

    Attributes:
        direct: light of the beam that the wall reflects, divided by the reflectance, in the unit of
            radiance, rows x columns x 3; 0 where something else than the wall is seen.
        reflectance: of the wall, rows x columns x 3; 0 elsewhere.
    """

    direct: np.ndarray
    reflectance: np.ndarray


def fine_wall(
    images: Images | ColourImages, moment: Moment | None, *, window: Window, factor: int
) -> FineWall:
    """The wall in a window without the beam.

    The reflectance follows from two images, of which one has even light from all sides added.

    Args:
        images: the images of a scene whose light is not sampled randomly.
        moment: what [unrest] moves.
        window: the window.
        factor: places along a side of a pixel.
    """
    both = [
        _in_colours(
            images, partial(_unlit, moment=moment, window=window, factor=factor, added=added)
        )
        for added in (0.0, _ALL_SIDES)
    ]
    return FineWall(both[0], both[1] - both[0], window, factor)


def fine_light(images: Images | ColourImages, poses: Sequence[Pose], wall: FineWall) -> FineLight:
    """The light of the beam on a wall, as its mean over some poses.

    Args:
        images: the images of a scene whose light is not sampled randomly.
        poses: poses during an exposure.
        wall: the wall.
    """
    usable = wall.reflectance > _LEAST_REFLECTANCE
    lit = np.zeros_like(wall.unlit)
    for pose in poses:
        seen = _in_colours(images, partial(_lit, pose=pose, wall=wall))
        usable &= ~np.isnan(seen)
        lit += seen
    reflectance = np.where(usable, wall.reflectance, np.float32(0.0))
    direct = np.where(usable, lit / len(poses) - wall.unlit, np.float32(0.0))
    return FineLight(direct / np.where(usable, reflectance, np.float32(1.0)), reflectance)


def _in_colours(images: Images | ColourImages, image: Callable[[Images], np.ndarray]) -> np.ndarray:
    """An image whose colours may have their own lines of sight."""
    if isinstance(images, ColourImages):
        seen = [image(own)[..., colour] for colour, own in enumerate(images.by_colour)]
        return np.stack(seen, axis=-1)
    return image(images)


def _unlit(
    images: Images, moment: Moment | None, window: Window, factor: int, added: float
) -> np.ndarray:
    """Radiance without the beam, with more even light from all sides."""
    from scenes.rendering.pixels import fine_image, more_even_light  # Mitsuba needs its variant

    images.place(tip=PARKED_MM, axis=DOWN, moment=moment)
    with more_even_light(images.mitsuba_scene, added):
        return fine_image(images.mitsuba_scene, window, factor=factor)[0]


def _lit(images: Images, pose: Pose, wall: FineWall) -> np.ndarray:
    """Radiance with the beam; NaN where something else than the wall is seen."""
    from scenes.rendering.pixels import fine_image

    images.place(tip=pose.tip, axis=pose.axis, moment=pose.moment)
    radiance, seen = fine_image(images.mitsuba_scene, wall.window, factor=wall.factor)
    return np.where(seen[..., None] > 0, radiance, np.float32(np.nan))
