"""The report of the static study: sentences, tables and pictures, all from this run's numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import matplotlib

from benchmarks.evaluation import LITERAL, SUBPIXEL, TABLE_I, TABLE_II
from benchmarks.reporting import Data, Picture, Report, Row, Section, Table
from benchmarks.studies.static import figures as pictures
from benchmarks.studies.static.bench import FROM_MM
from benchmarks.studies.static.causes import ALL, CAUSES, NONE, Part
from benchmarks.studies.static.run import Findings
from benchmarks.studies.static.tables import Entry, Spread
from benchmarks.studies.validate import ALL_PLANES, Conclusion, figures, number

_POOLED, _OWN = "all trials", "each trial"
_DIGITS = {"delta_k": 4, "b": 2, "r_squared": 4, "c": 2}


class Spot(NamedTuple):
    """Row of static_spots.csv: a frame of the first run, with all causes but a plane's tilt."""

    trial: str
    way: str
    d_r_mm: float
    semi_minor_px: float


def report(findings: Findings) -> Report:
    """The report of a run."""
    with matplotlib.rc_context(figures.STYLE):
        return Report(
            title="How far do the paper's Tables I and II spread, and what adds to their error?",
            lead=f"The paper's static experiment rendered, photographed and fitted {findings.runs} "
            "times: each run with its own noise, wall, touch, tilt, exposure and threshold. "
            f"Readings from {FROM_MM:g} mm on count; nearer to contact the fibre hides a good part "
            "of the spot.",
            found=list(_found(findings)),
            sections=[_tables(findings), _causes(findings)],
            data=[
                Data("static_tables.csv", Entry, findings.entries),
                Data("static_spread.csv", Spread, findings.spreads),
                Data("static_causes.csv", Part, findings.parts),
                Data("static_spots.csv", Spot, _spots(findings)),
            ],
        )


def _found(findings: Findings) -> Iterator[Conclusion]:
    for way in (LITERAL.name, SUBPIXEL.name):
        of = {s.quantity: s for s in findings.spreads if (s.way, s.trial) == (way, ALL_PLANES)}
        if not of:
            continue
        yield Conclusion(
            f"table I, {way}",
            f"Table I, {way}: δk {_pm(of['delta_k'])} mm/px and b {_pm(of['b'])} mm.",
            f"All planes over {of['delta_k'].runs} runs, mean ± standard deviation: R² "
            f"{_pm(of['r_squared'])}, RMSE {_pm(of['rmse'])} mm. Printed are "
            f"{number(of['delta_k'].paper, 4)} mm/px, {number(of['b'].paper, 3)} mm, "
            f"{number(of['r_squared'].paper, 4)} and {number(of['rmse'].paper, 3)} mm.",
        )
    for way in (LITERAL.name, SUBPIXEL.name):
        c = [s for s in findings.spreads if (s.way, s.quantity) == (way, "c")]
        if c:
            yield Conclusion(
                f"table II, {way}",
                f"Table II, {way}: c comes out as " + ", ".join(_pm(s) for s in c) + " mm.",
                "Its true values are those that the paper prints: "
                + ", ".join(number(s.paper, 2) for s in c)
                + " mm.",
            )
    yield _largest(findings)
    yield _enough(findings)


def _largest(findings: Findings) -> Conclusion:
    pooled = [p for p in findings.parts if p.scope == _POOLED]
    causes = sorted((p for p in pooled if p.cause in CAUSES), key=lambda p: -p.part_mm2)
    first = causes[0]
    share = ", ".join(
        f"{p.cause} {number(1e3 * p.part_mm2, 2, sign=True)} ± "
        f"{number(1e3 * p.standard_error_mm2, 2)}"
        for p in causes
    )
    none, together, whole = (_part(pooled, name) for name in (NONE, "together", ALL))
    return Conclusion(
        "causes",
        f"Of the causes, {first.cause} ({first.size}) adds most to the RMSE of all planes.",
        f"Mean square error in 10⁻³ mm², ± standard error over runs: without causes "
        f"{number(1e3 * none.part_mm2, 2)} (RMSE {number(none.rmse_mm, 3)} mm); {share}; together "
        f"beyond their sum {number(1e3 * together.part_mm2, 2, sign=True)} ± "
        f"{number(1e3 * together.standard_error_mm2, 2)}; with all "
        f"{number(1e3 * whole.part_mm2, 2)} (RMSE {number(whole.rmse_mm, 3)} mm).",
    )


