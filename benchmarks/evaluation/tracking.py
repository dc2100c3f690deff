"""Spots of a rendered trial, measured in the ways that the report compares."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimator import (
    FrameLabels,
    LiteralSettings,
    NoSpot,
    Spot,
    SpotRecord,
    Stack,
    SubpixelSettings,
    track,
    write_spots,
)

VISIBLE_ENOUGH = 0.5
"""Part of the half-maximum contour that must be visible for a spot to count."""

USED = "used"
"""Outcome of a frame that enters the fits."""


@dataclass(frozen=True)
class Way:
    """An estimator and the exposure that it is given.

    Attributes:
        name: of the way, in tables and file names.
        exposure: "paper" or "metered".
        settings: of the estimator; their type is the mode.
        clicked: started by a click on the spot, as the paper's operator does.
    """

    name: str
    exposure: str
    settings: LiteralSettings | SubpixelSettings
    clicked: bool

    @property
    def slug(self) -> str:
        """The name for use in file names."""
        return self.name.replace(",", "").replace(" ", "-")


LITERAL = Way("literal, paper exposure", "paper", LiteralSettings(), True)
"""The paper's own way: a threshold in frames of one exposure."""

LITERAL_METERED = Way("literal, metered", "metered", LiteralSettings(), True)

SUBPIXEL = Way("sub-pixel, metered", "metered", SubpixelSettings(), False)
"""The best way: the half-maximum edge in frames that are metered one by one."""

WAYS = (LITERAL, LITERAL_METERED, SUBPIXEL)


@dataclass(frozen=True)
class Tracked:
    """What one way of measuring made of one trial.

    Attributes:
        results: a spot or a typed failure, one a frame.
    """

    labels: tuple[FrameLabels, ...]
    results: tuple[Spot | NoSpot, ...]

    @property
    def used(self) -> np.ndarray:
        """Frames that enter the fits: a spot was found, and half of its contour can be seen."""
        return np.array(
            [
                bool(result) and row.visible_fraction >= VISIBLE_ENOUGH
                for row, result in zip(self.labels, self.results, strict=True)
            ]
        )

    @property
    def semi_minor_px(self) -> np.ndarray:
        """e1' of the frames used, px."""
        return np.array(
            [
                result.semi_minor_px
                for result, used in zip(self.results, self.used, strict=True)
                if used and isinstance(result, Spot)
            ]
        )

    @property
    def truth_px(self) -> np.ndarray:
        """e1' of the half-maximum label of the frames used, px."""
        return np.array([row.half_max_semi_minor_px for row in self.used_labels])

    @property
    def used_labels(self) -> tuple[FrameLabels, ...]:
        """Labels of the frames used."""
        return tuple(row for row, used in zip(self.labels, self.used, strict=True) if used)

    @property
    def travel_mm(self) -> np.ndarray:
        """d_r, the robot's reading since contact, of the frames used, mm."""
        return np.array([row.d_mm - self.labels[0].d_mm for row in self.used_labels])

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Outcome of each frame: "used", or why it does not count."""

        def outcome(result: Spot | NoSpot, used: bool) -> str:
            if isinstance(result, NoSpot):
                return result.reason.value.replace("_", " ")
            return USED if used else "less than half of the contour in view"

        return tuple(map(outcome, self.results, self.used))

    @property
    def left_out(self) -> Counter[str]:
        """Number of frames left out, by reason."""
        return Counter(outcome for outcome in self.outcomes if outcome != USED)


def track_stack(stack: Stack, way: Way, *, spots_file: Path) -> Tracked:
    """Measure every frame of a stack in one way and write the spots file."""
    labels = stack.exposed(way.exposure)
    first = labels[0]
    start = (first.half_max_x_px, first.half_max_y_px) if way.clicked else None
    results = tuple(track(stack.images(way.exposure), way.settings, start=start))
    mode = "literal" if isinstance(way.settings, LiteralSettings) else "subpixel"
    write_spots(
        spots_file,
        [
            SpotRecord(
                frame=row.frame,
                file_name=row.file_name,
                time_s=row.time_s,
                mode=mode,
                result=result,
            )
            for row, result in zip(labels, results, strict=True)
        ],
    )
    return Tracked(labels, results)
