"""The vessel tree of a fundus: grown from a seed, then drawn on a map.

| size | value | source |
|---|---|---|
| temporal artery, artery over vein | 0.105 mm, 0.68 | Guan et al. 2003; Lee et al. 2007 |
| temporal over nasal calibre | 3^(1/4.1) | flow ratio 3, flow ~ calibre^4.1 (Feke et al. 1989) |
| exponent and angle of branching | 2.59, 1.95; 78 degrees | arteries, veins; Luo et al. 2017 |
| course of the temporal arcades | a parabola from the disc | Oloumi et al. 2012 |

Every other number is an assumption, chosen so that a surgeon finds the picture realistic.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenes.walls.landmarks import DISC_MM, FOVEA_MM

_SHADE_CALIBRE_MM = 0.05  # a vessel of this calibre has 1 - 1/e of the density of a wide one
_REFLEX = 0.35  # the light streak along a vessel lowers its density by this ...
_REFLEX_WIDTH = 0.25  # ... over this fraction of its calibre
_EDGE_MM = 0.02  # sharpness of the photograph

_ARCADE_WIDTH_MM = 3.2**2 / 4.76  # the temporal arcades pass 3.2 mm above and below the fovea
_SMALLEST_CALIBRE_MM = 0.016  # finer vessels are not visible in a photograph
_STEP_MM = 0.06  # length of a piece of vessel
_CELL_MM = 0.15  # size of the cells that a vessel occupies


class _Arcade(NamedTuple):
    """The parabola w^2 = width t of a main vessel; t and w start at the disc."""

    temporal: int  # +1, or -1 for nasal
    up: int  # +1, or -1 for down
    width: float  # mm


class _Vessel(NamedTuple):
    """Start of a vessel that will grow to its next branching."""

    name: int
    relatives: frozenset[int]  # parent and sibling, which it may cross
    x: float
    y: float
    heading: float
    calibre: float
    vein: bool
    side: int  # side of its next small branch, +1: left
    arcade: _Arcade | None  # None for a side branch


def vessel_shades(
    rng: np.random.Generator, *, extent_mm: float, pixels: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Shades of the arteries and of the veins that a generator draws.

    Args:
        rng: random numbers of the tree.
        extent_mm: width and height of the map, mm of arc.
        pixels: width and height of the map, px.

    Returns:
        Two maps, pixels x pixels: 0 without a vessel, 1 in a wide one.
    """
    tree = list(_vessels(rng))
    artery, vein = (
        _draw(np.array([piece for of_vein, piece in tree if of_vein == kind]), extent_mm, pixels)
        for kind in (False, True)
    )
    return artery, vein


def _vessels(rng: np.random.Generator) -> Iterator[tuple[bool, tuple[float, ...]]]:
    """Pieces (is a vein, (x0, y0, x1, y1, calibre)) of the vessel trees, in mm.

    The widest vessel grows first and occupies its cells; no other of its kind crosses them.
    """
    taken: dict[tuple[int, int, bool], int] = {}
    waiting = [(-vessel.calibre, vessel) for vessel in _roots(rng)]
    names = itertools.count(len(waiting))
    heapq.heapify(waiting)
    while waiting:
        _, vessel = heapq.heappop(waiting)
        path, heading, stopped = _grow(vessel, taken, rng)
        for i, (start, end) in enumerate(pairwise(path)):
            # A vessel that was stopped becomes thinner over its last 0.8 mm.
            left = (len(path) - 1 - i) * _STEP_MM / 0.8 if stopped else 1.0
            yield vessel.vein, (*start, *end, vessel.calibre * min(1.0, left))
        if not stopped:
            for child in _branches(vessel, path[-1], heading, names, rng):
                heapq.heappush(waiting, (-child.calibre, child))


