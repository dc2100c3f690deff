"""A report as one HTML page, with its CSV files and figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2

from benchmarks.reporting.figures import save_figure
from benchmarks.reporting.report import Data, Picture, Report
from benchmarks.reporting.tables import Table, write_csv
from benchmarks.reporting.typeset import number


def write_page(
    folder: Path,
    report: Report,
    *,
    command: str,
    versions: Mapping[str, str],
    summary_file: str = "summary.json",
    template: str = "page.html.j2",
    **content: Any,
) -> None:
    """Write report.html, the report's CSV files, and its figures in figures/.

    Args:
        folder: an existing folder without these files.
        report: the report; its figures use the style of the caller's `rc_context`.
        command: command line that repeats the run.
        versions: versions of the packages that the results depend on.
        summary_file: file for programs, which the caller writes.
        template: page.html.j2, or a template that extends it.
        content: what else the template needs.
    """
    for data in report.data:
        if isinstance(data, Data):
            write_csv(folder / data.name, data.row_type, data.rows)
    (folder / "figures").mkdir()
    images = {
        picture.name: save_figure(
            picture.figure, folder / "figures" / picture.name, inline=picture.inline
        )
        for picture in report.pictures
    }
    html = _template(template).render(
        report=report,
        images=images,
        command=command,
        versions=versions,
        summary_file=summary_file,
        **content,
    )
    (folder / "report.html").write_text(html, encoding="utf-8", errors="backslashreplace")


def _template(name: str) -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("benchmarks.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["number"] = number
    environment.tests["table"] = lambda part: isinstance(part, Table)
    environment.tests["picture"] = lambda part: isinstance(part, Picture)
    return environment.get_template(name)
