"""The report's figures: of the spots, of the models' errors, and strips of frames."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse

from benchmarks.evaluation import (
    ACCEPTABLE_ERROR_MM,
    ALL_PLANES,
    COMPARED,
    DISTANCE,
    ECCENTRICITY,
    MEASURED,
    MODEL_COLOURS,
    READING,
    SUBPIXEL,
    TABLE_I,
    TRIAL_COLOURS,
    USED,
    WAYS,
    StaticTrial,
    Way,
    largest_errors,
    pinhole_title,
    rms,
)
from benchmarks.reporting import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    SKY,
    VERMILION,
    grouped,
    small_multiples,
)
from benchmarks.studies.validate.tables import ValidateFindings, small_plane_curve
from estimator import FrameLabels, NoSpot, Spot, read_stack

_WAY_COLOURS = dict(zip((way.name for way in WAYS), (VERMILION, ORANGE, BLUE), strict=True))
_MARKERS = ("o", "^", "s")
_WAY_MARKERS = dict(zip(_WAY_COLOURS, _MARKERS, strict=True))


class SpotFigures:
    """Figures of the spots of a run; `spots` are those of spots.csv."""

    def __init__(self, findings: ValidateFindings, spots: pd.DataFrame) -> None:
        self._findings = findings
        used = spots[spots.outcome == USED]
        self._used = dict(grouped(used, "source", "way", "group"))
        self._none = used[:0]

    def plane_fit(self) -> Figure:
        """d_r against e1' on the plane, with each trial's line and the line of all (Table I)."""
        fits = self._findings.plane_fits

        def draw(axes: Axes, source: str, way: str) -> None:
            spots = self._fitted(source, way, fits)
            for n, (group, rows) in enumerate(spots.items()):
                e = rows.measured_px
                _marks(axes, e, rows.d_r_mm, n, group)
                fit = fits[source, way][group]
                ends = np.array([e.min(), e.max()])
                axes.plot(ends, fit.delta_k * ends + fit.b, color=TRIAL_COLOURS[n], lw=1)
            sizes = [e for rows in spots.values() for e in rows.measured_px]
            for line, ls, color, label in (
                (fits.get((source, way), {}).get(ALL_PLANES), "--", BLACK, ALL_PLANES),
                (TABLE_I[ALL_PLANES], ":", GREY, "all planes of the paper"),
            ):
                if line and sizes:
                    ends = np.array([min(sizes), max(sizes)])
                    d = line.delta_k * ends + line.b
                    axes.plot(ends, d, ls=ls, color=color, lw=1, label=label, zorder=3)

        return self._by_source_and_way(draw, x=MEASURED, y=READING)

    def sphere_fit(self) -> Figure:
        """d_r against e1' in the eyeball, with the small-plane model at the fitted c (Table II)."""
        fits = self._findings.sphere_fits

        def draw(axes: Axes, source: str, way: str) -> None:
            for n, (group, rows) in enumerate(self._fitted(source, way, fits).items()):
                scene = next(t.scene for t in self._findings.trials if t.group == group)
                e = rows.measured_px
                _marks(axes, e, rows.d_r_mm, n, group)
                along = np.linspace(e.min(), e.max(), 50)
                curve = small_plane_curve(
                    along,
                    plane=self._findings.plane_fits[source, way][ALL_PLANES],
                    c=fits[source, way][group].c,
                    scale=scene.microscope.scale_mm_px,
                    eye_radius=scene.phantom.radius_mm,
                )
                axes.plot(along, curve, color=TRIAL_COLOURS[n], lw=1)

        return self._by_source_and_way(draw, x=MEASURED, y=READING)

    def residuals(self, fits: Mapping[tuple[str, str], Mapping[str, Any]]) -> Figure:
        """Residuals of the fits of Table I or II against distance."""

        def draw(axes: Axes, source: str, way: str) -> None:
            axes.axhline(0, color=GREY, lw=0.8)
            spots = self._fitted(source, way, fits)
            for n, (group, rows) in enumerate(spots.items()):
                x, y = rows.d_r_mm, rows.residual_mm
                axes.plot(x, y, color=TRIAL_COLOURS[n], lw=0.7, alpha=0.6)
                _marks(axes, x, y, n, group)
            size = rms(e for rows in spots.values() for e in rows.residual_mm)
            axes.set_title(f"rms {size:.2g} mm", loc="right", color=GREY)

        return self._by_source_and_way(draw, x=READING, y="estimate − $d_r$ (mm)")

    def bias(self) -> Figure:
        """Measured minus true semi-minor axis of each way, against distance."""

        def draw(axes: Axes, source: str, kind: str) -> None:
            axes.axhline(0, color=GREY, lw=0.8)
            for way, colour in _WAY_COLOURS.items():
                of = [
                    rows
                    for (s, w, group), rows in self._used.items()
                    if (s, w) == (source, way) and group.startswith(kind)
                ]
                seen = pd.concat([self._none, *of])
                x, y = seen.d_mm, seen.measured_px - seen.half_max_px
                axes.plot(x, y, ls="", marker=_WAY_MARKERS[way], ms=3, color=colour, label=way)

        return small_multiples(
            draw,
            rows=self._findings.sources,
            columns=["plane", "sphere"],
            x=DISTANCE,
            y="measured − true $e_1'$ (px)",
            sharex=True,
            sharey="row",
        )

    def half_maximum(self, ambiguous: tuple[float, float] | None) -> Figure:
        """The lens's half-maximum radius on the plane against distance, and the measured ones.

        Args:
            ambiguous: distances between which a radius belongs to more than one distance, mm.
        """
        trial = self._findings.planes("lens")[0]
        scale = trial.scene.microscope.scale_mm_px
        labels = self._findings.tracked[trial.name, SUBPIXEL.name].labels

        def draw(axes: Axes, *_: str) -> None:
            if ambiguous:
                label = "one radius, several distances"
                axes.axvspan(*ambiguous, color="#F2E6D0", lw=0, label=label)
            d = [row.d_mm for row in labels]
            half = [row.half_max_semi_minor_px * scale for row in labels]
            axes.plot(d, half, color=BLACK, lw=1.8, label="half maximum, true")
            cone = [row.cone_semi_minor_px * scale for row in labels]
            axes.plot(d, cone, color=GREY, ls="--", label="straight cone fitted to it")
            for way, colour in _WAY_COLOURS.items():
                seen = self._used.get(("lens", way, trial.group), self._none)
                x, y = seen.d_mm, seen.measured_px * scale
                axes.plot(x, y, ls="", marker=_WAY_MARKERS[way], ms=3.5, color=colour, label=way)
            axes.set_ylim(bottom=0)

        y = "semi-minor axis on the wall (mm)"
        return small_multiples(
            draw, rows=[""], columns=[""], x=DISTANCE, y=y, height=3.1, legend_columns=3
        )

    def _fitted(
        self, source: str, way: str, fits: Mapping[tuple[str, str], Mapping[str, Any]]
    ) -> dict[str, pd.DataFrame]:
        """The spots behind each trial's fit."""
        groups = [name for name in fits.get((source, way), {}) if name != ALL_PLANES]
        return {group: self._used[source, way, group] for group in groups}

    def _by_source_and_way(self, draw: Any, *, x: str, y: str) -> Figure:
        fits = self._findings.plane_fits
        ways = [way for way in _WAY_COLOURS if any(way == name for _, name in fits)]
        rows = self._findings.sources
        return small_multiples(
            draw, rows=rows, columns=ways, x=x, y=y, legend_columns=5, sharex=True, sharey="row"
        )


