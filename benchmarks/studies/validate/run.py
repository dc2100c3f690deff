"""The main job: the paper's static experiment on rendered images, and its model against the truth.

DIR/run.json         the request; a folder with another run.json is refused
    stacks/…         labelled image stacks, one for each trial
    spots/…          the spots measured in them, in each way
    *.csv, figures/  the numbers and figures of the report
    summary.json     what was found
    report.html      the same, for people
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.evaluation import (
    ACCEPTABLE_ERROR_MM,
    ACCURACY,
    ALL_PLANES,
    CHOSEN_DISTANCES_MM,
    COMPARED,
    LITERAL,
    STRAIGHT,
    SUBPIXEL,
    USED,
    WAYS,
    StaticTrial,
    Tracked,
    accuracy,
    grid_trials,
    largest,
    limit_eccentricity,
    model_error_figure,
    paper_trials,
    reproduction,
    rms,
    track_stack,
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
)
from benchmarks.studies.validate import figures
from benchmarks.studies.validate.tables import (
    CHOSEN_ECCENTRICITIES_MM,
    ValidateFindings,
    ambiguous_range,
    analytic_errors,
    fit_tables,
    frame_table,
    half_maximum_curve,
    nearest_reproduction,
    plane_table,
    rendered_errors,
    sphere_table,
    spot_table,
    square_errors,
)
from estimator import Stack
from scenes import World

_STRIPS = {"plane 1": "printed plane", "sphere 1": "eyeball phantom"}


def run(*, out: Path, quick: bool, seed: int, source: str) -> ValidateFindings:
    """Render, measure, fit, compare and report.

    Args:
        out: folder of the run; a run with the same settings is resumed.
        quick: fewer frames.
        seed: of camera noise and wall texture.
        source: "lens", "cone" or "both".

    Raises:
        InputError: `out` has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    request = Request(out=out, quick=quick, seed=seed, options={"source": source})
    study = Study("validate", request, command=("eyespot", "validate"))
    sources = ("lens", "cone") if source == "both" else (source,)
    trials = [t for kind in sources for t in paper_trials(source=kind, quick=quick, seed=seed)]
    trials += grid_trials(quick=quick, seed=seed)
    with ThreadPoolExecutor(max_workers=1) as beside:
        # These take seconds and need no renderer, so they run beside the trials of the ideal cone.
        analytic = beside.submit(lambda: analytic_errors(quick=quick))
        light = beside.submit(lambda: World(trials[0].scene).light)
        with study.timed("render and measure"):
            tracked = _tracked(study, [t for t in trials if t.source == "cone"])
            light.result()
            tracked |= _tracked(study, [t for t in trials if t.source == "lens"])
        with study.timed("fit and compare"):
            plane_fits, sphere_fits = fit_tables(trials, tracked)
            findings = ValidateFindings(
                stacks=study.folder / "stacks",
                trials=trials,
                tracked=tracked,
                plane_fits=plane_fits,
                sphere_fits=sphere_fits,
                analytic=analytic.result(),
                rendered=rendered_errors(trials, tracked),
            )
    study.publish(report, findings)
    return findings


def _tracked(study: Study, trials: list[StaticTrial]) -> dict[tuple[str, str], Tracked]:
    """Spots of every trial in every way whose exposure it has; of the grid in the best way."""
    by_name = {trial.name: trial for trial in trials}
    folder = study.folder / "spots"
    folder.mkdir(exist_ok=True)

    def measure(name: str, stack: Stack) -> dict[tuple[str, str], Tracked]:
        kinds = by_name[name].scene.exposures.kinds
        ways = [way for way in WAYS if way.exposure in kinds]
        return {
            (name, way.name): track_stack(stack, way, spots_file=folder / f"{name}-{way.slug}.csv")
            for way in (ways if by_name[name].kind != "grid" else [SUBPIXEL])
        }

    found = study.measured({trial.name: trial.scene for trial in trials}, measure)
    return {key: tracked for of_trial in found.values() for key, tracked in of_trial.items()}


