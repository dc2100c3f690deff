"""The report's figures but for the strip of frames, drawn from the rows of `tables`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, COMPARED, TABLE_I, USED, WAYS, ModelError
from benchmarks.studies.validate.run import Findings
from benchmarks.studies.validate.tables import (
    ALL_PLANES,
    CHOSEN_DISTANCES_MM,
    SpotRow,
    small_plane_curve,
)

# Okabe and Ito's palette, which colour-blind readers can tell apart.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#8A8A8A"

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "figure.dpi": 150,
    "savefig.dpi": 150,
    "savefig.facecolor": "white",
    "svg.hashsalt": "eyespot",  # the same data give the same file
}
"""For `matplotlib.rc_context`."""

WAY_COLOURS = dict(zip((way.name for way in WAYS), (VERMILION, ORANGE, BLUE), strict=True))
MODEL_COLOURS = dict(zip(COMPARED, (VERMILION, BLUE, GREEN, BLACK), strict=True))
TRIAL_MARKERS = ("o", "^", "s")
TRIAL_COLOURS = (BLUE, ORANGE, GREEN)
_WIDTH_IN = 10.0

READING = "$d_r$, reading since contact (mm)"
MEASURED = "measured $e_1'$ (px)"
DISTANCE = "$d$, tip to wall along the beam (mm)"
ECCENTRICITY = "eccentricity $c$ (mm)"


class Panel(NamedTuple):
    """One source measured in one way."""

    source: str
    way: str
    axes: Axes


def plane_fit(findings: Findings, rows: Sequence[SpotRow]) -> Figure:
    """d_r against e1' on the plane, with each trial's line and the line of all (Table I)."""
    fits = findings.plane_fits

    def draw(panel: Panel) -> None:
        for group, group_rows in _fitted(rows, panel, fits):
            e = np.array([row.measured_px for row in group_rows])
            _marks(panel.axes, e, [row.d_r_mm for row in group_rows], group)
            fit = fits[panel.source, panel.way][group]
            ends = np.array([e.min(), e.max()])
            panel.axes.plot(ends, fit.delta_k * ends + fit.b, color=_colour(group), lw=1)
        used = _used(rows, panel.source, panel.way, "plane")
        ends = np.array([f(row.measured_px for row in used) for f in (min, max)])
        ours, printed = fits[panel.source, panel.way][ALL_PLANES], TABLE_I[ALL_PLANES]
        for line, ls, color, label in (
            (ours, "--", BLACK, ALL_PLANES),
            (printed, ":", GREY, "all planes of the paper"),
        ):
            d = line.delta_k * ends + line.b
            panel.axes.plot(ends, d, ls=ls, color=color, lw=1, label=label, zorder=3)

    return _by_source_and_way(fits, draw, x=MEASURED, y=READING)


def sphere_fit(findings: Findings, rows: Sequence[SpotRow]) -> Figure:
    """d_r against e1' in the eyeball, with the small-plane model at the fitted c (Table II)."""
    scenes = {(t.source, t.group): t.scene for t in findings.trials}

    def draw(panel: Panel) -> None:
        key = panel.source, panel.way
        for group, group_rows in _fitted(rows, panel, findings.sphere_fits):
            scene, fit = scenes[panel.source, group], findings.sphere_fits[key][group]
            e = np.array([row.measured_px for row in group_rows])
            name = f"{group}: c {scene.spot.eccentricity_mm:.2f}, fitted {fit.c:.2f} mm"
            _marks(panel.axes, e, [row.d_r_mm for row in group_rows], group, name)
            along = np.linspace(e.min(), e.max(), 50)
            curve = small_plane_curve(
                along,
                plane=findings.plane_fits[key][ALL_PLANES],
                c=fit.c,
                scale=scene.microscope.scale_mm_px,
                eye_radius=scene.phantom.radius_mm,
            )
            panel.axes.plot(along, curve, color=_colour(group), lw=1)
        panel.axes.legend(loc="upper left", handletextpad=0.2)

    return _by_source_and_way(
        findings.sphere_fits,
        draw,
        x=MEASURED,
        y=READING,
        shared_legend=False,
    )


