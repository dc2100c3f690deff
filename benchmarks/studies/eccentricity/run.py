"""`eyespot study eccentricity`: how wrong each model is, where, and by which cause.

DIR/model_error.csv  every error of every model, analytic and rendered
    limits.csv       at which c a model's error reaches 0.1 and 0.5 mm
    refit.csv        c fitted as the paper does, and how much of the error that hides
    causes.csv       Shapley's share of each cause
    space.csv, sensitivity.csv  errors over the whole space, and which axis they come from
    stacks/, spots/  rendered frames, and the spots measured in them
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

import optics
import scenes
from benchmarks.evaluation import (
    ACCURACY,
    MICROSCOPE_MM,
    MODEL_ERROR,
    accuracy,
    geometry_of,
    largest,
    model_error_figure,
    require_roomy_eyeball,
)
from benchmarks.reporting import (
    Claim,
    Column,
    Picture,
    Report,
    Request,
    Section,
    Study,
    Table,
    grouped,
    rows_of,
)
from benchmarks.studies.eccentricity import figures, limits, rendered, space
from benchmarks.studies.eccentricity.causes import (
    CAUSES,
    WRONG_C_MM,
    WRONG_R_MM,
    spread_length,
)
from benchmarks.studies.eccentricity.figures import EccentricityFindings, pinhole_heights
from benchmarks.studies.eccentricity.limits import (
    LARGEST_C_MM,
    LIMITS_MM,
    SHOWN_C_MM,
    Withdrawals,
)
from benchmarks.studies.eccentricity.space import AXES, PINHOLES, Space
from estimator.files import written_whole
from scenes import Scene


def run(request: Request) -> EccentricityFindings:
    """Compute, render, compare and report.

    Args:
        request: the arguments; its option "geometries" is their number in the space.

    Raises:
        SceneError: the wall is no eyeball, or too small.
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    study = Study("eccentricity", request, defaults=("source.kind=cone",), check=check)
    scene = study.scene
    with study.timed("render and measure"):
        found = rendered.measure(study, _trials(scene, quick=request.quick))
    with study.timed("withdrawals on exact contours"):
        exact = _withdrawals(scene, quick=request.quick)
    on_exact = pd.concat([w.errors for w in exact.values()], ignore_index=True)
    with study.timed("space of geometries"):
        filled = fill_space(
            scene,
            count=int(request.options["geometries"]),
            seed=study.seed,
            csv_file=study.folder / "model_error.csv",
            before=pd.concat([on_exact, found.errors]),
        )
    findings = EccentricityFindings(
        scene=scene,
        withdrawals=exact,
        limits=limits.limits(on_exact),
        rendered=found,
        geometries=filled.count,
        spreads=filled.spreads(),
        sensitivities=filled.sensitivities(),
        within=filled.within(LIMITS_MM[-1]),
    )
    study.publish(report, findings)
    return findings


def check(scene: Scene) -> None:
    """Refuse a scene in which c cannot reach its largest value.

    Raises:
        SceneError: saying what to change.
    """
    require_roomy_eyeball(scene, f"c reaches {LARGEST_C_MM:g} mm")


def fill_space(
    scene: Scene, *, count: int, seed: int, csv_file: Path, before: pd.DataFrame
) -> Space:
    """Errors of all models over the space of geometries; writes model_error.csv as it goes.

    Args:
        scene: gives the scale, the spot's size at contact and the medium.
        count: of geometries, rounded up to a power of two or to whole blocks of such.
        csv_file: file to write; it gets its name when it is complete.
        before: rows to write before those of the space.
    """
    cone = geometry_of(scene)
    filled = Space()
    with (
        written_whole(csv_file, replace=True) as partial,
        partial.open("w", encoding="utf-8") as file,
    ):
        file.write(",".join(MODEL_ERROR) + "\n")
        file.writelines(map(space.csv_line, before.itertuples(index=False, name=None)))
        for block in space.blocks(
            count=count,
            seed=seed,
            scale=cone.scale,
            contact_radius=-cone.apex_offset * float(np.tan(cone.half_angle)),
        ):
            filled.add(block)
            file.write(space.csv_text(block, medium=scene.source.medium))
    return filled