# The claims.


def claims(findings: ValidateFindings) -> Iterator[Claim]:
    """All claims of a run: the models' errors first, Table I last."""
    yield from _small_plane(findings)
    yield from _rendered_models(findings)
    yield from _fitted_eccentricity(findings)
    yield from _cone_returned(findings)
    yield from _half_maximum(findings)
    yield from _table_one(findings)
    yield _used(findings)


def _small_plane(findings: ValidateFindings) -> Iterator[Claim]:
    analytic = findings.analytic
    for height, here in grouped(analytic[analytic.model == "small_plane"], "z_f_mm"):
        square = [tuple(square_errors(here, c=c).error_mm) for c in CHOSEN_ECCENTRICITIES_MM]
        yield Claim(
            name=f"small_plane, z_F = {height:g} mm",
            sentence="The error of the paper's model reaches the acceptable {high:g} mm at c = "
            "{reached:.1f} mm (a dash: not up to c = {most:g} mm) and is {value:.3f} mm at most. "
            "With the cone known and the beam square to the wall, it is {first:+.3f} mm at c = "
            "{chosen[0]:g} mm and {second:+.3f} mm at c = {chosen[1]:g} mm, for d = "
            "{distances:g} mm.",
            value=largest(here.error_mm),
            high=ACCEPTABLE_ERROR_MM,
            numbers={
                "reached": limit_eccentricity(here, ACCEPTABLE_ERROR_MM),
                "most": here.c_mm.max(),
                "chosen": CHOSEN_ECCENTRICITIES_MM,
                "first": square[0],
                "second": square[1],
                "distances": CHOSEN_DISTANCES_MM,
            },
        )


def _rendered_models(findings: ValidateFindings) -> Iterator[Claim]:
    for (model, height), own in grouped(accuracy(findings.rendered), "model", "z_f_mm"):
        yield Claim(
            name=f"{model} on rendered spots, z_F = {height:g} mm",
            sentence="The largest error is {value:.3f} mm on {spots} spots of the ideal cone in "
            "sub-pixel mode (acceptable: {high:g} mm). Where the beam's tilt has the azimuth "
            "{azimuths:g}°, it is {errors:.3f} mm. (0° tilts the beam towards growing c.)",
            value=largest(own.max_abs_error_mm),
            high=ACCEPTABLE_ERROR_MM,
            numbers={
                "spots": int(own.spots.sum()),
                "azimuths": tuple(own.azimuth_deg),
                "errors": tuple(own.max_abs_error_mm),
            },
        )


def _fitted_eccentricity(findings: ValidateFindings) -> Iterator[Claim]:
    every = sphere_table(findings)
    if every.empty:
        return
    best = every[(every.source == every.source.iloc[-1]) & (every.way == SUBPIXEL.name)]
    if len(best):
        yield Claim(
            name="a fitted c is smaller than the true c",
            sentence="{value:g} of {low:g} fits give a smaller c than the true one, which hides an "
            "error of the model. Fitted as in Table II ({source}, {way}), c is {fitted:.2f} mm, "
            "the true c {true:.2f} mm; {expected:.2f} mm would make the paper's cos φ the right "
            "factor for this pinhole (z_F = {height:g} mm). The residuals of {residual:.3f} mm at "
            "most do not test the model.",
            value=int((every.c_fitted_mm < every.c_true_mm).sum()),
            low=len(every),
            numbers={
                "source": best.source.iloc[0],
                "way": best.way.iloc[0],
                "fitted": tuple(best.c_fitted_mm),
                "true": tuple(best.c_true_mm),
                "expected": tuple(best.c_expected_mm),
                "height": findings.trials[0].scene.microscope.pinhole_height_mm,
                "residual": best.max_error_mm.max(),
            },
        )


