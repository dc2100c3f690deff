"""Figures of the dynamic study."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, LITERAL, SUBPIXEL
from benchmarks.reporting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    small_multiples,
)
from benchmarks.studies.dynamic.findings import (
    COMPARED,
    LATENCIES_S,
    MOTIONS,
    PARTS,
    DynamicFindings,
)

_WAY_COLOURS = {LITERAL: VERMILION, SUBPIXEL: BLUE}
_PART_COLOURS = dict(zip(PARTS, (GREY, ORANGE, GREEN, PURPLE), strict=True))
_SPEED = "speed of the tip (mm/s)"
_DASHES = dict(zip(LATENCIES_S, ("-", "--", ":"), strict=True))
_MARKS = dict(zip(MOTIONS, ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^")), strict=True))
_LEAST_MM = 1e-3
"""Smaller errors are drawn at the foot of a logarithmic axis."""


def errors_by_speed(findings: DynamicFindings) -> Figure:
    """RMS error against speed: a row for each source, a column for each motion."""

    def draw(axes: Axes, source: str, motion: str) -> None:
        axes.axhline(ACCEPTABLE_ERROR_MM, color=GREY, lw=0.8, ls=":")
        for way, colour in _WAY_COLOURS.items():
            for latency, dashes in _DASHES.items():
                rows = findings.by_speed(source, motion, way.name, latency)
                x, y = [s.speed_mm_s for s in rows], _drawn([s.rms_error_mm for s in rows])
                label = f"{way.name}, {1000 * latency:g} ms late"
                axes.plot(x, y, color=colour, ls=dashes, marker="o", ms=3, label=label)

    return _by_source_and_motion(findings, draw, y="RMS error (mm)")


def parts_by_speed(findings: DynamicFindings, *, way: str) -> Figure:
    """RMS of each part of one way's error against speed, with the latest poses."""

    def draw(axes: Axes, source: str, motion: str) -> None:
        rows = findings.by_speed(source, motion, way, LATENCIES_S[-1])
        x = [s.speed_mm_s for s in rows]
        for part, colour in _PART_COLOURS.items():
            y = _drawn([getattr(s, f"rms_{part}_mm") for s in rows])
            axes.plot(x, y, color=colour, marker="o", ms=3, label=part)
        axes.plot(x, [s.rms_error_mm for s in rows], color=BLACK, ls="--", label="error")

    return _by_source_and_motion(findings, draw, y="RMS (mm)")


def frame_by_frame(findings: DynamicFindings) -> Figure:
    """Error of every frame with stamped poses against the tip's speed in it."""

    def draw(axes: Axes, source: str, way: str) -> None:
        axes.axhline(0, color=GREY, lw=0.8)
        for motion, (colour, marker) in _MARKS.items():
            key = source, motion, way
            here = [row for row in findings.stamped if row[:3] == key and not row.doubt]
            x, y = [r.speed_mm_s for r in here], [r.error_mm for r in here]
            axes.plot(x, y, ls="", marker=marker, ms=3, color=colour, label=motion)

    ways = [way.name for way in COMPARED]
    rows = findings.sources
    return small_multiples(draw, rows=rows, columns=ways, x=_SPEED, y="error (mm)", sharex=True)


def _by_source_and_motion(
    findings: DynamicFindings, draw: Callable[[Axes, str, str], None], *, y: str
) -> Figure:
    speeds = sorted({s.speed_mm_s for s in findings.spreads})

    def drawn(axes: Axes, source: str, motion: str) -> None:
        draw(axes, source, motion)
        axes.set(xscale="log", yscale="log", xticks=speeds)
        axes.set_ylim(bottom=_LEAST_MM)
        axes.minorticks_off()
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")

    rows, columns = findings.sources, list(MOTIONS)
    return small_multiples(
        drawn, rows=rows, columns=columns, x=_SPEED, y=y, sharex=True, sharey=True
    )


def _drawn(sizes: Sequence[float]) -> list[float]:
    """The sizes with zeros lifted to the foot of the axis; NaN stays."""
    return [size if math.isnan(size) else max(size, _LEAST_MM) for size in sizes]