def residuals(findings: Findings, rows: Sequence[SpotRow], kind: str) -> Figure:
    """What the fits of Table I (`kind` "plane") or II ("sphere") leave, against distance."""
    fits = findings.plane_fits if kind == "plane" else findings.sphere_fits

    def draw(panel: Panel) -> None:
        panel.axes.axhline(0, color=GREY, lw=0.8)
        for group, group_rows in _fitted(rows, panel, fits):
            x = [row.d_r_mm for row in group_rows]
            y = [row.residual_mm for row in group_rows]
            panel.axes.plot(x, y, color=_colour(group), lw=0.7, alpha=0.6)
            _marks(panel.axes, x, y, group)
        every = [row.residual_mm for row in _used(rows, panel.source, panel.way, kind)]
        panel.axes.set_title(f"rms {_rms(every):.2g} mm", loc="right", color=GREY)

    return _by_source_and_way(fits, draw, x=READING, y="estimate − $d_r$ (mm)")


def bias(findings: Findings, rows: Sequence[SpotRow]) -> Figure:
    """Measured minus true semi-minor axis of each way, against distance."""
    sources = _sources(findings)
    figure = _figure(height=2.7 * len(sources))
    grid = figure.subplots(len(sources), 2, sharex=True, sharey="row", squeeze=False)
    for axes_row, source in zip(grid, sources, strict=True):
        for axes, kind in zip(axes_row, ("plane", "sphere"), strict=True):
            axes.axhline(0, color=GREY, lw=0.8)
            axes.set_title(f"{source}, {'plane' if kind == 'plane' else 'eyeball'}")
            for way in WAYS:
                chosen = _used(rows, source, way.name, kind)
                if not chosen:
                    continue
                y = np.array([row.measured_px - row.half_max_px for row in chosen])
                axes.plot(
                    [row.d_mm for row in chosen],
                    y,
                    ls="",
                    marker=TRIAL_MARKERS[WAYS.index(way)],
                    ms=3,
                    color=WAY_COLOURS[way.name],
                    label=f"{way.name} (rms {_rms(y):.2g} px)",
                )
            if axes.get_legend_handles_labels()[1]:
                axes.legend(loc="best")
            axes.set_ylabel("measured − true $e_1'$ (px)")
    for axes in grid[-1]:
        axes.set_xlabel(DISTANCE)
    return figure


