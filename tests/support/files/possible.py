"""Whether values that a reader accepted can be in the world: each by the law or range that it has.

Written from the definitions in plain words (a length is not negative, a part lies between 0 and
1, a unit vector has the length 1), not from the readers' own limits.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.spots import Spot, SpotRecord
from eyespot.formats.stack import FrameLabels, Stack
from eyespot.optics.viewing.eye import Eye
from eyespot.scenes import Scene


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
            yield "eye", 0 < found.eye_radius_mm
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
