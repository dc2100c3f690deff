"""Poses from which the fit of a first frame starts.

Behind a lens one radius may belong to several distances, and without the robot's axis a spot may
lean to either side. So distances and directions are scanned, and every one that might become the
best is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from estimator.image import Outline
from estimator.pixels.beam import BeamLight, Pose
from estimator.pixels.frame_model import lit
from estimator.pixels.frame_state import Direction, FrameState
from estimator.pixels.solver import Solver

_DISTANCES_MM = np.geomspace(0.4, 7.0, 20)
_ROUND = 1.02  # ratio of the axes below which a spot shows no tilt
_MOST = 3  # starts that are fitted
_SIZE, _TINY = (0.2, 0.05), 1e-6
"""Standard deviation of the logarithm of the spot's area, for light without and with a sharp edge:
the contour of a bell follows the texture, and cells are counted."""
_STEEPEST = 60.0  # incidence, degrees
_BLURRED_PX = 1.5  # width of an edge, above which its blur has a shape
_SHAPES = ((-1.0, 2.0 / np.pi), (0.0, 1.0), (2.0, 6.0 / np.pi))
"""Kurtosis of a blur, and its variance over the square of the edge width (`Spot.edge_width_px`),
which is that of the Gaussian whose step is as steep in the middle: 2/pi for a disc, and 6/pi for
exp(-r/L)."""


def scanned_starts(
    solver: Solver,
    frame_at: Callable[[Pose], FrameState],
    spot: Outline,
    own: np.ndarray,
    directions: list[np.ndarray],
) -> list[FrameState]:
    """The frame at the poses that are the likeliest along each direction, best first.

    Args:
        solver: of the frame's window.
        frame_at: the frame with a pose.
        spot: in the frame.
        own: changes of the beam's own parameters.
        directions: axes of the beam.
    """
    found: list[tuple[float, FrameState]] = []
    spot_px2 = np.pi * spot.semi_major_px * spot.semi_minor_px
    model = solver.model
    point = solver.beam.wall_points(np.array([[spot.x_px, spot.y_px]]))[0][0]
    for axis in directions:
        costs: list[float] = []
        states: list[FrameState | None] = []
        for distance in _DISTANCES_MM:
            pose = solver.beam.pose(point - distance * axis, axis)
            scanned = None if pose is None else model.scanned(frame_at(pose), own)
            state, cost = (None, np.inf) if scanned is None else scanned
            if state is not None:
                cells = np.count_nonzero(lit(model.light(state, own)))
                size = cells * model.window.side**2 / spot_px2
                cost += (np.log(max(size, _TINY)) / _SIZE[solver.beam.sharp]) ** 2
            states.append(state)
            costs.append(cost)
        padded = np.array([np.inf, *costs, np.inf])
        for k in np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])):
            state = states[k]
            if state is not None:
                found.append((costs[k], state))
    found.sort(key=lambda one: one[0])
    return [state for _, state in found[:_MOST]]


def blurred_starts(frame: FrameState, spot: Outline) -> list[FrameState]:
    """A frame with the blurs that a sharp edge may have, which looks as wide as the spot's.

    Args:
        frame: at a pose.
        spot: in the frame.
    """
    if spot.edge_width_px < _BLURRED_PX:
        return [frame]
    return [
        replace(frame, blur_px2=share * spot.edge_width_px**2, kurtosis=kurtosis)
        for kurtosis, share in _SHAPES
    ]


def mirrored_start(solver: Solver, frame: FrameState, own: np.ndarray) -> FrameState | None:
    """A frame with the beam leaning to the other side of the wall's normal, as alike in the image.

    Args:
        solver: of the frame's window.
        frame: at a pose that was found.
        own: changes of the beam's own parameters.

    Returns:
        The frame, or None if such a beam meets no wall that is seen.
    """
    pose = frame.pose
    normal = np.cross(pose.right, pose.down)
    axis = 2.0 * (pose.axis @ normal) * normal - pose.axis
    other = solver.beam.pose(pose.spot - pose.distance * axis, axis)
    scanned = None if other is None else solver.model.scanned(replace(frame, pose=other), own)
    return None if scanned is None else scanned[0]


def likely_directions(
    beam: BeamLight, spot: Outline, direction: Direction | None
) -> list[np.ndarray]:
    """Axes of the beam to start from: the robot's, or square to the wall and tilted as the spot."""
    if direction is not None:
        return [direction.axis]
    return list(_tilted(beam, spot))


def _tilted(beam: BeamLight, spot: Outline) -> Iterator[np.ndarray]:
    along = np.array([np.cos(spot.angle_rad), np.sin(spot.angle_rad)])
    middle = np.array([spot.x_px, spot.y_px])
    points, normals = beam.wall_points(np.stack([middle, middle + along]))
    normal = normals[0]
    yield -normal
    ratio = spot.semi_major_px / spot.semi_minor_px
    if ratio > _ROUND:
        way = points[1] - points[0]
        way -= (way @ normal) * normal
        way /= np.linalg.norm(way)
        tilt = min(np.arccos(1.0 / ratio), np.radians(_STEEPEST))
        for side in (-1.0, 1.0):
            yield -np.cos(tilt) * normal + side * np.sin(tilt) * way
