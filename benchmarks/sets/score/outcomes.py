"""What an estimator made of each image of a set, beside the truth."""

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
    """What became of an image.

    A spot is the true one if its centre lies within one true semi-major axis of the true centre.
    """

    FOUND = "found"
    """Half of the contour or more is seen, and the true spot is reported."""
    MISSED = "missed"
    """Half or more is seen, and no spot is reported."""
    MISPLACED = "misplaced"
    """Half or more is seen, and a spot elsewhere is reported: a miss and a false spot."""
    HIDDEN = "hidden"
    """Less than half is seen, and no spot is reported."""
    GLIMPSED = "glimpsed"
    """Less than half is seen, and the true spot is reported; its errors are not counted."""
    INVENTED = "invented"
    """Less than half is seen, and a spot is reported elsewhere, or nothing is seen at all."""


class Judged(NamedTuple):
    """An image, its truth, and what an estimator said of it.

    Attributes:
        circumstances: truth and what groups it.
        record: line of the spots file; None where there is none.
        outcome: what became of it.
        errors: estimate - truth by quantity, of images found; NaN where it was not measured.
        sigmas: the estimator's own standard deviations of them.
    """

    circumstances: Circumstances
    record: SpotRecord | None
    outcome: Outcome
    errors: Mapping[str, float]
    sigmas: Mapping[str, float]


CENTRE = "centre_px"
"""Distance between the centres: the one quantity without a sign."""

QUANTITIES = ("x_px", "y_px", CENTRE, "semi_major_px", "semi_minor_px", "distance_mm")
"""What is scored; distances are compared with d = |SO|."""

_ROWS = {"x_px": 0, "y_px": 1, "semi_major_px": 2, "semi_minor_px": 3}
"""Where a quantity stands in a spot's covariance."""


def judge(
    images: Mapping[str, Circumstances], records: Mapping[str, SpotRecord], *, against: Against
) -> list[Judged]:
    """Compare an estimator's records with the labels of a set.

    Images count by split and exposure: where the records name one image of a split's exposure, all
    of its images count, and those without a record as without a spot.

    Args:
        images: of the set, by name.
        records: by the image's name.
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
    outcome = _outcome(labels, spot, against)
    if outcome is not Outcome.FOUND or spot is None or record is None:
        return Judged(about, record, outcome, {}, {})
    errors = {q: getattr(spot, q) - getattr(labels, f"{against}_{q}") for q in _ROWS}
    errors[CENTRE] = math.hypot(errors["x_px"], errors["y_px"])
    errors["distance_mm"] = record.distance_mm - labels.d_mm
    sigmas = {q: math.sqrt(spot.covariance[i, i]) for q, i in _ROWS.items()}
    sigmas["distance_mm"] = record.sigma_distance_mm
    return Judged(about, record, outcome, errors, sigmas)


def _outcome(labels: FrameLabels, spot: Spot | None, against: Against) -> Outcome:
    visible = labels.visible_fraction >= VISIBLE_ENOUGH
    if spot is None:
        return Outcome.MISSED if visible else Outcome.HIDDEN
    far = math.hypot(
        spot.x_px - getattr(labels, f"{against}_x_px"),
        spot.y_px - getattr(labels, f"{against}_y_px"),
    )
    # "not >": a spot without a place is elsewhere.
    elsewhere = not far <= getattr(labels, f"{against}_semi_major_px")
    if visible:
        return Outcome.MISPLACED if elsewhere else Outcome.FOUND
    nothing = labels.visible_fraction == 0
    return Outcome.INVENTED if elsewhere or nothing else Outcome.GLIMPSED
