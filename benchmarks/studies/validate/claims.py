"""The claims of the main job."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from benchmarks.evaluation import (
    ACCEPTABLE_ERROR_MM,
    ALL_PLANES,
    CHOSEN_DISTANCES_MM,
    LITERAL,
    STRAIGHT,
    SUBPIXEL,
    USED,
    WAYS,
    accuracy,
    largest,
    limit_eccentricity,
    reproduction,
    rms,
)
from benchmarks.reporting import Claim
from benchmarks.studies.validate.analysis import (
    ambiguous_range,
    half_maximum_curve,
    nearest_reproduction,
)
from benchmarks.studies.validate.findings import CHOSEN_ECCENTRICITIES_MM, ValidateFindings
from benchmarks.studies.validate.tables import sphere_rows, square_rows


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
    errors = [e for e in findings.analytic if e.model == "small_plane"]
    for height in dict.fromkeys(e.z_f_mm for e in errors):
        here = [e for e in errors if e.z_f_mm == height]
        square = [
            tuple(e.error_mm for e in square_rows(here, c=c)) for c in CHOSEN_ECCENTRICITIES_MM
        ]
        yield Claim(
            name=f"small_plane, z_F = {height:g} mm",
            sentence="The error of the paper's model reaches the acceptable {high:g} mm at c = "
            "{reached:.1f} mm (a dash: not up to c = {most:g} mm) and is {value:.3f} mm at most. "
            "With the cone known and the beam square to the wall, it is {first:+.3f} mm at c = "
            "{chosen[0]:g} mm and {second:+.3f} mm at c = {chosen[1]:g} mm, for d = "
            "{distances:g} mm.",
            value=largest(e.error_mm for e in here),
            high=ACCEPTABLE_ERROR_MM,
            numbers={
                "reached": limit_eccentricity(here, ACCEPTABLE_ERROR_MM),
                "most": max(e.c_mm for e in here),
                "chosen": CHOSEN_ECCENTRICITIES_MM,
                "first": square[0],
                "second": square[1],
                "distances": CHOSEN_DISTANCES_MM,
            },
        )


def _rendered_models(findings: ValidateFindings) -> Iterator[Claim]:
    rows = accuracy(findings.rendered)
    for model, height in dict.fromkeys((row.model, row.z_f_mm) for row in rows):
        own = [row for row in rows if (row.model, row.z_f_mm) == (model, height)]
        yield Claim(
            name=f"{model} on rendered spots, z_F = {height:g} mm",
            sentence="The largest error is {value:.3f} mm on {spots} spots of the ideal cone in "
            "sub-pixel mode (acceptable: {high:g} mm). Where the beam's tilt has the azimuth "
            "{azimuths:g}°, it is {errors:.3f} mm. (0° tilts the beam towards growing c.)",
            value=largest(row.max_abs_error_mm for row in own),
            high=ACCEPTABLE_ERROR_MM,
            numbers={
                "spots": sum(row.spots for row in own),
                "azimuths": tuple(row.azimuth_deg for row in own),
                "errors": tuple(row.max_abs_error_mm for row in own),
            },
        )


def _fitted_eccentricity(findings: ValidateFindings) -> Iterator[Claim]:
    every = sphere_rows(findings)
    best = [row for row in every if (row.source, row.way) == (every[-1].source, SUBPIXEL.name)]
    if best:
        yield Claim(
            name="a fitted c is smaller than the true c",
            sentence="{value:g} of {low:g} fits give a smaller c than the true one, which hides an "
            "error of the model. Fitted as in Table II ({source}, {way}), c is {fitted:.2f} mm, "
            "the true c {true:.2f} mm; {expected:.2f} mm would make the paper's cos φ the right "
            "factor for this pinhole (z_F = {height:g} mm). The residuals of {residual:.3f} mm at "
            "most do not test the model.",
            value=sum(row.c_fitted_mm < row.c_true_mm for row in every),
            low=len(every),
            numbers={
                "source": best[0].source,
                "way": best[0].way,
                "fitted": tuple(row.c_fitted_mm for row in best),
                "true": tuple(row.c_true_mm for row in best),
                "expected": tuple(row.c_expected_mm for row in best),
                "height": findings.trials[0].scene.microscope.pinhole_height_mm,
                "residual": max(row.max_error_mm for row in best),
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
