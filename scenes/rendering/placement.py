"""Rigid transforms and the wall of a Mitsuba scene."""

from __future__ import annotations

from typing import Any

import numpy as np

import optics


def rigid_transform(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Rigid transform, 4 x 4, that maps the origin to `origin` and +z to `direction`."""
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(direction))
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = first, second, direction, origin
    return matrix


def wall_shape(mitsuba_scene: Any) -> Any:
    """The wall of a Mitsuba scene."""
    return next(shape for shape in mitsuba_scene.shapes() if shape.id() == "wall")
