"""What was found, in sentences whose numbers and verdicts are computed from the findings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, USED, WAYS, ModelError, Trial
from benchmarks.studies.validate import analysis
from benchmarks.studies.validate.run import SUBPIXEL, Findings
from benchmarks.studies.validate.tables import (
    ALL_PLANES,
    CHOSEN_DISTANCES_MM,
    rendered_accuracy,
    sphere_rows,
    square_rows,
)

CHOSEN_ECCENTRICITIES_MM = (3.0, 5.0)
"""Where the text and the tables say how wrong the models are."""
PAPERS_WAY = next(way.name for way in WAYS if way.exposure == "paper")


class Conclusion(NamedTuple):
    """A statement about the run.

    Attributes:
        topic: what it is about, the same in every run.
        headline: which way it fell.
        text: the numbers behind it.
        holds: the answer, where the topic is a question of yes or no.
    """

    topic: str
    headline: str
    text: str
    holds: bool | None = None


def conclusions(findings: Findings) -> list[Conclusion]:
    """All statements that this run's data allow."""
    return [
        *_table_one(findings),
        *_half_maximum(findings),
        *_small_plane(findings),
        *_other_models(findings),
        *_fitted_eccentricity(findings),
        *_cone_returned(findings),
        *_left_out(findings),
    ]


