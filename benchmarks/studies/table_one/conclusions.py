"""What the study of Table I found, in sentences whose numbers are this run's."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks.evaluation import LITERAL, SUBPIXEL, TABLE_I, PlaneRow, fit_lines
from benchmarks.studies.table_one import causes, moments
from benchmarks.studies.table_one.rendered import Confirmed
from benchmarks.studies.table_one.run import Findings
from benchmarks.studies.table_one.scan import (
    ANYWHERE,
    AT_SCALE,
    FARTHEST_MM,
    SCALES_MM_PX,
    readings,
)
from benchmarks.studies.validate import ALL_PLANES, Conclusion, number

PAPERS_TRIALS = [row for name, row in TABLE_I.items() if name != ALL_PLANES]
_ROUNDED = PlaneRow(delta_k=0.0005, b=0.02, r_squared=0.002, rmse=0.005)
"""Distances from the printed pooled row that count as one."""
_LEAST_SHARE = 0.1


def conclusions(findings: Findings) -> Iterable[Conclusion]:
    """All statements of a run."""
    yield _reproduced(findings)
    yield _family(findings)
    yield _range(findings)
    yield from _failing(findings)
    yield _subpixel(findings)
    yield _consistency()
    yield _apart(findings)


def _reproduced(findings: Findings) -> Conclusion:
    best = findings.confirmed[0]
    told = "; ".join(
        f"{criterion.quantity} "
        + ", ".join(number(value, criterion.digits) for value in criterion.values)
        + f"{criterion.unit} ({'met' if criterion.met else 'not met'})"
        for criterion in best.criteria(LITERAL.name)
    )
    if best.reproduces:
        headline = f"Rendered and tracked literally, {lens_told(best)} reproduces Table I."
    elif best.straight:
        headline = (
            f"Rendered and tracked literally, {lens_told(best)} gives the line of Table I, with "
            "less scatter than the paper's."
        )
    else:
        headline = "Rendered and tracked literally, no lens tried reproduces Table I."
    return Conclusion(
        "table I",
        headline,
        f"{_upper(lens_told(best))}, threshold at {number(best.choice.level)} of the "
        f"peak at 5 mm, readings from {best.choice.from_mm:g} to {best.choice.to_mm:g} mm: {told}.",
        holds=best.reproduces,
    )


def _family(findings: Findings) -> Conclusion:
    fitting = sorted(
        (c for c in findings.asked(AT_SCALE) if c.miss <= 1), key=lambda c: (c.family, c.level)
    )
    anywhere = [c for c in findings.asked(ANYWHERE) if c.miss <= 1]
    scale = findings.scene.microscope.scale_mm_px
    listed = "; ".join(
        f"NA {number(c.numerical_aperture)}, sag {number(c.sag_mm, 3)} mm, threshold "
        f"{number(c.level)}, up to {c.to_mm:g} mm"
        for c in fitting
    )
    return Conclusion(
        "lenses",
        f"{len(fitting)} of {len(findings.isophotes)} lenses give Table I's line from contact, all "
        f"with caps of {number(max((c.sag_mm for c in fitting), default=np.nan), 3)} mm and less.",
        f"At {scale:g} mm/px: {listed or 'none'}. Where neither the scale (between "
        f"{SCALES_MM_PX[0]:g} and {SCALES_MM_PX[1]:g} mm/px) nor the distances (up to "
        f"{FARTHEST_MM:g} mm) are known, {len(anywhere)} lenses do: the table alone does not tell "
        "the lens.",
    )


def _range(findings: Findings) -> Conclusion:
    best = findings.confirmed[0].choice
    isophotes = findings.isophotes[best.family]
    told = []
    for end in (best.to_mm, 4.5, 6.0):
        d_r = readings(0.0, end)
        radius = isophotes.radius(d_r, level=np.full_like(d_r, best.level))
        line = fit_lines(np.where(radius > 0, radius, np.nan) / best.scale_mm_px, d_r)
        told.append(
            f"to {end:g} mm δk {number(float(line.delta_k), 4)} mm/px, b "
            f"{number(float(line.b))} mm, R² {number(float(line.r_squared), 3)}, RMSE "
            f"{number(float(line.rmse), 3)} mm"
        )
    return Conclusion(
        "range",
        f"The line is that of readings from {best.from_mm:g} to {best.to_mm:g} mm.",
        f"The same lens and threshold from contact: {'; '.join(told)}. The table's own R² and RMSE "
        "say that its trials span "
        + ", ".join(number(moments.even_span(row), 1) for row in PAPERS_TRIALS)
        + " mm, if their readings are evenly spaced.",
    )


def _failing(findings: Findings) -> Iterable[Conclusion]:
    failing = [one for one in findings.confirmed if not one.straight]
    if not failing:
        return
    told = []
    for one in failing:
        pooled = one.lines[LITERAL.name, ALL_PLANES]
        told.append(
            f"{lens_told(one)}: δk {number(pooled.delta_k_mm_px, 4)} mm/px, b "
            f"{number(pooled.b_mm)} mm, R² {number(pooled.r_squared, 3)}"
        )
    yield Conclusion(
        "lenses that fail",
        f"{len(failing)} of the {len(findings.confirmed)} lenses rendered fail at their best "
        "threshold and range.",
        "Literal mode, all planes: " + "; ".join(told) + ".",
    )


def _subpixel(findings: Findings) -> Conclusion:
    best = findings.confirmed[0]
    fits = {way: best.lines[way, ALL_PLANES] for way in (LITERAL.name, SUBPIXEL.name)}
    literal, half = fits[LITERAL.name], fits[SUBPIXEL.name]
    return Conclusion(
        "sub-pixel mode",
        f"The same lens in sub-pixel mode: δk {number(half.delta_k_mm_px, 4)} mm/px, b "
        f"{number(half.b_mm)} mm, R² {number(half.r_squared, 3)}.",
        f"Literal mode on the same light: δk {number(literal.delta_k_mm_px, 4)} mm/px, b "
        f"{number(literal.b_mm)} mm, R² {number(literal.r_squared, 3)}. The fixed threshold "
        "measures brightness along with size; the half maximum of each frame does not, and it "
        f"is least at a reading of {number(findings.marks[0].half_maximum_turns_at_mm, 1)} mm.",
    )


def _consistency() -> Conclusion:
    printed = TABLE_I[ALL_PLANES]
    even = moments.from_contact(PAPERS_TRIALS, weights=(1, 1, 1)).row
    best = moments.best_from_contact(PAPERS_TRIALS, least_share=_LEAST_SHARE)
    nearest = moments.nearest(PAPERS_TRIALS, printed, tolerance=_ROUNDED)
    holds = best.row.r_squared >= printed.r_squared - _ROUNDED.r_squared
    return Conclusion(
        "the table itself",
        "Table I's pooled row can be that of its three trials from contact."
        if holds
        else "Table I's pooled row is not that of its three trials from contact.",
        f"The trials' own moments, evenly spaced from contact and of like size, pool to R² "
        f"{number(even.r_squared, 3)} and RMSE {number(even.rmse, 3)} mm, and with the best share "
        f"of spots for each ({_LEAST_SHARE:.0%} or more) to {number(best.row.r_squared, 3)} and "
        f"{number(best.row.rmse, 3)} mm; printed are {number(printed.r_squared, 3)} and "
        f"{number(printed.rmse, 3)} mm. Nearest to it come mean readings of "
        + ", ".join(number(mean, 1) for mean in nearest.means)
        + " mm with "
        + ", ".join(number(100 * weight, 0) for weight in nearest.weights)
        + f" % of the spots: R² {number(nearest.row.r_squared, 3)}, RMSE "
        f"{number(nearest.row.rmse, 3)} mm. No lens enters this.",
        holds=holds,
    )


def _apart(findings: Findings) -> Conclusion:
    first, second, third = PAPERS_TRIALS
    contacts = [-row.b / row.delta_k for row in PAPERS_TRIALS]
    rendered = ", ".join(
        number(line.delta_k_mm_px, 4)
        for (way, trial), line in findings.confirmed[0].lines.items()
        if way == LITERAL.name and trial != ALL_PLANES
    )
    ratios, touches = zip(
        *(causes.light_and_touch(row, second) for row in (first, third)), strict=True
    )
    light = max(
        abs(c.contact_radius_change_px) for c in findings.causes if c.cause.endswith("light")
    )
    apart = (
        "Light can set δk apart, but not −b/δk:"
        if light < np.ptp(contacts) / 3
        else "Light can set both δk and −b/δk apart; if it did not,"
    )
    return Conclusion(
        "trials apart",
        f"{apart} point 1 needs {number(abs(touches[0]))} mm of missed touch against point 2, "
        f"point 3 {number(abs(touches[1]))} mm.",
        "Light, and with it the tilt and the picture on the wall, moves δk and b alike: a fifth "
        f"more or less moves −b/δk by {number(light, 1)} px at most. Touch moves b alone. Against "
        f"point 2, point 1 has δk {number(100 * (ratios[0] - 1), 1, sign=True)} % and −b/δk "
        f"{number(contacts[0] - contacts[1], 1, sign=True)} px, point 3 "
        f"{number(100 * (ratios[1] - 1), 1, sign=True)} % and "
        f"{number(contacts[2] - contacts[1], 1, sign=True)} px. The rendered trials of the best "
        f"lens, on three places of one picture and touched exactly, have δk of {rendered} mm/px.",
    )


def lens_told(one: Confirmed) -> str:
    """The lens in words."""
    choice = one.choice
    cap = "a flat end" if choice.sag_mm == 0 else f"a cap of {number(choice.sag_mm, 3)} mm"
    return f"a lens of NA {number(choice.numerical_aperture)} with {cap}"


def _upper(text: str) -> str:
    return text[0].upper() + text[1:]
