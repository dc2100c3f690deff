"""Whether values that a reader accepted can be in the world: each by the law or range that it has.

Written from the definitions in plain words (a length is not negative, a part lies between 0 and
1, a unit vector has the length 1), not from the readers' own limits.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from eyespot.benchmarks.predictions import Plan
from eyespot.benchmarks.sets.spec import PlannedStack
from eyespot.formats.calibration import Calibration
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.poses import PoseTrack
from eyespot.formats.rig import Rig
from eyespot.formats.spot import Spot
from eyespot.formats.spots import SpotRecord
from eyespot.formats.stack import FrameLabels, Stack
from eyespot.optics.refraction import MEDIA
from eyespot.optics.viewing.schematic_eye import Eye
from eyespot.scenes import Scene

WIDEST_MM = 1000.0
"""Radius that no eye or phantom has; the largest known eye, of a squid, has 140 mm."""
WIDEST_BEAM_MM = 25.0
"""Radius at the tip that no beam has which fits into an eye with its fibre."""
FARTHEST_MM = 1e6
"""A kilometre, farther than any robot reaches."""


def impossible(found: Any) -> list[str]:
    """What of a reader's result nothing in the world can have."""
    return [words for words, holds in _laws(found) if not holds]


def _laws(found: Any) -> Iterator[tuple[str, bool]]:
    match found:
        case list() | tuple():
            for one in found:
                yield from _laws(one)
        case Stack():
            for labels in found.labels:
                yield from _of_labels(labels)
            frames = [(one.frame, one.exposure) for one in found.labels]
            yield "two images of one moment", len({*frames}) == len(frames)
        case SpotRecord():
            yield from _of_record(found)
        case MicroscopeFile():
            yield "scale", 0 < found.scale_mm_px < 100
            yield "eye", 0 < found.eye_radius_mm < WIDEST_MM
            yield "images", found.width_px * found.height_px < 1e9
            yield "pinhole", not math.isnan(found.pinhole_height_mm)
        case Rig():
            yield from _of_rig(found)
        case Calibration():
            yield from _of_calibration(found)
        case Plan():
            yield "times", bool(np.all(np.diff(found.times_s) > 0))
            yield "noise", not np.any(found.array("noise") < 0)
            yield "intervals", not np.any(found.array("low") > found.array("high"))
        case PoseTrack():
            yield "times", bool(np.all(np.diff(found.times_s) >= 0))
            yield "directions", bool(np.allclose(np.linalg.norm(found.rotations, axis=1), 1))
            yield "places", bool(np.all(np.abs(found.positions_mm) < FARTHEST_MM))
        case PlannedStack():
            yield from _laws(found.scene)
        case Eye():
            yield "axial length", 0 < float(found.axial_length) < 100
            yield "indices", all(1 <= float(one.medium.index) <= 4 for one in found.lens)
            yield "retina", bool(np.all(np.asarray(found.retina_semi_axes) > 0))
        case Scene():
            core, fibre = found.source.cone_core_radius_mm, found.instrument.fibre_diameter_mm / 2
            narrow = found.schema_version == 1 or core <= 1.03 * fibre
            yield "cone in its fibre", found.source.kind != "cone" or narrow
            yield "spot on the wall", found.spot.eccentricity_mm < 1e4
            yield "reflectance", 0 <= found.phantom.reflectance < 1


def _of_rig(rig: Rig) -> Iterator[tuple[str, bool]]:
    wall, fibre, robot, work = rig.wall, rig.instrument, rig.robot, rig.workspace
    radius = WIDEST_MM if wall.radius_mm is None else wall.radius_mm
    yield "eye", 0 < radius <= WIDEST_MM
    yield "scale", 0 < (rig.microscope.scale_mm_px or 1) < 100
    yield "fibre", 0 < fibre.fibre_diameter_mm / 2 < WIDEST_BEAM_MM
    # As in a scene, a core may be as wide as its fibre within what data sheets allow.
    yield "core", (fibre.core_radius_mm or 0) <= 1.03 * fibre.fibre_diameter_mm / 2
    yield "clear layer", 0 <= (wall.clear_layer_mm or 0) < radius
    yield "normal", abs(math.hypot(*wall.normal) - 1) < 1e-6 and wall.normal[2] > 0
    yield "radius known", wall.radius_sigma_mm < WIDEST_MM
    turn = robot.eye_from_robot or (0, 0, 0, 1)
    yield "turn", abs(math.hypot(*turn) - 1) < 1e-6
    yield "tip", max(map(abs, robot.tip_mm)) < FARTHEST_MM
    if isinstance(robot.touch, tuple):
        yield "touch", 0 <= robot.touch[0] < 2 * radius and robot.touch[1] > 0
    yield "c", work.eccentricity_mm is None or work.eccentricity_mm[1] < radius
    yield "d", 0 < work.distance_mm[0] <= work.distance_mm[1] < 2 * radius
    yield "tilt", 0 <= work.tilt_deg[0] <= work.tilt_deg[1] < 90


def _of_calibration(found: Calibration) -> Iterator[tuple[str, bool]]:
    values = found.values
    yield "index", abs(found.medium.index - MEDIA.get(found.medium.name, found.medium.index)) < 0.02
    yield "scale", 0 < values.get("scale", 1) < 100
    yield "eye", 0 < values.get("eye_radius", 1) < WIDEST_MM
    yield "c", 0 <= values.get("eccentricity", 0) < values.get("eye_radius", WIDEST_MM)
    if "b" in values:
        half_angle, b, _ = found.cone
        yield "beam at the tip", abs(b) * math.tan(half_angle) < WIDEST_BEAM_MM
    else:
        core, rim = values["core_radius"], values["aperture_radius"]
        yield "core", 0 < core < WIDEST_BEAM_MM
        yield "rim", 0 < rim < WIDEST_BEAM_MM
        yield "cap no more than half a ball", 0 <= values["sag"] <= rim
        yield "length", 0 <= values["glue_length"] < WIDEST_MM
        yield "aperture in the glue", values["numerical_aperture"] <= values["glue_index"]


def _unknown(value: float) -> bool:
    return not math.isfinite(value)


def _of_labels(one: FrameLabels) -> Iterator[tuple[str, bool]]:
    for name, value in one:
        if not isinstance(value, float) or _unknown(value):
            continue
        if name.endswith(("semi_major_px", "semi_minor_px")):
            yield f"{name} = {value}", 0 <= value < 1e6
        if name in ("d_mm", "nearest_mm", "c_mm", "exposure_s", "speed_mm_s", "relative_power"):
            yield f"{name} = {value}", value >= 0
        if name.endswith("_fraction"):
            yield f"{name} = {value}", 0 <= value <= 1
    yield f"axis {one.axis}", abs(math.hypot(*one.axis) - 1) < 0.01
    yield "incidence", _unknown(one.incidence_rad) or 0 <= one.incidence_rad <= 1.5708
    yield "mask", one.mask_file_name != one.file_name


def _of_record(record: SpotRecord) -> Iterator[tuple[str, bool]]:
    sigma = record.sigma_distance_mm
    yield f"sigma {sigma}", _unknown(sigma) or sigma >= 0
    if isinstance(spot := record.result, Spot):
        yield "axes", 0 < spot.semi_minor_px <= spot.semi_major_px * 1.001
        for part in (spot.coverage, spot.inlier_fraction, spot.saturated):
            yield f"part {part}", _unknown(part) or 0 <= part <= 1.001
        covariance = spot.covariance
        if np.isfinite(covariance).all():
            scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
            least = np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min()
            yield "covariance", bool(np.all(np.diag(covariance) >= 0) and least > -1e-3)
