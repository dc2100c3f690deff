"""Labels of every frame of a scene, from the exact geometry."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

import optics
from scenes.description import Scene
from scenes.world import geometry
from scenes.world.motion import Trajectory, frame_times, trajectory


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
    motion, times = timeline(scene)
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


def timeline(scene: Scene) -> tuple[Trajectory, np.ndarray]:
    """The motion, and the middle of each frame's exposure, s.

    Raises:
        SceneError: the tip touches the wall or leaves the eye; the message names the moment.
    """
    motion = trajectory(scene)
    times = frame_times(scene, motion)
    # Between frames the tip meets no wall either.
    often = np.arange(0.0, times.max(), 1 / scene.clocks.kinematics_hz)
    both = np.union1d(often, times)
    geometry.check_poses(scene, times=both, **motion.at(both)._asdict())
    return motion, times


def spot_labels(scene: Scene, moments: Moments, frame: int) -> dict[str, Any]:
    """The labels of `estimator.FrameLabels` that geometry decides, of one frame."""
    spots, eyeball = moments.spots, scene.phantom.kind == "eyeball"

    def at(column: object) -> Any:
        # A frame of a NumPy array takes a tenth of the time of one of a JAX array.
        return np.asarray(column)[frame].tolist()

    c = at(spots.eccentricity)
    labels: dict[str, Any] = {
        "frame": frame,
        "time_s": at(moments.times),
        "d_mm": at(spots.distance),
        "nearest_mm": at(spots.nearest),
        "c_mm": c,
        "azimuth_rad": at(spots.azimuth),
        "phi_rad": math.asin(c / scene.phantom.radius_mm) if eyeball else 0.0,
        "incidence_rad": at(spots.incidence),
        "incidence_azimuth_rad": at(spots.incidence_azimuth),
        "tip_mm": tuple(at(spots.beam.tip)),
        "axis": tuple(at(spots.beam.axis)),
        "spot_mm": tuple(at(spots.origin)),
        "speed_mm_s": at(moments.speed),
        "medium": scene.source.medium,
        "seed": scene.seed,
    }
    for kind, ellipse in (("cone", spots.cone), ("half_max", spots.half_max)):
        x, y = at(ellipse.centre)
        labels |= {
            f"{kind}_x_px": x,
            f"{kind}_y_px": y,
            f"{kind}_semi_major_px": at(ellipse.semi_major),
            f"{kind}_semi_minor_px": at(ellipse.semi_minor),
            f"{kind}_angle_rad": at(ellipse.angle),
        }
    return labels
