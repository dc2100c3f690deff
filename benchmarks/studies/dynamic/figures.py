"""Pictures of the dynamic study."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation import ACCEPTABLE_ERROR_MM
from benchmarks.studies.dynamic.parts import PARTS, DynamicError, DynamicSpread
from benchmarks.studies.dynamic.trials import COMPARED, LATENCIES_S, LITERAL, MOTIONS, SUBPIXEL
from benchmarks.studies.validate import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION

WAY_COLOURS = {LITERAL.name: VERMILION, SUBPIXEL.name: BLUE}
PART_COLOURS = dict(zip(PARTS, (GREY, ORANGE, GREEN, PURPLE), strict=True))
SPEED = "speed of the tip (mm/s)"
_DASHES = ("-", "--", ":")
_MARKS = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"))
_LEAST_MM = 1e-3
"""Errors below it are drawn at the foot of a logarithmic axis."""


def errors_by_speed(spreads: Sequence[DynamicSpread]) -> Figure:
    """RMS error against speed: a row for each source, a column for each motion."""
    figure, panels = _panels(spreads)
    for (source, motion), axes in panels.items():
        axes.axhline(ACCEPTABLE_ERROR_MM, color=GREY, lw=0.8, ls=":")
        for way in COMPARED:
            for latency, dashes in zip(LATENCIES_S, _DASHES, strict=True):
                rows = [s for s in spreads if s[:3] == (source, motion, way.name)]
                rows = [s for s in rows if s.latency_s == latency]
                label = "stamped" if latency == 0 else f"{1000 * latency:g} ms late"
                axes.plot(
                    [s.speed_mm_s for s in rows],
                    _drawn([s.rms_error_mm for s in rows]),
                    color=WAY_COLOURS[way.name],
                    ls=dashes,
                    marker="o",
                    ms=3,
                    label=f"{way.name}, {label}",
                )
    _finish(figure, panels, "RMS error (mm)", speeds=_speeds(spreads), columns=2)
    return figure


def parts_by_speed(spreads: Sequence[DynamicSpread], *, way: str) -> Figure:
    """RMS of each part of one way's error against speed; the latest pose of all."""
    figure, panels = _panels(spreads)
    for (source, motion), axes in panels.items():
        rows = [s for s in spreads if s[:3] == (source, motion, way)]
        rows = [s for s in rows if s.latency_s == LATENCIES_S[-1]]
        x = [s.speed_mm_s for s in rows]
        for part in PARTS:
            y = [getattr(s, f"rms_{part}_mm") for s in rows]
            axes.plot(x, _drawn(y), color=PART_COLOURS[part], marker="o", ms=3, label=part)
        axes.plot(x, [s.rms_error_mm for s in rows], color=BLACK, ls="--", label="error")
    _finish(figure, panels, "RMS (mm)", speeds=_speeds(spreads), columns=5)
    return figure


def frame_by_frame(rows: Sequence[DynamicError]) -> Figure:
    """Error of every frame with stamped poses against the tip's speed in it."""
    stamped = [row for row in rows if row.latency_s == LATENCIES_S[0] and not row.doubt]
    sources = list(dict.fromkeys(row.source for row in rows))
    figure = Figure(figsize=(10.0, 3.2 * len(sources) + 0.4), layout="constrained")
    grid = figure.subplots(len(sources), len(COMPARED), sharex=True, squeeze=False)
    for line, source in zip(grid, sources, strict=True):
        for axes, way in zip(line, COMPARED, strict=True):
            axes.axhline(0, color=GREY, lw=0.8)
            for motion, (colour, marker) in zip(MOTIONS, _MARKS, strict=True):
                here = [r for r in stamped if (r.source, r.motion) == (source, motion)]
                here = [r for r in here if r.way == way.name]
                x, y = [r.speed_mm_s for r in here], [r.error_mm for r in here]
                axes.plot(x, y, ls="", marker=marker, ms=3, color=colour, label=motion)
            axes.set_title(f"{source}, {way.name}")
        line[0].set_ylabel("error (mm)")
    for axes in grid[-1]:
        axes.set_xlabel(SPEED)
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _panels(spreads: Sequence[DynamicSpread]) -> tuple[Figure, dict[tuple[str, str], Axes]]:
    sources = list(dict.fromkeys(s.source for s in spreads))
    figure = Figure(figsize=(10.0, 2.8 * len(sources) + 0.8), layout="constrained")
    grid = figure.subplots(len(sources), len(MOTIONS), sharex=True, sharey=True, squeeze=False)
    return figure, {
        (source, motion): axes
        for line, source in zip(grid, sources, strict=True)
        for motion, axes in zip(MOTIONS, line, strict=True)
    }


def _finish(
    figure: Figure,
    panels: dict[tuple[str, str], Axes],
    quantity: str,
    *,
    speeds: Sequence[float],
    columns: int,
) -> None:
    for (source, motion), axes in panels.items():
        axes.set(title=f"{source}, {motion}", xscale="log", yscale="log")
        axes.set_ylim(bottom=_LEAST_MM)
        axes.set_xticks(speeds)
        axes.minorticks_off()
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")
        axes.set(xlabel=SPEED, ylabel=quantity)
        axes.label_outer()
    first = next(iter(panels.values()))
    handles = first.get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=columns)


def _speeds(spreads: Sequence[DynamicSpread]) -> list[float]:
    return sorted({s.speed_mm_s for s in spreads})


def _drawn(sizes: Sequence[float]) -> list[float]:
    """With zeros lifted to the foot of the axis; NaN stays."""
    return [size if math.isnan(size) else max(size, _LEAST_MM) for size in sizes]
