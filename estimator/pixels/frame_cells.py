"""The light of a frame on a lattice of square cells, on a wall that moves in the image.

The map of the wall is drawn in the pixels of the first frame that it knows. When the eye turns or
the microscope drifts, a point of the map is elsewhere in the image. So a window of the map is
shifted and turned into the image, and the pixels of each of its cells are averaged there.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage


class WallMotion(NamedTuple):
    """A shift and a turn of the image: p_image = R(turn) p_map + shift.

    Attributes:
        right, down: the shift, px.
        turn: clockwise as it is seen, rad.
    """

    right: float = 0.0
    down: float = 0.0
    turn: float = 0.0

    @classmethod
    def about(
        cls, centre: Float[np.ndarray, "2"], shift: Float[np.ndarray, "2"], turn: float
    ) -> "WallMotion":
        """A turn about a point of the map, and then a shift."""
        right, down = centre + shift - cls(turn=turn).rotation @ centre
        return cls(float(right), float(down), turn)

    @property
    def rotation(self) -> Float[np.ndarray, "2 2"]:
        """Columns: where a step to the right and one down on the map lead in the image."""
        cosine, sine = math.cos(self.turn), math.sin(self.turn)
        return np.array([[cosine, -sine], [sine, cosine]])

    def image_px(self, on_map: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Where points of the map are in the image, px."""
        return on_map @ self.rotation.T + (self.right, self.down)

    def map_px(self, in_image: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Where points of the image are on the map, px."""
        return (in_image - (self.right, self.down)) @ self.rotation

    def after(self, first: "WallMotion") -> "WallMotion":
        """This motion after another one."""
        right, down = self.image_px(np.array([first.right, first.down])).tolist()
        return WallMotion(right, down, self.turn + first.turn)

    def since(self, first: "WallMotion") -> "WallMotion":
        """What came after another motion to make this one."""
        turn = WallMotion(turn=self.turn - first.turn)
        right, down = turn.image_px(np.array([first.right, first.down])).tolist()
        return WallMotion(self.right - right, self.down - down, turn.turn)

    def on_map(self, image: np.ndarray, corner: tuple[int, int], outside: float) -> np.ndarray:
        """An image as the map's pixels have it, from a corner (x, y) of the map on.

        It is as large as the image; what the image does not show has the value `outside`.
        """
        shift = self.image_px(np.array(corner, float))
        return cv2.warpAffine(
            image,
            np.column_stack([self.rotation, shift]),
            image.shape[1::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderValue=outside,
        )


STILL = WallMotion()
"""Nothing has moved."""


COUNT = 26
"""Cells along each side of a lattice. The time of a frame grows with its sixth power."""

_ALONG = (np.arange(COUNT) + 0.5) / (0.5 * COUNT) - 1.0
SIDES = np.stack([np.tile(_ALONG, COUNT), np.repeat(_ALONG, COUNT)])
"""Place of each cell to the right of the window's middle and below it, over half of its side."""
SHADES = np.stack([*SIDES, SIDES[0] ** 2, SIDES[0] * SIDES[1], SIDES[1] ** 2])
"""Polynomials of that place up to the second degree, without the constant."""

_KEPT_WINDOW_OFFSET = 0.2
"""A window is kept while the spot is so near to its middle, over half of its side."""
_KEPT_WINDOW_RATIO = 1.16  # a window is kept while its cells are at most 16 % larger than needed
_AHEAD, _AHEAD_FRAMES = 0.15, 4.0
"""How far ahead of a moving point a new window lies: over the reach, and in frames, the less of
both. So it serves for several frames; what is kept of earlier ones takes as long to model anew."""


class CellWindow(NamedTuple):
    """A lattice of COUNT x COUNT cells of the image.

    Attributes:
        left, top: first pixel.
        side: of a cell, px.
    """

    left: int
    top: int
    side: int

    @classmethod
    def around(cls, centre_px: np.ndarray, reach_px: float) -> "CellWindow":
        """The window with a point in its middle, that reaches at least so far."""
        side = max(2, int(np.ceil(2.0 * reach_px / COUNT)))
        left, top = np.round(np.asarray(centre_px) - 0.5 * COUNT * side).astype(int).tolist()
        return cls(left, top, side)

    def following(
        self, centre_px: Float[np.ndarray, "2"], reach_px: float, moved_px: Float[np.ndarray, "2"]
    ) -> "CellWindow":
        """This window as long as it serves for a point that moves, or else one ahead of the point.

        If only the place does not serve, it is moved by whole cells.

        Args:
            reach_px: to what must lie within the window.
            moved_px: way of the point since the frame before.
        """
        off = np.abs(centre_px - self.middle_px).max() / (0.5 * COUNT * self.side)
        needed = 2.0 * reach_px / COUNT
        sized = needed < _KEPT_WINDOW_RATIO * self.side < _KEPT_WINDOW_RATIO**2 * math.ceil(needed)
        if off < _KEPT_WINDOW_OFFSET and sized:
            return self
        ahead = _AHEAD_FRAMES * moved_px
        most = _AHEAD * reach_px / max(float(np.abs(ahead).max()), 1e-9)
        fresh = CellWindow.around(centre_px + min(most, 1.0) * ahead, reach_px)
        if not sized:
            return fresh
        right, down = np.round((fresh.middle_px - self.middle_px) / self.side).astype(int).tolist()
        return self._replace(left=self.left + self.side * right, top=self.top + self.side * down)

    @property
    def corner_px(self) -> Float[np.ndarray, "2"]:
        """Outer corner of the first pixel; pixel centres are integers."""
        return np.array([self.left - 0.5, self.top - 0.5])

    @property
    def middle_px(self) -> Float[np.ndarray, "2"]:
        """Middle of the lattice."""
        return self.corner_px + 0.5 * COUNT * self.side

    def in_image(self, motion: WallMotion) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
        """After a motion of the wall, where the corner is in the image, and a cell's upper side."""
        return motion.image_px(self.corner_px), self.side * motion.rotation[:, 0]

    def middles_after(self, motions: Sequence[WallMotion]) -> Float[np.ndarray, "k 2"]:
        """Where the middle is in the image after motions of the wall, px."""
        return np.stack([motion.image_px(self.middle_px) for motion in motions])

    def centres(self) -> Float[np.ndarray, "count count 2"]:
        """Centres of the cells, px."""
        along = self.side * (np.arange(COUNT) + 0.5)
        u, v = np.meshgrid(along, along)
        return self.corner_px + np.stack([u, v], axis=-1)

    def pixels(
        self, cells: Bool[np.ndarray, "n"], shape: tuple[int, ...]
    ) -> Bool[np.ndarray, "h w"]:
        """The pixels of some cells, in an image of a shape."""
        rows, columns = (
            (np.arange(length) - first) // self.side
            for length, first in zip(shape, (self.top, self.left), strict=True)
        )
        # A border of no cell stands for all pixels outside the window.
        bordered = np.pad(cells.reshape(COUNT, COUNT), 1)
        return bordered[np.ix_(*(np.clip(at + 1, 0, COUNT + 1) for at in (rows, columns)))]


def rolled(values: Float[np.ndarray, "*k n"], right: int, down: int) -> Float[np.ndarray, "*k n"]:
    """Values of a window's cells after it has moved; 0 for new cells."""
    grids = values.reshape(-1, COUNT, COUNT)
    return ndimage.shift(grids, (0, -down, -right), order=0).reshape(values.shape)


class CellMeans(NamedTuple):
    """A frame's light in the cells of a window.

    Attributes:
        light: its mean, full wells.
        usable: whether the cell is in the image and all of it usable.
        sigma: standard deviation of as much light by the camera's noise, full wells.
    """

    light: Float[np.ndarray, "n"]
    usable: Bool[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n"]


_KEPT_WINDOWS = 2  # whose means a frame keeps: the newest, and one in which others are fitted


class CellLight:
    """A frame's light, ready to be averaged over cells.

    Args:
        light: per pixel, full wells.
        usable: whether a pixel shows light, which may be that of full scale.
        variance: of a pixel with some light, full wells².
        motion: of the wall, in whose pixels the windows are.
        ceiling: light of a pixel at full scale, if those of the spot are; infinite if not.

    Attributes:
        saturated: whether the spot is at full scale.
        means: the light in the cells of a window, see `_means`. A fit asks for it again at each of
            its states, so those of the last windows are kept.
    """

    def __init__(
        self,
        light: Float[np.ndarray, "h w"],
        usable: Bool[np.ndarray, "h w"],
        variance: Callable[[np.ndarray], np.ndarray],
        motion: WallMotion = STILL,
        ceiling: float = math.inf,
    ) -> None:
        self.ceiling, self.saturated = ceiling, ceiling < math.inf
        self.variance, self.motion = variance, motion
        corner = 0, 0
        light, bad = light.astype(np.float32), (~usable).astype(np.float32)
        if motion != STILL:
            middle = 0.5 * np.array(light.shape[1::-1])
            left, top = np.round(motion.map_px(middle) - middle).astype(int).tolist()
            corner = left, top
            light = motion.on_map(light, corner, outside=0.0)
            bad = motion.on_map(bad, corner, outside=1.0)
        integrals = (
            cv2.integral(light, sdepth=cv2.CV_64F),
            cv2.integral((bad > 0).astype(np.uint8), sdepth=cv2.CV_32S),
        )
        means = functools.partial(_means, *integrals, corner, variance)
        self.means: Callable[[CellWindow], CellMeans] = functools.lru_cache(_KEPT_WINDOWS)(means)


def _means(
    light: Float[np.ndarray, "h+1 w+1"],
    bad: Int[np.ndarray, "h+1 w+1"],
    corner: tuple[int, int],
    variance: Callable[[np.ndarray], np.ndarray],
    window: CellWindow,
) -> CellMeans:
    """What the cells of a window show, from the integrals of light and of bad pixels."""
    left, top = corner
    rows = window.top - top + window.side * np.arange(COUNT + 1)
    columns = window.left - left + window.side * np.arange(COUNT + 1)
    height, width = light.shape[0] - 1, light.shape[1] - 1
    at = np.ix_(np.clip(rows, 0, height), np.clip(columns, 0, width))
    inside = np.logical_and.outer(
        (rows[:-1] >= 0) & (rows[1:] <= height), (columns[:-1] >= 0) & (columns[1:] <= width)
    )
    mean, spoilt = (np.diff(np.diff(sums[at], axis=0), axis=1).ravel() for sums in (light, bad))
    mean = mean / window.side**2
    sigma = np.sqrt(variance(np.maximum(mean, 0.0))) / window.side
    return CellMeans(mean, inside.ravel() & (spoilt == 0), sigma)