def _trials(scene: Scene, *, quick: bool) -> list[rendered.EccentricTrial]:
    return rendered.trials(
        scene,
        pinhole_heights=pinhole_heights(scene),
        eccentricities=np.linspace(0.0, LARGEST_C_MM, 3 if quick else 9).tolist(),
        few=(4.0, LARGEST_C_MM) if quick else np.linspace(0.0, LARGEST_C_MM, 5).tolist(),
        frames=3 if quick else 12,
    )


def _withdrawals(scene: Scene, *, quick: bool) -> dict[tuple[float, float], Withdrawals]:
    """On exact contours: four pinholes, square to the wall and at the scene's incidence."""
    eccentricities = np.linspace(0.0, LARGEST_C_MM, 17 if quick else 81)
    found = {}
    for height in (0.0, *pinhole_heights(scene), np.inf):
        for incidence_deg in dict.fromkeys((0.0, scene.spot.incidence_deg)):
            own = scenes.changed(
                scene, {"microscope.pinhole_height_mm": height, "spot.incidence_deg": incidence_deg}
            )
            found[height, incidence_deg] = limits.withdrawals(
                geometry_of(own), eccentricities=eccentricities, medium=scene.source.medium
            )
    return found


# The page.


def report(findings: EccentricityFindings) -> Report:
    """The report of a run."""
    return Report(
        title="How wrong is the distance, at which eccentricity, and why?",
        lead="Five models from spot size to distance against the exact geometry: on exact "
        "contours, and on spots measured in rendered frames.",
        claims=list(_claims(findings)),
        sections=[
            _errors(findings),
            _limits(findings),
            _refit(findings),
            _causes(findings),
            _space(findings),
        ],
        data={
            "model_error.csv": None,
            "limits.csv": findings.limits,
            "refit.csv": pd.concat([findings.refits, findings.rendered.refits]),
            "causes.csv": findings.rendered.shares,
            "space.csv": findings.spreads,
            "sensitivity.csv": findings.sensitivities,
        },
    )


def _claims(findings: EccentricityFindings) -> Iterator[Claim]:
    spot = findings.scene.spot
    for height in findings.heights:
        for model in optics.MODELS:
            yield Claim(
                name=f"z_F = {height:g} mm, {model}",
                sentence="At {incidence:g}° incidence (azimuth {azimuth:g}°) the largest error "
                "over d = 0.5 to 6 mm reaches {limits:g} mm at c = {value:.2f} mm (a dash: not up "
                "to c = {end:g} mm).",
                value=findings.limits_of(model, height, spot.incidence_deg),
                numbers={
                    "incidence": spot.incidence_deg,
                    "azimuth": spot.incidence_azimuth_deg,
                    "limits": LIMITS_MM,
                    "end": LARGEST_C_MM,
                },
            )
    for height in findings.heights:
        yield _hidden(findings, height)
    for height in findings.heights:
        yield from _main_cause(findings, height)
    yield from _measured(findings)
    yield Claim(
        name="space",
        sentence="Within {limit:g} mm in {value:.0%} of {geometries:,} geometries ({models}): over "
        "the ranges of c, d, r, incidence, azimuth and half-angle below, a quarter of them with "
        "each pinhole.",
        value=tuple(findings.within.values()),
        numbers={
            "limit": LIMITS_MM[-1],
            "geometries": findings.geometries,
            "models": tuple(findings.within),
        },
    )
    yield _azimuth(findings)


