"""The results as data: noise, wrong assumptions, and readings of rendered images."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, NamedTuple

import numpy as np

from benchmarks.reporting import Column
from benchmarks.studies.rivals.pictures import Pictures
from scenes import Scene

CONTOUR_PX, MARK_PX, WALL_PX = 0.05, 1.0, 0.1
"""Stated noise: of each of 128 points of the spot's edge (as in the study of poses), of a tip or
a shadow's tip in x and y (an assumption), and of the wall's texture matched in a pair (an
assumption)."""


class Sensor(StrEnum):
    """What the distance is read from."""

    SPOT = "spot"
    SHADOW = "shadow"
    STEREO = "stereo"


class Wrong(StrEnum):
    """One thing that a sensor takes as known and that is wrong."""

    PATH = "the path is taken for a pinhole"
    LAMP = "the light guide is 1 mm elsewhere"
    AXIS = "the axis is 1° off"
    RADIUS = "the eye's radius is 0.5 mm larger"


class Outcome(StrEnum):
    """What became of a reading."""

    READ = "read"
    OUT_OF_VIEW = "out of view"
    """A mark lies outside the window, or the iris hides it."""
    HIDDEN = "hidden"
    """The instrument hides the shadow of its tip, or too much of the spot."""
    NO_SPOT = "no spot"
    """The estimator found none; spots.csv has the reason."""
    NO_TEXTURE = "no texture"
    """The two images of the wall cannot be matched."""


class Expected(NamedTuple):
    """Row of expected.csv: what marks of the stated noise give, with everything known."""

    sensor: Annotated[str, Column("sensor")]
    path: Annotated[str, Column("path")]
    c_mm: Annotated[float, Column("c, mm", 1)]
    d_mm: Annotated[float, Column("d, mm", 1)]
    outcome: Annotated[str, Column("outcome")]
    sigma_mm: Annotated[float, Column("σ of d, mm")]


class Bias(NamedTuple):
    """Row of wrong.csv: error of exact marks if one assumption is wrong; RMS over directions."""

    sensor: Annotated[str, Column("sensor")]
    path: Annotated[str, Column("path")]
    wrong: Annotated[str, Column("what is wrong")]
    c_mm: Annotated[float, Column("c, mm", 1)]
    d_mm: Annotated[float, Column("d, mm", 1)]
    error_mm: Annotated[float, Column("error, mm", sign=True)]


class Reading(NamedTuple):
    """Row of readings.csv: a distance read from rendered images; error = estimate - truth.

    The marks' errors are the largest of the reading's marks: the semi-minor axis for the spot, the
    place of tip and shadow otherwise; empty if nothing was read.
    """

    sensor: Annotated[str, Column("sensor")]
    path: Annotated[str, Column("path")]
    wall: Annotated[str, Column("wall")]
    c_mm: Annotated[float, Column("c, mm", 1)]
    d_mm: Annotated[float, Column("d, mm", 1)]
    outcome: Annotated[str, Column("outcome")]
    error_mm: Annotated[float, Column("error, mm", sign=True)]
    mark_error_px: Annotated[float, Column("mark's error, px", 2)]


class ReadSummary(NamedTuple):
    """Readings of one sensor on one wall through one path."""

    sensor: Annotated[str, Column("sensor")]
    path: Annotated[str, Column("path")]
    wall: Annotated[str, Column("wall")]
    asked: Annotated[int, Column("places")]
    read: Annotated[int, Column("read")]
    median_mm: Annotated[float, Column("median |error|, mm")]
    largest_mm: Annotated[float, Column("largest, mm")]
    mark_px: Annotated[float, Column("median mark's error, px", 2)]
    why_not: Annotated[str, Column("not read because")]


@dataclass(frozen=True, kw_only=True)
class RivalFindings:
    """All results of a run.

    Attributes:
        scene: the study's; its seed and its camera are used.
        expected: with stated noise.
        wrong: with one wrong assumption.
        readings: of rendered images.
        photographs: of the first wall, by path and distance.
    """

    scene: Scene
    expected: list[Expected]
    wrong: list[Bias]
    readings: list[Reading]
    photographs: dict[tuple[str, float], Pictures]

    @property
    def paths(self) -> list[str]:
        """Names of the viewing paths."""
        return list(dict.fromkeys(row.path for row in self.expected))

    @property
    def walls(self) -> list[str]:
        """Kinds of the rendered walls."""
        return list(dict.fromkeys(row.wall for row in self.readings))

    def sigma(self, sensor: Sensor, path: str) -> list[float]:
        """Standard deviations of the places that the sensor can read, mm."""
        rows = (r for r in self.expected if (r.sensor, r.path) == (sensor, path))
        return [row.sigma_mm for row in rows if row.outcome == Outcome.READ]

    def bias(self, sensor: Sensor, path: str, wrong: Wrong) -> list[float]:
        """Errors under one wrong assumption at the places that the sensor can read, mm."""
        rows = (r for r in self.wrong if r[:3] == (sensor, path, wrong))
        return [row.error_mm for row in rows]

    def read(
        self, sensor: Sensor, *, path: str | None = None, wall: str | None = None
    ) -> list[Reading]:
        """The readings of a sensor, of all paths and walls or of one."""
        return [
            row
            for row in self.readings
            if row.sensor == sensor and path in (None, row.path) and wall in (None, row.wall)
        ]

    def summaries(self) -> list[ReadSummary]:
        """The readings by sensor, path and wall."""
        rows = []
        for key in dict.fromkeys(row[:3] for row in self.readings):
            every = [row for row in self.readings if row[:3] == key]
            done = [row for row in every if row.outcome == Outcome.READ]
            reasons = [row.outcome for row in every if row.outcome != Outcome.READ]
            errors = [abs(row.error_mm) for row in done]
            rows.append(
                ReadSummary(
                    *key,
                    len(every),
                    len(done),
                    median(errors),
                    max(errors, default=np.nan),
                    median(row.mark_error_px for row in done),
                    ", ".join(f"{why} {reasons.count(why)}" for why in dict.fromkeys(reasons)),
                )
            )
        return rows


def median(values: Iterable[float]) -> float:
    """The median; NaN of nothing."""
    every = list(values)
    return float(np.median(every)) if every else float("nan")