def _cone_returned(findings: ValidateFindings) -> Iterator[Claim]:
    fits = findings.plane_fits.get(("cone", SUBPIXEL.name))
    if fits is not None:
        trial, fit = findings.planes("cone")[0], fits[ALL_PLANES]
        source = trial.scene.source
        contact = findings.tracked[trial.name, SUBPIXEL.name].labels[0].d_mm
        yield Claim(
            name="the ideal cone is returned",
            sentence="In sub-pixel mode the fitted δk of the ideal cone (k {k:g}, b {b:.3f} mm) "
            "has an error of {value:+.2f} %. The fitted b of {fit.b:.3f} mm has an error of "
            "{b_error:+.3f} mm. d_r is zero at contact, where the tip's rim touches and its centre "
            "is {contact:.3f} mm from the wall.",
            value=100 * (fit.delta_k / (trial.scene.microscope.scale_mm_px * source.cone_k) - 1),
            numbers={
                "k": source.cone_k,
                "b": source.cone_apex_offset_mm,
                "fit": fit,
                "b_error": fit.b - (source.cone_apex_offset_mm - contact),
                "contact": contact,
            },
        )


def _half_maximum(findings: ValidateFindings) -> Iterator[Claim]:
    curve = half_maximum_curve(findings)
    fits = [findings.plane_fits.get(("lens", way.name)) for way in (SUBPIXEL, LITERAL)]
    if curve is None:
        return
    d, radius = curve
    first, last = ambiguous_range(d, radius) or (math.nan, math.nan)
    chosen = sorted({0, int(np.argmin(radius)), len(d) - 1})
    edge, threshold = (fit[ALL_PLANES].r_squared if fit else math.nan for fit in fits)
    tracked = [findings.tracked[trial.name, SUBPIXEL.name] for trial in findings.planes("lens")]
    yield Claim(
        name="the lens's half-maximum radius grows with distance",
        sentence="One radius belongs to several distances over {value:.2f} mm: from {first:.2f} to "
        "{last:.2f} mm. The radius is {radii:.3f} mm at d = {at:.2f} mm. Sub-pixel mode follows it "
        "to {bias:.2f} px (rms). A straight line through its readings has R² {edge:.3f}, one "
        "through those of the fixed threshold {threshold:.3f} (straight: {straight:g} or more).",
        value=0.0 if math.isnan(first) else last - first,
        high=0.0,
        numbers={
            "first": first,
            "last": last,
            "radii": tuple(radius[chosen].tolist()),
            "at": tuple(d[chosen].tolist()),
            "bias": rms(e for t in tracked for e in (t.semi_minor_px - t.truth_px).tolist()),
            "edge": edge,
            "threshold": threshold,
            "straight": STRAIGHT,
        },
    )


def _table_one(findings: ValidateFindings) -> Iterator[Claim]:
    for source in findings.sources:
        fits = findings.plane_fits.get((source, LITERAL.name), {})
        if len(fits) < 2:
            continue
        settings = findings.planes(source)[0].scene.source
        name = f"lens {settings.lens}" if source == "lens" else "ideal cone"
        yield from reproduction(fits, name=f"Table I by the {name}").values()
        part = nearest_reproduction(findings, source=source, way=LITERAL)
        if part is not None:
            yield Claim(
                name=f"Table I by the {name}, best part of the range",
                sentence="The range d_r = {low_mm:g} to {high_mm:g} mm meets most criteria, "
                "{value:g} of {low:g}: δk {values[0]:.4f} mm/px, b {values[1]:.2f} mm, "
                "R² {values[2]:.3f} and RMSE {values[3]:.3f} mm of the trials.",
                value=part.met,
                low=len(part.criteria),
                numbers={
                    "low_mm": part.low,
                    "high_mm": part.high,
                    "values": tuple(claim.value for claim in part.criteria.values()),
                },
            )