def number(value: float, digits: int = 2, *, sign: bool = False) -> str:
    """The value with a true minus sign; zero has none, and what is not finite is a dash."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:{'+' if sign else ''}.{digits}f}"
    return text.lstrip("+-") if float(text) == 0 else text.replace("-", "−")


def pinhole(z_f_mm: float, eye_radius_mm: float) -> str:
    """Where the pinhole is, in words."""
    where = f"z_F = {z_f_mm:g} mm"
    return f"{where}, on the eyeball's sphere" if math.isclose(z_f_mm, eye_radius_mm) else where


def source_name(findings: Findings, source: str) -> str:
    """The source with what tells it from others, in words."""
    settings = _first_plane(findings, source).scene.source
    if source == "lens":
        return f"lens “{settings.lens}”"
    return f"ideal cone (k {settings.cone_k:g}, b {number(settings.cone_apex_offset_mm, 3)} mm)"


def _table_one(findings: Findings) -> Iterable[Conclusion]:
    for source in ("lens", "cone"):
        fits = findings.plane_fits.get((source, PAPERS_WAY))
        if fits is None or len(fits) == 1:
            continue
        criteria = analysis.reproduction(fits)
        missed = [c.quantity for c in criteria if not c.met]
        name = source_name(findings, source)
        yield Conclusion(
            f"{source} reproduces Table I",
            f"The {name} does not reproduce Table I: it misses {_list(missed)}."
            if missed
            else f"The {name} reproduces Table I.",
            f"Measured as the paper does ({PAPERS_WAY}): {_found(criteria)}. "
            f"{_nearest(findings, source) if missed else ''}Asked: {_asked(criteria)}.",
            not missed,
        )


def _nearest(findings: Findings, source: str) -> str:
    """The part of the range that does better than the whole; the paper does not name its own."""
    whole = analysis.reproduction(findings.plane_fits[source, PAPERS_WAY])
    part = analysis.nearest_reproduction(findings, source=source, way=PAPERS_WAY)
    if part is None or sum(c.met for c in part.criteria) <= sum(c.met for c in whole):
        return "No part of the range comes nearer. "
    return (
        f"Of its parts, d_r = {_short(part.low)} to {_short(part.high)} mm comes nearest: "
        f"{_found(part.criteria)}. "
    )


def _half_maximum(findings: Findings) -> Iterable[Conclusion]:
    curve = analysis.half_maximum_curve(findings)
    if curve is None:
        return
    d, radius = curve
    shared = analysis.ambiguous_range(d, radius)
    chosen = sorted({0, int(np.argmin(radius)), len(d) - 1})
    text = "It is " + _list([f"{number(radius[i], 3)} mm at d = {number(d[i])} mm" for i in chosen])
    if shared is not None:
        text += (
            f"; between {number(shared[0])} and {number(shared[1])} mm one radius belongs to "
            "several distances"
        )
    yield Conclusion(
        "half-maximum radius grows with distance",
        f"The lens's half-maximum radius {'grows' if shared is None else 'does not grow'} with "
        "distance all the way.",
        f"{text}.{_straightness(findings)}",
        shared is None,
    )


def _straightness(findings: Findings) -> str:
    """How straight d against e1' is for the lens, in the best way and in the paper's."""
    best = findings.plane_fits.get(("lens", SUBPIXEL))
    paper = findings.plane_fits.get(("lens", PAPERS_WAY))
    if best is None or paper is None:
        return ""
    edge, threshold = best[ALL_PLANES].r_squared, paper[ALL_PLANES].r_squared
    verdict = {
        (True, True): "both are straight",
        (True, False): "the edge gives a straight line, the threshold does not",
        (False, True): "the line is straight by threshold and exposure, not by the edge",
        (False, False): "neither is straight",
    }[edge > analysis.STRAIGHT, threshold > analysis.STRAIGHT]
    return (
        f" Sub-pixel mode follows it to {number(_rms_bias(findings), 2)} px (rms). A straight line "
        f"through its readings has R² {number(edge, 3)}, one through those of the fixed threshold "
        f"{number(threshold, 3)}: {verdict}."
    )


def _small_plane(findings: Findings) -> Iterable[Conclusion]:
    errors = [e for e in findings.analytic if e.model == "small_plane"]
    if not errors:
        return
    offs, leaving, staying = [], [], []
    for height, radius in _heights(errors):
        here = [e for e in errors if e.z_f_mm == height]
        spans = [
            f"{_span([e.error_mm for e in square], 3, sign=True)} mm at c = {c:g} mm"
            for c in CHOSEN_ECCENTRICITIES_MM
            if (square := square_rows(here, c=c))
        ]
        offs.append(f"{pinhole(height, radius)}: {_list(spans)}")
        limit = analysis.limit_eccentricity(here, ACCEPTABLE_ERROR_MM)
        if limit is None:
            staying.append(f"z_F = {height:g} mm")
        else:
            leaving.append(f"c = {number(limit, 1)} mm for z_F = {height:g} mm")
    headline = []
    if leaving:
        headline.append(f"leaves the acceptable {ACCEPTABLE_ERROR_MM:g} mm at {_list(leaving)}")
    if staying:
        most = max(e.c_mm for e in errors)
        headline.append(
            f"stays within {ACCEPTABLE_ERROR_MM:g} mm up to c = {most:g} mm for {_list(staying)}"
        )
    nearest, farthest = CHOSEN_DISTANCES_MM[0], CHOSEN_DISTANCES_MM[-1]
    yield Conclusion(
        "small_plane stays within the acceptable error",
        f"The paper's model {' and '.join(headline)}.",
        f"Its error with the cone known, the beam square to the wall and d from {nearest:g} to "
        f"{farthest:g} mm: {'; '.join(offs)}.",
        not leaving,
    )


def _other_models(findings: Findings) -> Iterable[Conclusion]:
    accuracy = [row for row in rendered_accuracy(findings.rendered) if row.model != "small_plane"]
    if not accuracy:
        return
    parts = []
    for height, radius in _heights(findings.rendered):
        rows = [row for row in accuracy if row.z_f_mm == height]
        sizes = _list([f"{row.model} {number(row.max_abs_error_mm, 3)}" for row in rows])
        parts.append(f"{pinhole(height, radius)}: {sizes} mm ({rows[0].spots} spots)")
    models = dict.fromkeys(row.model for row in accuracy)
    bad = {row.model for row in accuracy if row.max_abs_error_mm >= ACCEPTABLE_ERROR_MM}
    good = [model for model in models if model not in bad]
    headline = (
        f"{_list(good)} {'stays' if len(good) == 1 else 'stay'} within {ACCEPTABLE_ERROR_MM:g} mm "
        "on rendered spots"
        if good
        else f"No model stays within {ACCEPTABLE_ERROR_MM:g} mm on rendered spots"
    )
    if "stereographic" in bad:
        headline += ", stereographic only for a pinhole on the sphere"
    yield Conclusion(
        "the other models stay within the acceptable error",
        f"{headline[0].upper()}{headline[1:]}.",
        f"Largest errors on the ideal cone, sub-pixel mode: {'; '.join(parts)}.",
        not bad,
    )


def _fitted_eccentricity(findings: Findings) -> Iterable[Conclusion]:
    every = sphere_rows(findings)
    if not every:
        return
    smaller = sum(row.c_fitted_mm < row.c_true_mm for row in every)
    holds = smaller == len(every)
    key = ("cone", SUBPIXEL)
    if key not in findings.sphere_fits:
        key = every[0].source, every[0].way
    rows = [row for row in every if (row.source, row.way) == key]
    fitted, true, expected = (
        _list([number(value) for value in values])
        for values in zip(
            *((row.c_fitted_mm, row.c_true_mm, row.c_expected_mm) for row in rows), strict=True
        )
    )
    scene = next(t for t in findings.trials if t.kind == "sphere").scene
    where = pinhole(scene.microscope.pinhole_height_mm, scene.phantom.radius_mm)
    largest = number(max(row.max_error_mm for row in rows), 3)
    yield Conclusion(
        "fitted c is smaller than true c",
        f"The fitted c is smaller than the true one in {'all' if holds else f'{smaller} of'} "
        f"{len(every)} fits{': it hides an error of the model' if holds else ''}.",
        f"Fitted as in Table II ({key[0]}, {key[1]}), c comes out as {fitted} mm where it is "
        f"{true} mm; {expected} mm make the paper's cos φ equal to the right factor for this "
        f"pinhole ({where}). The residuals, {largest} mm at most, are no test of the model.",
        holds,
    )


def _cone_returned(findings: Findings) -> Iterable[Conclusion]:
    fits = findings.plane_fits.get(("cone", SUBPIXEL))
    if fits is None:
        return
    trial, fit = _first_plane(findings, "cone"), fits[ALL_PLANES]
    source = trial.scene.source
    contact = findings.tracked[trial.name, SUBPIXEL].labels[0].d_mm
    slope = 100 * (fit.delta_k / (trial.scene.microscope.scale_mm_px * source.cone_k) - 1)
    b = fit.b - (source.cone_apex_offset_mm - contact)
    yield Conclusion(
        "the ideal cone is returned",
        f"Sub-pixel mode returns the ideal cone with δk {number(slope, 2, sign=True)} % and b "
        f"{number(b, 3, sign=True)} mm off.",
        f"The fitted b is {number(fit.b, 3)} mm, because d_r begins at contact, where the tip's "
        f"rim touches and its axis has {number(contact, 3)} mm to go.",
    )


def _left_out(findings: Findings) -> Iterable[Conclusion]:
    outcomes: dict[str, list[str]] = {}
    for (_, way), tracked in findings.tracked.items():
        outcomes.setdefault(way, []).extend(tracked.outcomes)
    used = sum(found.count(USED) for found in outcomes.values())
    blind = [
        f"“{way}” sees no spot that counts in any of its {len(found)} frames"
        for way, found in outcomes.items()
        if USED not in found
    ]
    yield Conclusion(
        "frames left out",
        f"{used} of {sum(map(len, outcomes.values()))} measurements enter the fits.",
        f"{_list(blind)}." if blind else "",
    )


def _rms_bias(findings: Findings) -> float:
    """Of sub-pixel mode on the lens's planes, px."""
    tracked = [
        findings.tracked[trial.name, SUBPIXEL]
        for trial in findings.trials
        if (trial.source, trial.kind) == ("lens", "plane")
    ]
    bias = np.concatenate([t.semi_minor_px - t.truth_px for t in tracked])
    return float(np.sqrt(np.mean(bias**2)))


