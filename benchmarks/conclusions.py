"""What was found, in sentences whose numbers and verdicts are computed from the findings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks import analysis
from benchmarks.model_error import ModelError
from benchmarks.paper import ACCEPTABLE_ERROR_MM
from benchmarks.tables import ALL_PLANES, rendered_accuracy, sphere_rows, square_rows
from benchmarks.tracking import USED, WAYS
from benchmarks.trials import Trial
from benchmarks.validate import SUBPIXEL, Findings

CHOSEN_ECCENTRICITIES_MM = (3.0, 5.0)
"""Where the text and the tables say how wrong the models are."""
PAPERS_WAY = next(way.name for way in WAYS if way.exposure == "paper")


class Conclusion(NamedTuple):
    """A statement about the run.

    Attributes:
        title: what it is about.
        text: one or a few sentences.
        holds: which way it fell, where it is a question of yes or no.
    """

    title: str
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
        got = "; ".join(
            f"{c.quantity} {_span(c.values, c.digits)}{c.unit} ({'' if c.met else 'not '}within "
            f"{number(c.low, c.digits)} to {number(c.high, c.digits)})"
            for c in criteria
        )
        missed = [c.quantity for c in criteria if not c.met]
        holds = not missed
        verdict = "reproduces" if holds else "does not reproduce"
        why = "all demands are met" if holds else f"it fails on {_list(missed)}"
        text = (
            f"The {source_name(findings, source)}, measured as the paper does ({PAPERS_WAY}), "
            f"{verdict} Table I: {why}. {got}."
        )
        if source == "cone":
            text += " A cone is what the table assumes, so this shows what the measuring changes."
        yield Conclusion("Table I", text, holds)


def _half_maximum(findings: Findings) -> Iterable[Conclusion]:
    curve = analysis.half_maximum_curve(findings)
    if curve is None:
        return
    d, radius = curve
    name = source_name(findings, "lens")
    shared = analysis.ambiguous_range(d, radius)
    least = int(np.argmin(radius))
    chosen = dict.fromkeys((0, least, len(d) - 1))
    points = ", ".join(f"{number(radius[i], 3)} mm at d = {number(d[i])} mm" for i in chosen)
    if shared is None:
        text = f"The half-maximum radius of the {name} grows with distance all the way: {points}."
    else:
        text = (
            f"The half-maximum radius of the {name} does not grow with distance all the way: "
            f"{points}. Between {number(shared[0])} and {number(shared[1])} mm one radius belongs "
            "to several distances, whatever measures it."
        )
    yield Conclusion("The edge at half maximum", text + _straightness(findings), shared is None)


def _straightness(findings: Findings) -> str:
    """How straight d against e1' is for the lens, in the best way and in the paper's."""
    best = findings.plane_fits.get(("lens", SUBPIXEL))
    if best is None:
        return ""
    text = (
        f" Sub-pixel mode follows that radius to {number(_rms_bias(findings), 3)} px (rms), and a "
        f"straight line through its readings has an RMSE of {number(best[ALL_PLANES].rmse, 3)} mm"
    )
    paper = findings.plane_fits.get(("lens", PAPERS_WAY))
    if paper is None:
        return text + "."
    text += f"; through those of the fixed threshold, {number(paper[ALL_PLANES].rmse, 3)} mm"
    if paper[ALL_PLANES].rmse < best[ALL_PLANES].rmse:
        text += (
            ". So the straight line comes from the threshold and the exposure, not from the edge"
        )
    return text + "."


def _small_plane(findings: Findings) -> Iterable[Conclusion]:
    errors = [e for e in findings.analytic if e.model == "small_plane"]
    offs, leaving, staying = [], [], []
    for height, radius in _heights(errors):
        spans = []
        for c in CHOSEN_ECCENTRICITIES_MM:
            square = [e for e in square_rows(errors, c=c) if e.z_f_mm == height]
            if square:
                size = _span([e.error_mm for e in square], 3, sign=True)
                nearest, farthest = (f([e.d_mm for e in square]) for f in (min, max))
                spans.append(f"{size} mm at c = {c:g} mm")
        if spans:
            offs.append(f"{' and '.join(spans)} ({pinhole(height, radius)})")
        limit = analysis.limit_eccentricity(
            [e for e in errors if e.z_f_mm == height], ACCEPTABLE_ERROR_MM
        )
        if limit is None:
            staying.append(f"z_F = {height:g} mm")
        else:
            leaving.append(f"at c = {number(limit, 1)} mm for z_F = {height:g} mm")
    if not offs:
        return
    text = (
        f"With the cone known, the beam square to the wall and d from {nearest:g} to {farthest:g} "
        f"mm, the paper's model is off by {'; by '.join(offs)}. "
    )
    if leaving:
        text += f"It leaves the {ACCEPTABLE_ERROR_MM:g} mm that the paper calls acceptable "
        text += f"{_list(leaving)}. "
    if staying:
        farthest_c = max(e.c_mm for e in errors)
        text += f"It stays within {ACCEPTABLE_ERROR_MM:g} mm up to c = {farthest_c:g} mm for "
        text += f"{_list(staying)}. "
    yield Conclusion("The small-plane model", text.strip(), not leaving)


def _other_models(findings: Findings) -> Iterable[Conclusion]:
    accuracy = [row for row in rendered_accuracy(findings.rendered) if row.model != "small_plane"]
    if not accuracy:
        return
    parts = []
    for height, radius in _heights(findings.rendered):
        rows = [row for row in accuracy if row.z_f_mm == height]
        sizes = ", ".join(f"{row.model} {number(row.max_abs_error_mm, 3)}" for row in rows)
        parts.append(f"{sizes} mm in {rows[0].spots} spots ({pinhole(height, radius)})")
    models = list(dict.fromkeys(row.model for row in accuracy))
    bad = {row.model for row in accuracy if row.max_abs_error_mm >= ACCEPTABLE_ERROR_MM}
    good = [model for model in models if model not in bad]
    text = f"Largest errors on rendered spots of the ideal cone: {'; '.join(parts)}. "
    if good:
        stay = "stays" if len(good) == 1 else "stay"
        text += f"At every pinhole height {_list(good)} {stay} within {ACCEPTABLE_ERROR_MM:g} mm"
    else:
        text += f"None stays within {ACCEPTABLE_ERROR_MM:g} mm at every pinhole height"
    if "stereographic" in bad:
        text += "; stereographic holds only for a pinhole on the sphere"
    yield Conclusion("The other models", f"{text}.", not bad)


def _fitted_eccentricity(findings: Findings) -> Iterable[Conclusion]:
    every = sphere_rows(findings)
    key = ("cone", SUBPIXEL)
    if key not in findings.sphere_fits:
        key = next(iter(findings.sphere_fits), ("", ""))
    rows = [row for row in every if (row.source, row.way) == key]
    if not rows:
        return
    pairs = _list(
        [f"{number(row.c_fitted_mm)} mm where it is {number(row.c_true_mm)}" for row in rows]
    )
    expected = _list([number(row.c_expected_mm) for row in rows])
    scene = next(t for t in findings.trials if t.kind == "sphere").scene
    where = pinhole(scene.microscope.pinhole_height_mm, scene.phantom.radius_mm)
    largest = number(max(row.max_error_mm for row in rows), 3)
    text = f"Fitted as in Table II ({key[0]}, {key[1]}), c comes out as {pairs} mm. "
    smaller = all(row.c_fitted_mm < row.c_true_mm for row in rows)
    if smaller:
        text += (
            f"The paper's cos φ is too small a factor for this pinhole ({where}), and the fit "
            f"makes up for it with a smaller c: {expected} mm are expected. The model's error "
            f"hides there, and the residuals, {largest} mm at most, do not show it."
        )
    else:
        text += (
            f"It is not smaller than the true c throughout, as the pinhole ({where}) would have "
            f"it: {expected} mm are expected. The residuals are {largest} mm at most."
        )
    yield Conclusion("The fitted eccentricity", text, smaller)


def _cone_returned(findings: Findings) -> Iterable[Conclusion]:
    fits = findings.plane_fits.get(("cone", SUBPIXEL))
    if fits is None:
        return
    trial, fit = _first_plane(findings, "cone"), fits[ALL_PLANES]
    source = trial.scene.source
    contact = findings.tracked[trial.name, SUBPIXEL].labels[0].d_mm
    delta_k = trial.scene.microscope.scale_mm_px * source.cone_k
    b = source.cone_apex_offset_mm - contact
    yield Conclusion(
        "What went in comes out",
        f"On the plane the ideal cone comes back from sub-pixel mode with δk = "
        f"{number(fit.delta_k, 5)} mm/px, {number(100 * (fit.delta_k / delta_k - 1), 2, sign=True)}"
        f" % off, and b = {number(fit.b, 3)} mm, {number(fit.b - b, 3, sign=True)} mm off: d_r "
        f"begins where the tip's rim touches and its axis has {number(contact, 3)} mm to go, which "
        f"the fit must add to {number(source.cone_apex_offset_mm, 3)} mm.",
    )


def _left_out(findings: Findings) -> Iterable[Conclusion]:
    outcomes = {
        way.name: [
            outcome
            for (_, name), tracked in findings.tracked.items()
            if name == way.name
            for outcome in tracked.outcomes
        ]
        for way in WAYS
    }
    total = sum(map(len, outcomes.values()))
    used = sum(o.count(USED) for o in outcomes.values())
    text = f"{used} of {total} measurements enter the fits and comparisons."
    for name, found in outcomes.items():
        if found and USED not in found:
            text += f" “{name}” yields no spot that counts in any of its {len(found)} frames."
    yield Conclusion("Frames left out", text)


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


def _span(values: Sequence[float], digits: int, *, sign: bool = False) -> str:
    """Range of values, the one nearest to zero first."""
    ordered = sorted(values, key=abs)
    low, high = (number(v, digits, sign=sign) for v in (ordered[0], ordered[-1]))
    return low if low == high else f"{low} to {high}"


def _list(words: Sequence[str]) -> str:
    return " and ".join(words) if len(words) < 3 else f"{', '.join(words[:-1])} and {words[-1]}"
