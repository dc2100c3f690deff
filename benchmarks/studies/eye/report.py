"""The report of the study of eyes."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from benchmarks.reporting import Claim, Picture, Report, Section, Table, frame_of
from benchmarks.studies.eye import figures
from benchmarks.studies.eye.findings import (
    LIMITS_MM,
    REFRACTIONS_D,
    EyeFindings,
    EyeRow,
    Limit,
    PathRow,
    Share,
    Summary,
)
from benchmarks.studies.eye.geometry import NOMINAL_RADIUS_MM
from benchmarks.studies.eye.recipes import WITHDRAWALS_C_MM, Recipe


def report(findings: EyeFindings) -> Report:
    """The report of a run."""
    limits = findings.limits()
    return Report(
        title="How wrong is the distance when the microscope looks through the eye's own optics?",
        lead=f"Exact spots of a cone (k 20, b −5.117 mm) in {findings.population} random eyes of a "
        "healthy adult population (Rozema et al. 2016) and in schematic eyes, seen by a microscope "
        "through a viewing lens, the cornea and the crystalline or an artificial lens. Each recipe "
        "says what has to be known of the eye. Errors are the largest over the distances and, "
        "where tilted, over tilts of 30° in three directions; the beam's direction is known.",
        claims=list(_claims(findings, limits)),
        sections=[
            Section(
                "Error against eccentricity",
                Picture(
                    "error",
                    figures.error_figure(findings),
                    "Largest error of 95 % of the eyes. Left: perpendicular beams; right: tilted, "
                    "too. Grey: the largest c that a pupil of 7 mm shows (5 to 95 % of the eyes); "
                    "spots beyond it are computed as if the iris were open. Dashed: 0.1 and "
                    "0.5 mm. A line ends where fewer than 95 % of the eyes show a whole spot.",
                    data="eye_errors.csv",
                ),
                Table.of_rows(
                    Limit,
                    limits,
                    "c in mm up to which half and 95 % of the eyes stay within 0.1 and 0.5 mm: "
                    "perpendicular beams (square), and tilted ones, too (any). Empty if the limit "
                    "is exceeded at c = 0. No c is counted at which fewer than 95 % of the eyes "
                    "show the whole spot: an artificial lens ends within the pupil.",
                    data="limits.csv",
                ),
                _RECIPES,
            ),
            Section(
                "The pinhole that stands for an eye",
                Picture(
                    "kappa",
                    figures.kappa_figure(findings),
                    "Reciprocal working distance κ = 1/(z_F + r) fitted in each random eye. "
                    "Dotted: that of the paraxial pinhole of Navarro's eye. Negative: the pinhole "
                    "lies behind the retina.",
                    data="eyes.csv",
                ),
                Table.of_rows(
                    PathRow,
                    findings.path_rows(),
                    "Pinholes, and the largest c that a dilated pupil of 7 mm shows.",
                    data="eyes.csv",
                ),
                Table.of_rows(
                    EyeRow,
                    findings.schematic_rows(),
                    "Schematic eyes: fitted κ, field, and largest |error| at c = 3 mm by the area "
                    "with the eye's own and with Navarro's pinhole. The random eyes have Navarro's "
                    "kind of lens, of one index; the lenses of the others have a gradient.",
                    data="eyes.csv",
                ),
            ),
            Section(
                "Why",
                Table.of_rows(
                    Share,
                    findings.causes,
                    f"Shapley's shares in the error of 95 % of the eyes, {findings.causes_path}, "
                    "tilted beams included. The first row of each block is the error in the mean "
                    "eye without noise, which the shares add to.",
                    data="causes.csv",
                ),
            ),
        ],
        data={
            "eye_errors.csv": frame_of(Summary, findings.summaries()),
            "limits.csv": frame_of(Limit, limits),
            "eyes.csv": frame_of(EyeRow, findings.eye_rows()),
            "causes.csv": frame_of(Share, findings.causes),
        },
    )


_RECIPES = (
    f"“{Recipe.SMALL_PLANE}” is the paper's; like “{Recipe.PLANAR}” and “{Recipe.STEREOGRAPHIC}” "
    f"it knows nothing of the eye but a sphere of {NOMINAL_RADIUS_MM:g} mm. "
    f"“{Recipe.PARAXIAL}” and “{Recipe.LOCAL}” take the "
    "pinhole or the magnification from Navarro's eye behind the same viewing lens. "
    f"“{Recipe.FITTED}” and “{Recipe.AREA}” fit δ, κ and the radius of a sphere in the eye itself, "
    f"from three withdrawals at c = {', '.join(f'{c:g}' for c in WITHDRAWALS_C_MM)} mm with nine "
    "frames each, like `eyespot fit --model eye`: the robot's axis known, 25° from the retina's "
    "normal and sideways; 0.1 px of noise on the centre and each semi-axis and 0.05 mm on each "
    "touch. "
    f"“{Recipe.EXACT_SCHEMATIC}” traces the spot through Navarro's eye onto its retina. "
    f"“{Recipe.AREA_SCHEMATIC}” uses the pinhole and the sphere that this fit finds in Navarro's "
    "eye. The recipes with “area” or “exact” look for the exact spot that has the ellipse's centre "
    "and area. The others use the semi-minor axis, know c and assume a perpendicular beam."
)


def _claims(findings: EyeFindings, limits: list[Limit]) -> Iterator[Claim]:
    for path, row in zip(findings.paths, findings.path_rows(), strict=True):
        tilted = {r.recipe: r for r in limits if r.path == path and r.tilt == "any"}
        yield Claim(
            name=f"within {LIMITS_MM[0]:g} mm, {path}",
            sentence="Through {path}, 95 % of the eyes stay within {limit:g} mm up to c = "
            "{value:.1f} mm with a pinhole fitted in the eye and the ellipse's area, up to "
            "{schematic:.1f} mm with the pinhole of Navarro's eye, and up to {small:.1f} mm with "
            "small_plane. A pupil of 7 mm shows c = {field:.1f} mm (median).",
            value=_or_zero(tilted[Recipe.AREA].within_0_1_mm),
            numbers={
                "path": path,
                "limit": LIMITS_MM[0],
                "schematic": _or_zero(tilted[Recipe.AREA_SCHEMATIC].within_0_1_mm),
                "small": _or_zero(tilted[Recipe.SMALL_PLANE].within_0_1_mm),
                "field": row.field,
            },
        )
    gradient = [row for row in findings.schematic_rows() if row.eye != "navarro"]
    for path in findings.paths if gradient else ():
        yield _gradient_lenses(path, [row for row in gradient if row.path == path])
    yield _small_plane(findings)
    yield _largest_cause(findings)


def _gradient_lenses(path: str, rows: list[EyeRow]) -> Claim:
    own, navarros = (
        [getattr(row, name) for row in rows if math.isfinite(getattr(row, name))]
        for name in ("fitted_error_mm", "schematic_error_mm")
    )
    return Claim(
        name=f"other schematic eyes, {path}",
        sentence="Through {path}, at c = 3 mm, the schematic eyes with a gradient lens (Liou and "
        "Brennan, Atchison from {low:g} to {high:g} D) are off by up to {value:.3f} mm with their "
        "own pinhole and the area, and by up to {navarro:.2f} mm with Navarro's pinhole.",
        value=max(own, default=math.nan),
        numbers={
            "path": path,
            "low": min(REFRACTIONS_D),
            "high": max(REFRACTIONS_D),
            "navarro": max(navarros, default=math.nan),
        },
    )


def _small_plane(findings: EyeFindings) -> Claim:
    c = 3.0
    place = int(np.flatnonzero(findings.eccentricities == c)[0])
    medians = {
        path: np.nanmedian(found.errors[Recipe.SMALL_PLANE][findings.random, place, :, 0], axis=0)
        for path, found in findings.paths.items()
    }
    worst = {path: float(m[np.argmax(np.abs(m))]) for path, m in medians.items()}
    return Claim(
        name="small_plane at c = 3",
        sentence="At c = {c:g} mm and a perpendicular beam small_plane errs by {listed} (median of "
        "the eyes at the worst distance).",
        value=tuple(worst.values()),
        numbers={"c": c, "listed": "; ".join(f"{e:+.2f} mm, {p}" for p, e in worst.items())},
    )


def _largest_cause(findings: EyeFindings) -> Claim:
    rows = [r for r in findings.causes if r.recipe == Recipe.AREA and r.c_mm == 3.0]
    largest = max(rows, key=lambda row: row.share_mm)
    return Claim(
        name="largest remaining cause",
        sentence="With the fitted pinhole and the area the largest share of what remains at "
        "c = {row.c_mm:g} mm is {value:.3f} mm: {row.cause} ({path}).",
        value=largest.share_mm,
        numbers={"row": largest, "path": findings.causes_path},
    )


def _or_zero(c: float) -> float:
    """A limit that is exceeded at c = 0 is kept up to 0."""
    return 0.0 if math.isnan(c) else c
