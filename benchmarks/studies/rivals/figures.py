"""Figures of the study of rivals."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, DISTANCE
from benchmarks.reporting import BLUE, ORANGE, VERMILION, limit_lines, small_multiples
from benchmarks.studies.rivals.findings import Outcome, RivalFindings, Sensor, Wrong

_COLOURS = {Sensor.SPOT: BLUE, Sensor.SHADOW: ORANGE, Sensor.STEREO: VERMILION}
_MARKS = {Sensor.SPOT: "o", Sensor.SHADOW: "^", Sensor.STEREO: "s"}
_LINES = ("-", "--", ":")
_SMALLEST_MM, _LARGEST_MM = 1e-4, 5.0


def noise_figure(findings: RivalFindings) -> Figure:
    """Standard deviation against distance: a panel for each path, a line style for each c."""

    def draw(axes: Axes, _: str, path: str) -> None:
        for sensor in _COLOURS:
            rows = [r for r in findings.expected if (r.sensor, r.path) == (sensor, path)]
            _lines(axes, sensor, [(row.c_mm, row.d_mm, row.sigma_mm) for row in rows])
        axes.axhline(ACCEPTABLE_ERROR_MM, color=VERMILION, lw=0.8, ls="--")
        axes.set_yscale("log")
        axes.set_ylim(_SMALLEST_MM, _LARGEST_MM)

    return small_multiples(
        draw,
        rows=[""],
        columns=findings.paths,
        x=DISTANCE,
        y="σ of d (mm)",
        legend_columns=3,
        sharey=True,
    )


def path_figure(findings: RivalFindings) -> Figure:
    """Error against distance if the path is taken for a pinhole: a panel for each path."""
    paths = list(dict.fromkeys(row.path for row in findings.wrong if row.wrong == Wrong.PATH))

    def draw(axes: Axes, _: str, path: str) -> None:
        limit_lines(axes, ACCEPTABLE_ERROR_MM)
        for sensor in _COLOURS:
            rows = [r for r in findings.wrong if r[:3] == (sensor, path, Wrong.PATH)]
            _lines(axes, sensor, [(row.c_mm, row.d_mm, row.error_mm) for row in rows])

    return small_multiples(
        draw,
        rows=[""],
        columns=paths,
        x=DISTANCE,
        y="estimate − truth (mm)",
        height=3.2,
        legend_columns=3,
        sharey=True,
    )


def _lines(axes: Axes, sensor: Sensor, points: list[tuple[float, float, float]]) -> None:
    """Lines of a sensor's values against distance, one for each c, from (c, d, value)."""
    for c, line in zip(dict.fromkeys(c for c, _, _ in points), _LINES, strict=False):
        own = [(d, value) for at, d, value in points if at == c]
        axes.plot(
            *zip(*own, strict=True),
            line,
            color=_COLOURS[sensor],
            marker=_MARKS[sensor],
            ms=3,
            label=f"{sensor}, c = {c:g} mm",
        )


def reading_figure(findings: RivalFindings) -> Figure:
    """|Error| of the rendered readings against distance: rows of paths, columns of walls."""

    def draw(axes: Axes, path: str, wall: str) -> None:
        for sensor, colour in _COLOURS.items():
            rows = findings.read(sensor, path=path, wall=wall)
            done = [row for row in rows if row.outcome == Outcome.READ]
            axes.plot(
                [row.d_mm for row in done],
                [max(abs(row.error_mm), _SMALLEST_MM) for row in done],
                ls="",
                marker=_MARKS[sensor],
                ms=4,
                color=colour,
                label=sensor,
            )
        axes.axhline(ACCEPTABLE_ERROR_MM, color=VERMILION, lw=0.8, ls="--")
        axes.set_yscale("log")
        axes.set_ylim(_SMALLEST_MM, _LARGEST_MM)

    return small_multiples(
        draw,
        rows=findings.paths,
        columns=findings.walls,
        x=DISTANCE,
        y="|error| (mm)",
        height=2.2,
        sharex=True,
        sharey=True,
    )


def photograph_figure(findings: RivalFindings) -> Figure:
    """What the sensors see: the central image and the left one, a row for each path."""
    distance = max(d for _, d in findings.photographs)

    def draw(axes: Axes, path: str, view: str) -> None:
        photograph = np.asarray(getattr(findings.photographs[path, distance], view), float)
        axes.imshow(np.clip(photograph / findings.scene.camera.full_scale_dn, 0.0, 1.0))
        axes.set_axis_off()

    return small_multiples(
        draw,
        rows=findings.paths,
        columns=["left", "centre", "right"],
        x="",
        y="",
        height=2.6,
        legend_columns=0,
    )
