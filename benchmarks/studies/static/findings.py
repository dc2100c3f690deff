"""The results as data: Tables I and II of many runs, and the parts of their error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, NamedTuple

import numpy as np

from benchmarks.evaluation import LITERAL, PAPERS_PLANES, SUBPIXEL, TABLE_II
from benchmarks.reporting import Column
from scenes import Scene

FROM_MM = 0.5
"""Least reading that the fits use; nearer, the fibre hides a large part of the spot."""

TOUCH_MM = 0.1
TILT_DEG = 5.0
LIGHT = 0.1
THRESHOLD_DN = 10

CAUSES = {
    "noise": "the camera's",
    "texture": "printed retina in place of an even wall",
    "touch": f"{TOUCH_MM:g} mm, normal, a trial",
    "tilt": f"plane {TILT_DEG:g}° either way, a trial",
    "exposure": f"{100 * LIGHT:g} %, normal, a trial",
    "threshold": f"{THRESHOLD_DN:g} grey levels, normal, a run",
}
"""The causes and their sizes, which are assumptions: the paper does not report them."""

NONE, TOGETHER, ALL = "none", "together", "all"
"""No cause; what all causes together add beyond their sum; all causes."""


class Scope(StrEnum):
    """Whose mean square error is split."""

    OWN = "each trial"
    POOLED = "all trials"


class CausePart(NamedTuple):
    """Row of static_causes.csv: the mean square error that a cause alone adds.

    `scope`: error of the line through all trials, or the mean over each trial's own line. The error
    without causes plus all parts and "together" is the error with all causes.
    """

    scope: Annotated[Scope, Column("line of")]
    cause: Annotated[str, Column("cause")]
    size: Annotated[str, Column("size")]
    part_mm2: Annotated[float, Column("part, 10⁻³ mm²", scale=1e3)]
    standard_error_mm2: Annotated[float, Column("standard error", scale=1e3)]
    rmse_mm: Annotated[float, Column("RMSE, mm")]


class StaticSpot(NamedTuple):
    """Row of static_spots.csv: a frame of the first run, with all causes (eyeballs: no tilt)."""

    trial: str
    way: str
    d_r_mm: float
    semi_minor_px: float


class Entry(NamedTuple):
    """Row of static_tables.csv: one quantity of one trial in one run."""

    way: str
    run: int
    trial: str
    quantity: str
    value: float


class RunSpread(NamedTuple):
    """Row of static_spread.csv: a quantity over all runs, and the paper's value.

    For c, `paper` is the value that the paper fitted; it is the true c of the trial here.
    """

    way: str
    trial: str
    quantity: str
    runs: int
    mean: float
    standard_deviation: float
    paper: float


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Spots of one way of measuring under one set of causes.

    Attributes:
        semi_minor: runs x trials x frames, px; NaN where no spot counts.
        readings: the same, mm.
    """

    semi_minor: np.ndarray
    readings: np.ndarray


@dataclass(frozen=True, kw_only=True)
class StaticFindings:
    """All results of a run.

    Attributes:
        scene: the study's.
        runs: number of paired runs.
        planes: literal mode on planes by variant: NONE, each cause, ALL.
        subpixel: sub-pixel mode on planes under all causes.
        spheres: by way of measuring, under all causes but tilt.
        entries: Tables I and II of every run.
        spreads: over runs.
        parts: of the error, by cause.
    """

    scene: Scene
    runs: int
    planes: dict[str, Measured]
    subpixel: Measured
    spheres: dict[str, Measured]
    entries: list[Entry]
    spreads: list[RunSpread]
    parts: list[CausePart]

    def spread(self, way: str, trial: str, quantity: str) -> RunSpread | None:
        """A quantity over all runs; None if too few runs have it."""
        key = (way, trial, quantity)
        return next((row for row in self.spreads if row[:3] == key), None)

    def part(self, scope: Scope, cause: str) -> CausePart:
        """The part of one cause."""
        return next(row for row in self.parts if (row.scope, row.cause) == (scope, cause))

    @property
    def with_all(self) -> dict[tuple[str, str], tuple[list[str], Measured]]:
        """Trials and their spots under all causes, by wall ("plane", "sphere") and way."""
        planes = {LITERAL.name: self.planes[ALL], SUBPIXEL.name: self.subpixel}
        return {
            (wall, way): (list(trials), measured)
            for wall, trials, by_way in (
                ("plane", PAPERS_PLANES, planes),
                ("sphere", TABLE_II, self.spheres),
            )
            for way, measured in by_way.items()
        }

    @property
    def first_run(self) -> Iterator[StaticSpot]:
        """Every frame of the first run."""
        for (_, way), (trials, measured) in self.with_all.items():
            first = zip(trials, measured.semi_minor[0], measured.readings[0], strict=True)
            for trial, axis, reading in first:
                for e, d in zip(axis, reading, strict=True):
                    yield StaticSpot(trial, way, float(d), float(e))