def _roots(rng: np.random.Generator) -> list[_Vessel]:
    """Vessels where they leave the cup: four arcades and four small vessels of each kind."""
    starts = []
    for vein, up in itertools.product((False, True), (1, -1)):
        temporal_calibre = 0.105 / 0.68 if vein else 0.105
        nasal_calibre = temporal_calibre / 3 ** (1 / 4.1)
        temporal = _Arcade(1, up, _ARCADE_WIDTH_MM * rng.lognormal(0, 0.1))
        nasal = _Arcade(-1, up, 3 * _ARCADE_WIDTH_MM * rng.lognormal(0, 0.2))
        dx, small = -0.12 if vein else 0.05, 0.35 * temporal_calibre
        starts += [
            (dx, 0.0, up * math.pi / 2 + rng.normal(0, 0.15), temporal_calibre, vein, temporal),
            (dx, 0.0, up * math.pi / 2 + rng.normal(0, 0.15), nasal_calibre, vein, nasal),
            (-0.1, 0.1 * up, math.pi + rng.normal(0, 0.3), small, vein, None),
            (0.1, 0.1 * up, rng.normal(0, 0.4), small, vein, None),
        ]
    return [
        _Vessel(
            name=name,
            relatives=frozenset(range(len(starts))),
            x=DISC_MM[0] + dx,
            y=DISC_MM[1] + dy,
            heading=heading,
            calibre=calibre,
            vein=vein,
            side=int(rng.choice((-1, 1))),
            arcade=arcade,
        )
        for name, (dx, dy, heading, calibre, vein, arcade) in enumerate(starts)
    ]


def _grow(
    vessel: _Vessel, taken: dict[tuple[int, int, bool], int], rng: np.random.Generator
) -> tuple[list[tuple[float, float]], float, bool]:
    """Points of a vessel up to its next branching, its last heading, and whether it was stopped."""
    x, y, heading, bend = vessel.x, vessel.y, vessel.heading, 0.0
    mean_length = 0.9 if vessel.arcade else 0.6 + 12 * vessel.calibre
    steps = 1 + int(rng.gamma(4, mean_length / 4) / _STEP_MM)
    follow = _STEP_MM / (0.5 if vessel.arcade else 2.5)
    path = [(x, y)]
    for jolt in rng.normal(0, 0.35, steps):
        heading += follow * math.sin(_course(x, y, vessel.arcade) - heading) + bend * _STEP_MM
        bend += jolt - bend * _STEP_MM / 0.4
        x += _STEP_MM * math.cos(heading)
        y += _STEP_MM * math.sin(heading)
        path.append((x, y))
        if math.dist((x, y), FOVEA_MM) < 0.25 + 5 * vessel.calibre:
            return path, heading, True
        # On and near the disc, vessels may overlap.
        if math.dist((x, y), DISC_MM) > 1.3:
            cell = math.floor(x / _CELL_MM), math.floor(y / _CELL_MM), vessel.vein
            owner = taken.setdefault(cell, vessel.name)
            if owner != vessel.name and owner not in vessel.relatives:
                return path, heading, True
    return path, heading, False


def _course(x: float, y: float, arcade: _Arcade | None) -> float:
    """Preferred direction of a vessel at a position.

    An arcade follows its parabola. A side branch between the temporal arcades turns towards the
    fovea, any other side branch away from the disc.
    """
    t, w = DISC_MM[0] - x, y - DISC_MM[1]
    if arcade is None:
        if w * w < _ARCADE_WIDTH_MM * t and t < 8:
            return math.atan2(FOVEA_MM[1] - y, FOVEA_MM[0] - x)
        return math.atan2(w, -t)
    t, w = t * arcade.temporal, w * arcade.up
    off = (w * w - arcade.width * t) / math.hypot(arcade.width, 2 * w)
    off = max(-1.0, min(1.0, off))
    along_t, along_w = 2 * w + arcade.width * off, arcade.width - 2 * w * off
    return math.atan2(along_w * arcade.up, -along_t * arcade.temporal)


