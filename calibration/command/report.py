"""The page of a fit: parameters and residuals."""

import base64
import io
import math
import statistics
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot.calibration.command.crossed import Crossed
from eyespot.calibration.command.fit_verdict import Doubt, Fault, Fitted, PixelResiduals
from eyespot.calibration.least_squares import SIGNIFICANCE, accepted_range, slow_waves
from eyespot.formats.report_page import PALETTE, STYLE, in_figure, templates

_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_COLOUR_SCALE_SIGMAS = 4.0  # standard deviations at both ends of the residuals' colour scale


def render(
    fitted: Fitted, doubts: Sequence[Doubt], crossed: Crossed | None = None, **about: Any
) -> str:
    """The HTML page of a fit; `about` has the template's other variables."""
    with matplotlib.rc_context(STYLE):
        each = fitted.parts or [fitted]
        figures: dict[str, Any] = {"residuals": [_svg(residuals_figure(one)) for one in each]}
        if fitted.lines:
            figures["lines"] = _svg(_lines(fitted))
        if crossed is not None:
            figures["crossed"] = _svg(crossed.figure())
    return (
        templates("eyespot.calibration.command")
        .get_template("fit.html.j2")
        .render(
            **about,
            fitted=fitted,
            crossed=crossed,
            doubts=doubts,
            figures=figures,
            mean_squares={n: float(np.mean(v**2)) for n, v in fitted.residuals.items()},
            kinds=slow_waves(fitted.residuals),
            accepted=accepted_range(fitted.degrees_of_freedom),
            stated=any(doubt.fault is Fault.STATED_MISFIT for doubt in doubts),
            significance=SIGNIFICANCE,
            number=rounded,
        )
    )


def rounded(value: float, digits: int = 6) -> str:
    """A value in words; empty for NaN."""
    if math.isnan(value):
        return ""
    return "not determined" if math.isinf(value) else f"{value:.{digits}g}"


def residuals_figure(fitted: Fitted) -> Figure:
    """The residuals of spots, or those of pixels, over their standard deviations."""
    with matplotlib.rc_context(STYLE):
        return _residuals(fitted) if fitted.pixels is None else _pixels(fitted.pixels)


def _residuals(fitted: Fitted) -> Figure:
    """Each kind of residual against the reading; the last panel has all against a normal's."""
    rows = math.ceil((len(fitted.residuals) + 1) / 3)
    figure = Figure(figsize=(10.0, 2.0 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, 3, squeeze=False).flat
    normal = statistics.NormalDist()
    quantiles = panels[len(fitted.residuals)]
    for kind, (name, values) in enumerate(fitted.residuals.items()):
        at = 0
        for number, recording in enumerate(fitted.recordings):
            readings = recording.trial.readings
            _marks(panels[kind], readings, values[at : at + readings.size], number, recording.name)
            at += readings.size
        panels[kind].axhline(0.0, color="#999999", lw=0.8)
        panels[kind].set(title=in_figure(name), xlabel="reading (mm)", ylabel="residual / σ")
        expected = [normal.inv_cdf((k + 0.5) / values.size) for k in range(values.size)]
        _marks(quantiles, expected, np.sort(values), kind, name)
    quantiles.axline((0.0, 0.0), slope=1.0, color="#999999", lw=0.8)
    quantiles.set(xlabel="quantile of the normal distribution", ylabel="sorted residual / σ")
    quantiles.legend(loc="upper left", fontsize=7, labelspacing=0.2, handletextpad=0.1)
    for unused in panels[len(fitted.residuals) + 1 :]:
        unused.set_axis_off()
    if len(fitted.recordings) > 1:
        panels[0].legend()
    return figure


def _pixels(pixels: PixelResiduals) -> Figure:
    """Maps of smoothed residuals for groups of frames, and the mean residual of each frame."""
    figure = Figure(figsize=(10.0, 6.6), layout="constrained")
    halves: Any = figure.subfigures(2, 1, height_ratios=(2.2, 1.0))
    upper, lower = halves
    grid = upper.subplots(2, 3, squeeze=False, sharex=True, sharey=True)
    lit = np.argwhere(np.isfinite(pixels.maps).any(axis=0))
    (top, first), (bottom, last) = lit.min(axis=0), lit.max(axis=0)
    for axes in grid.flat[len(pixels.maps) :]:
        axes.set_axis_off()
    for axes, smooth, (begin, end) in zip(grid.flat, pixels.maps, pixels.groups, strict=False):
        shown = axes.imshow(
            smooth,
            cmap="RdBu_r",
            vmin=-_COLOUR_SCALE_SIGMAS,
            vmax=_COLOUR_SCALE_SIGMAS,
            interpolation="nearest",
        )
        axes.set(xlim=(first - 1, last + 1), ylim=(bottom + 1, top - 1), facecolor="#E4E4E4")
        axes.set_title(f"frame {begin}" if begin == end else f"frames {begin} to {end}")
        axes.grid(visible=False)
    upper.colorbar(shown, ax=grid, extend="both", label="smoothed residual / its σ")
    for axes in grid[-1]:
        axes.set_xlabel("$u$ (px)")
    for axes in grid[:, 0]:
        axes.set_ylabel("$v$ (px)")
    frames = lower.subplots()
    _marks(frames, pixels.frames, pixels.of_frames, 0, "")
    frames.axhline(0.0, color="#999999", lw=0.8)
    frames.set(xlabel="frame", ylabel="mean over pixels / its σ")
    return figure


def _lines(fitted: Fitted) -> Figure:
    """Distance against spot size, with confidence bands."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for number, recording in enumerate(fitted.recordings):
        size, line, band = fitted.lines[recording.name]
        trial = recording.trial
        axis = np.asarray(trial.ellipses.semi_minor)
        count_from = trial.touch.mean if trial.kind == "eyeball" else 0.0
        distance = trial.readings + count_from
        colour = PALETTE[number % len(PALETTE)]
        _marks(left, axis, distance, number, recording.name)
        left.plot(size, line, color=colour, lw=1)
        left_over = np.interp(axis, size, line) - distance
        _marks(right, axis, left_over, number, recording.name)
        right.fill_between(size, -band, band, color=colour, alpha=0.2, lw=0)
    for axes in (left, right):
        axes.set_xlabel("$e_1'$ (px)")
    left.set_ylabel("reading (mm)")
    right.set_ylabel("model − reading (mm)")
    left.legend()
    return figure


def _marks(axes: Axes, x: Any, y: Any, number: int, label: str) -> None:
    axes.plot(
        x,
        y,
        _MARKERS[number % len(_MARKERS)],
        color=PALETTE[number % len(PALETTE)],
        ms=3.5,
        label=in_figure(label),
    )


def _svg(figure: Figure) -> str:
    """Data URI of the figure."""
    file = io.BytesIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(file.getvalue()).decode()}"
