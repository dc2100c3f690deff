"""The report as one HTML page: shapes rows into the tables that the template prints."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jinja2
from markupsafe import Markup, escape

from benchmarks.evaluation import USED, WAYS, paper
from benchmarks.studies.validate import tables
from benchmarks.studies.validate.conclusions import (
    CHOSEN_ECCENTRICITIES_MM,
    Conclusion,
    number,
    pinhole,
    source_name,
)
from benchmarks.studies.validate.run import Findings
from scenes import frame_count, scene_toml


class ErrorLine(NamedTuple):
    """Errors of one model at the chosen eccentricities and distances, mm; NaN if not computed."""

    z_f_mm: float
    r_mm: float
    model: str
    errors_mm: list[float]


class OutcomeLine(NamedTuple):
    """What became of a trial's frames, a cell for each way; empty where it was not measured."""

    trial: str
    cells: list[str]


def render(
    findings: Findings,
    *,
    found: Sequence[Conclusion],
    versions: Mapping[str, Mapping[str, str]],
    images: Mapping[str, str],
) -> str:
    """The page.

    Args:
        findings: the run.
        found: its conclusions.
        versions: of packages, by what they did.
        images: data URIs by the figure's name.
    """
    first = findings.trials[0]
    sources = dict.fromkeys(trial.source for trial in findings.trials if trial.kind == "plane")
    return template("report.html.j2").render(
        digits_for=_digits_for,
        pinhole=pinhole,
        settings=findings.settings,
        found=found,
        versions=versions,
        images=images,
        sources={source: source_name(findings, source) for source in sources},
        ways=[way.name for way in WAYS],
        plane_rows=_by_source_and_way(tables.plane_rows(findings)),
        sphere_rows=_by_source_and_way(tables.sphere_rows(findings)),
        all_planes=tables.ALL_PLANES,
        **_about_the_paper(),
        eccentricities=CHOSEN_ECCENTRICITIES_MM,
        distances=tables.CHOSEN_DISTANCES_MM,
        square=_square_lines(findings),
        accuracy=tables.rendered_accuracy(findings.rendered),
        outcomes=_outcome_lines(findings),
        trials=findings.trials,
        frames=sum(frame_count(trial.scene) for trial in findings.trials),
        scene=first.scene,
        scene_toml=scene_toml(first.scene),
        seconds=findings.seconds,
    )


def template(name: str) -> jinja2.Template:
    """A page's template; `number` and the filter `symbols` are there for all."""
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [
                jinja2.PackageLoader("benchmarks.studies.validate"),
                jinja2.PackageLoader("benchmarks.reporting"),
            ]
        ),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["symbols"] = _symbols
    environment.globals["number"] = number
    return environment.get_template(name)


def _symbols(text: str) -> Markup:
    """The text with the subscripts that plain text has no letters for."""
    html = str(escape(text))
    for plain, symbol in (("z_F", "z<sub>F</sub>"), ("d_r", "d<sub>r</sub>")):
        html = html.replace(plain, symbol)
    return Markup(html)


def _about_the_paper() -> dict[str, Any]:
    """What its tables imply and the captions mention."""
    trials = [row for name, row in paper.TABLE_I.items() if name != tables.ALL_PLANES]
    return {
        "paper": paper,
        "paper_radii": [-row.b / row.delta_k for row in trials],
        "paper_max": max(row.max_error for row in paper.TABLE_II.values()),
        "outside": [row.c for row in paper.TABLE_II.values() if row.c > paper.LARGEST_VIEW_MM / 2],
    }


def _digits_for(error: float, least: int) -> int:
    """Decimals that show two figures of a standard error, and no fewer than `least`."""
    if not math.isfinite(error) or error <= 0:
        return least
    return max(least, 1 - math.floor(math.log10(error)))


def _by_source_and_way(rows: Sequence[Any]) -> dict[tuple[str, str], list[Any]]:
    groups: dict[tuple[str, str], list[Any]] = {}
    for row in rows:
        groups.setdefault((row.source, row.way), []).append(row)
    return groups


def _square_lines(findings: Findings) -> list[ErrorLine]:
    """Errors of a beam square to the wall: a line for each pinhole height and model."""
    found = {
        (e.z_f_mm, e.r_mm, e.model, c, round(e.d_mm, 6)): e.error_mm
        for c in CHOSEN_ECCENTRICITIES_MM
        for e in tables.square_rows(findings.analytic, c=c)
    }
    return [
        ErrorLine(
            *line,
            errors_mm=[
                found.get((*line, c, d), math.nan)
                for c in CHOSEN_ECCENTRICITIES_MM
                for d in tables.CHOSEN_DISTANCES_MM
            ],
        )
        for line in dict.fromkeys(key[:3] for key in found)
    ]


def _outcome_lines(findings: Findings) -> list[OutcomeLine]:
    """A line for each trial of the paper's kind, one for each grid."""
    names: dict[str, list[str]] = {}
    for trial in findings.trials:
        line = f"grid, {trial.group}" if trial.kind == "grid" else f"{trial.source}, {trial.group}"
        names.setdefault(line, []).append(trial.name)
    lines = []
    for line, members in names.items():
        cells = []
        for way in WAYS:
            outcomes: Counter[str] = Counter()
            for name in members:
                if (name, way.name) in findings.tracked:
                    outcomes.update(findings.tracked[name, way.name].outcomes)
            cells.append(_outcome_cell(outcomes))
        lines.append(OutcomeLine(line, cells))
    return lines


def _outcome_cell(outcomes: Counter[str]) -> str:
    if not outcomes:
        return ""
    text = f"{outcomes[USED]} of {outcomes.total()}"
    reasons = [f"{n} {reason}" for reason, n in sorted(outcomes.items()) if reason != USED]
    return f"{text}; {', '.join(reasons)}" if reasons else text
