"""The fitted parameters as a table on the terminal."""

from __future__ import annotations

import math

import numpy as np
from rich.table import Table

from calibration.command.fitted import Fitted
from calibration.solvers import correlations
from estimator.files import QUANTITIES


def result_table(fitted: Fitted, *, title: str) -> Table:
    """A row for each parameter: value, standard deviation, unit, correlations."""
    table = Table(title=title)
    sigma, together = np.sqrt(np.diag(fitted.covariance)), correlations(fitted.covariance)
    # A given parameter, which was not fitted, is correlated with nothing.
    found = np.flatnonzero(sigma > 0)
    names = list(fitted.values)
    for heading in ("parameter", "value", "± σ", "unit", *(f"ρ {names[i]}" for i in found)):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for i, (name, value) in enumerate(fitted.values.items()):
        cells = ["" if math.isnan(rho) else f"{rho:+.2f}" for rho in together[i, found]]
        table.add_row(name, f"{value:.6g}", _error(sigma[i]), QUANTITIES[name].unit, *cells)
    for name, value, error, unit in fitted.others:
        table.add_row(name, f"{value:.4g}", _error(error), unit)
    return table


def _error(sigma: float) -> str:
    if math.isinf(sigma):
        return "not determined"
    if sigma == 0:
        return "given"
    return "" if math.isnan(sigma) else f"{sigma:.2g}"
