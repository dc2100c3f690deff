"""The report's figures except the strips of frames, drawn from the rows of spots.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
    largest_errors,
    pinhole_title,
    rms,
)
from benchmarks.reporting import BLACK, BLUE, GREY, ORANGE, VERMILION, small_multiples
from benchmarks.studies.validate.findings import SpotRow, ValidateFindings
from benchmarks.studies.validate.tables import small_plane_curve

_WAY_COLOURS = dict(zip((way.name for way in WAYS), (VERMILION, ORANGE, BLUE), strict=True))
_MARKERS = ("o", "^", "s")
_WAY_MARKERS = dict(zip(_WAY_COLOURS, _MARKERS, strict=True))


class SpotFigures:
    """Figures of the spots of a run.

    Args:
        findings: the run.
        rows: all spots.
    """

    def __init__(self, findings: ValidateFindings, rows: Sequence[SpotRow]) -> None:
        self._findings = findings
        self._used: dict[tuple[str, str, str], list[SpotRow]] = {}
        for row in rows:
            if row.outcome == USED:
                self._used.setdefault((row.source, row.way, row.group), []).append(row)

    def plane_fit(self) -> Figure:
        """d_r against e1' on the plane, with each trial's line and the line of all (Table I)."""
        fits = self._findings.plane_fits

        def draw(axes: Axes, source: str, way: str) -> None:
            spots = self._fitted(source, way, fits)
            for n, (group, rows) in enumerate(spots.items()):
                e = np.array([row.measured_px for row in rows])
                _marks(axes, e, [row.d_r_mm for row in rows], n, group)
                fit = fits[source, way][group]
                ends = np.array([e.min(), e.max()])
                axes.plot(ends, fit.delta_k * ends + fit.b, color=TRIAL_COLOURS[n], lw=1)
            sizes = [row.measured_px for rows in spots.values() for row in rows]
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
                e = np.array([row.measured_px for row in rows])
                _marks(axes, e, [row.d_r_mm for row in rows], n, group)
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
                x, y = [row.d_r_mm for row in rows], [row.residual_mm for row in rows]
                axes.plot(x, y, color=TRIAL_COLOURS[n], lw=0.7, alpha=0.6)
                _marks(axes, x, y, n, group)
            size = rms(row.residual_mm for rows in spots.values() for row in rows)
            axes.set_title(f"rms {size:.2g} mm", loc="right", color=GREY)

        return self._by_source_and_way(draw, x=READING, y="estimate − $d_r$ (mm)")

    def bias(self) -> Figure:
        """Measured minus true semi-minor axis of each way, against distance."""

        def draw(axes: Axes, source: str, kind: str) -> None:
            axes.axhline(0, color=GREY, lw=0.8)
            for way, colour in _WAY_COLOURS.items():
                rows = self._some(source, way, kind)
                x, y = [r.d_mm for r in rows], [r.measured_px - r.half_max_px for r in rows]
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
                seen = self._used.get(("lens", way, trial.group), [])
                x, y = [row.d_mm for row in seen], [row.measured_px * scale for row in seen]
                axes.plot(x, y, ls="", marker=_WAY_MARKERS[way], ms=3.5, color=colour, label=way)
            axes.set_ylim(bottom=0)

        y = "semi-minor axis on the wall (mm)"
        return small_multiples(
            draw, rows=[""], columns=[""], x=DISTANCE, y=y, height=3.1, legend_columns=3
        )

    def _some(self, source: str, way: str, kind: str) -> list[SpotRow]:
        """The used spots of one source, way and kind of wall."""
        return [
            row
            for (s, w, group), rows in self._used.items()
            if (s, w) == (source, way) and group.startswith(kind)
            for row in rows
        ]

    def _fitted(
        self, source: str, way: str, fits: Mapping[tuple[str, str], Mapping[str, Any]]
    ) -> dict[str, list[SpotRow]]:
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
    tilted = max(e.incidence_deg for e in findings.rendered)

    def draw(axes: Axes, azimuth: float, height: float) -> None:
        axes.axhline(ACCEPTABLE_ERROR_MM, color=VERMILION, lw=0.8, ls="--")
        for model, marker in zip(COMPARED, "ov^s", strict=True):
            exact, seen = (
                [
                    e
                    for e in errors
                    if (e.model, e.z_f_mm, e.azimuth_deg) == (model, height, azimuth)
                ]
                for errors in (findings.analytic, findings.rendered)
            )
            line = largest_errors(e for e in exact if abs(e.incidence_deg - tilted) < 1e-6)
            colour = MODEL_COLOURS[model]
            # On exact contours `exact` is right to rounding, too small for a logarithmic axis.
            if model != "exact":
                axes.plot(*line, color=colour, lw=1)
            points = largest_errors(seen)
            axes.plot(*points, color=colour, ls="", marker=marker, ms=4.5, label=model)
        axes.set(yscale="log")
        axes.set_ylim(bottom=5e-4)
        axes.yaxis.set_major_formatter("{x:g}")

    return small_multiples(
        draw,
        rows=list(dict.fromkeys(e.azimuth_deg for e in findings.rendered)),
        columns=list(dict.fromkeys(e.z_f_mm for e in findings.rendered)),
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
