"""Labels of every frame of a scene, from the exact geometry."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

import optics
from scenes import geometry
from scenes.motion import Trajectory, frame_times, trajectory
from scenes.settings import Scene


class Moments(NamedTuple):
    """What is true of every frame.

    Attributes:
        motion: the tip at any moment.
        times: middle of each frame's exposure, s.
        spots: at those moments.
        speed: of the tip then, mm/s.
    """

    motion: Trajectory
    times: np.ndarray
    spots: optics.SpotTruth
    speed: np.ndarray


def moments(scene: Scene, table: optics.IrradianceTable | None) -> Moments:
    """Truth of every frame of the scene; see `optics.spot_truth`.

    Args:
        scene: the scene.
        table: vector irradiance of the lens, or None for the ideal cone.

    Raises:
        SceneError: the tip touches the wall or leaves the eye, or the spot leaves the window; the
            message names the moment.
    """
    motion = trajectory(scene)
    times = frame_times(scene, motion)
    # Between frames the tip meets no wall either.
    often = np.arange(0.0, times.max(), 1 / scene.clocks.kinematics_hz)
    both = np.union1d(often, times)
    geometry.check_poses(scene, times=both, **motion.at(both)._asdict())
    cone = geometry.cone(scene, table)
    spots = optics.spot_truth(
        geometry.wall(scene),
        geometry.microscope(scene),
        table,
        **motion.at(times)._asdict(),
        half_angle=cone.half_angle,
        apex_offset=cone.apex_offset,
    )
    geometry.check_window(scene, times=times, contours=np.asarray(spots.contour_px))
    return Moments(motion, times, spots, motion.speed(times))


def spot_labels(scene: Scene, moments: Moments, frame: int) -> dict[str, Any]:
    """The labels of `estimator.FrameLabels` that geometry decides, of one frame."""
    spots, eyeball = moments.spots, scene.phantom.kind == "eyeball"
    c = float(spots.eccentricity[frame])
    labels: dict[str, Any] = {
        "frame": frame,
        "time_s": float(moments.times[frame]),
        "d_mm": float(spots.distance[frame]),
        "nearest_mm": float(spots.nearest[frame]),
        "c_mm": c,
        "azimuth_rad": float(spots.azimuth[frame]),
        "phi_rad": math.asin(c / scene.phantom.radius_mm) if eyeball else 0.0,
        "incidence_rad": float(spots.incidence[frame]),
        "incidence_azimuth_rad": float(spots.incidence_azimuth[frame]),
        "tip_mm": _floats(spots.beam.tip[frame]),
        "axis": _floats(spots.beam.axis[frame]),
        "spot_mm": _floats(spots.origin[frame]),
        "speed_mm_s": float(moments.speed[frame]),
        "medium": scene.source.medium,
        "seed": scene.seed,
    }
    for kind, ellipse in (("cone", spots.cone), ("half_max", spots.half_max)):
        x, y = _floats(ellipse.centre[frame])
        labels |= {
            f"{kind}_x_px": x,
            f"{kind}_y_px": y,
            f"{kind}_semi_major_px": float(ellipse.semi_major[frame]),
            f"{kind}_semi_minor_px": float(ellipse.semi_minor[frame]),
            f"{kind}_angle_rad": float(ellipse.angle[frame]),
        }
    return labels


def _floats(vector: object) -> tuple[float, ...]:
    return tuple(float(x) for x in np.asarray(vector))
