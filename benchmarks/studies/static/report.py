"""The report of the static study."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from benchmarks.evaluation import ALL_PLANES, LITERAL, PAPERS_PLANES, SUBPIXEL, TABLE_I, TABLE_II
from benchmarks.reporting import Claim, Column, Data, Picture, Report, Section, Table, number
from benchmarks.studies.static import figures
from benchmarks.studies.static.findings import (
    ALL,
    CAUSES,
    FROM_MM,
    NONE,
    TOGETHER,
    CausePart,
    Entry,
    RunSpread,
    Scope,
    StaticFindings,
    StaticSpot,
)

_WAYS = (LITERAL.name, SUBPIXEL.name)
_COLUMNS = {
    "delta_k": Column("δk, mm/px", 4),
    "b": Column("b, mm", 2),
    "r_squared": Column("R²", 4),
    "rmse": Column("RMSE, mm"),
    "c": Column("c, mm", 2),
    "standard_deviation": Column("standard deviation, mm"),
    "mean_absolute_error": Column("mean |error|, mm"),
    "max_error": Column("largest |error|, mm"),
}
"""The quantities of Tables I and II."""


def report(findings: StaticFindings) -> Report:
    """The report of a run."""
    return Report(
        title="How much do the paper's Tables I and II scatter, and what causes their error?",
        lead=f"The paper's static experiment was rendered, photographed and fitted {findings.runs} "
        "times. Each run has its own noise, wall, touch, tilt, exposure and threshold. "
        f"The fits use readings from {FROM_MM:g} mm on, because nearer to contact the fibre hides "
        "a large part of the spot.",
        claims=list(_claims(findings)),
        sections=[
            Section(
                "Tables I and II over many runs",
                Picture(
                    "static_trials",
                    figures.trials(findings),
                    "Spots of all runs with all causes, on the planes (top) and in the eyeball "
                    "(bottom); lines: those of the paper's Table I.",
                    data="static_spots.csv",
                ),
                _table(
                    findings,
                    TABLE_I,
                    "Table I with all causes, mean ± standard deviation over runs.",
                ),
                _table(
                    findings,
                    TABLE_II,
                    "Table II with all causes: the small-plane model with each run's own δk and b.",
                ),
            ),
            Section(
                "Causes of the RMSE",
                Picture(
                    "static_causes",
                    figures.causes(findings.parts),
                    "Mean square error that each cause adds alone, and all together beyond their "
                    "sum, with standard errors over paired runs; dotted: the paper's mean square "
                    "error.",
                    data="static_causes.csv",
                ),
                Table.of(
                    CausePart,
                    findings.parts,
                    "Parts of the mean square error in literal mode. The first row is the error "
                    "without any cause, because a lens's light does not give an exact line. This "
                    "error, the parts and “together” sum to “all”. The sizes of the causes are "
                    "assumptions. A small cause adds an error in proportion to the square of its "
                    "size. Several runs share a wall; the standard error of texture accounts for "
                    "this.",
                    data="static_causes.csv",
                ),
            ),
        ],
        data=[
            Data("static_tables.csv", Entry, findings.entries),
            Data("static_spread.csv", RunSpread, findings.spreads),
            Data("static_causes.csv", CausePart, findings.parts),
            Data("static_spots.csv", StaticSpot, findings.first_run),
        ],
    )


def _claims(findings: StaticFindings) -> Iterator[Claim]:
    for way in _WAYS:
        for quantity in TABLE_I[ALL_PLANES]._fields:
            spread = findings.spread(way, ALL_PLANES, quantity)
            if spread is not None:
                yield _spread_claim(f"Table I, {way}", spread)
    for way in _WAYS:
        for trial in TABLE_II:
            spread = findings.spread(way, trial, "c")
            if spread is not None:
                yield _spread_claim(f"Table II, {way}, {trial}", spread)
    yield _causes(findings)
    printed = [row.rmse for row in PAPERS_PLANES.values()]
    yield Claim(
        name="the paper's RMSE",
        sentence="With all causes a trial's RMSE is {value:.3f} mm (the paper's trials: {low:.3f} "
        "to {high:.3f} mm). For all planes together it is {pooled:.3f} mm (the paper's: "
        "{paper:.3f} mm).",
        value=findings.part(Scope.OWN, ALL).rmse_mm,
        low=min(printed),
        high=max(printed),
        numbers={
            "pooled": findings.part(Scope.POOLED, ALL).rmse_mm,
            "paper": TABLE_I[ALL_PLANES].rmse,
        },
    )


def _spread_claim(where: str, spread: RunSpread) -> Claim:
    column = _COLUMNS[spread.quantity]
    digits = f".{column.digits}f"
    return Claim(
        name=f"{where}, {column.heading}",
        sentence=f"{{value:{digits}}} ± {{spread.standard_deviation:{digits}}}, mean ± standard "
        f"deviation over {{spread.runs}} runs; the paper prints {{spread.paper:{digits}}}.",
        value=spread.mean,
        numbers={"spread": spread},
    )


def _causes(findings: StaticFindings) -> Claim:
    parts = {c: findings.part(Scope.POOLED, c) for c in (NONE, *CAUSES, TOGETHER, ALL)}
    ordered = sorted((parts[cause] for cause in CAUSES), key=lambda part: -part.part_mm2)
    return Claim(
        name="causes",
        sentence="The cause {causes[0]} adds most to the mean square error of all planes. "
        "In 10⁻³ mm², {causes} add {parts:+.2f} (standard errors over runs: {errors:.2f}). "
        "Together they add {together:+.2f} ± {together_error:.2f} beyond their sum. Without causes "
        "the error is {none:.2f} (RMSE {none_rmse:.3f} mm), with all causes {value:.2f} (RMSE "
        "{all_rmse:.3f} mm).",
        value=1e3 * parts[ALL].part_mm2,
        numbers={
            "causes": tuple(part.cause for part in ordered),
            "parts": tuple(1e3 * part.part_mm2 for part in ordered),
            "errors": tuple(1e3 * part.standard_error_mm2 for part in ordered),
            "together": 1e3 * parts[TOGETHER].part_mm2,
            "together_error": 1e3 * parts[TOGETHER].standard_error_mm2,
            "none": 1e3 * parts[NONE].part_mm2,
            "none_rmse": parts[NONE].rmse_mm,
            "all_rmse": parts[ALL].rmse_mm,
        },
    )


def _table(findings: StaticFindings, printed: Mapping[str, Any], caption: str) -> Table:
    quantities = next(iter(printed.values()))._fields
    columns = [Column("way"), Column("trial"), *(_COLUMNS[name] for name in quantities)]
    rows = [
        (way, trial, *(_mean_and_deviation(findings.spread(way, trial, q)) for q in quantities))
        for way in _WAYS
        for trial in printed
    ]
    paper = [("paper", trial, *_rounded(quantities, row)) for trial, row in printed.items()]
    return Table(columns, [*rows, *paper], caption, "static_spread.csv")


def _mean_and_deviation(spread: RunSpread | None) -> str:
    if spread is None:
        return "–"
    return " ± ".join(_rounded([spread.quantity] * 2, (spread.mean, spread.standard_deviation)))


def _rounded(quantities: Iterable[str], values: Iterable[float]) -> list[str]:
    return [
        number(value, _COLUMNS[name].digits) for name, value in zip(quantities, values, strict=True)
    ]