def model_error_size(findings: ValidateFindings) -> Figure:
    """Largest absolute error over all distances, on a logarithmic axis: a column a pinhole."""
    rendered, analytic = findings.rendered, findings.analytic
    tilted = rendered.incidence_deg.max()
    exact = analytic[(analytic.incidence_deg - tilted).abs() < 1e-6]

    def draw(axes: Axes, azimuth: float, height: float) -> None:
        axes.axhline(ACCEPTABLE_ERROR_MM, color=VERMILION, lw=0.8, ls="--")
        for model, marker in zip(COMPARED, "ov^s", strict=True):
            line, points = (
                largest_errors(
                    errors[
                        (errors.model == model)
                        & (errors.z_f_mm == height)
                        & (errors.azimuth_deg == azimuth)
                    ]
                )
                for errors in (exact, rendered)
            )
            colour = MODEL_COLOURS[model]
            # On exact contours `exact` is right to rounding, too small for a logarithmic axis.
            if model != "exact":
                axes.plot(line, color=colour, lw=1)
            axes.plot(points, color=colour, ls="", marker=marker, ms=4.5, label=model)
        axes.set(yscale="log")
        axes.set_ylim(bottom=5e-4)
        axes.yaxis.set_major_formatter("{x:g}")

    return small_multiples(
        draw,
        rows=rendered.azimuth_deg.unique().tolist(),
        columns=rendered.z_f_mm.unique().tolist(),
        title=lambda azimuth, height: f"{pinhole_title(height)}, azimuth {azimuth:g}°",
        x=ECCENTRICITY,
        y="largest |estimate − $d$| (mm)",
        height=3.1,
        sharey=True,
    )


