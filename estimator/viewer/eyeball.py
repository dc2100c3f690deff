"""The eye in three dimensions: eyeball, retina, and the beam from the tip to the wall.

Everything is in the eye frame, mm: the origin is the eyeball's centre, +z points to the microscope.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from estimator.files import MicroscopeFile

_GREY, _RING = (128, 128, 128), (190, 120, 90)
_RINGS_MM = range(1, 7)  # eccentricities, where beams are pointed
_POINTS = 73


def log_eyeball(stream: Any, microscope: MicroscopeFile) -> None:
    """Add a spherical eyeball, or a plane wall, with rings at every mm of eccentricity.

    An ellipsoidal retina is not drawn.

    Args:
        stream: `rerun.RecordingStream`.
        microscope: whose eye it is.
    """
    import rerun

    stream.log("eye", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if microscope.retina is not None:
        return
    radius = microscope.eye_radius_mm
    if microscope.plane_normal is None:
        ball = rerun.Ellipsoids3D(
            radii=[radius],
            colors=[_GREY],
            fill_mode=rerun.components.FillMode.MajorWireframe,
        )
        stream.log("eye/ball", ball, static=True)
    angle = np.linspace(0, 2 * np.pi, _POINTS)
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    rings = [
        np.column_stack([c * circle, _heights_mm(microscope, c * circle)])
        for c in _RINGS_MM
        if c < radius
    ]
    stream.log("eye/retina", rerun.LineStrips3D(rings, colors=[_RING]), static=True)


def log_beam(
    stream: Any,
    path: str,
    *,
    tip_mm: np.ndarray,
    axis: np.ndarray,
    distance_mm: float,
    colour: tuple[int, int, int],
) -> None:
    """Add a beam: the tip, and an arrow from there to the wall.

    Args:
        stream: `rerun.RecordingStream`.
        path: of the beam in the recording.
        tip_mm: S, (3,).
        axis: unit vector from the tip towards the wall, (3,).
        distance_mm: |SO|.
        colour: red, green, blue, 0 to 255.
    """
    import rerun

    stream.log(f"{path}/tip", rerun.Points3D([tip_mm], radii=[0.1], colors=[colour]))
    arrow = distance_mm * np.asarray(axis)
    stream.log(f"{path}/beam", rerun.Arrows3D(origins=[tip_mm], vectors=[arrow], colors=[colour]))


def _heights_mm(microscope: MicroscopeFile, points_mm: np.ndarray) -> np.ndarray:
    """z of the wall at points (..., 2) of the plane square to the microscope's axis."""
    if microscope.plane_normal is not None:
        nx, ny, nz = microscope.plane_normal
        return -microscope.eye_radius_mm - points_mm @ np.array([nx, ny]) / nz
    return -np.sqrt(microscope.eye_radius_mm**2 - np.sum(points_mm**2, axis=-1))