def _used(findings: ValidateFindings) -> Claim:
    outcomes = {
        way.name: [
            outcome
            for (_, name), tracked in findings.tracked.items()
            if name == way.name
            for outcome in tracked.outcomes
        ]
        for way in WAYS
    }
    used = {way: found.count(USED) for way, found in outcomes.items()}
    return Claim(
        name="frames used",
        sentence="The fits use {value:g} of {total} measurements. By way of measuring ({ways}): "
        "{used:g} of {frames:g}.",
        value=sum(used.values()),
        numbers={
            "total": sum(map(len, outcomes.values())),
            "ways": "; ".join(used),
            "used": tuple(used.values()),
            "frames": tuple(map(len, outcomes.values())),
        },
    )


# The page.


def report(findings: ValidateFindings) -> Report:
    """The report of a run.

    Raises:
        StackError: a stack that the strips of frames need is missing or broken.
    """
    planes, spheres = plane_table(findings), sphere_table(findings)
    spots, frames = spot_table(findings), frame_table(findings)
    strips = {group: figures.shown_frames(findings, group) for group in _STRIPS}
    left_out = frames[frames.outcome != USED]
    chosen = _chosen(findings)
    rendered_accuracy = accuracy(findings.rendered)
    drawn = figures.SpotFigures(findings, spots)
    return Report(
        title="How accurate is a distance measured from a spot of light?",
        lead="The static experiment of Zhou et al. 2020 (“Spotlight-based 3D Instrument Guidance "
        "for Retinal Surgery”) on rendered images whose truth is known, and its small-plane model "
        "against the exact geometry.",
        claims=list(claims(findings)),
        sections=[
            _models(findings),
            Section(
                "Frames",
                *(
                    Picture(
                        f"strip_{group.replace(' ', '_')}",
                        figures.strip_figure(lines, stacks=findings.stacks),
                        f"The tip withdraws from the {_STRIPS[group]}; d is the distance from tip "
                        "to wall along the beam. Blue: the measured ellipse (literal mode in paper "
                        "frames, sub-pixel mode in metered ones). Orange, dashed: the true contour "
                        "at half of the noise-free, unoccluded peak. Paper frames share one "
                        "exposure; metered frames put the spot's peak at "
                        f"{findings.trials[0].scene.exposures.metered_peak:.0%} of full scale.",
                        data="strip.csv",
                        inline="jpeg",
                    )
                    for group, lines in strips.items()
                ),
            ),
            _measured(findings, drawn),
            _fits(findings, planes, spheres, drawn),
            _frames_used(findings),
            _trials(findings),
        ],
        data={
            "model_error.csv": pd.concat([findings.analytic, findings.rendered]),
            "rendered_accuracy.csv": rendered_accuracy,
            "table_1.csv": planes,
            "table_2.csv": spheres,
            "spots.csv": spots,
            "frames.csv": frames,
            "strip.csv": figures.strip_table([line for lines in strips.values() for line in lines]),
        },
        summary={
            "plane_fits": planes.to_dict("records"),
            "sphere_fits": spheres.to_dict("records"),
            "model_errors": chosen.to_dict("records"),
            "rendered_accuracy": rendered_accuracy.to_dict("records"),
            "left_out": left_out.groupby("outcome", sort=False).frames.sum().to_dict(),
            "left_out_by_trial": left_out.to_dict("records"),
        },
    )


def _chosen(findings: ValidateFindings) -> pd.DataFrame:
    """The errors of a square beam that the report gives."""
    return pd.concat([square_errors(findings.analytic, c=c) for c in CHOSEN_ECCENTRICITIES_MM])


