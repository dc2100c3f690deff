"""The report as one HTML page."""

from __future__ import annotations

from typing import Any

import jinja2

from benchmarks.reporting.report import Picture
from benchmarks.reporting.tables import Table
from benchmarks.reporting.typeset import number


def page(**content: Any) -> str:
    """The page; the template report.html.j2 defines the content that it needs."""
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
    return environment.get_template("report.html.j2").render(**content)
