"""The fitted parameters as a table on the terminal."""

from __future__ import annotations

import math

import numpy as np
from rich.table import Table

from calibration.command.fitted import Fitted
from calibration.solvers import correlations
from estimator.files import QUANTITIES, in_terminal

_STRONG = 0.9
"""Correlations above this are named under the table; the report lists all."""


def result_table(fitted: Fitted, *, title: str) -> Table:
    """A row for each parameter: value, standard deviation, unit."""
    sigma = np.sqrt(np.diag(fitted.covariance))
    table = Table(title=in_terminal(title), caption=_strong_correlations(fitted))
    for heading in ("parameter", "value", "± σ", "unit"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for i, (name, value) in enumerate(fitted.values.items()):
        table.add_row(in_terminal(name), f"{value:.6g}", _error(sigma[i]), QUANTITIES[name].unit)
    for name, value, error, unit in fitted.others:
        table.add_row(in_terminal(name), f"{value:.4g}", _error(error), unit)
    return table


def _strong_correlations(fitted: Fitted) -> str | None:
    names, rho = list(fitted.values), correlations(fitted.covariance)
    pairs = [
        f"{names[i]} and {names[j]} {rho[i, j]:+.2f}"
        for i, j in zip(*np.triu_indices(len(names), 1), strict=True)
        if abs(rho[i, j]) > _STRONG  # false for NaN, where a parameter was not fitted
    ]
    return f"Strong correlations: {', '.join(pairs)}." if pairs else None


def _error(sigma: float) -> str:
    if math.isinf(sigma):
        return "not determined"
    if sigma == 0:
        return "given"
    return "" if math.isnan(sigma) else f"{sigma:.2g}"
