"""Which pixels change when the tip moves: those that show the instrument or its light.

Import after `load_mitsuba`.
"""

import math
from typing import Any

import mitsuba as mi
import numpy as np

from eyespot.scenes.description.scene_keys import GAUGE_DIAMETER_MM
from eyespot.scenes.rendering.plugins import wall_shape
from eyespot.scenes.world.motion import Poses
from eyespot.scenes.world.world import World

_TILE_PX = 16
# The curved wall within a tile extends beyond the sphere around its corners by less than this
# factor, if a pixel is at most 0.1 mm wide.
_BULGE = 1.05
_SPREAD_REACH = 12.0  # in lengths of the wall's spread; 8e-5 of the light goes farther


class Reach:
    """The image in square tiles, each with the camera's rays through it.

    Args:
        mitsuba_scene: the loaded scene, with the instrument out of view.
        wall: fraction of each pixel that shows the wall in that state, H x W.
    """

    def __init__(self, world: World, mitsuba_scene: Any, *, wall: np.ndarray) -> None:
        self._instrument = world.scene.instrument
        height, width = wall.shape
        rows, columns = (-(-side // _TILE_PX) for side in wall.shape)
        tile = np.arange(rows)[:, None] * columns + np.arange(columns)
        tile = tile.repeat(_TILE_PX, axis=0).repeat(_TILE_PX, axis=1)
        self._tile = tile[:height, :width]  # index of each pixel's tile
        u = np.minimum(np.arange(columns + 1) * _TILE_PX, width) / width
        v = np.minimum(np.arange(rows + 1) * _TILE_PX, height) / height
        place = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2).T
        ray, _ = mitsuba_scene.sensors()[0].sample_ray(0.0, 0.5, mi.Point2f(place), mi.Point2f(0.5))
        seen = mitsuba_scene.ray_intersect(ray)
        corners, sight = (
            np.array(a, float).T.reshape(rows + 1, columns + 1, 3) for a in (seen.p, ray.d)
        )
        bare = np.array(seen.shape == wall_shape(mitsuba_scene)).reshape(rows + 1, columns + 1)
        # Of each tile: the middle of its wall; the radius round it that contains wall and rays; and
        # its growth per mm along the rays towards the camera, 0 where they converge there.
        four, rays = _corners(corners), _corners(sight)
        centre = four.mean(axis=0)
        aside, turned = four - centre, rays - rays.mean(axis=0)
        apart = np.linalg.norm(aside, axis=-1)
        growth = -np.sum(aside * turned, axis=-1) / np.maximum(apart, 1e-9)
        self._centre, self._radius = centre.reshape(-1, 3), apart.max(axis=0).ravel() * _BULGE
        self._widening = np.maximum(growth.max(axis=0), 0.0).ravel()
        self._sight = sight[:-1, :-1].reshape(-1, 3)
        # The beam may light objects in front of the wall: such tiles change in every pose.
        self._always = np.bincount(self._tile[wall < 1], minlength=rows * columns) > 0
        self._always |= ~_corners(bare).all(axis=0).ravel()
        # Radius that contains all light at the tip, mm, and its growth per mm along the axis.
        table = world.table
        if table is None:
            slope = math.tan(world.cone.half_angle)
            self._envelope = -world.cone.apex_offset * slope, slope
        else:
            self._envelope = float(table.contact_radius), float(table.slope)
        if world.wall_spread is not None:
            # Along the wall, light reaches as far sideways and, on a steep wall, as far ahead.
            further = _SPREAD_REACH * world.wall_spread.max()
            at_tip, slope = self._envelope
            self._envelope = at_tip + further * (1 + slope), slope

    def pixels(self, poses: Poses) -> list[np.ndarray]:
        """Indices of the pixels that each pose can change, counted along rows from the top left."""
        return [self._pixels(tip, axis) for tip, axis in zip(*poses, strict=True)]

    def _pixels(self, tip: np.ndarray, axis: np.ndarray) -> np.ndarray:
        offset = self._centre - tip
        ahead = offset @ axis
        aside = np.linalg.norm(offset - ahead[:, None] * axis, axis=1)
        at_tip, slope = self._envelope
        reached = aside - self._radius <= at_tip + slope * (ahead + self._radius)
        reached &= ahead + self._radius >= 0
        reached |= self._always
        instrument = self._instrument
        if instrument.visible:
            end = instrument.fibre_length_mm
            fibre, shaft = instrument.fibre_diameter_mm / 2, GAUGE_DIAMETER_MM[instrument.gauge] / 2
            reached |= self._see_rod(offset, axis, start=0.0, end=end, thickness=fibre)
            reached |= self._see_rod(offset, axis, start=end, end=math.inf, thickness=shaft)
        return np.flatnonzero(reached[self._tile]).astype(np.uint32)

    def _see_rod(
        self, offset: np.ndarray, axis: np.ndarray, *, start: float, end: float, thickness: float
    ) -> np.ndarray:
        """Tiles that may show a rod from `start` to `end` (mm) behind the tip."""
        across = axis - (self._sight @ axis)[:, None] * self._sight
        apart = -offset + np.sum(offset * self._sight, axis=1)[:, None] * self._sight
        square = np.maximum(np.sum(across * across, axis=1), 1e-12)
        behind = np.clip(np.sum(apart * across, axis=1) / square, start, end)
        nearest = np.linalg.norm(apart - behind[:, None] * across, axis=1)
        away = np.linalg.norm(offset + behind[:, None] * axis, axis=1)
        return np.asarray(nearest <= thickness + self._radius + self._widening * away)


def _corners(grid: np.ndarray) -> np.ndarray:
    """The values of a grid at the four corners of each tile, 4 x rows x columns x ..."""
    return np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]])
