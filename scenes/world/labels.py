"""The labels of a frame that follow from geometry."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

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
    eyeball = scene.phantom.kind == "eyeball"
    labels: dict[str, Any] = {
        "frame": frame,
        "time_s": at(world.times),
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
        "speed_mm_s": at(world.speed),
        "medium": scene.source.medium,
        "seed": scene.seed,
    }
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