def _hidden(findings: EccentricityFindings, height: float) -> Claim:
    incidence = findings.scene.spot.incidence_deg
    refits = findings.refits
    rows = refits[(refits.z_f_mm == height) & (refits.incidence_deg == incidence)]
    row = min(rows_of(rows), key=lambda r: abs(r.c_mm - SHOWN_C_MM))
    return Claim(
        name=f"z_F = {height:g} mm, fitted c",
        sentence="Fitting c hides {value:.0%} of the error of small_plane at c = {row.c_mm:g} mm. "
        "The fit finds c = {row.fitted_c_mm:.2f} mm and has residuals of up to "
        "{row.largest_residual_mm:.3f} mm, where the error with the true c is "
        "{row.largest_error_mm:.3f} mm. The residuals reach {limits:g} mm at c = {reached:.2f} mm "
        "(a dash: not up to c = {end:g} mm).",
        value=row.hidden_mm / row.largest_error_mm,
        numbers={
            "row": row,
            "limits": LIMITS_MM,
            "reached": findings.limits_of("small_plane", height, incidence, refit=True),
            "end": LARGEST_C_MM,
        },
    )


def _main_cause(findings: EccentricityFindings, height: float) -> Iterator[Claim]:
    shares, exact = findings.rendered.shares, findings.analytic
    if shares.empty:
        return
    here = rows_of(shares[(shares.z_f_mm == height) & (shares.model == "small_plane")])
    if not here:
        return
    nearest = min(here, key=lambda p: (abs(p.c_mm - SHOWN_C_MM), abs(p.d_mm - SHOWN_C_MM)))
    spot = [p for p in here if (p.c_mm, p.d_mm) == (nearest.c_mm, nearest.d_mm)]
    ordered = sorted(spot, key=lambda p: -abs(p.part_mm))
    own = min(
        rows_of(
            exact[
                (exact.z_f_mm == height)
                & (exact.model == "small_plane")
                & (exact.incidence_deg == nearest.incidence_deg)
            ]
        ),
        key=lambda e: (abs(e.c_mm - nearest.c_mm), abs(e.d_mm - nearest.d_mm)),
    )
    yield Claim(
        name=f"z_F = {height:g} mm, causes",
        sentence="At c = {spot.c_mm:.1f} mm and d = {spot.d_mm:.1f} mm the error of small_plane is "
        "{value:+.3f} mm if it is also given an r too large by {wrong_r:g} mm and a c too large by "
        "{wrong_c:g} mm; its own error on the exact contour is {own.error_mm:+.3f} mm (c = "
        "{own.c_mm:g}, d = {own.d_mm:g} mm). The causes, the largest first: {causes}. Their "
        "shares in mm: {parts:+.3f}. (Shapley's values: a cause alone can do more or less.)",
        value=nearest.whole_mm,
        numbers={
            "spot": nearest,
            "own": own,
            "wrong_r": WRONG_R_MM,
            "wrong_c": WRONG_C_MM,
            "causes": tuple(p.cause for p in ordered),
            "parts": tuple(p.part_mm for p in ordered),
        },
    )


def _measured(findings: EccentricityFindings) -> Iterator[Claim]:
    found, errors = findings.rendered, findings.rendered.with_true_c
    if len(errors):
        yield Claim(
            name="rendered spots",
            sentence="Largest errors over {spots} spots: {value:.3f} mm ({models}); k, b, c and r "
            "are given. {left_out} frames have no spot that counts.",
            value=tuple(largest(errors.error_mm[errors.model == m]) for m in optics.MODELS),
            numbers={
                "models": optics.MODELS,
                "spots": found.frames - found.left_out,
                "left_out": found.left_out,
            },
        )


def _azimuth(findings: EccentricityFindings) -> Claim:
    of = findings.spreads
    key = (of.model == "corrected") & (of.pinhole == f"{MICROSCOPE_MM:g}")
    bins = rows_of(of[key & (of.axis == "azimuth_deg")])
    best, worst = (choose(bins, key=lambda s: s.percentile_95_mm) for choose in (min, max))
    return Claim(
        name=f"z_F = {MICROSCOPE_MM:g} mm, azimuth",
        sentence="The error of corrected depends on the azimuth of the beam's tilt: 95 % of the "
        "errors are below {best.percentile_95_mm:.3f} mm at azimuths of {best.from_value:g} to "
        "{best.to_value:g}°, and below {value:.3f} mm at azimuths of {worst.from_value:g} to "
        "{worst.to_value:g}°. The model is one of a square beam. A tilt along the meridian of O "
        "(azimuth 0 or 180°) makes the spot longer where the image makes it shorter. exact is "
        "given the beam's direction.",
        value=worst.percentile_95_mm,
        numbers={"best": best, "worst": worst},
    )


