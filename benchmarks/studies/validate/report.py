"""Writes what a run found: report.html for people, summary.json, CSV and figures for the rest.

Everything is made in a folder beside its place and moved there file by file once all of it is
whole, so a report that cannot be finished leaves an earlier one as it was.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from benchmarks.evaluation import USED, ModelError
from benchmarks.reporting import published, save_figure, versions, write_json
from benchmarks.studies.validate import analysis, figures, page, strip, tables
from benchmarks.studies.validate.conclusions import (
    CHOSEN_ECCENTRICITIES_MM,
    Conclusion,
    conclusions,
)
from benchmarks.studies.validate.run import Findings
from benchmarks.studies.validate.tables import Accuracy, FrameRow, PlaneRow, SphereRow, SpotRow
from estimator import read_stack

SCHEMA = 1
_STRIPS = ("plane 1", "sphere 1")


def write(findings: Findings, out: Path) -> None:
    """Write the report of a run into its folder.

    Args:
        findings: the run.
        out: its folder, which holds the trials' stacks in `stacks/`.

    Raises:
        StackError: a stack that the strip of frames needs is missing or broken.
    """
    out = Path(out)
    with published(out) as folder:
        rows = _write_tables(findings, folder)
        found = conclusions(findings)
        used = _versions(findings, out / "stacks")
        summary = _summary(findings, found, used)
        write_json(folder / "summary.json", summary)
        images = _write_figures(findings, rows, folder, stacks=out / "stacks")
        html = page.render(findings, found=found, versions=used, images=images)
        (folder / "report.html").write_text(html, encoding="utf-8")


def _write_tables(findings: Findings, folder: Path) -> list[SpotRow]:
    """All CSV files but the strip's; returns the spots, which the figures share."""
    spots = tables.spot_rows(findings)
    contents: dict[str, tuple[type[Any], list[Any]]] = {
        "table_1.csv": (PlaneRow, tables.plane_rows(findings)),
        "table_2.csv": (SphereRow, tables.sphere_rows(findings)),
        "spots.csv": (SpotRow, spots),
        "frames.csv": (FrameRow, tables.frame_rows(findings)),
        "model_error.csv": (ModelError, findings.analytic + findings.rendered),
        "rendered_accuracy.csv": (Accuracy, tables.rendered_accuracy(findings.rendered)),
    }
    for name, (row_type, rows) in contents.items():
        tables.write_csv(folder / name, row_type, rows)
    return spots


def _write_figures(
    findings: Findings, rows: list[SpotRow], folder: Path, *, stacks: Path
) -> dict[str, str]:
    """Every figure as PNG and SVG; returns them as data URIs by name."""
    (folder / "figures").mkdir()
    shown = []
    images = {}
    with matplotlib.rc_context(figures.STYLE):
        for group in _STRIPS:
            lines = strip.shown_frames(findings, group)
            shown += [strip.strip_row(frame) for line in lines for frame in line]
            name = f"strip_{group.replace(' ', '_')}"
            # Noise of a camera is what JPEG is for: a tenth of the SVG, with PNG inside.
            figure = strip.strip(lines, stacks=stacks)
            images[name] = save_figure(figure, folder / "figures" / name, inline="jpeg")
        for name, figure in _plots(findings, rows):
            images[name] = save_figure(figure, folder / "figures" / name, inline="svg")
    tables.write_csv(folder / "strip.csv", strip.StripRow, shown)
    return images


def _plots(findings: Findings, rows: list[SpotRow]) -> Iterator[tuple[str, Figure]]:
    if findings.plane_fits:
        yield "plane_fit", figures.plane_fit(findings, rows)
        yield "plane_residuals", figures.residuals(findings, rows, "plane")
        yield "sphere_fit", figures.sphere_fit(findings, rows)
        yield "sphere_residuals", figures.residuals(findings, rows, "sphere")
    yield "bias", figures.bias(findings, rows)
    curve = analysis.half_maximum_curve(findings)
    if curve is not None:
        ambiguous = analysis.ambiguous_range(*curve)
        yield "half_maximum", figures.half_maximum(findings, rows, ambiguous)
    yield "model_error", figures.model_error(findings.analytic, findings.rendered)
    yield "model_error_size", figures.model_error_size(findings)


def _summary(
    findings: Findings, found: list[Conclusion], versions: dict[str, dict[str, str]]
) -> dict[str, Any]:
    chosen = [
        error
        for c in CHOSEN_ECCENTRICITIES_MM
        for error in tables.square_rows(findings.analytic, c=c)
    ]
    left_out = [row for row in tables.frame_rows(findings) if row.outcome != USED]
    by_reason: dict[str, int] = {}
    for row in left_out:
        by_reason[row.outcome] = by_reason.get(row.outcome, 0) + row.frames
    return {
        "schema_version": SCHEMA,
        "settings": findings.settings,
        "found": [c._asdict() for c in found],
        "plane_fits": [row._asdict() for row in tables.plane_rows(findings)],
        "sphere_fits": [row._asdict() for row in tables.sphere_rows(findings)],
        "model_errors": [row._asdict() for row in chosen],
        "rendered_accuracy": [row._asdict() for row in tables.rendered_accuracy(findings.rendered)],
        "left_out": by_reason,
        "left_out_by_trial": [row._asdict() for row in left_out],
        "versions": versions,
        "seconds": findings.seconds,
    }


def _versions(findings: Findings, stacks: Path) -> dict[str, dict[str, str]]:
    """Versions that rendered (by the stacks themselves) and that measured and fitted."""
    run = read_stack(stacks / findings.trials[0].name).description.get("run", {})
    return {"rendered": run.get("versions", {}), "measured": versions()}
