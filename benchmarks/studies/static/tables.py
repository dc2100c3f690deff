"""Tables I and II of every run, and their spread beside the paper's figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.evaluation import ALL_PLANES, PAPERS_PLANES, TABLE_I, TABLE_II
from benchmarks.studies.static.causes import lines
from benchmarks.studies.static.findings import Entry, Measured, RunSpread
from calibration import fit_eccentricity
from scenes import Scene

FEWEST_SPOTS = 3


def entries(way: str, *, planes: Measured, spheres: Measured, scene: Scene) -> list[Entry]:
    """Tables I and II of every run.

    Args:
        way: of measuring.
        planes: spots on the planes.
        spheres: spots in the spheres.
        scene: gives the scale and the eye's radius.
    """
    own, pooled = lines(planes.semi_minor, planes.readings)
    rows = []
    for quantity in TABLE_I[ALL_PLANES]._fields:
        per_trial, of_all = getattr(own, quantity), getattr(pooled, quantity)
        for run in range(of_all.size):
            for trial, value in zip(PAPERS_PLANES, per_trial[run], strict=True):
                rows.append(Entry(way, run, trial, quantity, float(value)))
            rows.append(Entry(way, run, ALL_PLANES, quantity, float(of_all[run])))
    for run, trial in np.ndindex(spheres.semi_minor.shape[:2]):
        axis, reading = spheres.semi_minor[run, trial], spheres.readings[run, trial]
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
            Entry(way, run, name, quantity, getattr(fit, quantity))
            for quantity in TABLE_II[name]._fields
        ]
    return rows


def spreads(rows: Sequence[Entry]) -> list[RunSpread]:
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
            RunSpread(
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
