"""Parts of drawn frames: random ellipses and walls; shafts, shadows and glints."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from scenes.drawn.drawing import SHAPE, Drawing, Truth
from scenes.walls import fundus

_SCALE_MM_PX = 0.0067
_RETINA_PX = 2000


def any_truth(
    rng: np.random.Generator, semi_minor: float, axis_ratio: float = 1.1, about: float = 5.0
) -> Truth:
    """A random ellipse of a given size near the middle of the frame."""
    dx, dy = rng.uniform(-about, about, 2)
    return Truth(
        x=SHAPE[1] / 2 + dx,
        y=SHAPE[0] / 2 + dy,
        semi_major=semi_minor * axis_ratio,
        semi_minor=semi_minor,
        angle=rng.uniform(-math.pi / 2, math.pi / 2),
    )


@functools.lru_cache(maxsize=4)
def _retina(seed: int) -> np.ndarray:
    return fundus(seed=seed, extent_mm=_RETINA_PX * _SCALE_MM_PX, pixels=_RETINA_PX)


def any_wall(rng: np.random.Generator, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """A random window of a printed retina, with mean 1 in the brightest channel."""
    retina = _retina(int(rng.integers(4)))
    row = rng.integers(retina.shape[0] - shape[0] + 1)
    column = rng.integers(retina.shape[1] - shape[1] + 1)
    wall = retina[row : row + shape[0], column : column + shape[1]].astype(float)
    return wall / wall.mean(axis=(0, 1)).max()


def behind_shaft(tip: tuple[float, float], heading: float, width_px: float) -> np.ndarray:
    """Visible fraction of the wall behind a shaft from the tip in a direction (rad)."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    along = (u - tip[0]) * math.cos(heading) + (v - tip[1]) * math.sin(heading)
    across = (v - tip[1]) * math.cos(heading) - (u - tip[0]) * math.sin(heading)
    return 1 - np.clip(np.minimum(along, width_px / 2 - np.abs(across)) + 0.5, 0, 1)


def with_shaft(
    drawing: Drawing, rng: np.random.Generator, reach: float, width_px: float
) -> Drawing:
    """A drawing with a shaft. Its tip ends `reach` semi-minor axes before the spot's centre."""
    truth, heading = drawing.truth, rng.uniform(0, 2 * math.pi)
    away = reach * truth.semi_minor
    tip = truth.x + away * math.cos(heading), truth.y + away * math.sin(heading)
    return replace(drawing, seen=behind_shaft(tip, heading, width_px))


def with_quarter_in_shadow(drawing: Drawing, rng: np.random.Generator) -> Drawing:
    """A drawing with a sector of 90 degrees in shadow; its edges are blurred by 1.5 px."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    direction = np.arctan2(v - drawing.truth.y, u - drawing.truth.x) - rng.uniform(0, 2 * math.pi)
    lit = (direction % (2 * math.pi) > math.pi / 2).astype(float)
    return replace(drawing, lit=gaussian_filter(lit, 1.5))


def with_glints(
    drawing: Drawing, rng: np.random.Generator, *, on_edge: bool, number: int = 4
) -> Drawing:
    """A drawing with bright discs of 3 to 9 px radius on the contour, or within 1.6 radii."""
    v, u = np.ogrid[: SHAPE[0], : SHAPE[1]]
    glints = np.zeros(SHAPE)
    for _ in range(number):
        angle, radius = rng.uniform(0, 2 * math.pi), rng.uniform(3, 9)
        away = drawing.truth.semi_minor * (1.0 if on_edge else rng.uniform(0.2, 1.6))
        x, y = drawing.truth.x + away * math.cos(angle), drawing.truth.y + away * math.sin(angle)
        glints[(u - x) ** 2 + (v - y) ** 2 < radius**2] = 250
    return replace(drawing, glints=gaussian_filter(glints, 1.0))