def _errors(findings: EccentricityFindings) -> Section:
    measured = findings.rendered.with_true_c
    limits = " and ".join(f"{limit:g}" for limit in LIMITS_MM)
    return Section(
        "Error against eccentricity",
        Picture(
            "model_error",
            model_error_figure(findings.analytic, measured, models=optics.MODELS),
            "Error of every model against c: a row for each pinhole height, a column for each "
            "model. Lines: exact contours (dotted: square beam). Dots: rendered spots. Every model "
            "is given the true k, b, c and r.",
            data="model_error.csv",
        ),
        Picture(
            "largest_error",
            figures.worst_errors(findings),
            "Largest absolute error over d = 0.5 to 6 mm, on exact contours (lines) and on "
            "rendered spots (dots). Dashed: with c fitted to the withdrawal itself. Dotted: "
            f"{limits} mm. On exact contours the model exact has no error except rounding and is "
            "not drawn.",
            data="model_error.csv",
        ),
        Table.of(
            accuracy(measured),
            ACCURACY,
            "Errors on rendered spots, sub-pixel mode, all c and d together.",
            data="model_error.csv",
        ),
    )


def _limits(findings: EccentricityFindings) -> Section:
    models = [(model, False) for model in optics.MODELS] + [("small_plane", True)]
    rows = []
    for height in findings.heights:
        for incidence in dict.fromkeys((0.0, findings.scene.spot.incidence_deg)):
            reached = [findings.limits_of(m, height, incidence, refit=refit) for m, refit in models]
            for limit, eccentricities in zip(LIMITS_MM, zip(*reached, strict=True), strict=True):
                rows.append((height, incidence, limit, *eccentricities))
    headings = ("z_F, mm", "incidence, °", "limit, mm", *optics.MODELS, "small_plane, c fitted")
    return Section(
        "Where each model reaches the limits",
        Table(
            [Column(heading, 2) for heading in headings],
            rows,
            "Smallest c in mm at which the largest error over d = 0.5 to 6 mm reaches the limit; a "
            f"dash: not up to c = {LARGEST_C_MM:g} mm.",
            data="limits.csv",
        ),
    )


def _refit(findings: EccentricityFindings) -> Section:
    incidence, refits = findings.scene.spot.incidence_deg, findings.refits
    whole = np.isclose(refits.c_mm % 1.0, 0.0) & (refits.c_mm > 0)
    chosen = whole & refits.z_f_mm.isin(findings.heights) & (refits.incidence_deg == incidence)
    return Section(
        "The error that a fit of c hides",
        "The paper fits c to the same distances with which it then tests the model (Table II). A "
        "wrong c compensates for a wrong factor as long as the correct factor is below 1. If the "
        "correct factor is above 1, the fit ends at c = 0.",
        Picture(
            "refit",
            figures.fitted_eccentricity(findings),
            f"Left: fitted against true c at {incidence:g}° incidence; grey: where they agree. "
            "Right: largest error with the true c (lines) and largest residual with the fitted one "
            "(dashed).",
            data="refit.csv",
        ),
        Table.of(
            refits[chosen],
            {
                "z_f_mm": Column("z_F, mm", 1),
                "c_mm": Column("true c, mm", 0),
                "fitted_c_mm": Column("fitted c, mm"),
                "largest_error_mm": Column("error, mm"),
                "largest_residual_mm": Column("residual, mm"),
                "hidden_mm": Column("hidden, mm"),
            },
            "Largest error over d with the true c, largest residual with the fitted one, and the "
            "difference, which the fit hides; exact contours.",
            data="refit.csv",
        ),
    )


