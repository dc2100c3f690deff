"""The labels of a frame that follow from geometry."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import optics
from scenes.world.world import World


def spot_labels(world: World, frame: int) -> dict[str, Any]:
    """The fields of `estimator.files.FrameLabels` that follow from geometry, for one frame.

    Args:
        world: the scene and everything derived from it.
        frame: number of the frame.
    """
    scene, spots = world.scene, world.truth

    def at(column: object) -> Any:
        # Indexing a NumPy array takes a tenth of the time of indexing a JAX array.
        return np.asarray(column)[frame].tolist()

    c = at(spots.eccentricity)
    labels: dict[str, Any] = {
        "frame": frame,
        "time_s": round(at(world.times), 9),  # as people write times
        "d_mm": at(spots.distance),
        "nearest_mm": at(spots.nearest),
        "c_mm": c,
        "azimuth_rad": at(spots.azimuth),
        "phi_rad": _phi(world, c=c, azimuth=at(spots.azimuth)),
        "incidence_rad": at(spots.incidence),
        "incidence_azimuth_rad": at(spots.incidence_azimuth),
        "tip_mm": tuple(at(spots.beam.tip)),
        "axis": tuple(at(spots.beam.axis)),
        "spot_mm": tuple(at(spots.origin)),
        "speed_mm_s": at(world.speed),
        "medium": scene.source.medium,
        "seed": scene.seed,
    }
    if (shifts := world.colour_shifts) is not None:
        for colour, shift in zip(("red", "blue"), shifts[:, frame], strict=True):
            x, y = shift.tolist()
            labels |= {f"{colour}_shift_x_px": x, f"{colour}_shift_y_px": y}
    unrest = scene.unrest
    moment = world.unrest.at(frame, at(world.times))
    if unrest.shifts:
        labels["view_x_px"], labels["view_y_px"] = moment.view_px.tolist()
    if unrest.turns:
        degrees = np.degrees(moment.turn).tolist()
        labels |= {f"eye_turn_{k}_deg": d for k, d in zip("xyz", degrees, strict=True)}
    if unrest.power_swing:
        labels["relative_power"] = moment.power
    if world.reflections is not None:
        x, y = (world.brightest_reflex_px + moment.view_px).tolist()
        labels |= {"reflex_x_px": x, "reflex_y_px": y}
    ellipses = {"cone": spots.cone, "half_max": spots.half_max}
    if (spread := world.spread_spots) is not None:
        ellipses |= {"spread_cone": spread.cone, "spread_half_max": spread.half_max}
    for kind, ellipse in ellipses.items():
        x, y = at(ellipse.centre)
        labels |= {
            f"{kind}_x_px": x,
            f"{kind}_y_px": y,
            f"{kind}_semi_major_px": at(ellipse.semi_major),
            f"{kind}_semi_minor_px": at(ellipse.semi_minor),
            f"{kind}_angle_rad": at(ellipse.angle),
        }
    return labels


def _phi(world: World, *, c: float, azimuth: float) -> float:
    """Angle between the local normal and the microscope's axis; of a plane 0 by convention."""
    wall = world.wall
    if isinstance(wall, optics.Sphere):
        return math.asin(c / float(wall.radius))
    if isinstance(wall, optics.Plane):
        return 0.0
    x, y, z = np.asarray(wall.frame_at(eccentricity=c, azimuth=azimuth).outward).tolist()
    return math.atan2(math.hypot(x, y), -z)
