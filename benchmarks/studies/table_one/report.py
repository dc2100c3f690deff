"""The report on Table I: tables and the figure, all from this run's numbers."""

from __future__ import annotations

import matplotlib

from benchmarks.evaluation import TABLE_I
from benchmarks.reporting import Data, Picture, Report, Row, Section, Table
from benchmarks.studies.table_one.causes import Cause, Mark
from benchmarks.studies.table_one.conclusions import PAPERS_TRIALS, conclusions, lens_told
from benchmarks.studies.table_one.figure import figure
from benchmarks.studies.table_one.rendered import Line
from benchmarks.studies.table_one.run import Findings
from benchmarks.studies.table_one.scan import AT_SCALE, Choice
from benchmarks.studies.validate import figures, number


def report(findings: Findings) -> Report:
    """The report of a run."""
    with matplotlib.rc_context(figures.STYLE):
        return Report(
            title="Which lens gives the paper's Table I, and what sets its trials apart?",
            lead="A fixed threshold on the light of glue lenses: a scan of lenses, thresholds and "
            "distances in closed form, then the best lenses and some that fail on rendered stacks, "
            "tracked by the paper's algorithm and in sub-pixel mode.",
            found=list(conclusions(findings)),
            sections=[_lenses(findings), _rendered(findings), _trials(findings)],
            data=[
                Data("table_one_scan.csv", Choice, findings.choices),
                Data(
                    "table_one_rendered.csv",
                    Line,
                    [line for one in findings.confirmed for line in one.lines.values()],
                ),
                Data("table_one_marks.csv", Mark, findings.marks),
                Data("table_one_causes.csv", Cause, findings.causes),
            ],
        )


def _lenses(findings: Findings) -> Section:
    rows: list[Row] = [
        (
            number(c.numerical_aperture),
            number(c.sag_mm, 3),
            c.level,
            f"{c.from_mm:g} to {c.to_mm:g}",
            c.delta_k_mm_px,
            c.b_mm,
            c.r_squared,
            c.rmse_mm,
            c.miss,
        )
        for c in sorted(findings.asked(AT_SCALE), key=lambda c: c.miss)[:16]
    ]
    return Section(
        "Lenses",
        Picture(
            "table_one",
            figure(findings),
            "Left: the worst of what Table I asks, in units of its tolerance, for each lens at its "
            "best threshold and range near contact; below 1 the lens fits. Middle and right: "
            "spots on rendered planes (marks) of the fixed threshold and of the half maximum, and "
            "the same in closed form (lines); grey: the paper's three lines over the spans that "
            "their R² and RMSE imply, from contact.",
            data="table_one_scan.csv",
        ),
        Table(
            (
                "NA",
                "sag, mm",
                "threshold / peak at 5 mm",
                "d_r, mm",
                "δk, mm/px",
                "b, mm",
                "R²",
                "RMSE, mm",
                "worst / tolerance",
            ),
            rows,
            "The nearest lenses of the scan, in closed form, at the scene's scale.",
            digits=4,
            data="table_one_scan.csv",
        ),
    )


def _rendered(findings: Findings) -> Section:
    rows: list[Row] = [
        (
            lens_told(one),
            way,
            trial,
            line.delta_k_mm_px,
            line.b_mm,
            line.r_squared,
            line.rmse_mm,
            number(line.contact_radius_px, 1),
            line.spots,
        )
        for one in findings.confirmed
        for (way, trial), line in one.lines.items()
    ]
    rows += [
        ("paper", "", name, *row, number(-row.b / row.delta_k, 1), "")
        for name, row in TABLE_I.items()
    ]
    marks: list[Row] = [
        (
            lens_told(one),
            mark.contact_radius_px,
            mark.growth_px,
            mark.half_maximum_delta_k_mm_px,
            mark.half_maximum_b_mm,
            mark.half_maximum_r_squared,
            mark.half_maximum_turns_at_mm,
        )
        for one, mark in zip(findings.confirmed, findings.marks, strict=True)
    ]
    return Section(
        "Rendered",
        Table(
            (
                "lens",
                "way",
                "trial",
                "δk, mm/px",
                "b, mm",
                "R²",
                "RMSE, mm",
                "−b/δk, px",
                "spots",
            ),
            rows,
            "Lines through the spots of rendered trials, beside the paper's.",
            digits=4,
            data="table_one_rendered.csv",
        ),
        Table(
            (
                "lens",
                "−b/δk, px",
                "growth by 10 % light, px",
                "δk of half maximum, mm/px",
                "b, mm",
                "R²",
                "least at d_r, mm",
            ),
            marks,
            "What would tell these lenses apart, in closed form: how the thresholded spot reacts "
            "to light, and the line of the half maximum over the same readings.",
            digits=3,
            data="table_one_marks.csv",
        ),
    )


def _trials(findings: Findings) -> Section:
    rows: list[Row] = [
        (
            c.cause,
            c.delta_k_mm_px,
            c.b_mm,
            c.contact_radius_px,
            c.r_squared,
            c.rmse_mm,
            c.delta_k_change_percent,
            c.b_change_mm,
            c.contact_radius_change_px,
        )
        for c in findings.causes
    ]
    second = PAPERS_TRIALS[1]
    for name, row in zip(("point 1", "point 3"), (PAPERS_TRIALS[0], PAPERS_TRIALS[2]), strict=True):
        contact = -row.b / row.delta_k
        rows.append(
            (
                f"paper, {name} against point 2",
                row.delta_k,
                row.b,
                contact,
                row.r_squared,
                row.rmse,
                100 * (row.delta_k / second.delta_k - 1),
                row.b - second.b,
                contact + second.b / second.delta_k,
            )
        )
    return Section(
        "What sets trials apart",
        Table(
            (
                "cause",
                "δk, mm/px",
                "b, mm",
                "−b/δk, px",
                "R²",
                "RMSE, mm",
                "change of δk, %",
                "of b, mm",
                "of −b/δk, px",
            ),
            rows,
            "The best lens's line, in closed form, and what each cause alone makes of it.",
            digits=3,
            data="table_one_causes.csv",
        ),
    )
