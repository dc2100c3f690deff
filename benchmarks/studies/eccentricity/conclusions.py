"""What the study of eccentricity found, in sentences whose numbers are this run's."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

import optics
from benchmarks.reporting import MICROSCOPE_MM
from benchmarks.studies.eccentricity.limits import LIMITS_MM
from benchmarks.studies.eccentricity.run import Findings, pinhole_heights
from benchmarks.studies.eccentricity.space import PINHOLES, Spread
from benchmarks.studies.validate import Conclusion, number, pinhole

SHOWN_C_MM = 4.0
"""Where sentences and tables say how the error splits."""


def conclusions(findings: Findings, spreads: Sequence[Spread]) -> Iterable[Conclusion]:
    """All statements of a run."""
    for height in pinhole_heights(findings.scene):
        yield _leaves(findings, height)
    for height in pinhole_heights(findings.scene):
        yield _hidden(findings, height)
    if findings.rendered.parts:
        for height in pinhole_heights(findings.scene):
            yield _main_cause(findings, height)
    yield from _measured(findings)
    yield _within(findings)
    yield _azimuth(spreads)


def _leaves(findings: Findings, height: float) -> Conclusion:
    """Where the models leave the limits with one pinhole."""
    incidence = findings.scene.spot.incidence_deg
    where = pinhole(height, findings.scene.phantom.radius_mm)
    told = {
        model: _leaves_at(
            [limit_of(findings, model, False, height, incidence, x) for x in LIMITS_MM]
        )
        for model in optics.MODELS
    }
    return Conclusion(
        f"limits, z_F = {height:g} mm",
        f"With {where}, small_plane {told['small_plane']}.",
        f"At {incidence:g}° incidence, azimuth {findings.scene.spot.incidence_azimuth_deg:g}°, by "
        "the largest error over d = 0.5 to 6 mm: "
        + "; ".join(f"{model} {text}" for model, text in told.items())
        + ".",
    )


def _hidden(findings: Findings, height: float) -> Conclusion:
    """How much of the error a fitted c hides."""
    incidence = findings.scene.spot.incidence_deg
    rows = [r for r in findings.refits if (r.z_f_mm, r.incidence_deg) == (height, incidence)]
    row = min(rows, key=lambda r: abs(r.c_mm - SHOWN_C_MM))
    share = 100 * row.hidden_mm / row.largest_error_mm
    where = pinhole(height, findings.scene.phantom.radius_mm)
    bound = ", the end of its range," if row.at_bound else ""
    limits = [limit_of(findings, "small_plane", True, height, incidence, x) for x in LIMITS_MM]
    return Conclusion(
        f"refit, z_F = {height:g} mm",
        f"With {where}, fitting c hides {number(share, 0)} % of the error of small_plane at "
        f"c = {row.c_mm:g} mm.",
        f"The fit finds c = {number(row.fitted_c_mm, 2)} mm{bound} and leaves residuals of "
        f"{number(row.largest_residual_mm, 3)} mm at most, where the error with the true c is "
        f"{number(row.largest_error_mm, 3)} mm. By its residuals the model {_leaves_at(limits)}.",
    )


def _main_cause(findings: Findings, height: float) -> Conclusion:
    """The largest parts of the paper's model's error."""
    here = [p for p in findings.rendered.parts if (p.z_f_mm, p.model) == (height, "small_plane")]
    nearest = min(here, key=lambda p: (abs(p.c_mm - SHOWN_C_MM), abs(p.d_mm - SHOWN_C_MM)))
    spot = [p for p in here if (p.c_mm, p.d_mm) == (nearest.c_mm, nearest.d_mm)]
    ordered = sorted(spot, key=lambda p: -abs(p.part_mm))
    parts = ", ".join(f"{p.cause} {number(p.part_mm, 3, sign=True)}" for p in ordered)
    where = pinhole(height, findings.scene.phantom.radius_mm)
    return Conclusion(
        f"causes, z_F = {height:g} mm",
        f"With {where}, {ordered[0].cause} is the largest cause of the error of small_plane.",
        f"At c = {number(nearest.c_mm, 1)} mm and d = {number(nearest.d_mm, 1)} mm its error of "
        f"{number(nearest.whole_mm, 3, sign=True)} mm is the sum of (mm): {parts}.",
    )


def _measured(findings: Findings) -> Iterable[Conclusion]:
    errors = [e for e in findings.rendered.errors if not e.refit]
    if not errors:
        return
    worst = {
        model: max(abs(e.error_mm) for e in errors if e.model == model) for model in optics.MODELS
    }
    best = min(worst, key=lambda model: worst[model])
    found = findings.rendered
    yield Conclusion(
        "rendered",
        f"On rendered spots {best} is the best model, within {number(worst[best], 3)} mm.",
        f"Largest errors over {found.frames - found.left_out} spots ({found.left_out} frames "
        "without one that counts), k, b, c and r given: "
        + ", ".join(f"{model} {number(error, 3)} mm" for model, error in worst.items())
        + ".",
    )


def _within(findings: Findings) -> Conclusion:
    space = findings.space
    limit = LIMITS_MM[-1]
    shares = {
        model: 100
        * np.mean(np.abs(np.concatenate([space.errors(model, p) for p in PINHOLES])) <= limit)
        for model in optics.MODELS
    }
    return Conclusion(
        "space",
        f"small_plane is within {limit:g} mm in {number(shares['small_plane'], 0)} % of "
        f"{space.count:,} geometries.",
        "Over the ranges of c, d, r, incidence, azimuth and half-angle below, a quarter of them "
        "with each pinhole: "
        + ", ".join(f"{model} {number(share, 0)} %" for model, share in shares.items())
        + ".",
    )


def _azimuth(spreads: Sequence[Spread]) -> Conclusion:
    """What the direction of the beam's tilt does to `corrected` under a microscope."""
    bins = [
        s
        for s in spreads
        if (s.model, s.pinhole, s.axis) == ("corrected", f"{MICROSCOPE_MM:g}", "azimuth_deg")
    ]
    best, worst = (choose(bins, key=lambda s: s.percentile_95_mm) for choose in (min, max))

    def around(s: Spread) -> str:
        size = number(s.percentile_95_mm, 3)
        return f"{size} mm at azimuths of {s.from_value:g} to {s.to_value:g}°"

    return Conclusion(
        "azimuth",
        f"With z_F = {MICROSCOPE_MM:g} mm, corrected depends on where the beam is tilted to: 95 % "
        f"of its errors are below {around(best)}, and below {around(worst)}.",
        "It holds for a square beam; a tilt along the meridian of O (azimuth 0 or 180°) makes the "
        "spot longer where the image makes it shorter. exact knows the beam's direction.",
    )


def limit_of(
    findings: Findings, model: str, refit: bool, height: float, incidence: float, limit: float
) -> float:
    """c at which a model leaves a limit, mm; NaN where it does not."""
    key = (model, refit, height, incidence, limit)
    return next(
        row.c_mm
        for row in findings.limits
        if (row.model, row.refit, row.z_f_mm, row.incidence_deg, row.limit_mm) == key
    )


def _leaves_at(eccentricities: list[float]) -> str:
    """In words, where `LIMITS_MM` are left; NaN where one is not."""
    parts = [
        f"{limit:g} mm at c = {number(c, 2)} mm"
        for limit, c in zip(LIMITS_MM, eccentricities, strict=True)
        if not math.isnan(c)
    ]
    kept = [x for x, c in zip(LIMITS_MM, eccentricities, strict=True) if math.isnan(c)]
    stays = [f"stays within {kept[0]:g} mm"] if kept else []
    return " and ".join(([f"leaves {' and '.join(parts)}"] if parts else []) + stays)