def _marks(axes: Axes, x: Any, y: Any, n: int, label: str) -> None:
    """Open marks of the trial with number n, larger ones around smaller ones."""
    size, colour = 2.4 + 1.1 * n, TRIAL_COLOURS[n]
    axes.plot(
        x, y, ls="", marker=_MARKERS[n], ms=size, mfc="none", mew=0.7, color=colour, label=label
    )


# Strips of frames.

_COLUMNS = 7
_MARGIN = 1.5  # of the view, in units of the largest spot
_GAP, _CAPTION = 6, 44  # between frames, and below one, px of the frames
_WIDTH_IN, _LEGEND_IN, _LEFT = 10.0, 0.25, 0.04
_DASHES = (0, (3, 2))
# The last of the ways that share an exposure is the best one.
_SHOWN = {way.exposure: way for way in WAYS}


_EllipseNumbers = tuple[float, float, float, float, float]
"""Centre, semi-axes (px) and angle (rad)."""


class Shown(NamedTuple):
    """A frame of the strip."""

    trial: StaticTrial
    way: Way
    labels: FrameLabels
    result: Spot | NoSpot
    outcome: str


def shown_frames(findings: ValidateFindings, group: str) -> list[list[Shown]]:
    """One line of frames for each source and exposure, at evenly spaced distances.

    Args:
        group: place of the trials, "plane 1".
    """
    lines = []
    for trial in (trial for trial in findings.trials if trial.group == group):
        for exposure in trial.scene.exposures.kinds:
            way = _SHOWN[exposure]
            tracked = findings.tracked[trial.name, way.name]
            frames = list(zip(tracked.labels, tracked.results, tracked.outcomes, strict=True))
            chosen = np.linspace(0, len(frames) - 1, min(_COLUMNS, len(frames))).round()
            lines.append([Shown(trial, way, *frames[int(i)]) for i in chosen])
    return lines


def strip_table(lines: Sequence[Sequence[Shown]]) -> pd.DataFrame:
    """Content of strip.csv: the frames with both ellipses; px and rad."""
    ellipse = ["x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad"]
    about = ["trial", "way", "file_name", "d_mm", "outcome"]
    rows = [
        (
            *(shown.trial.name, shown.way.name, shown.labels.file_name, shown.labels.d_mm),
            shown.outcome,
            *_true_ellipse(shown.labels),
            *_measured_ellipse(shown.result),
        )
        for line in lines
        for shown in line
    ]
    return pd.DataFrame(rows, columns=about + [f"true_{name}" for name in ellipse] + ellipse)


