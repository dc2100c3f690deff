"""The results as data: lenses, their lines, and what changes a line."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, NamedTuple

import numpy as np

from benchmarks.evaluation import LITERAL, Criterion, PlaneRow, reproduction
from benchmarks.reporting import Claim, Column
from benchmarks.studies.table_one.isophotes import Family, Isophotes
from scenes import Scene


class Demand(StrEnum):
    """Which of the paper's unknown conditions are free for a lens."""

    AT_SCALE = "from contact, at the scene's scale"
    ANYWHERE = "at any distance and scale"


class LensChoice(NamedTuple):
    """Row of table_one_scan.csv: a lens, a threshold and a range, and the resulting line.

    `level` is the threshold over the peak at 5 mm. `scale_mm_px` is the scale of the comparison.
    `miss` is the worst deviation from Table I in units of its tolerance; up to 1, all criteria are
    met.
    """

    numerical_aperture: Annotated[float, Column("NA", 2)]
    sag_mm: Annotated[float, Column("sag, mm")]
    asked: Demand
    level: Annotated[float, Column("threshold / peak at 5 mm", 4)]
    from_mm: Annotated[float, Column("from d_r, mm", 1)]
    to_mm: Annotated[float, Column("to d_r, mm", 1)]
    scale_mm_px: float
    delta_k_mm_px: Annotated[float, Column("δk, mm/px", 4)]
    b_mm: Annotated[float, Column("b, mm", 4)]
    r_squared: Annotated[float, Column("R²", 4)]
    rmse_mm: Annotated[float, Column("RMSE, mm", 4)]
    miss: Annotated[float, Column("worst / tolerance", 4)]

    @property
    def family(self) -> Family:
        """The lens."""
        return Family(self.numerical_aperture, self.sag_mm)


class RenderedLine(NamedTuple):
    """Row of table_one_rendered.csv: a line through measured spots of one lens.

    `level` is the threshold over the peak at 5 mm on a wall of the mean colour.
    """

    numerical_aperture: Annotated[float, Column("NA", 2)]
    sag_mm: Annotated[float, Column("sag, mm")]
    level: float
    from_mm: float
    to_mm: float
    scale_mm_px: float
    way: Annotated[str, Column("way")]
    trial: Annotated[str, Column("trial")]
    delta_k_mm_px: Annotated[float, Column("δk, mm/px", 4)]
    b_mm: Annotated[float, Column("b, mm", 4)]
    r_squared: Annotated[float, Column("R²", 4)]
    rmse_mm: Annotated[float, Column("RMSE, mm", 4)]
    contact_radius_px: Annotated[float, Column("−b/δk, px", 1)]
    spots: Annotated[int, Column("spots")]

    @classmethod
    def of(
        cls, choice: LensChoice, way: str, trial: str, line: PlaneRow, *, spots: int
    ) -> RenderedLine:
        """The row of a line."""
        lens = (*choice.family, choice.level, choice.from_mm, choice.to_mm, choice.scale_mm_px)
        return cls(*lens, way, trial, *line, -line.b / line.delta_k, spots)


class LensMark(NamedTuple):
    """Row of table_one_marks.csv: what distinguishes a lens from another with the same line.

    `growth_px` is how much the thresholded spot grows by a tenth more light, at the range's middle;
    the half maximum's line over the same range is what sub-pixel mode measures.
    """

    numerical_aperture: Annotated[float, Column("NA", 2)]
    sag_mm: Annotated[float, Column("sag, mm")]
    level: float
    from_mm: float
    to_mm: float
    contact_radius_px: Annotated[float, Column("−b/δk, px")]
    growth_px: Annotated[float, Column("growth by 10 % light, px")]
    half_maximum_delta_k_mm_px: Annotated[float, Column("δk of half maximum, mm/px")]
    half_maximum_b_mm: Annotated[float, Column("b, mm")]
    half_maximum_r_squared: Annotated[float, Column("R²")]
    half_maximum_turns_at_mm: Annotated[float, Column("least at d_r, mm")]


class CauseLine(NamedTuple):
    """Row of table_one_causes.csv: change of a trial's line under one cause of a stated size."""

    cause: Annotated[str, Column("cause")]
    delta_k_mm_px: Annotated[float, Column("δk, mm/px", 4)]
    b_mm: Annotated[float, Column("b, mm")]
    contact_radius_px: Annotated[float, Column("−b/δk, px")]
    r_squared: Annotated[float, Column("R²")]
    rmse_mm: Annotated[float, Column("RMSE, mm")]
    delta_k_change_percent: Annotated[float, Column("change of δk, %", sign=True)]
    b_change_mm: Annotated[float, Column("of b, mm", sign=True)]
    contact_radius_change_px: Annotated[float, Column("of −b/δk, px", sign=True)]


class ConfirmedLens(NamedTuple):
    """A choice of the scan on rendered stacks.

    Attributes:
        choice: of the scan, with the threshold and the first reading at which the rendered spots
            come nearest to Table I.
        spots: e1' (px, NaN where none counts) and d_r (mm) by (way, trial).
        lines: by (way, trial), "all planes" among them.
    """

    choice: LensChoice
    spots: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]
    lines: dict[tuple[str, str], RenderedLine]

    @property
    def criteria(self) -> dict[Criterion, Claim]:
        """The criteria of Table I in literal mode."""
        fits = {
            trial: PlaneRow(line.delta_k_mm_px, line.b_mm, line.r_squared, line.rmse_mm)
            for (way, trial), line in self.lines.items()
            if way == LITERAL.name
        }
        return reproduction(fits, name="Table I by the best lens")

    @property
    def reproduces(self) -> bool:
        """Whether all criteria are met, scatter as large as the paper's included."""
        return all(claim.holds for claim in self.criteria.values())

    @property
    def straight(self) -> bool:
        """Whether they are met if the scatter may be smaller than the paper's."""
        rmse = self.criteria[Criterion.RMSE]
        others = (c for criterion, c in self.criteria.items() if criterion != Criterion.RMSE)
        return np.max(rmse.value) <= rmse.high and all(claim.holds for claim in others)


@dataclass(frozen=True, kw_only=True)
class TableOneFindings:
    """All results of a run.

    Attributes:
        scene: the study's.
        isophotes: of all lenses of the scan.
        choices: of each lens, by both demands.
        confirmed: lenses on rendered stacks: those that give the table, those that give its line,
            the others; of a kind the best of the scan first.
        marks: of the same lenses.
        causes: what makes trials of the best lens differ.
    """

    scene: Scene
    isophotes: dict[Family, Isophotes]
    choices: list[LensChoice]
    confirmed: list[ConfirmedLens]
    marks: list[LensMark]
    causes: list[CauseLine]

    def asked(self, demand: Demand) -> list[LensChoice]:
        """Choices by one demand."""
        return [choice for choice in self.choices if choice.asked == demand]

    @property
    def lines(self) -> list[RenderedLine]:
        """Lines of all rendered lenses."""
        return [line for one in self.confirmed for line in one.lines.values()]
