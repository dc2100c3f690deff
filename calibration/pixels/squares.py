"""Squares of pixels that are fitted as one datum where a lens's light is smooth.

A mean over k x k pixels has the information of its pixels if the light is nearly even over them,
and costs one evaluation of the model. Squares are halved, down to single pixels, until that is so,
the model's quadrature is exact and every pixel is usable: at sharp edges, at the instrument's
outline, and at the frame's border.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8
from scipy import ndimage

from calibration.pixels.chunks import CHUNK, Chunk, Problem, View, look
from calibration.pixels.data import Footage
from optics.wall_light import LensTable

_LARGEST_PX = 16
"""Side of the largest squares; a power of two."""
_INEXACT = 0.1
"""Largest error of a square's model, in standard deviations of its mean."""
_CONTRAST = 0.1
"""Largest difference of a square's quarters from its mean, relative to it. Lenses of
`tests.photon_fits coverage` then have standard errors up to 7 % larger than with single pixels."""


def seen(
    footage: Footage,
    problem: Problem,
    table: LensTable | None,
    x: Array,
    frame: int,
    centres: Float[np.ndarray, "n 2"],
    *,
    side: float = 1.0,
) -> View:
    """Evaluate the model on squares of one frame."""
    ones = np.ones(len(centres))
    every = chunked(footage, frame, centres, side * ones, ones, ones)
    views = [look(problem, table, x, chunk) for chunk in every]

    def joined(*parts: Array) -> np.ndarray:
        # All chunks of a frame have the same tip and axis.
        whole = np.concatenate([np.asarray(part) for part in parts])
        return whole[: len(centres)] if len(parts[0]) == CHUNK else whole[:3]

    return jax.tree.map(joined, *views)


def chunked(
    footage: Footage,
    frame: int,
    centres: Float[np.ndarray, "n 2"],
    sides: Float[np.ndarray, "n"],
    light: Float[np.ndarray, "n"],
    weight: Float[np.ndarray, "n"],
) -> Iterator[Chunk]:
    """Chunks of one size, padded."""
    for begin in range(0, len(light), CHUNK):
        part = slice(begin, begin + CHUNK)
        missing = CHUNK - len(light[part])
        yield Chunk(
            pixels=np.pad(centres[part], ((0, missing), (0, 0)), mode="edge"),
            sides=np.pad(sides[part], (0, missing), mode="edge"),
            light=np.pad(light[part], (0, missing)),
            weight=np.pad(weight[part], (0, missing)),
            reading=np.asarray(footage.readings[frame]),
            exposure_s=np.asarray(footage.exposure_s[frame]),
            frame=np.asarray(frame),
        )


_GUESSED = 0.01
"""Error of the model in the first fit, relative to a frame's brightest square. Squares are far less
noisy than this, and cut by edges."""


class _Squares(NamedTuple):
    """Squares of one size in a frame, with the model's light and whether all pixels are usable."""

    corners: Int[np.ndarray, "n 2"]
    light: Float[np.ndarray, "n"]
    usable: Bool[np.ndarray, "n"]