def _branches(
    parent: _Vessel,
    place: tuple[float, float],
    heading: float,
    names: Iterator[int],
    rng: np.random.Generator,
) -> list[_Vessel]:
    """The two vessels after a branching, without those too fine to be visible.

    calibre^n = major^n + minor^n, and the smaller branch turns by the larger angle.
    """
    n = 1.95 if parent.vein else 2.59
    minor_over_major = rng.uniform(0.3, 0.7) if parent.arcade else rng.uniform(0.45, 1.0)
    major = parent.calibre * (1 + minor_over_major**n) ** (-1 / n)
    angle = math.radians(78) * rng.normal(1, 0.1)
    minor_turn = angle / (1 + minor_over_major**2)
    side = parent.side if rng.random() < 0.8 else -parent.side
    first, second = next(names), next(names)
    children = (
        (first, heading - side * (angle - minor_turn), major, parent.arcade),
        (second, heading + side * minor_turn, minor_over_major * major, None),
    )
    return [
        _Vessel(
            name=name,
            relatives=frozenset((parent.name, first, second)),
            x=place[0],
            y=place[1],
            heading=direction,
            calibre=calibre,
            vein=parent.vein,
            side=-side,
            arcade=arcade,
        )
        for name, direction, calibre, arcade in children
        if calibre > _SMALLEST_CALIBRE_MM
    ]


def _draw(pieces: NDArray[np.float64], extent_mm: float, pixels: int) -> NDArray[np.float32]:
    """Shade of vessels on the map, 1 for a wide one; where they overlap, the darkest counts.

    A piece is a line, filtered with a box of a pixel's width, so its shade is the same at any
    resolution. Pieces with windows of equal size are drawn together.
    """
    pixel = extent_mm / pixels
    edge = max(pixel, _EDGE_MM)
    x0, y0, x1, y1, calibre = pieces.T
    reach = np.ceil(((_STEP_MM + calibre + edge) / 2) / pixel).astype(int)
    column = np.floor(((x0 + x1) / 2 + extent_mm / 2) / pixel).astype(int)
    row = np.floor((extent_mm / 2 - (y0 + y1) / 2) / pixel).astype(int)
    on_map = (np.abs(column - pixels / 2) < pixels / 2 + reach) & (
        np.abs(row - pixels / 2) < pixels / 2 + reach
    )
    margin = 2 * int(reach.max()) + 1
    width = pixels + 2 * margin
    body, streak = np.zeros(width * width, np.float32), np.zeros(width * width, np.float32)
    for window in np.unique(reach[on_map]):
        chosen = np.flatnonzero(on_map & (reach == window))
        offsets = np.arange(-window, window + 1)
        for few in np.array_split(chosen, 1 + len(chosen) * len(offsets) ** 2 // 1_000_000):
            columns = column[few, None, None] + offsets
            rows = row[few, None, None] + offsets[:, None]
            px = (columns + 0.5) * pixel - extent_mm / 2 - x0[few, None, None]
            py = extent_mm / 2 - (rows + 0.5) * pixel - y0[few, None, None]
            ax, ay = (x1 - x0)[few, None, None], (y1 - y0)[few, None, None]
            along = np.clip((px * ax + py * ay) / (ax * ax + ay * ay), 0, 1)
            distance = np.hypot(px - along * ax, py - along * ay)
            at = (rows + margin) * width + columns + margin
            depth = 1 - np.exp(-calibre[few, None, None] / _SHADE_CALIBRE_MM)
            for canvas, part in ((body, 1.0), (streak, _REFLEX_WIDTH)):
                half = part * calibre[few, None, None] / 2
                covered = np.minimum(distance + edge / 2, half) - np.maximum(
                    distance - edge / 2, -half
                )
                seen = covered > 0
                np.maximum.at(canvas, at[seen], (depth * covered / edge)[seen].astype(np.float32))
    body -= np.float32(_REFLEX) * streak
    return body.reshape(width, width)[margin:-margin, margin:-margin]