def _models(findings: ValidateFindings) -> Section:
    square = _chosen(findings)
    places = list(dict.fromkeys(zip(square.c_mm, square.d_mm, strict=True)))
    by_place = square.set_index(["z_f_mm", "model", "c_mm", "d_mm"]).error_mm
    rows = [
        (model, height, *(by_place[height, model, *place] for place in places))
        for height in square.z_f_mm.unique().tolist()
        for model in COMPARED
    ]
    columns = [Column(f"c {c:g}, d {d:.2g} mm", sign=True) for c, d in places]
    return Section(
        "The models against the exact geometry",
        Picture(
            "model_error",
            model_error_figure(findings.analytic, findings.rendered),
            "Error of the distance against eccentricity c, on exact contours (lines; dotted: square"
            " beam) and on spots measured in rendered frames of the ideal cone (dots, at the "
            "rendered distances). Every model is given the true k, b, c and r. The paper puts the "
            "pinhole F on the eyeball's sphere in its equation for FP, and at the eyeball's centre "
            "in the caption of the figure that goes with it; a real microscope has z_F near 200 "
            f"mm. Dashed: the {ACCEPTABLE_ERROR_MM} mm that the paper calls acceptable.",
            data="model_error.csv",
        ),
        Picture(
            "model_error_size",
            figures.model_error_size(findings),
            "The largest absolute error over all distances, on exact contours (lines) and rendered "
            "spots (marks), at the incidence of the frames. On exact contours the model exact has "
            "no error by construction and is not drawn. Dashed: the acceptable error.",
            data="rendered_accuracy.csv",
        ),
        Table(
            [Column("model"), Column("z_F, mm", 1), *columns],
            rows,
            "Errors in mm on exact contours, the beam square to the wall.",
            data="model_error.csv",
        ),
        Table.of(
            accuracy(findings.rendered),
            ACCURACY,
            "Errors on rendered spots of the ideal cone at all c and d of the grid, sub-pixel "
            "mode. Azimuth: direction of the beam's tilt, 0° towards growing c.",
            data="rendered_accuracy.csv",
        ),
    )


def _measured(findings: ValidateFindings, drawn: figures.SpotFigures) -> Section:
    pictures = [
        Picture(
            "bias",
            drawn.bias(),
            "Bias of each way of measuring: measured minus true e₁′. The truth is the half-maximum "
            "contour (for the ideal cone, its edge). The literal mode cuts at grey level 200, "
            "wherever that lies on the spot's profile.",
            data="spots.csv",
        )
    ]
    curve = half_maximum_curve(findings)
    if curve is not None:
        pictures.append(
            Picture(
                "half_maximum",
                drawn.half_maximum(ambiguous_range(*curve)),
                "Semi-minor axis of the lens's spot on the first plane. Where the black curve "
                "falls or has the height of another of its points (shaded), a half-maximum radius "
                "alone does not determine the distance. Dashed: the straight cone fitted to the "
                "black curve (label “cone”).",
                data="spots.csv",
            )
        )
    return Section("Measured and true spots", *pictures)


