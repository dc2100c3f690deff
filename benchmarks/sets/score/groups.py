"""Scores of each estimator, for all images and by condition."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from benchmarks.sets.score.conditions import CONDITIONS, Circumstances
from benchmarks.sets.score.measures import Counts, Errors, counts_of, errors_of
from benchmarks.sets.score.outcomes import Against, Judged, judge
from estimator import SpotRecord

ALL = "all"
"""Condition and group of all images together."""

_ORDER = [ALL, *(condition.name for condition in CONDITIONS)]


class Group(NamedTuple):
    """Score of an estimator on a group of images.

    Attributes:
        estimator: name of the estimator.
        condition: condition by which images are grouped.
        group: group within that condition.
        counts: numbers of images by outcome.
        errors: errors of each measured quantity.
    """

    estimator: str
    condition: str
    group: str
    counts: Counts
    errors: list[Errors]

    def of(self, quantity: str) -> Errors | None:
        """Errors of one quantity; None if it was not measured."""
        return next((errors for errors in self.errors if errors.quantity == quantity), None)


@dataclass(frozen=True, kw_only=True)
class Score:
    """Scores of estimators on a set.

    Attributes:
        against: which of the two ellipses is the truth.
        judged: outcomes of each estimator.
        left_out: number of images in splits and exposures for which an estimator has no spots.
        groups: scores of each estimator, for all images and by condition.
    """

    against: Against
    judged: Mapping[str, list[Judged]]
    left_out: Mapping[str, int]
    groups: list[Group]

    def total(self, estimator: str) -> Group:
        """Score of an estimator on all images."""
        return next(
            group for group in self.groups if (group.estimator, group.condition) == (estimator, ALL)
        )

    def by_condition(self) -> dict[tuple[str, str], dict[str, Group]]:
        """Scores of all estimators for each condition and group, in order.

        Conditions with a single group are omitted.
        """
        rows: dict[tuple[str, str], dict[str, Group]] = {}
        for group in self.groups:
            if group.condition != ALL:
                rows.setdefault((group.condition, group.group), {})[group.estimator] = group
        conditions = [condition for condition, _ in rows]
        return {key: row for key, row in rows.items() if conditions.count(key[0]) > 1}


def score(
    images: Mapping[str, Circumstances],
    spots: Mapping[str, Mapping[str, SpotRecord]],
    *,
    against: Against,
) -> Score:
    """Compare estimators' spots with the labels of a set.

    Args:
        images: images of the set, see `circumstances_of`.
        spots: records of each estimator by image name, see `read_set_spots`.
        against: which of the two ellipses is the truth.
    """
    judged = {name: judge(images, records, against=against) for name, records in spots.items()}
    return Score(
        against=against,
        judged=judged,
        left_out={name: len(images) - len(found) for name, found in judged.items()},
        groups=sorted(
            (group for name, found in judged.items() for group in _groups(name, found)),
            key=lambda group: _ORDER.index(group.condition),
        ),
    )


def _groups(estimator: str, images: list[Judged]) -> Iterator[Group]:
    yield Group(estimator, ALL, ALL, counts_of(images), errors_of(images))
    for condition in CONDITIONS:
        for group in condition.groups([image.circumstances for image in images]):
            members = [
                image for image in images if condition.group_of(image.circumstances) == group
            ]
            yield Group(estimator, condition.name, group, counts_of(members), errors_of(members))