def _first_plane(findings: Findings, source: str) -> Trial:
    return next(t for t in findings.trials if (t.source, t.kind) == (source, "plane"))


def _heights(errors: Sequence[ModelError]) -> list[tuple[float, float]]:
    """Pinhole heights with the eye's radius, in order."""
    return list(dict.fromkeys((e.z_f_mm, e.r_mm) for e in errors))


def _found(criteria: Sequence[analysis.Criterion]) -> str:
    return ", ".join(f"{c.quantity} {_span(c.values, c.digits)}{c.unit}" for c in criteria)


def _asked(criteria: Sequence[analysis.Criterion]) -> str:
    return ", ".join(f"{c.quantity} {_short(c.low)} to {_short(c.high)}{c.unit}" for c in criteria)


def _short(value: float) -> str:
    return f"{value:g}".replace("-", "−")


def _span(values: Sequence[float], digits: int, *, sign: bool = False) -> str:
    """Range of values, the one nearest to zero first."""
    ordered = sorted(values, key=abs)
    low, high = (number(v, digits, sign=sign) for v in (ordered[0], ordered[-1]))
    return low if low == high else f"{low} to {high}"


def _list(words: Sequence[str]) -> str:
    return " and ".join(words) if len(words) < 3 else f"{', '.join(words[:-1])} and {words[-1]}"
