"""Marks in a picture: the tip, its shadow, and the height of the wall in a stereo pair.

The labels help: they say where to look (within `REACH_PX`), and how the outline runs there. The
place is measured from the picture. A network would have to find all of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import ConvexHull
from skimage.measure import points_in_poly

import optics
from benchmarks.studies.rivals.sensors import shadow_of
from benchmarks.studies.rivals.setup import (
    RADIUS_MM,
    SCALE_MM_PX,
    TOOL_RADIUS_MM,
    Place,
    Views,
    project,
)

REACH_PX = 12.0
"""Largest error of a mark: it is searched for within this distance of the label."""

_COARSE_STEP_PX, _STEP_PX = 2.0, 1.0
"""The coarse one is as wide as an edge. With steps of a pixel the parabola does not see that the
image is interpolated linearly."""
_SMOOTH_PX = 1.5  # the standard deviation at which noise and the steps of a penumbra vanish
_BACK_MM = 1.0  # length of the instrument whose outline is used
_KEPT = 0.3  # of that length, from its back, is left out: the instrument does not end there
_SHAFT_MM = 8.0  # length of the instrument that may hide the wall near O

_PATCH_MM, _PATCH_POINTS = 3.0, 41  # side of the wall's part around O that is matched
_HEIGHTS_MM = np.linspace(-1.5, 1.5, 31)
_COARSE_PX = 8.0  # brightness that changes more slowly is no texture
_MARGIN_PX = 2 * _COARSE_PX  # so far an edge changes the texture beside it
_LEAST_CORRELATION = 0.3
_FEWEST = 100  # points of the wall that both images must show


class Outline(NamedTuple):
    """Part of an outline, px: points and outward unit normals, n x 2."""

    points: np.ndarray
    normals: np.ndarray


def tool_outline(one: Place, camera: optics.Camera) -> Outline:
    """Outline of the instrument's end in the image."""
    return _outline(camera, *(_rim(one, behind) for behind in (0.0, _BACK_MM)))


def shadow_outline(one: Place, camera: optics.Camera) -> Outline:
    """Outline of the shadow of the instrument's end in the image."""
    rims = (_rim(one, behind) for behind in (0.0, _BACK_MM))
    return _outline(camera, *(np.asarray(shadow_of(r, one.lamp)) for r in rims))


def found_shift(image: np.ndarray, outline: Outline, *, dark: bool) -> np.ndarray:
    """Shift of an outline at which the image is steepest across it, px.

    Args:
        image: grey, H x W.
        outline: where the labels say that it is.
        dark: whether the inside is known to be darker than the outside.
    """
    smooth = gaussian_filter(image, _SMOOTH_PX)
    down, right = np.gradient(smooth)

    def steepness(shift: np.ndarray) -> float:
        columns, rows = (outline.points + shift).T
        across = (
            map_coordinates(right, [rows, columns], order=1, mode="nearest") * outline.normals[:, 0]
            + map_coordinates(down, [rows, columns], order=1, mode="nearest")
            * outline.normals[:, 1]
        )
        return float(np.mean(across if dark else np.abs(across)))

    return _highest(steepness)


def wall_height(left: np.ndarray, right: np.ndarray, one: Place, seen: Views) -> float | None:
    """Height of the wall near O above the place where it is thought to be, mm; None if no texture.

    Every height is tried: the wall's points are looked up in both images, and the height at which
    the two agree best is the answer.

    Args:
        left: grey image.
        one: place of the instrument, which hides a part of the wall.
    """
    textures = [
        gaussian_filter(image, _SMOOTH_PX) - gaussian_filter(image, _COARSE_PX)
        for image in (left, right)
    ]
    first, second = map(np.asarray, optics.perpendicular_frame(one.spot / RADIUS_MM))
    side = np.linspace(-_PATCH_MM / 2, _PATCH_MM / 2, _PATCH_POINTS)
    a, b = (grid.ravel()[:, None] for grid in np.meshgrid(side, side))
    towards = one.spot + a * first + b * second
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    shafts = [_shaft(one, camera) for camera in seen[1:]]
    correlations = []
    for height in _HEIGHTS_MM:
        pixels = [
            np.asarray(project(camera, (RADIUS_MM - height) * towards)) for camera in seen[1:]
        ]
        bare = [
            ~points_in_poly(places, shaft) & _within_the_iris(camera, places)
            for places, shaft, camera in zip(pixels, shafts, seen[1:], strict=True)
        ]
        values = [
            map_coordinates(texture, places.T[::-1], order=1, mode="nearest")[bare[0] & bare[1]]
            for texture, places in zip(textures, pixels, strict=True)
        ]
        correlations.append(float(np.corrcoef(*values)[0, 1]) if values[0].size > _FEWEST else -1.0)
    best = int(np.argmax(correlations))
    if not correlations[best] >= _LEAST_CORRELATION or not 0 < best < len(_HEIGHTS_MM) - 1:
        return None
    step = _HEIGHTS_MM[1] - _HEIGHTS_MM[0]
    return float(_HEIGHTS_MM[best] + step * _vertex(*correlations[best - 1 : best + 2]))


