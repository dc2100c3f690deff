"""What is true of a frame: its labels, from the geometry of its world."""

import math
from typing import Any

import numpy as np

from eyespot import optics
from eyespot.scenes.world.world import World


def spot_labels(world: World, frame: int) -> dict[str, Any]:
    """The fields of `formats.stack.FrameLabels` that follow from geometry, for one frame."""
    scene, spots = world.scene, world.truth

    def at(column: object) -> Any:
        # Indexing a NumPy array takes a tenth of the time of indexing a JAX array.
        return np.asarray(column)[frame].tolist()

    c, azimuth = at(spots.eccentricity), at(spots.azimuth)
    phi = 0.0  # between the local normal and the microscope's axis; of a plane by convention
    if isinstance(world.wall, optics.Sphere):
        phi = math.asin(c / float(world.wall.radius))
    elif isinstance(world.wall, optics.Ellipsoid):
        normal = world.wall.frame_at(eccentricity=c, azimuth=azimuth).outward
        x, y, z = np.asarray(normal).tolist()
        phi = math.atan2(math.hypot(x, y), -z)
    labels: dict[str, Any] = {
        "frame": frame,
        "time_s": round(at(world.times), 9),  # as people write times
        "d_mm": at(spots.distance),
        "nearest_mm": at(spots.nearest),
        "c_mm": c,
        "azimuth_rad": azimuth,
        "phi_rad": phi,
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
    if scene.phantom.clear_layer_mm:
        pose = np.asarray(at(spots.beam.tip)), np.asarray(at(spots.beam.axis))
        labels["surface_mm"] = float(world.surface.intersect(*pose).distance)
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
