"""Outcome of each image: spot found, missed, misplaced ..."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from typing import Literal, NamedTuple

from benchmarks.evaluation import VISIBLE_ENOUGH
from benchmarks.sets.score.conditions import Circumstances
from estimator import FrameLabels, Spot, SpotRecord

Against = Literal["half_max", "cone"]


class Outcome(Enum):
    """Outcome of an image.

    A spot is the true spot if its centre lies within one true semi-major axis of the true centre. A
    distance without an ellipse counts as the true spot, since nothing says where it was read.
    """

    FOUND = "found"
    """At least half of the contour is visible, and the true spot is reported."""
    MISSED = "missed"
    """At least half is visible, and no spot is reported."""
    MISPLACED = "misplaced"
    """At least half is visible, and a spot elsewhere is reported: missed and a false spot."""
    HIDDEN = "hidden"
    """Less than half is visible, and no spot is reported."""
    GLIMPSED = "glimpsed"
    """Less than half is visible, and the true spot is reported; its errors are not counted."""
    INVENTED = "invented"
    """Less than half is visible and a spot elsewhere is reported, or nothing is visible."""


class Judged(NamedTuple):
    """An image with its labels and the result of an estimator.

    Attributes:
        circumstances: labels, and properties for grouping.
        record: line of the spots file; None if missing.
        outcome: the outcome.
        errors: estimate - truth by quantity, for found images; NaN if not measured.
        sigmas: standard deviations from the estimator.
    """

    circumstances: Circumstances
    record: SpotRecord | None
    outcome: Outcome
    errors: Mapping[str, float]
    sigmas: Mapping[str, float]


CENTRE = "centre_px"
"""Distance between the centres, the only quantity without a sign."""

QUANTITIES = ("x_px", "y_px", CENTRE, "semi_major_px", "semi_minor_px", "distance_mm")
"""Scored quantities; the true distance is d = |SO|."""

_ROWS = {"x_px": 0, "y_px": 1, "semi_major_px": 2, "semi_minor_px": 3}
"""Index of a quantity in the covariance of a spot."""


def judge(
    images: Mapping[str, Circumstances], records: Mapping[str, SpotRecord], *, against: Against
) -> list[Judged]:
    """Compare an estimator's records with the labels of a set.

    If the records contain one image of a split and exposure, all images of that split and exposure
    count. An image without a record counts as an image without a spot.

    Args:
        images: images of the set, by name.
        records: records by image name.
        against: which of the two ellipses is the truth.

    Returns:
        The images that count.
    """
    covered = {_kind(images[name]) for name in records}
    return [
        _judged(about, records.get(name), against)
        for name, about in images.items()
        if _kind(about) in covered
    ]


def _kind(about: Circumstances) -> tuple[str, str]:
    return about.split, about.labels.exposure


def _judged(about: Circumstances, record: SpotRecord | None, against: Against) -> Judged:
    labels = about.labels
    spot = record.result if record is not None and isinstance(record.result, Spot) else None
    outcome = _outcome(labels, spot, record, against)
    if outcome is not Outcome.FOUND or record is None:
        return Judged(about, record, outcome, {}, {})
    errors = dict.fromkeys(QUANTITIES, math.nan)
    errors["distance_mm"] = record.distance_mm - labels.d_mm
    sigmas = {"distance_mm": record.sigma_distance_mm}
    if spot is not None:
        errors |= {q: getattr(spot, q) - getattr(labels, f"{against}_{q}") for q in _ROWS}
        errors[CENTRE] = math.hypot(errors["x_px"], errors["y_px"])
        sigmas |= {q: math.sqrt(spot.covariance[i, i]) for q, i in _ROWS.items()}
    return Judged(about, record, outcome, errors, sigmas)


def _outcome(
    labels: FrameLabels, spot: Spot | None, record: SpotRecord | None, against: Against
) -> Outcome:
    visible = labels.visible_fraction >= VISIBLE_ENOUGH
    if spot is None:
        if record is None or math.isnan(record.distance_mm):
            return Outcome.MISSED if visible else Outcome.HIDDEN
        elsewhere = False
    else:
        far = math.hypot(
            spot.x_px - getattr(labels, f"{against}_x_px"),
            spot.y_px - getattr(labels, f"{against}_y_px"),
        )
        # `not <=` includes NaN: a spot without a position is elsewhere.
        elsewhere = not far <= getattr(labels, f"{against}_semi_major_px")
    if visible:
        return Outcome.MISPLACED if elsewhere else Outcome.FOUND
    nothing = labels.visible_fraction == 0
    return Outcome.INVENTED if elsewhere or nothing else Outcome.GLIMPSED