def _fits(
    findings: ValidateFindings,
    planes: pd.DataFrame,
    spheres: pd.DataFrame,
    drawn: figures.SpotFigures,
) -> Section:
    if planes.empty:
        return Section("The paper's Tables I and II", "Too few spots for any fit.")
    return Section(
        "The paper's Tables I and II",
        Table.of(
            planes,
            {
                "source": Column("source"),
                "way": Column("way"),
                "trial": Column("trial"),
                "delta_k_mm_px": Column("δk, mm/px", 4),
                "delta_k_error_mm_px": Column("±", 4),
                "paper_delta_k_mm_px": Column("paper", 4),
                "b_mm": Column("b, mm"),
                "b_error_mm": Column("±"),
                "paper_b_mm": Column("paper"),
                "r_squared": Column("R²", 4),
                "paper_r_squared": Column("paper", 4),
                "rmse_mm": Column("RMSE, mm", 4),
                "paper_rmse_mm": Column("paper", 4),
                "contact_radius_px": Column("−b/δk, px", 1),
                "spots": Column("spots"),
                "converged": Column("converged"),
            },
            "Table I: fits of d_r = δk e₁′ + b on the plane, with standard errors, and the paper's "
            "values for its own trials. −b/δk is the radius at contact in px. The paper calls b a "
            "diameter, but its value is minus the distance from the virtual apex to the tip.",
            data="table_1.csv",
        ),
        Picture(
            "plane_fit",
            drawn.plane_fit(),
            "Reading d_r against the measured semi-minor axis e₁′ on the plane, with each trial's "
            "line, the line of all trials and, dotted, the paper's. d_r is 0 at contact, where the "
            "tip's rim touches.",
            data="spots.csv",
        ),
        Picture(
            "plane_residuals",
            drawn.residuals(findings.plane_fits),
            "Residuals of each trial's line; rms over all trials.",
            data="spots.csv",
        ),
        Table.of(
            spheres,
            {
                "source": Column("source"),
                "way": Column("way"),
                "trial": Column("trial"),
                "c_true_mm": Column("true c, mm"),
                "c_fitted_mm": Column("fitted c, mm"),
                "c_error_mm": Column("±"),
                "c_expected_mm": Column("expected"),
                "standard_deviation_mm": Column("SD, mm", 4),
                "paper_standard_deviation_mm": Column("paper"),
                "mean_absolute_error_mm": Column("mean |error|, mm", 4),
                "paper_mean_absolute_error_mm": Column("paper"),
                "max_error_mm": Column("max |error|, mm", 4),
                "paper_max_error_mm": Column("paper"),
                "spots": Column("spots"),
                "converged": Column("converged"),
                "at_bound": Column("at the bound"),
            },
            "Table II: fits of the small-plane model in the eyeball. δk and b come from all "
            "planes, and c is the only free parameter. The scenes have the c that the paper "
            "prints. “Expected” is the c whose cos φ is the correct first-order factor of the true "
            "c. The largest error is 0.372 mm in the paper's text and 0.396 mm in its table.",
            data="table_2.csv",
        ),
        Picture(
            "sphere_fit",
            drawn.sphere_fit(),
            "Reading d_r against e₁′ in the eyeball, with the small-plane model at the fitted c.",
            data="spots.csv",
        ),
        Picture(
            "sphere_residuals",
            drawn.residuals(findings.sphere_fits),
            "Residuals of the fits of c, rms over all trials (the paper's error figure, over "
            "distance instead of index). A small residual does not show that the model is right, "
            "because c compensates for the model's error.",
            data="spots.csv",
        ),
    )


def _frames_used(findings: ValidateFindings) -> Section:
    outcomes: dict[str, dict[str, Counter[str]]] = {}
    for trial in findings.trials:
        line = f"grid, {trial.group}" if trial.kind == "grid" else f"{trial.source}, {trial.group}"
        for way in WAYS:
            if (trial.name, way.name) in findings.tracked:
                counts = outcomes.setdefault(line, {}).setdefault(way.name, Counter())
                counts.update(findings.tracked[trial.name, way.name].outcomes)
    rows = [
        (line, way, ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common()))
        for line, by_way in outcomes.items()
        for way, counts in by_way.items()
    ]
    return Section(
        "Frames used and left out",
        Table(
            [Column("trial"), Column("way"), Column("frames")],
            rows,
            "Frames that the fits use, and the reasons why others are left out. A frame is used if "
            "a spot was found and the instrument hides less than half of the true contour.",
            data="frames.csv",
        ),
    )


def _trials(findings: ValidateFindings) -> Section:
    headings = ("stack", "source", "wall", "c, mm", "azimuth, °", "incidence, °", "z_F, mm", "seed")
    rows = [
        (
            *(trial.name, trial.source, trial.scene.phantom.kind),
            *(trial.scene.spot.eccentricity_mm, trial.scene.spot.azimuth_deg),
            *(trial.scene.spot.incidence_deg, trial.scene.microscope.pinhole_height_mm),
            trial.scene.seed,
        )
        for trial in findings.trials
    ]
    return Section(
        "The trials",
        Table(
            [Column(heading, 1) for heading in headings],
            rows,
            "In each trial the tip withdraws at 0.1 mm/s, without motion blur. (The paper states "
            "0.1 mm/s in one place and 0.01 mm/s in another.)",
        ),
    )
