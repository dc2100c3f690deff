"""The light of a saturated spot with a sharp edge: how much of each cell it covers.

Within the spot every pixel is at full scale, whatever the light is. A cell at the edge is so bright
as the share of it that the spot covers; and there the pixels that are cut by the edge are at full
scale as well, if a part of them is enough for that, so that the spot looks larger.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation

from estimator.pixels.cells import COUNT

_BLOOM_PX, BLOOM_DOUBT_PX = 0.45, 0.1
"""How far the edge of a saturated spot is outside of the spot's, px, and its standard deviation. An
edge cuts 1.27 pixels per pixel of its length, in the mean over all directions. Light of r full
scales fills each of them of which it covers 1/r, so that the edge is 0.64 (1 - 1/r) too far
outside: between 0.3 and 0.6 for any r above 2."""
CUT = 0.3  # error of a pixel that such an edge cuts, over the step: those of 0 and 1 are alike
_WHOLE = 0.98  # of a cell, above which it is covered
_LEAST = 1e-9  # 1/mm²


class Covered(NamedTuple):
    """What a saturated spot makes of the cells.

    Attributes:
        light: of the beam, per unit power, 1/mm², as far as the camera shows it.
        over: whether a cell or one beside it is at full scale.
        cover: share of such a cell that the spot covers; 0 for others.
        slopes: derivatives of `light`.
    """

    light: Float[np.ndarray, "n"]
    over: Bool[np.ndarray, "n"]
    cover: Float[np.ndarray, "n"]
    slopes: Float[np.ndarray, "k n"]

    @property
    def whole(self) -> Bool[np.ndarray, "n"]:
        """Cells that are covered, which say no more than that."""
        return self.over & (self.cover > _WHOLE)


def covered(
    light: Float[np.ndarray, "n"],
    room: Float[np.ndarray, "n"],
    slopes: Float[np.ndarray, "k n"] | None = None,
    *,
    pixel_mm: float = 0.0,
) -> Covered:
    """The light of a beam as far as a camera shows it.

    Args:
        light: per unit power, 1/mm².
        room: light that takes a cell to full scale.
        slopes: derivatives of the light, the first two by shifts of the spot along the wall, mm.
            Without them, the edge is where the spot's is.
        pixel_mm: side of a pixel on the wall.
    """
    brightest = _brightest_near(light)
    full = np.maximum(light[brightest], _LEAST)
    over = (full > room) & (room > 0)
    cover = np.where(over, light / full, 0.0)
    if slopes is None:
        return Covered(np.where(over, room * cover, light), over, cover, np.zeros((0, light.size)))
    by_state = (slopes - cover * slopes[:, brightest]) / full
    bloom = _BLOOM_PX * pixel_mm * np.hypot(*by_state[:2])
    cover = np.where(over, np.minimum(cover + bloom, 1.0), 0.0)
    return Covered(
        np.where(over, room * cover, light), over, cover, np.where(over, room * by_state, slopes)
    )


def _brightest_near(light: Float[np.ndarray, "n"]) -> np.ndarray:
    """For each cell the number of the brightest of it and those around it."""
    numbers = np.arange(light.size).reshape(COUNT, COUNT)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(numbers, 1, mode="edge"), (3, 3))
    near = windows.reshape(light.size, 9)
    return near[np.arange(light.size), np.argmax(light[near], axis=1)]


def halo(light: Float[np.ndarray, "n"], lit: Bool[np.ndarray, "n"]) -> float:
    """Light beside a spot over that farther away, in which no tool and no vessel counts.

    Args:
        light: of the cells.
        lit: cells of the spot.
    """
    spot, grid = lit.reshape(COUNT, COUNT), light.reshape(COUNT, COUNT)
    edge, beside = (binary_dilation(spot, iterations=cells) for cells in (1, 3))
    near, far = grid[beside & ~edge], grid[~beside]
    return float(np.median(near) / max(np.median(far), _LEAST)) if near.size and far.size else 1.0
