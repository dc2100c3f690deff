"""The report of the study of media."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, NamedTuple

import numpy as np

import optics
from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, largest, mean, rms
from benchmarks.reporting import Claim, Column, Picture, Report, Section, Table, frame_of
from benchmarks.studies.medium import figures
from benchmarks.studies.medium.findings import (
    AIR,
    CONE,
    FARTHEST_MM,
    NEAREST_MM,
    VITREOUS,
    MediumError,
    MediumFindings,
    Method,
    Regression,
)


class ErrorSummary(NamedTuple):
    """Errors of one method in one medium, over all distances."""

    source: Annotated[str, Column("source")]
    light: Annotated[str, Column("light")]
    medium: Annotated[str, Column("medium")]
    method: Annotated[Method, Column("method")]
    spots: Annotated[int, Column("spots")]
    mean_mm: Annotated[float, Column("mean, mm")]
    rms_mm: Annotated[float, Column("rms, mm")]
    largest_mm: Annotated[float, Column("largest, mm")]
    ambiguous: Annotated[float, Column("ambiguous, %", scale=100)]


def report(findings: MediumFindings) -> Report:
    """The report of a run."""
    indices = ", ".join(f"{medium} {float(optics.MEDIA[medium]):g}" for medium in (AIR, VITREOUS))
    return Report(
        title="How large is the error of a calibration in air when it is used in vitreous?",
        lead="The cone fitted to a glue lens in air is used in vitreous, and compared with the "
        "lens model for the same spots, which needs no other fit. The control is an ideal cone, "
        "whose light no medium refracts.",
        claims=list(_claims(findings)),
        sections=[
            Section(
                "Error against distance",
                Picture(
                    "error",
                    figures.error_figure(findings),
                    "Error of the distance. Lines: computed from the lens's light on a square "
                    "plane. Marks: rendered frames of an eyeball (incidence "
                    f"{findings.scene.spot.incidence_deg:g}°), with the cone fitted to rendered "
                    "frames of a plane in air. Squares are in air; open circles are flagged "
                    "ambiguous. In the grey bands one radius belongs to several distances; the "
                    "dotted green line is the solution farthest from the truth. Dashed: the "
                    f"clinically acceptable {ACCEPTABLE_ERROR_MM:g} mm.",
                    data="medium_error.csv",
                ),
                Table.of_rows(
                    ErrorSummary,
                    _summaries(findings),
                    f"Errors over d = {NEAREST_MM:g} to {FARTHEST_MM:g} mm.",
                    data="medium_error.csv",
                ),
                _METHODS,
            ),
            Section(
                "Why",
                Picture(
                    "radius",
                    figures.radius_figure(findings),
                    "Half-maximum radius of each light in each medium, and the cone that a "
                    "regression makes of it (dashed).",
                    data="medium_cones.csv",
                ),
                Table.of_rows(
                    Regression,
                    findings.regressions,
                    f"Cones d = kR + b of the half-maximum radius over d = {NEAREST_MM:g} to "
                    f"{FARTHEST_MM:g} mm, and the distances between which one radius belongs to "
                    f"several. Refractive indices: {indices}.",
                    data="medium_cones.csv",
                ),
            ),
        ],
        data={
            "medium_error.csv": frame_of(MediumError, findings.rows),
            "medium_cones.csv": frame_of(Regression, findings.regressions),
        },
    )


_METHODS = (
    f"“{Method.AIR_CONE}”: d = kR + b with k and b from air. “{Method.LENS_CONE}”: k and b "
    f"computed for vitreous from the lens's parameters. “{Method.LENS}”: the distance at which the "
    "lens makes this spot in vitreous. On its own curve the lens model has no error by "
    "construction if only one distance has this radius, so its lines show only the ambiguity. Its "
    "rendered marks show its accuracy, because there the shape of the profile also contributes. "
    "The lens's parameters are those of the scene, without the uncertainty of a fit in air."
)


def _claims(findings: MediumFindings) -> Iterator[Claim]:
    lenses = [light for light in findings.lights if light != CONE]
    for lens in lenses:
        air, vitreous = (findings.curves[lens, medium].regression for medium in (AIR, VITREOUS))
        yield Claim(
            name=f"air to vitreous, {lens}",
            sentence="Calibrated in air, the distance in vitreous is off by up to {value:.2f} mm "
            "(acceptable: {high:g} mm). In air it is off by up to {in_air:.2f} mm, because a lens "
            "is no cone. In vitreous k is {vitreous.k:.1f} instead of {air.k:.1f} and b is "
            "{vitreous.b_mm:.2f} instead of {air.b_mm:.2f} mm. The cone that the lens model "
            "computes for vitreous is off by up to {lens_cone:.2f} mm.",
            value=largest(findings.errors("analytic", lens, VITREOUS, Method.AIR_CONE)),
            high=ACCEPTABLE_ERROR_MM,
            numbers={
                "in_air": largest(findings.errors("analytic", lens, AIR, Method.AIR_CONE)),
                "air": air,
                "vitreous": vitreous,
                "lens_cone": largest(findings.errors("analytic", lens, VITREOUS, Method.LENS_CONE)),
            },
        )
    for lens in lenses:
        yield _lens_model(findings, lens)
    yield _control(findings)


def _lens_model(findings: MediumFindings, lens: str) -> Claim:
    rows = findings.some("rendered", lens, VITREOUS, Method.LENS)
    sure = [abs(r.error_mm) for r in rows if not r.ambiguous and math.isfinite(r.error_mm)]
    cone = np.abs(findings.errors("rendered", lens, VITREOUS, Method.AIR_CONE))
    return Claim(
        name=f"lens model, {lens}",
        sentence="In rendered vitreous the lens model is off by {value:.3f} mm and the cone of air "
        "by {cone:.2f} mm (medians). Of {spots} spots {ambiguous} are flagged ambiguous and "
        "{unanswered} have no answer. Of the other {sure} spots {beyond} are off by more than "
        "{limit:g} mm, the worst by {worst:.3f} mm.",
        value=float(np.median(sure)) if sure else math.nan,
        numbers={
            "cone": float(np.median(cone)),
            "spots": len(rows),
            "ambiguous": sum(row.ambiguous for row in rows),
            "unanswered": sum(not math.isfinite(row.error_mm) for row in rows),
            "sure": len(sure),
            "beyond": sum(error > ACCEPTABLE_ERROR_MM for error in sure),
            "limit": ACCEPTABLE_ERROR_MM,
            "worst": largest(sure),
        },
    )


def _control(findings: MediumFindings) -> Claim:
    air, vitreous = (
        {r.d_mm: r.error_mm for r in findings.some("rendered", CONE, m, Method.AIR_CONE)}
        for m in (AIR, VITREOUS)
    )
    differences = [vitreous[d] - air[d] for d in air.keys() & vitreous.keys()]
    return Claim(
        name="control",
        sentence="The ideal cone's rendered distances differ by {value:.4f} mm at most between the "
        "media ({pairs} pairs of frames of the same seed). No medium refracts the cone, so any "
        "difference would be an error of the study itself.",
        value=largest(differences),
        numbers={"pairs": len(differences)},
    )


def _summaries(findings: MediumFindings) -> Iterator[ErrorSummary]:
    for key in dict.fromkeys(row[:4] for row in findings.rows):
        rows = findings.some(*key)
        errors = [row.error_mm for row in rows]
        ambiguous = mean(row.ambiguous for row in rows)
        yield ErrorSummary(*key, len(rows), mean(errors), rms(errors), largest(errors), ambiguous)
