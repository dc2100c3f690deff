"""The report of the study of eccentricity: sentences and tables, all from this run's numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import matplotlib
import numpy as np

import optics
from benchmarks import figures
from benchmarks.conclusions import Conclusion, number, pinhole
from benchmarks.studies import causes
from benchmarks.studies import eccentricity_figures as pictures
from benchmarks.studies.causes import CAUSES, Part
from benchmarks.studies.eccentricity import LARGEST_C_MM, Findings, pinhole_heights
from benchmarks.studies.eccentricity_limits import LIMITS_MM, Limit, Refit
from benchmarks.studies.eccentricity_space import AXES, PINHOLES, Sensitivity, Spread
from benchmarks.studies.study import MICROSCOPE_MM, Data, Picture, Report, Row, Section, Table

_SHOWN_C_MM = 4.0
"""Where sentences say how the error splits."""


def report(findings: Findings) -> Report:
    """The report of a run."""
    spreads = findings.space.spreads()
    with matplotlib.rc_context(figures.STYLE):
        return Report(
            title="How wrong is the distance, at which eccentricity, and why?",
            lead="Five models from spot size to distance against the exact geometry: on exact "
            "contours, and on spots measured in rendered frames.",
            found=list(_found(findings, spreads)),
            sections=[
                _errors(findings),
                _limits(findings),
                _refit(findings),
                _causes(findings),
                _space(findings, spreads),
            ],
            data=[
                "model_error.csv",
                Data("limits.csv", Limit, findings.limits),
                Data("refit.csv", Refit, findings.refits + findings.rendered.refits),
                Data("causes.csv", Part, findings.rendered.parts),
                Data("space.csv", Spread, spreads),
                Data("sensitivity.csv", Sensitivity, findings.space.sensitivities()),
            ],
        )


def _found(findings: Findings, spreads: Sequence[Spread]) -> Iterable[Conclusion]:
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
        model: _leaves_at([_limit(findings, model, False, height, incidence, x) for x in LIMITS_MM])
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
    row = min(rows, key=lambda r: abs(r.c_mm - _SHOWN_C_MM))
    share = 100 * row.hidden_mm / row.largest_error_mm
    where = pinhole(height, findings.scene.phantom.radius_mm)
    bound = ", the end of its range," if row.at_bound else ""
    limits = [_limit(findings, "small_plane", True, height, incidence, x) for x in LIMITS_MM]
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
    nearest = min(here, key=lambda p: (abs(p.c_mm - _SHOWN_C_MM), abs(p.d_mm - _SHOWN_C_MM)))
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


def _errors(findings: Findings) -> Section:
    measured = [e for e in findings.rendered.errors if not e.refit]
    rows: list[Row] = []
    for model in optics.MODELS:
        for height in pinhole_heights(findings.scene):
            errors = np.array(
                [e.error_mm for e in measured if (e.model, e.z_f_mm) == (model, height)]
            )
            if errors.size:
                largest = float(np.max(np.abs(errors)))
                rows.append((model, f"{height:g}", float(errors.mean()), largest, int(errors.size)))
    return Section(
        "Error against eccentricity",
        Picture(
            "model_error",
            figures.model_error(findings.analytic, measured, models=optics.MODELS),
            "Error of every model against c: a row for each pinhole height, a column for each "
            "model. k, b, c and r are given to every model, as they are.",
            data="model_error.csv",
        ),
        Picture(
            "largest_error",
            pictures.largest_errors(findings.withdrawals, measured),
            "Largest absolute error over d = 0.5 to 6 mm, on exact contours (lines) and on "
            "rendered spots (dots); dashed: with c fitted to the withdrawal itself; dotted: "
            f"{' and '.join(f'{x:g}' for x in LIMITS_MM)} mm. On exact contours exact is right to "
            "rounding and not drawn.",
            data="model_error.csv",
        ),
        Table(
            ("model", "z_F, mm", "mean error, mm", "largest |error|, mm", "spots"),
            rows,
            "Errors on rendered spots, sub-pixel mode, all c and d together.",
            digits=4,
            data="model_error.csv",
        ),
    )


def _limits(findings: Findings) -> Section:
    scene = findings.scene
    keys = [
        (height, incidence, limit)
        for height in pinhole_heights(scene)
        for incidence in dict.fromkeys((0.0, scene.spot.incidence_deg))
        for limit in LIMITS_MM
    ]
    models = [(model, False) for model in optics.MODELS] + [("small_plane", True)]
    rows: list[Row] = [
        [f"{value:g}" for value in key]
        + [_limit(findings, model, refit, *key) for model, refit in models]
        for key in keys
    ]
    return Section(
        f"Where each model leaves {' and '.join(f'{x:g}' for x in LIMITS_MM)} mm",
        Table(
            ("z_F, mm", "incidence, °", "limit, mm", *optics.MODELS, "small_plane, c fitted"),
            rows,
            "Smallest c in mm at which the largest error over d = 0.5 to 6 mm reaches the limit; a "
            f"dash: not up to c = {LARGEST_C_MM:g} mm.",
            digits=2,
            data="limits.csv",
        ),
    )


def _refit(findings: Findings) -> Section:
    incidence = findings.scene.spot.incidence_deg
    chosen = [
        r
        for r in findings.refits
        if r.z_f_mm in pinhole_heights(findings.scene)
        and r.incidence_deg == incidence
        and math.isclose(r.c_mm % 1.0, 0.0)
        and r.c_mm > 0
    ]
    return Section(
        "What fitting c hides",
        "The paper finds c by fitting its model to the very distances that it is then judged by "
        "(Table II). A wrong factor is taken up by a wrong c as long as the right one is below 1; "
        "where it is above, the fit ends at c = 0.",
        Picture(
            "refit",
            pictures.fitted_eccentricity(findings.refits),
            f"Left: fitted against true c at {incidence:g}° incidence; grey: where they agree. "
            "Right: largest error with the true c (lines) and largest residual with the fitted one "
            "(dashed).",
            data="refit.csv",
        ),
        Table(
            ("z_F, mm", "true c, mm", "fitted c, mm", "error, mm", "residual, mm", "hidden, mm"),
            [
                (
                    f"{r.z_f_mm:g}",
                    f"{r.c_mm:g}",
                    r.fitted_c_mm,
                    r.largest_error_mm,
                    r.largest_residual_mm,
                    r.hidden_mm,
                )
                for r in chosen
            ],
            "Largest error over d with the true c, largest residual with the fitted one, and the "
            "difference, which is what the fit hides; exact contours.",
            data="refit.csv",
        ),
    )


def _causes(findings: Findings) -> Section:
    parts = findings.rendered.parts
    text = (
        "Each link between distance and spot is real or ideal, with the model's own term for it; "
        "so every model is right when all are ideal. Each cause's part is its Shapley value, "
        f"exact over all {1 << len(CAUSES):,} sets of causes, and the parts sum to the error. Edge "
        "and pixels are measured in rendered frames: with noise, and without it at twice the "
        f"resolution. The models were given r {causes.WRONG_R_MM:g} mm and c "
        f"{causes.WRONG_C_MM:g} mm too large, which is also why exact owes "
        "something to links that it knows. The paper's cos φ counts as a term for "
        "foreshortening, which is how the paper derives it."
    )
    if not parts:
        return Section("Causes", text, "No rendered spot counts in this run.")
    # The distance that most spots share, nearest to the middle of the range.
    d = min({round(p.d_mm, 6) for p in parts}, key=lambda d: abs(d - _SHOWN_C_MM))
    far = max({round(p.c_mm, 6) for p in parts if abs(p.d_mm - d) < 1e-6})
    far_ones = [p for p in parts if abs(p.d_mm - d) < 1e-6 and abs(p.c_mm - far) < 1e-6]
    tables = [
        _cause_table([p for p in far_ones if p.z_f_mm == height])
        for height in dict.fromkeys(p.z_f_mm for p in far_ones)
    ]
    return Section(
        "Causes",
        text,
        Picture(
            "causes",
            pictures.causes(parts, d=d),
            f"Parts of the error at d = {d:.3g} mm, {findings.scene.spot.incidence_deg:g}° "
            "incidence; diamonds: the error, their sum. Each panel has a scale of its own.",
            data="causes.csv",
        ),
        *tables,
    )


def _cause_table(parts: list[Part]) -> Table:
    """The parts of all models at one geometry."""
    first = parts[0]
    rows: list[Row] = [[cause, *(p.part_mm for p in parts if p.cause == cause)] for cause in CAUSES]
    rows.append(["whole", *(p.whole_mm for p in parts if p.cause == CAUSES[0])])
    return Table(
        ("cause", *optics.MODELS),
        rows,
        f"Parts in mm at c = {first.c_mm:.3g} mm and d = {first.d_mm:.3g} mm, "
        f"z_F = {first.z_f_mm:g} mm.",
        digits=4,
        data="causes.csv",
    )


def _space(findings: Findings, spreads: Sequence[Spread]) -> Section:
    space = findings.space
    found = {(s.model, s.pinhole, s.axis): s.first_order for s in space.sensitivities()}
    ranges = ", ".join(
        f"{name.rsplit('_', 1)[0].replace('_', '-')} {low:g} to {high:g} "
        f"{name.rsplit('_', 1)[1].replace('deg', '°')}"
        for name, (low, high) in AXES.items()
    )
    models = [model for model in optics.MODELS if model != "exact"]
    return Section(
        "The whole space",
        f"{space.count:,} geometries, a scrambled Sobol sequence: {ranges}; z_F = 0, r, 200 mm and "
        "infinite. Whatever the cone's angle, the spot at contact keeps the scene's size.",
        Picture(
            "space",
            pictures.spreads(spreads),
            "Absolute error along each axis over all others: median (lines) and 95th percentile "
            "(dotted).",
            data="space.csv",
        ),
        Table(
            ("model", "pinhole", *(name.rsplit("_", 1)[0].replace("_", "-") for name in AXES)),
            [
                (model, p, *(found[model, p, axis] for axis in AXES))
                for model in models
                for p in PINHOLES
            ],
            "Part of the error's variance that each axis alone explains (first-order Sobol "
            "index); what is missing to 1 is due to axes together.",
            digits=2,
            data="sensitivity.csv",
        ),
    )


def _limit(
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