def _enough(findings: Findings) -> Conclusion:
    """Whether causes of these sizes make the paper's errors."""
    own = _part([p for p in findings.parts if p.scope == _OWN], ALL)
    pooled = _part([p for p in findings.parts if p.scope == _POOLED], ALL)
    printed = [row.rmse for name, row in TABLE_I.items() if name != ALL_PLANES]
    low, high, whole = min(printed), max(printed), TABLE_I[ALL_PLANES].rmse
    place = "within" if low <= own.rmse_mm <= high else "outside"
    return Conclusion(
        "the paper's RMSE",
        f"With all causes a trial's RMSE is {number(own.rmse_mm, 3)} mm, {place} the paper's "
        f"{number(low, 3)} to {number(high, 3)} mm.",
        f"All planes together: {number(pooled.rmse_mm, 3)} mm, the paper's {number(whole, 3)} mm.",
        holds=bool(low <= own.rmse_mm <= high),
    )


def _tables(findings: Findings) -> Section:
    def rows(trials: Iterable[str], quantities: Iterable[str]) -> list[Row]:
        of = {(s.way, s.trial, s.quantity): s for s in findings.spreads}
        ours: list[Row] = [
            (
                way,
                trial,
                *(_pm(of[way, trial, q]) if (way, trial, q) in of else "–" for q in quantities),
            )
            for way in (LITERAL.name, SUBPIXEL.name)
            for trial in trials
        ]
        printed = {**TABLE_I, **TABLE_II}
        return ours + [
            (
                "paper",
                trial,
                *(number(getattr(printed[trial], q), _DIGITS.get(q, 3)) for q in quantities),
            )
            for trial in trials
        ]

    first = ("delta_k", "b", "r_squared", "rmse")
    second = ("c", "standard_deviation", "mean_absolute_error", "max_error")
    return Section(
        "Tables I and II over many runs",
        Picture(
            "static_trials",
            pictures.trials(findings),
            "Spots of all runs with all causes, on the planes (top) and in the eyeball (bottom); "
            "lines: those of the paper's Table I.",
            data="static_spots.csv",
        ),
        Table(
            ("way", "trial", "δk, mm/px", "b, mm", "R²", "RMSE, mm"),
            rows(TABLE_I, first),
            "Table I with all causes, mean ± standard deviation over runs.",
            data="static_spread.csv",
        ),
        Table(
            (
                "way",
                "trial",
                "c, mm",
                "standard deviation, mm",
                "mean |error|, mm",
                "largest |error|, mm",
            ),
            rows(TABLE_II, second),
            "Table II likewise: the small-plane model with each run's own δk and b.",
            data="static_spread.csv",
        ),
    )


def _causes(findings: Findings) -> Section:
    rows: list[Row] = [
        (
            p.scope,
            p.cause,
            p.size,
            1e3 * p.part_mm2,
            1e3 * p.standard_error_mm2,
            p.rmse_mm,
        )
        for p in findings.parts
    ]
    return Section(
        "What adds to the RMSE",
        Picture(
            "static_causes",
            pictures.causes(findings.parts),
            "Mean square error that each cause adds alone, and all together beyond their sum, "
            "with standard errors over paired runs; dotted: the paper's mean square error.",
            data="static_causes.csv",
        ),
        Table(
            ("line of", "cause", "size", "part, 10⁻³ mm²", "standard error", "RMSE, mm"),
            rows,
            "Parts of the mean square error in literal mode. The first row is the error without "
            "any cause: a lens's light makes no exact line. The parts and together lead from it to "
            "all. Sizes are assumptions: small ones add in proportion to their square. Runs share "
            "walls in turn, which the standard error of texture allows for.",
            data="static_causes.csv",
        ),
    )


def _spots(findings: Findings) -> Iterator[Spot]:
    planes = {LITERAL.name: findings.planes[ALL], SUBPIXEL.name: findings.subpixel}
    names = [name for name in TABLE_I if name != ALL_PLANES]
    for trials, by_way in ((names, planes), (list(TABLE_II), findings.spheres)):
        for way, measured in by_way.items():
            for trial, axis, reading in zip(
                trials, measured.semi_minor[0], measured.readings[0], strict=True
            ):
                for e, d in zip(axis, reading, strict=True):
                    yield Spot(trial, way, float(d), float(e))


def _part(parts: Iterable[Part], cause: str) -> Part:
    return next(part for part in parts if part.cause == cause)


def _pm(spread: Spread) -> str:
    digits = _DIGITS.get(spread.quantity, 3)
    return f"{number(spread.mean, digits)} ± {number(spread.standard_deviation, digits)}"