def _rim(one: Place, behind: float, *, margin: float = 0.0) -> np.ndarray:
    """Points of the instrument's circumference at a distance behind its tip, 32 x 3, mm."""
    angle = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)[:, None]
    first, second = map(np.asarray, optics.perpendicular_frame(one.axis))
    circle = np.cos(angle) * first + np.sin(angle) * second
    return one.tip - behind * one.axis + (TOOL_RADIUS_MM + margin) * circle


def _outline(camera: optics.Camera, front: np.ndarray, back: np.ndarray) -> Outline:
    ends = [np.asarray(project(camera, rim)) for rim in (front, back)]
    corners = _hull(np.concatenate(ends))
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(edges, axis=1)
    points, normals = [], []
    for corner, edge, length in zip(corners, edges, lengths, strict=True):
        count = max(1, round(length))
        steps = (np.arange(count) + 0.5) / count
        points.append(corner + steps[:, None] * edge)
        # Corners run such that the outside is on this side.
        normals.append(np.tile(np.array([edge[1], -edge[0]]) / length, (count, 1)))
    along = ends[0].mean(axis=0) - ends[1].mean(axis=0)
    every = np.concatenate(points)
    kept = (every - ends[1].mean(axis=0)) @ along > _KEPT * (along @ along)
    return Outline(every[kept], np.concatenate(normals)[kept])


def _shaft(one: Place, camera: optics.Camera) -> np.ndarray:
    """Corners of the instrument's whole outline, with a margin, px."""
    margin = _MARGIN_PX * SCALE_MM_PX
    rims = [_rim(one, behind, margin=margin) for behind in (-margin, _SHAFT_MM)]
    return _hull(np.asarray(project(camera, np.concatenate(rims))))


def _within_the_iris(camera: Any, pixels: np.ndarray) -> np.ndarray:
    """Whether pixels are so far from the iris's edge that the edge is no part of their texture."""
    shifts = _MARGIN_PX * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    passed = _transmittance(camera, pixels[None] + shifts[:, None])
    return np.all(np.asarray(passed) > 0, axis=0)


_transmittance = eqx.filter_jit(lambda camera, pixels: camera.transmittance(pixels))


def _hull(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull, counter-clockwise in x and y."""
    return points[ConvexHull(points).vertices]


def _highest(score: Callable[[np.ndarray], float]) -> np.ndarray:
    """The shift with the highest score: on a coarse grid, then on a fine one, then by parabolas."""
    found = np.zeros(2)
    for reach, step in ((REACH_PX, _COARSE_STEP_PX), (_COARSE_STEP_PX, _STEP_PX)):
        steps = np.arange(-reach, reach + step / 2, step)
        scores = np.array([[score(found + np.array([x, y])) for x in steps] for y in steps])
        row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
        found = found + np.array([steps[column], steps[row]])
    if 0 < column < len(steps) - 1:
        found[0] += _STEP_PX * _vertex(*scores[row, column - 1 : column + 2])
    if 0 < row < len(steps) - 1:
        found[1] += _STEP_PX * _vertex(*scores[row - 1 : row + 2, column])
    return found


def _vertex(before: float, middle: float, after: float) -> float:
    """Place of a parabola's top through three values one step apart, in steps from the middle."""
    bend = before - 2 * middle + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0
