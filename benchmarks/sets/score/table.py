"""Tables of a score on the terminal."""

from __future__ import annotations

import math

from rich.table import Table

from benchmarks.sets.score.groups import Group, Score
from benchmarks.sets.score.measures import Errors
from estimator.files import in_terminal

MAIN = "semi_minor_px"
"""The quantity that determines distances, by which groups are compared."""

_MOST_COLUMNS = 4  # estimators with two columns each


def tables(result: Score) -> list[Table]:
    """Outcomes and errors of all images, calibration of σ, and the main quantity by condition.

    The last table is left out if a terminal is too narrow for all estimators; the page has it.
    """
    found = [_outcomes(result), _errors(result), _sigmas(result)]
    return [*found, _conditions(result)] if len(result.judged) <= _MOST_COLUMNS else found


def _outcomes(result: Score) -> Table:
    visible = ("spot visible", "found", "missed", "false spots")
    hidden = ("hidden", "found although hidden", "left out")
    table = _table("Images", "estimator", "images", *visible, *hidden)
    for name, left_out in result.left_out.items():
        counts = result.total(name).counts
        table.add_row(in_terminal(name), *map(str, (*counts, left_out)))
    return table


def _errors(result: Score) -> Table:
    title = f"Errors of the found spots ({result.against}), with 95 % intervals in brackets"
    columns = ("estimator", "quantity", "n", "bias", "RMSE", "median |e|", "largest")
    table = _table(title, *columns, left=2)
    for name in result.judged:
        for errors in result.total(name).errors:
            table.add_row(
                in_terminal(name),
                errors.quantity,
                str(errors.n),
                _number(errors.bias, signed=True),
                _rmse(errors),
                _number(errors.median_abs),
                _number(errors.max_abs),
            )
    return table


def _sigmas(result: Score) -> Table:
    title = "Errors divided by the estimator's σ; ideal: 0 ± 1, 0.68, 0.95"
    table = _table(title, "estimator", "quantity", "n", "e/σ", "within σ", "within 2σ", left=2)
    for name in result.judged:
        for errors in result.total(name).errors:
            if errors.n_sigma > 1:
                table.add_row(
                    in_terminal(name),
                    errors.quantity,
                    str(errors.n_sigma),
                    _spread(errors),
                    _part(errors.within_1_sigma, errors.within_1_low, errors.within_1_high),
                    _part(errors.within_2_sigma, errors.within_2_low, errors.within_2_high),
                )
    return table


def _conditions(result: Score) -> Table:
    table = _table(f"RMSE of {MAIN}, and missed images", "condition", "group", left=2)
    for name in result.judged:
        table.add_column(in_terminal(name), justify="right")
        table.add_column("missed", justify="right")
    last = ""
    for (condition, group), row in result.by_condition().items():
        if condition != last:
            table.add_section()
        cells = [cell for name in result.judged for cell in _group_cells(row.get(name))]
        table.add_row("" if condition == last else condition, in_terminal(group), *cells)
        last = condition
    return table


def _group_cells(group: Group | None) -> tuple[str, str]:
    if group is None:
        return "", ""
    errors = group.of(MAIN)
    counts = group.counts
    missed = f"{counts.missed} of {counts.visible}" if counts.visible else ""
    return _rmse(errors) if errors else "", missed


def _table(title: str, *columns: str, left: int = 1) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold")
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index < left else "right")
    return table


def _number(value: float, *, signed: bool = False) -> str:
    return "" if math.isnan(value) else f"{value:{'+' if signed else ''}.3f}"


def _rmse(errors: Errors) -> str:
    if math.isnan(errors.rmse_low):
        return _number(errors.rmse)
    return f"{errors.rmse:.3f} [{errors.rmse_low:.3f}, {errors.rmse_high:.3f}]"


def _spread(errors: Errors) -> str:
    return f"{errors.z_mean:+.2f} ± {errors.z_std:.2f}"


def _part(part: float, low: float, high: float) -> str:
    return f"{part:.2f} [{low:.2f}, {high:.2f}]"