def _causes(findings: EccentricityFindings) -> Section:
    shares = findings.rendered.shares
    text = (
        "Each link between distance and spot is real or ideal, together with the model's own term "
        "for it. Every model is exact if all links are ideal. Each cause's part is its Shapley "
        f"value, exact over all {1 << len(CAUSES):,} sets of causes, and the parts sum to the "
        "error. Edge and pixels are measured in rendered frames: with noise, and without it at "
        "twice the resolution. Light spread in the wall is computed for a sharp cone, with the "
        f"scene's length, or that of printed paper: {spread_length(findings.scene):.3f} mm. The "
        f"models are given an r {WRONG_R_MM:g} mm and a c "
        f"{WRONG_C_MM:g} mm too large, so the model exact also has errors from links that it "
        "models. "
        "The paper's cos φ counts as a term for foreshortening, as the paper derives it."
    )
    if shares.empty:
        return Section("Causes", text, "No rendered spot counts in this run.")
    # The distance that most spots share, nearest to the middle of the range.
    d = min(shares.d_mm.round(6).unique(), key=lambda d: abs(d - SHOWN_C_MM))
    there = shares[(shares.d_mm - d).abs() < 1e-6]
    far = there[(there.c_mm - there.c_mm.round(6).max()).abs() < 1e-6]
    return Section(
        "Causes",
        text,
        Picture(
            "causes",
            figures.causes(findings, d=d),
            f"Parts of the error at d = {d:.3g} mm, {findings.scene.spot.incidence_deg:g}° "
            "incidence; diamonds: the error, their sum. Each panel has a scale of its own.",
            data="causes.csv",
        ),
        *(_cause_table(of) for _, of in grouped(far, "z_f_mm")),
    )


def _cause_table(shares: pd.DataFrame) -> Table:
    """The parts of all models at one geometry."""
    first = shares.iloc[0]
    rows = [(cause, *shares.part_mm[shares.cause == cause]) for cause in CAUSES]
    whole = ("whole", *shares.whole_mm[shares.cause == CAUSES[0]])
    return Table(
        [Column("cause"), *(Column(model, 4) for model in optics.MODELS)],
        [*rows, whole],
        f"Parts in mm at c = {first.c_mm:.3g} mm and d = {first.d_mm:.3g} mm, "
        f"z_F = {first.z_f_mm:g} mm.",
        data="causes.csv",
    )


def _space(findings: EccentricityFindings) -> Section:
    units = {"mm": "mm", "deg": "°"}
    axes = {name: name.replace("_", "-").rsplit("-", 1) for name in AXES}
    ranges = ", ".join(
        f"{title} {AXES[name][0]:g} to {AXES[name][1]:g} {units[unit]}"
        for name, (title, unit) in axes.items()
    )
    found = findings.sensitivities.set_index(["model", "pinhole", "axis"]).first_order
    rows = [
        (model, pinhole, *(found[model, pinhole, axis] for axis in AXES))
        for model in optics.MODELS
        if model != "exact"
        for pinhole in PINHOLES
    ]
    headings = ("model", "pinhole", *(title for title, _ in axes.values()))
    return Section(
        "The whole space",
        f"{findings.geometries:,} geometries, a scrambled Sobol sequence: {ranges}; z_F = 0, r, "
        "200 mm and infinite. For every half-angle the spot at contact has the scene's size.",
        Picture(
            "space",
            figures.spreads(findings),
            "Absolute error along each axis over all others: median (lines) and 95th percentile "
            "(dotted).",
            data="space.csv",
        ),
        Table(
            [Column(heading, 2) for heading in headings],
            rows,
            "Part of the error's variance that each axis alone explains (first-order Sobol "
            "index). The rest is due to axes together.",
            data="sensitivity.csv",
        ),
    )
