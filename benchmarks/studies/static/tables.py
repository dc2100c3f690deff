"""Tables I and II of every run, and their spread beside the paper's figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.evaluation import TABLE_I, TABLE_II
from benchmarks.studies.static import causes as static_causes
from benchmarks.studies.validate import ALL_PLANES
from calibration import fit_eccentricity
from scenes import Scene

FEWEST_SPOTS = 3


class Entry(NamedTuple):
    """Row of static_tables.csv: one figure of one trial in one run."""

    way: str
    run: int
    trial: str
    quantity: str
    value: float


class Spread(NamedTuple):
    """Row of static_spread.csv: a figure over all runs, beside the paper's.

    `paper_mm` of c is what the paper fitted, which the trial's true c is set to.
    """

    way: str
    trial: str
    quantity: str
    runs: int
    mean: float
    standard_deviation: float
    paper: float


def entries(
    way: str,
    *,
    planes: tuple[np.ndarray, np.ndarray],
    spheres: tuple[np.ndarray, np.ndarray],
    scene: Scene,
) -> list[Entry]:
    """Tables I and II of every run.

    Args:
        way: of measuring.
        planes: e1' (px) and d_r (mm), each runs x trials x frames.
        spheres: likewise.
        scene: gives the scale and the eye's radius.
    """
    own, pooled = static_causes.lines(*planes)
    rows = []
    names = [name for name in TABLE_I if name != ALL_PLANES]
    for quantity in ("delta_k", "b", "r_squared", "rmse"):
        per_trial, of_all = getattr(own, quantity), getattr(pooled, quantity)
        for run in range(of_all.size):
            for trial, value in zip(names, per_trial[run], strict=True):
                rows.append(Entry(way, run, trial, quantity, float(value)))
            rows.append(Entry(way, run, ALL_PLANES, quantity, float(of_all[run])))
    for run, trial in np.ndindex(spheres[0].shape[:2]):
        axis, reading = spheres[0][run, trial], spheres[1][run, trial]
        seen = np.isfinite(axis)
        if np.count_nonzero(seen) < FEWEST_SPOTS:
            continue
        fit = fit_eccentricity(
            semi_minor_px=axis[seen],
            distance=reading[seen],
            delta_k=float(pooled.delta_k[run]),
            b=float(pooled.b[run]),
            scale=scene.microscope.scale_mm_px,
            eye_radius=scene.phantom.radius_mm,
        )
        name = list(TABLE_II)[trial]
        rows += [
            Entry(way, run, name, "c", fit.c),
            Entry(way, run, name, "standard_deviation", fit.standard_deviation),
            Entry(way, run, name, "mean_absolute_error", fit.mean_absolute_error),
            Entry(way, run, name, "max_error", fit.max_error),
        ]
    return rows


def spreads(rows: Sequence[Entry]) -> list[Spread]:
    """Mean and standard deviation of every figure over the runs."""
    groups: dict[tuple[str, str, str], list[float]] = {}
    for row in rows:
        groups.setdefault((row.way, row.trial, row.quantity), []).append(row.value)
    found = []
    for (way, trial, quantity), values in groups.items():
        known = np.array([value for value in values if np.isfinite(value)])
        if known.size < 2:
            continue
        printed = {**TABLE_I, **TABLE_II}[trial]
        found.append(
            Spread(
                way=way,
                trial=trial,
                quantity=quantity,
                runs=known.size,
                mean=float(known.mean()),
                standard_deviation=float(known.std(ddof=1)),
                paper=float(getattr(printed, quantity)),
            )
        )
    return found