def half_maximum(
    findings: Findings,
    rows: Sequence[SpotRow],
    ambiguous: tuple[float, float] | None,
) -> Figure:
    """The lens's half-maximum radius on the plane against distance, and what each way measured.

    Args:
        findings: the run.
        rows: all spots.
        ambiguous: distances between which a radius belongs to more than one distance, mm.
    """
    trial = next(t for t in findings.trials if t.source == "lens" and t.kind == "plane")
    scale = trial.scene.microscope.scale_mm_px
    figure = _figure(height=3.6)
    axes = figure.subplots()
    if ambiguous:
        axes.axvspan(*ambiguous, color="#F2E6D0", lw=0, label="one radius, several distances")
    labels = [row for row in rows if row.trial == trial.name and row.way == WAYS[-1].name]
    d = [row.d_mm for row in labels]
    half = [row.half_max_px * scale for row in labels]
    axes.plot(d, half, color=BLACK, lw=1.8, label="half maximum, true")
    cone = [row.cone_px * scale for row in labels]
    axes.plot(d, cone, color=GREY, ls="--", label="straight cone fitted to it")
    for number, way in enumerate(WAYS):
        seen = [r for r in _used(rows, "lens", way.name, "plane") if r.trial == trial.name]
        if seen:
            axes.plot(
                [row.d_mm for row in seen],
                [row.measured_px * scale for row in seen],
                ls="",
                marker=TRIAL_MARKERS[number],
                ms=3.5,
                color=WAY_COLOURS[way.name],
                label=f"measured: {way.name}",
            )
    axes.set(xlabel=DISTANCE, ylabel="semi-minor axis on the wall (mm)")
    axes.set_ylim(bottom=0)
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def model_error(
    analytic: Sequence[ModelError],
    rendered: Sequence[ModelError],
    *,
    models: Sequence[str] = COMPARED,
) -> Figure:
    """Signed error against c: a row for each pinhole height, a column for each model."""
    heights = list(dict.fromkeys(e.z_f_mm for e in analytic))
    incidences = sorted({e.incidence_deg for e in analytic})
    shades = ("#A6CEE3", SKY, BLUE, "#08306B")
    colours = dict(zip(CHOSEN_DISTANCES_MM, shades, strict=True))
    figure = _figure(height=2.7 * len(heights) + 0.5)
    grid = figure.subplots(len(heights), len(models), sharex=True, sharey="row", squeeze=False)
    for axes_row, height in zip(grid, heights, strict=True):
        for axes, model in zip(axes_row, models, strict=True):
            _limit(axes)
            axes.set_title(f"{model}, {pinhole_title(height)}")
            for d, colour in colours.items():
                for incidence in incidences:
                    line = _at(analytic, model, height, d, incidence)
                    style = "-" if incidence == incidences[-1] else ":"
                    axes.plot(*_c_and_error(line), color=colour, ls=style)
                marks = _at(rendered, model, height, d)
                axes.plot(*_c_and_error(marks), ls="", marker="o", ms=3.5, color=colour)
        axes_row[0].set_ylabel("estimate − $d$ (mm)")
    for axes in grid[-1]:
        axes.set_xlabel(ECCENTRICITY)
    handles = [
        Line2D([], [], color=colour, label=f"$d$ = {d:g} mm") for d, colour in colours.items()
    ]
    handles += [
        Line2D(
            [],
            [],
            color=GREY,
            ls="-" if incidence == incidences[-1] else ":",
            label=f"exact contour, incidence {incidence:.0f}°",
        )
        for incidence in incidences
    ]
    handles += [
        Line2D([], [], color=GREY, ls="", marker="o", ms=3.5, label="rendered spot"),
        Line2D([], [], color=VERMILION, lw=0.8, ls="--", label=f"±{ACCEPTABLE_ERROR_MM:g} mm"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


def model_error_size(findings: Findings) -> Figure:
    """Largest absolute error over all distances, on a logarithmic axis: one panel a pinhole."""
    heights = list(dict.fromkeys(e.z_f_mm for e in findings.rendered))
    figure = _figure(height=3.6)
    grid = figure.subplots(1, len(heights), sharey=True, squeeze=False)
    for axes, height in zip(grid[0], heights, strict=True):
        axes.axhline(ACCEPTABLE_ERROR_MM, color=VERMILION, lw=0.8, ls="--")
        incidence = max(e.incidence_deg for e in findings.rendered)
        for model in COMPARED:
            exact = _at(findings.analytic, model, height, None, incidence)
            # On exact contours `exact` is right to rounding, which a logarithm has no room for.
            if model != "exact":
                axes.plot(*_worst(exact), color=MODEL_COLOURS[model], lw=1)
            axes.plot(
                *_worst(_at(findings.rendered, model, height)),
                color=MODEL_COLOURS[model],
                ls="",
                marker="ov^s"[COMPARED.index(model)],
                ms=4.5,
                label=model,
            )
        axes.set(yscale="log", xlabel=ECCENTRICITY, title=f"$z_F$ = {height:g} mm")
    grid[0, 0].set_ylabel("largest |estimate − $d$| (mm)")
    grid[0, 0].set_ylim(bottom=5e-4)
    grid[0, 0].yaxis.set_major_formatter("{x:g}")
    grid[0, -1].legend(loc="center right")
    return figure


def pinhole_title(z_f_mm: float) -> str:
    """The pinhole's height, for titles and legends."""
    return "telecentric" if np.isinf(z_f_mm) else f"$z_F$ = {z_f_mm:g} mm"


def _figure(*, height: float) -> Figure:
    return Figure(figsize=(_WIDTH_IN, height), layout="constrained")


def _by_source_and_way(
    fits: dict[tuple[str, str], Any],
    draw: Callable[[Panel], None],
    *,
    x: str,
    y: str,
    shared_legend: bool = True,
) -> Figure:
    """A row for each source, a column for each way that has fits."""
    sources = list(dict.fromkeys(source for source, _ in fits))
    ways = [way.name for way in WAYS if any(way.name == name for _, name in fits)]
    figure = _figure(height=2.9 * len(sources) + 0.3)
    grid = figure.subplots(len(sources), len(ways), sharex=True, sharey="row", squeeze=False)
    for axes_row, source in zip(grid, sources, strict=True):
        for axes, way in zip(axes_row, ways, strict=True):
            axes.set_title(f"{source}: {way}")
            if (source, way) in fits:
                draw(Panel(source, way, axes))
            else:
                axes.text(0.5, 0.5, "no fit", transform=axes.transAxes, ha="center", color=GREY)
        axes_row[0].set_ylabel(y)
    for axes in grid[-1]:
        axes.set_xlabel(x)
    if shared_legend:
        handles, names = max(
            (a.get_legend_handles_labels() for a in grid.flat), key=lambda h: len(h[0])
        )
        figure.legend(handles, names, loc="outside lower center", ncols=len(names))
    return figure


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _fitted(
    rows: Sequence[SpotRow], panel: Panel, fits: dict[tuple[str, str], Any]
) -> list[tuple[str, list[SpotRow]]]:
    """The spots behind each trial's fit."""
    chosen = [
        row for row in rows if (row.source, row.way, row.outcome) == (panel.source, panel.way, USED)
    ]
    groups = [name for name in fits[panel.source, panel.way] if name != ALL_PLANES]
    return [(name, [row for row in chosen if row.group == name]) for name in groups]


def _used(rows: Sequence[SpotRow], source: str, way: str, kind: str) -> list[SpotRow]:
    return [
        row
        for row in rows
        if (row.source, row.way, row.outcome) == (source, way, USED) and row.group.startswith(kind)
    ]


def _marks(axes: Axes, x: Any, y: Any, group: str, label: str | None = None) -> None:
    axes.plot(
        x,
        y,
        ls="",
        marker=TRIAL_MARKERS[_number(group)],
        ms=2.4 + 1.1 * _number(group),  # trials that agree are seen around each other
        mfc="none",
        mew=0.7,
        color=_colour(group),
        label=label or group,
    )


def _colour(group: str) -> str:
    return TRIAL_COLOURS[_number(group)]


def _number(group: str) -> int:
    """0 for "plane 1"."""
    return int(group.split()[-1]) - 1


def _sources(findings: Findings) -> list[str]:
    return list(dict.fromkeys(t.source for t in findings.trials if t.kind != "grid"))


def _limit(axes: Axes) -> None:
    axes.axhline(0, color=GREY, lw=0.8)
    for sign in (-1, 1):
        axes.axhline(sign * ACCEPTABLE_ERROR_MM, color=VERMILION, lw=0.8, ls="--")


def _at(
    errors: Sequence[ModelError],
    model: str,
    height: float,
    d: float | None = None,
    incidence: float | None = None,
) -> list[ModelError]:
    return [
        e
        for e in errors
        if (e.model, e.z_f_mm) == (model, height)
        and (d is None or abs(e.d_mm - d) < 1e-6)
        and (incidence is None or abs(e.incidence_deg - incidence) < 1e-6)
    ]


def _c_and_error(errors: Sequence[ModelError]) -> tuple[list[float], list[float]]:
    return [e.c_mm for e in errors], [e.error_mm for e in errors]


def _worst(errors: Sequence[ModelError]) -> tuple[list[float], list[float]]:
    """Largest absolute error at each c."""
    c = sorted({e.c_mm for e in errors})
    return c, [max(abs(e.error_mm) for e in errors if e.c_mm == value) for value in c]
