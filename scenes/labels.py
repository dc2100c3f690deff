"""Labels of every moment of a scene, from the exact geometry."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import optics
from scenes import geometry
from scenes.settings import Scene


def truth(scene: Scene, table: optics.IrradianceTable | None) -> optics.SpotTruth:
    """Truth of every moment of the scene's withdrawal; see `optics.spot_truth`.

    Args:
        scene: the scene.
        table: vector irradiance of the lens, or None for the ideal cone.

    Raises:
        SceneError: the spot leaves the window at some moment.
    """
    cone, spot = geometry.cone(scene, table), scene.spot
    found = optics.spot_truth(
        geometry.wall(scene),
        geometry.microscope(scene),
        table,
        distances=geometry.distances(scene),
        eccentricity=spot.eccentricity_mm,
        azimuth=math.radians(spot.azimuth_deg),
        incidence=math.radians(spot.incidence_deg),
        incidence_azimuth=math.radians(spot.incidence_azimuth_deg),
        half_angle=cone.half_angle,
        apex_offset=cone.apex_offset,
    )
    geometry.check_window(scene, np.asarray(found.contour_px).reshape(-1, 2))
    return found


def spot_labels(scene: Scene, truth: optics.SpotTruth, frame: int) -> dict[str, Any]:
    """The labels of `estimator.FrameLabels` that geometry decides, of one moment."""
    phantom, spot, withdrawal = scene.phantom, scene.spot, scene.withdrawal
    sin_phi = spot.eccentricity_mm / phantom.radius_mm if phantom.kind == "eyeball" else 0.0
    labels: dict[str, Any] = {
        "frame": frame,
        "time_s": float(truth.distance[frame] - truth.distance[0]) / withdrawal.speed_mm_s,
        "d_mm": float(truth.distance[frame]),
        "nearest_mm": float(truth.nearest[frame]),
        "c_mm": spot.eccentricity_mm,
        "azimuth_rad": math.radians(spot.azimuth_deg),
        "phi_rad": math.asin(sin_phi),
        "incidence_rad": math.radians(spot.incidence_deg),
        "incidence_azimuth_rad": math.radians(spot.incidence_azimuth_deg),
        "tip_mm": _floats(truth.beam.tip[frame]),
        "axis": _floats(truth.beam.axis[frame]),
        "spot_mm": _floats(truth.origin[frame]),
        "speed_mm_s": withdrawal.speed_mm_s,
        "medium": scene.source.medium,
        "seed": scene.seed,
    }
    for kind, ellipse in (("cone", truth.cone), ("half_max", truth.half_max)):
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