def strip_figure(lines: Sequence[Sequence[Shown]], *, stacks: Path) -> Figure:
    """Draw the frames, all at one scale.

    All frames are put into one picture, because an `Axes` for each takes ten times as long.

    Args:
        lines: of `shown_frames`.
        stacks: folder of the image stacks.
    """
    half = round(_MARGIN * max(f.labels.half_max_semi_major_px for line in lines for f in line))
    half += half % 2
    step = np.array([2 * half + _GAP, 2 * half + _CAPTION])
    columns = max(len(line) for line in lines)
    width, height = step * [columns, len(lines)] - [_GAP, 0]
    picture = np.full((height, width, 3), 255, np.uint8)
    figure = Figure(figsize=(_WIDTH_IN, _WIDTH_IN * (1 - _LEFT) * height / width + _LEGEND_IN))
    bottom = _LEGEND_IN / figure.get_figheight()
    axes = figure.add_axes((_LEFT, bottom, 1 - _LEFT, 1 - bottom), frameon=False)
    per_px = 72 * _WIDTH_IN * (1 - _LEFT) / width  # points on the page
    for row, line in enumerate(lines):
        first = line[0]
        stack = read_stack(stacks / first.trial.name)
        for column, frame in enumerate(line):
            corner = step * [column, row]
            tile, origin = _tile(stack.image(frame.labels), frame.labels, half)
            picture[corner[1] :, corner[0] :][: 2 * half, : 2 * half] = tile
            _annotate(axes, frame, corner, corner - origin, half, per_px)
        name = f"{first.trial.source}, {first.way.exposure}\n{first.way.name.split(',')[0]}"
        axes.text(-4 / per_px, step[1] * row + half, name, rotation=90, ha="right", va="center")
    axes.imshow(_halved(picture), extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    axes.set_axis_off()
    figure.legend(
        handles=[
            Line2D([], [], color=SKY, lw=1.8, label="measured"),
            Line2D([], [], color=ORANGE, lw=1.2, ls=_DASHES, label="true: half of the peak"),
        ],
        loc="lower center",
        ncols=2,
    )
    return figure


def _tile(image: np.ndarray, labels: FrameLabels, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Square of the image about the spot, black outside the frame, and its first pixel (u, v)."""
    origin = np.round([labels.half_max_x_px, labels.half_max_y_px]).astype(int) - half
    padded = np.pad(image, ((2 * half, 2 * half), (2 * half, 2 * half), (0, 0)))
    u, v = origin + 2 * half
    return padded[v : v + 2 * half, u : u + 2 * half], origin


def _halved(picture: np.ndarray) -> np.ndarray:
    """The picture at half the size, which is enough for a page and has a quarter of the bytes."""
    height, width = (2 * (n // 2) for n in picture.shape[:2])
    blocks = picture[:height, :width].reshape(height // 2, 2, width // 2, 2, 3)
    return blocks.mean(axis=(1, 3)).astype(np.uint8)


def _annotate(
    axes: Axes, frame: Shown, corner: np.ndarray, shift: np.ndarray, half: int, per_px: float
) -> None:
    """Both ellipses over a tile, its distance under it, and why there is no spot."""
    middle, foot = corner[0] + half, corner[1] + 2 * half
    if frame.result:
        _outline(axes, _measured_ellipse(frame.result), shift, color=SKY, lw=1.8)
    else:
        y = foot - 4 / per_px
        axes.text(middle, y, frame.outcome, color="white", ha="center", va="bottom", size=8)
    _outline(axes, _true_ellipse(frame.labels), shift, color=ORANGE, lw=1.0, ls=_DASHES)
    text = f"$d$ = {frame.labels.d_mm:.2f} mm"
    axes.text(middle, foot + 3 / per_px, text, ha="center", va="top")


def _outline(axes: Axes, ellipse: _EllipseNumbers, shift: np.ndarray, **style: Any) -> None:
    x, y, major, minor, angle = ellipse
    middle, degrees = (x + shift[0], y + shift[1]), math.degrees(angle)
    axes.add_patch(Ellipse(middle, 2 * major, 2 * minor, angle=degrees, fill=False, **style))


def _true_ellipse(labels: FrameLabels) -> _EllipseNumbers:
    names = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad")
    x, y, major, minor, angle = (getattr(labels, f"half_max_{name}") for name in names)
    return x, y, major, minor, angle


def _measured_ellipse(result: Spot | NoSpot) -> _EllipseNumbers:
    if isinstance(result, NoSpot):
        return (math.nan,) * 5
    return result.x_px, result.y_px, result.semi_major_px, result.semi_minor_px, result.angle_rad