class SquareChooser:
    """Chooses the squares of each frame for a lens near known parameters.

    Args:
        footage: the frames.
        problem: the fit.
        table: light of the lens.
        x: current parameters.
        nearest: least distance from the tip's plane at which the model is valid, mm.
        lit: fraction of a frame's peak above which a pixel counts as lit by the beam.
        margin_px: margin around the instrument.
        guess: whether `x` is only a guess, so that the model does not show which pixels are clear.
    """

    def __init__(
        self,
        footage: Footage,
        problem: Problem,
        table: LensTable | None,
        x: Array,
        *,
        nearest: float,
        lit: float,
        margin_px: float,
        guess: bool,
    ) -> None:
        self.guess = guess
        self.footage, self.problem, self.table, self.x = footage, problem, table, x
        self.nearest, self.lit, self.margin_px = nearest, lit, margin_px

    def chunks(self, frames: Sequence[int]) -> list[Chunk]:
        """The squares of some frames, with their mean light and its weight."""
        first, *rest = frames
        # The first frame runs alone, so that only one thread compiles.
        with ThreadPoolExecutor() as pool:
            parts = [self._of_frame(first), *pool.map(self._of_frame, rest)]
        return [chunk for part in parts for chunk in part]

    def equal_chunks(self, frames: Sequence[int], side: int) -> list[Chunk]:
        """Squares of one size in some frames, for a fit whose start is only a guess.

        Means over squares change smoothly even where a sharp edge moves, so a start that is far
        off still leads to the minimum. Their noise follows from the measured light.
        """
        return [chunk for frame in frames for chunk in self._equal(frame, side)]

    def _equal(self, frame: int, side: int) -> list[Chunk]:
        found = self._reached(frame, side)
        corners = found.corners[found.usable]
        u, v = corners.T // side
        clear = _means(self.footage.clear[frame], side)[v, u] == 1.0
        corners, means = corners[clear], _means(self.footage.light[frame], side)[v, u][clear]
        error = _GUESSED * means.max(initial=0.0)
        weight = 1.0 / np.sqrt(self.footage.noise.variance(means) / side**2 + error**2)
        sides = np.full(len(corners), float(side))
        centres = corners + 0.5 * (side - 1)
        return list(chunked(self.footage, frame, centres, sides, means, weight))

    def _of_frame(self, frame: int) -> list[Chunk]:
        noise, light = self.footage.noise, self.footage.light[frame]
        squares, side = self._reached(frame, _LARGEST_PX), _LARGEST_PX
        parts: list[np.ndarray] = []
        while len(squares.corners):
            if side == 1:
                keep = squares.usable
            else:
                half = side // 2
                steps = half * np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
                corners = (squares.corners[:, None] + steps).reshape(-1, 2)
                parted = self._view(frame, corners, half)[0]
                quarters, usable = (part.reshape(-1, 4) for part in (parted.light, parted.usable))
                error = np.abs(squares.light - quarters.mean(axis=1))
                sigma = np.sqrt(noise.variance(squares.light)) / side
                uneven = np.abs(quarters - squares.light[:, None]).max(axis=1)
                keep = squares.usable & usable.all(axis=1) & (error <= _INEXACT * sigma)
                keep &= uneven <= _CONTRAST * np.abs(squares.light)
                split = ~keep & (squares.usable | usable.any(axis=1))
            u, v = squares.corners[keep].T
            weight = side / np.sqrt(noise.variance(squares.light[keep]))
            centres = squares.corners[keep] + 0.5 * (side - 1)
            sides = np.full(len(u), float(side))
            means = _means(light, side)[v // side, u // side]
            parts.append(np.column_stack([centres, sides, means, weight]))
            if side == 1:
                break
            chosen = np.repeat(split, 4)
            squares, side = _Squares(*(part[chosen] for part in parted)), half
        u, v, sides, means, weight = np.concatenate(parts).T if parts else np.empty((5, 0))
        return list(chunked(self.footage, frame, np.stack([u, v], axis=-1), sides, means, weight))

    def _reached(self, frame: int, side: int) -> _Squares:
        """Squares that the beam reaches, and a ring around them."""
        height, width = self.footage.light.shape[1:]
        v, u = np.mgrid[0:height:side, 0:width:side]
        corners = np.stack([u.ravel(), v.ravel()], axis=-1)
        squares, view = self._view(frame, corners, side)
        bright = (view.direct > self.lit * view.direct.max()).reshape(u.shape)
        ring = max(1, _LARGEST_PX // 2 // side)
        near = ndimage.binary_dilation(bright, np.ones((3, 3)), iterations=ring).ravel()
        return _Squares(*(part[near] for part in squares))

    def _view(
        self, frame: int, corners: Int[np.ndarray, "n 2"], side: int
    ) -> tuple[_Squares, View]:
        footage = self.footage
        centres = corners + 0.5 * (side - 1)
        view = seen(footage, self.problem, self.table, self.x, frame, centres, side=float(side))
        usable = (corners + side <= footage.light.shape[:0:-1]).all(axis=1)
        usable &= np.asarray(view.along) > self.nearest
        light = np.asarray(view.light)
        if footage.in_view:
            reach = (self.margin_px + 0.5**0.5 * (side - 1)) * float(self.problem.microscope.scale)
            usable &= ~footage.instrument.hides(
                np.asarray(view.point),
                np.asarray(view.sight),
                tip=np.asarray(view.tip),
                axis=np.asarray(view.axis),
                margin=reach,
            )
        if not self.guess:
            usable &= footage.noise.is_clear(light)
        return _Squares(corners, light, usable), view


def residual_frames(
    shape: tuple[int, ...], chunks: Iterable[Chunk], offs: Float[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "frames h w"], UInt8[np.ndarray, "frames h w"]]:
    """Residuals (light minus model) and sides of the squares as frames; NaN and 0 elsewhere.

    Args:
        shape: frames, height and width.
        chunks: the fitted squares.
        offs: model minus light over sigma of all their squares, without padding.
    """
    residuals, sides = np.full(shape, np.nan, np.float32), np.zeros(shape, np.uint8)
    rest = offs
    for chunk in chunks:
        real = chunk.weight > 0
        own, rest = np.split(rest, [np.count_nonzero(real)])
        off, frame, side = -own, int(chunk.frame), chunk.sides[real].astype(int)
        u, v = (chunk.pixels[real] - 0.5 * (side[:, None] - 1)).round().astype(int).T
        for k in np.unique(side):
            one = side == k
            for dv, du in np.ndindex(k, k):
                residuals[frame, v[one] + dv, u[one] + du] = off[one]
                sides[frame, v[one] + dv, u[one] + du] = k
    return residuals, sides


def _means(image: np.ndarray, side: int) -> Float[np.ndarray, "rows columns"]:
    """Means over the squares that lie wholly in an image."""
    rows, columns = (length // side for length in image.shape)
    parts = image[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return np.asarray(parts.mean(axis=(1, 3), dtype=float))
