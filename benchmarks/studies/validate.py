"""The main job: the paper's static experiment on rendered images, and its model against the truth.

DIR/run.json         the request; a folder with another run.json is refused
    stacks/…         labelled image stacks, one for each trial
    spots/…          the spots measured in them, in each way
    *.csv, figures/  the numbers and figures of the report
    summary.json     what was found
    report.html      the same, for people
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from cyclopts.types import NonNegativeInt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse

import optics
from benchmarks import model_error
from benchmarks.model_error import (
    CHOSEN_DISTANCES_MM,
    COMPARED,
    DISTANCE,
    ECCENTRICITY,
    MEASURED,
    MODEL_COLOURS,
    READING,
    SHOWN,
    TRIAL_COLOURS,
    accuracy,
    geometry_of,
    largest_errors,
    limit_eccentricity,
    measured_errors,
    model_error_figure,
    pinhole_title,
)
from benchmarks.paper import (
    ACCEPTABLE_ERROR_MM,
    ALL_PLANES,
    LITERAL,
    PINHOLE_HEIGHTS_MM,
    STRAIGHT,
    SUBPIXEL,
    TABLE_I,
    TABLE_II,
    TILT_AZIMUTHS_DEG,
    USED,
    WAYS,
    Criterion,
    PlaneRow,
    StaticTrial,
    Way,
    grid_trials,
    largest,
    paper_trials,
    reproduction,
    rms,
    track_stack,
)
from benchmarks.reporting import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    SKY,
    VERMILION,
    Claim,
    Column,
    Picture,
    Report,
    Section,
    Table,
    grouped,
    number,
    rows_of,
    small_multiples,
    where,
)
from benchmarks.study import LightSource, OutputFolder, Quick, Study
from calibration import PlaneFit, SphereFit, fit_eccentricity, fit_lines, fit_plane
from estimator import Stack, read_stack
from scenes import Scene, World

# The fits of Tables I and II, the model errors, and the tables of the CSV files.

CHOSEN_ECCENTRICITIES_MM = (3.0, 5.0)
"""Eccentricities at which the report gives the model errors."""
_ANALYTIC_HEIGHTS_MM = (*PINHOLE_HEIGHTS_MM, 100.0)
_FEWEST_SPOTS = 6  # fewer do not determine a line and its scatter
_STEP_MM = 0.5
_SHORTEST_MM = 2.0


@dataclass(frozen=True, kw_only=True)
class ValidateFindings:
    """All results of a run.

    Attributes:
        spots: of every trial in every way (columns trial, source, kind, group, way, and those of
            `paper.spots_of`).
        plane_fits: by (source, way), then by "plane 1" … and "all planes".
        sphere_fits: by (source, way), then by "sphere 1" …
        rendered: model errors on measured spots of the ideal cone.
    """

    stacks: Path
    trials: list[StaticTrial]
    spots: pd.DataFrame
    plane_fits: dict[tuple[str, str], dict[str, PlaneFit]]
    sphere_fits: dict[tuple[str, str], dict[str, SphereFit]]
    analytic: pd.DataFrame
    rendered: pd.DataFrame

    def planes(self, source: str) -> list[StaticTrial]:
        """The trials of a source on the plane."""
        return [t for t in self.trials if (t.source, t.kind) == (source, "plane")]

    @property
    def sources(self) -> list[str]:
        """The sources of the paper's trials."""
        return list(dict.fromkeys(t.source for t in self.trials if t.kind != "grid"))


# Fits and model errors.

Fits = tuple[
    dict[tuple[str, str], dict[str, PlaneFit]], dict[tuple[str, str], dict[str, SphereFit]]
]
"""Fits on planes and in spheres, by (source, way), then by trial."""


def fit_tables(trials: Sequence[StaticTrial], spots: pd.DataFrame) -> Fits:
    """Tables I and II for every source and way of measuring with enough spots."""
    plane_fits, sphere_fits = {}, {}
    scene, used = trials[0].scene, spots[spots.used]
    for source, way in product(("lens", "cone"), WAYS):
        seen = where(used, source=source, way=way.name)
        enough = seen[seen.groupby("trial").trial.transform("size") >= _FEWEST_SPOTS]
        planes = where(enough, kind="plane")
        if planes.empty:
            continue
        pooled = _line(planes)
        plane_fits[source, way.name] = {
            group: _line(rows) for group, rows in grouped(planes, "group")
        } | {ALL_PLANES: pooled}
        sphere_fits[source, way.name] = {
            group: fit_eccentricity(
                semi_minor_px=rows.semi_minor_px.to_numpy(),
                distance=rows.d_r_mm.to_numpy(),
                delta_k=pooled.delta_k,
                b=pooled.b,
                scale=scene.microscope.scale_mm_px,
                eye_radius=scene.phantom.radius_mm,
            )
            for group, rows in grouped(where(enough, kind="sphere"), "group")
        }
    return plane_fits, sphere_fits


def _line(spots: pd.DataFrame) -> PlaneFit:
    return fit_plane(semi_minor_px=spots.semi_minor_px.to_numpy(), distance=spots.d_r_mm.to_numpy())


def analytic_errors(*, quick: bool) -> pd.DataFrame:
    """Errors on exact contours: square to the wall, and at the trials' incidence and azimuths."""
    geometry = geometry_of(grid_trials(quick=quick, seed=0)[0].scene)
    tilts = [(0.0, 0.0), *((geometry.incidence, azimuth) for azimuth in TILT_AZIMUTHS_DEG)]
    tables = [
        model_error.analytic_errors(
            geometry._replace(
                pinhole_height=height,
                incidence=incidence,
                incidence_azimuth=math.radians(azimuth_deg),
            ),
            eccentricities=np.linspace(0.0, 7.0, 8 if quick else 29),
            distances=np.arange(0.5, 6.01, 0.5),
        )
        for height in _ANALYTIC_HEIGHTS_MM
        for incidence, azimuth_deg in tilts
    ]
    return pd.concat(tables, ignore_index=True)


def rendered_errors(trials: Sequence[StaticTrial], spots: pd.DataFrame) -> pd.DataFrame:
    """Errors on measured spots of the grid, each pinhole height and azimuth in one batch."""
    used = spots[spots.used]
    geometries = {t.name: geometry_of(t.scene) for t in trials if t.kind == "grid"}
    tables = []
    for geometry in dict.fromkeys(geometries.values()):
        own = used.trial.isin([name for name, its in geometries.items() if its == geometry])
        tables.append(measured_errors(geometry, used[own]))
    return pd.concat(tables, ignore_index=True)


class PartialFit(NamedTuple):
    """The criteria of Table I on the spots of a part of the range, low <= d_r <= high (mm)."""

    low: float
    high: float
    criteria: dict[Criterion, Claim]

    @property
    def met(self) -> int:
        """Number of criteria that are met."""
        return sum(bool(claim.holds) for claim in self.criteria.values())


def nearest_reproduction(findings: ValidateFindings, *, source: str, way: Way) -> PartialFit | None:
    """The widest of those parts of the range that meet most criteria of Table I.

    The paper does not state the distances of its fits. This tries all parts of 2 mm or more that
    begin and end at multiples of 0.5 mm. None if no part has three spots of each trial.
    """
    used = findings.spots[findings.spots.used]
    planes = where(used, source=source, way=way.name, kind="plane")
    ends = np.arange(0.0, max(planes.d_r_mm, default=0.0) + 1e-6, _STEP_MM)
    groups = [t.group for t in findings.planes(source)]
    parts = []
    for low in ends:
        for high in ends[ends >= low + _SHORTEST_MM]:
            inside = planes[planes.d_r_mm.between(low - 1e-6, high + 1e-6, inclusive="neither")]
            spots = {
                group: (rows.semi_minor_px.to_numpy(), rows.d_r_mm.to_numpy())
                for group in groups
                for rows in [where(inside, group=group)]
            }
            if all(e.size >= 3 for e, _ in spots.values()):
                axes, travels = zip(*spots.values(), strict=True)
                spots[ALL_PLANES] = np.concatenate(axes), np.concatenate(travels)
                fits = {
                    group: PlaneRow(*(float(value) for value in fit_lines(e, d)))
                    for group, (e, d) in spots.items()
                }
                parts.append(PartialFit(float(low), float(high), reproduction(fits)))
    return max(parts, key=lambda part: (part.met, part.high - part.low), default=None)


def half_maximum_curve(findings: ValidateFindings) -> tuple[np.ndarray, np.ndarray] | None:
    """Distance and half-maximum radius (mm) of the lens on the first plane; None without a lens."""
    if not findings.planes("lens"):
        return None
    trial = findings.planes("lens")[0]
    rows = where(findings.spots, trial=trial.name, way=SUBPIXEL.name)
    scale = trial.scene.microscope.scale_mm_px
    return rows.d_mm.to_numpy(), rows.half_max_semi_minor_px.to_numpy() * scale


def ambiguous_range(distance: np.ndarray, radius: np.ndarray) -> tuple[float, float] | None:
    """First and last distance that share their radius with another distance, or None."""
    largest_before = np.maximum.accumulate(np.concatenate([[-math.inf], radius[:-1]]))
    least_after = np.minimum.accumulate(np.concatenate([radius[1:], [math.inf]])[::-1])[::-1]
    shared = (radius <= largest_before) | (radius >= least_after)
    if not shared.any():
        return None
    return float(distance[shared].min()), float(distance[shared].max())


# Tables of the CSV files.


def plane_table(findings: ValidateFindings) -> pd.DataFrame:
    """Table I for every source and way with fits, and the paper's values."""
    return pd.DataFrame(
        {
            "source": source,
            "way": way,
            "trial": trial,
            "delta_k_mm_px": fit.delta_k,
            "delta_k_error_mm_px": fit.delta_k_error,
            "paper_delta_k_mm_px": TABLE_I[trial].delta_k,
            "b_mm": fit.b,
            "b_error_mm": fit.b_error,
            "paper_b_mm": TABLE_I[trial].b,
            "r_squared": fit.r_squared,
            "paper_r_squared": TABLE_I[trial].r_squared,
            "rmse_mm": fit.rmse,
            "paper_rmse_mm": TABLE_I[trial].rmse,
            "contact_radius_px": -fit.b / fit.delta_k,
            "spots": fit.spots,
            "converged": fit.converged,
        }
        for (source, way), fits in findings.plane_fits.items()
        for trial, fit in fits.items()
    )


def sphere_table(findings: ValidateFindings) -> pd.DataFrame:
    """Table II for every source and way with fits, the true c and the paper's values.

    `c_expected_mm` is the c whose factor cos(phi) equals the correct factor of the true c.
    """
    scenes = {(t.source, t.group): t.scene for t in findings.trials}
    return pd.DataFrame(
        {
            "source": source,
            "way": way,
            "trial": trial,
            "c_true_mm": scenes[source, trial].spot.eccentricity_mm,
            "c_fitted_mm": fit.c,
            "c_error_mm": fit.c_error,
            "c_expected_mm": _expected_eccentricity(scenes[source, trial]),
            "standard_deviation_mm": fit.standard_deviation,
            "paper_standard_deviation_mm": TABLE_II[trial].standard_deviation,
            "mean_absolute_error_mm": fit.mean_absolute_error,
            "paper_mean_absolute_error_mm": TABLE_II[trial].mean_absolute_error,
            "max_error_mm": fit.max_error,
            "paper_max_error_mm": TABLE_II[trial].max_error,
            "spots": fit.spots,
            "converged": fit.converged,
            "at_bound": fit.at_bound,
        }
        for (source, way), fits in findings.sphere_fits.items()
        for trial, fit in fits.items()
    )


def spot_table(findings: ValidateFindings) -> pd.DataFrame:
    """Truth and measurement of every frame in every way in which it was measured.

    `estimate_mm` comes from the fit that used the frame. It is zero at contact, like d_r.
    """
    trials = {trial.name: trial for trial in findings.trials}
    tables = [
        rows.assign(
            estimate_mm=np.where(
                rows.used,
                _estimate(trials[name], way, rows.semi_minor_px.to_numpy(), findings),
                math.nan,
            )
        )
        for (name, way), rows in grouped(findings.spots, "trial", "way")
    ]
    spots = pd.concat(tables, ignore_index=True)
    spots["residual_mm"] = spots.estimate_mm - spots.d_r_mm
    return spots.rename(columns=_SHORT)[_SPOT_COLUMNS]


_SHORT = {
    "semi_minor_px": "measured_px",
    "half_max_semi_minor_px": "half_max_px",
    "cone_semi_minor_px": "cone_px",
}
_SPOT_COLUMNS = (
    "trial source group way frame file_name c_mm d_mm d_r_mm visible_fraction saturated_fraction "
    "outcome measured_px half_max_px cone_px estimate_mm residual_mm"
).split()
"""Of spots.csv."""


def frame_table(findings: ValidateFindings) -> pd.DataFrame:
    """Number of each trial's frames with one outcome in one way."""
    tables = [
        rows.groupby(["trial", "source", "way", "outcome"]).size().reset_index(name="frames")
        for _, rows in grouped(findings.spots, "trial", "way")
    ]
    return pd.concat(tables, ignore_index=True)


def square_errors(errors: pd.DataFrame, *, c: float) -> pd.DataFrame:
    """The errors of a beam square to the wall, at one eccentricity and the chosen distances."""
    chosen = np.isclose(errors.d_mm.to_numpy()[:, None], CHOSEN_DISTANCES_MM).any(axis=1)
    return errors[(errors.incidence_deg == 0) & np.isclose(errors.c_mm, c) & chosen]


def _expected_eccentricity(scene: Scene) -> float:
    """c' with cos(phi') = the right first-order factor at c, or 0 if that is above 1, mm."""
    r = scene.phantom.radius_mm
    factor = optics.corrected_factor(
        eccentricity=scene.spot.eccentricity_mm,
        eye_radius=r,
        inverse_working_distance=1.0 / (scene.microscope.pinhole_height_mm + r),
    )
    return r * math.sqrt(max(0.0, 1.0 - float(factor) ** 2))


def _estimate(
    trial: StaticTrial, way: str, semi_minor_px: np.ndarray, findings: ValidateFindings
) -> np.ndarray:
    """Distance since contact by the fit that the trial entered, mm; NaN without a fit."""
    planes = findings.plane_fits.get((trial.source, way), {})
    if trial.kind == "plane" and trial.group in planes:
        fit = planes[trial.group]
        return fit.delta_k * semi_minor_px + fit.b
    sphere = findings.sphere_fits.get((trial.source, way), {}).get(trial.group)
    if sphere is None:
        return np.full(semi_minor_px.shape, math.nan)
    return _small_plane_curve(semi_minor_px, planes[ALL_PLANES], sphere.c, trial.scene)


def _small_plane_curve(
    semi_minor_px: np.ndarray, plane: PlaneFit, c: float, scene: Scene
) -> np.ndarray:
    """Distance by the small-plane model with the plane's delta k and b, mm."""
    scale = scene.microscope.scale_mm_px
    return np.asarray(
        optics.small_plane_distance(
            semi_minor_px=semi_minor_px,
            scale=scale,
            k=plane.delta_k / scale,
            b=plane.b,
            eccentricity=c,
            eye_radius=scene.phantom.radius_mm,
        )
    )


# The report's figures: of the spots, of the models' errors, and strips of frames.

_WAY_COLOURS = dict(zip((way.name for way in WAYS), (VERMILION, ORANGE, BLUE), strict=True))
_MARKERS = ("o", "^", "s")
_WAY_MARKERS = dict(zip(_WAY_COLOURS, _MARKERS, strict=True))


def plane_fit_figure(findings: ValidateFindings, spots: pd.DataFrame) -> Figure:
    """d_r against e1' on the plane, with each trial's line and the line of all (Table I)."""
    fits = findings.plane_fits

    def draw(axes: Axes, key: tuple[str, str], trials: dict[str, pd.DataFrame]) -> None:
        def line(fit: PlaneFit | PlaneRow, e: pd.Series, **style: Any) -> None:
            ends = np.array([e.min(), e.max()])
            axes.plot(ends, fit.delta_k * ends + fit.b, lw=1, **style)

        for n, (group, rows) in enumerate(trials.items()):
            _marks(axes, rows.measured_px, rows.d_r_mm, n, group)
            line(fits[key][group], rows.measured_px, color=TRIAL_COLOURS[n])
        if trials:
            e = pd.concat(trials.values()).measured_px
            line(fits[key][ALL_PLANES], e, ls="--", color=BLACK, label=ALL_PLANES, zorder=3)
            papers = {"ls": ":", "color": GREY, "label": "all planes of the paper"}
            line(TABLE_I[ALL_PLANES], e, **papers, zorder=3)

    return _by_fit(findings, spots, fits, draw, x=MEASURED, y=READING)


def sphere_fit_figure(findings: ValidateFindings, spots: pd.DataFrame) -> Figure:
    """d_r against e1' in the eyeball, with the small-plane model at the fitted c (Table II)."""
    fits = findings.sphere_fits
    scenes = {trial.group: trial.scene for trial in findings.trials}

    def draw(axes: Axes, key: tuple[str, str], trials: dict[str, pd.DataFrame]) -> None:
        for n, (group, rows) in enumerate(trials.items()):
            e, plane = rows.measured_px, findings.plane_fits[key][ALL_PLANES]
            _marks(axes, e, rows.d_r_mm, n, group)
            along = np.linspace(e.min(), e.max(), 50)
            curve = _small_plane_curve(along, plane, fits[key][group].c, scenes[group])
            axes.plot(along, curve, color=TRIAL_COLOURS[n], lw=1)

    return _by_fit(findings, spots, fits, draw, x=MEASURED, y=READING)


def residual_figure(findings: ValidateFindings, spots: pd.DataFrame) -> Figure:
    """Residuals of the fits of Table II against distance."""

    def draw(axes: Axes, _: tuple[str, str], trials: dict[str, pd.DataFrame]) -> None:
        axes.axhline(0, color=GREY, lw=0.8)
        for n, (group, rows) in enumerate(trials.items()):
            x, y = rows.d_r_mm, rows.residual_mm
            axes.plot(x, y, color=TRIAL_COLOURS[n], lw=0.7, alpha=0.6)
            _marks(axes, x, y, n, group)
        size = rms(e for rows in trials.values() for e in rows.residual_mm)
        axes.set_title(f"rms {size:.2g} mm", loc="right", color=GREY)

    fits, y = findings.sphere_fits, "estimate − $d_r$ (mm)"
    return _by_fit(findings, spots, fits, draw, x=READING, y=y)


def _by_fit(
    findings: ValidateFindings,
    spots: pd.DataFrame,
    fits: Mapping[tuple[str, str], Mapping[str, Any]],
    draw: Callable[[Axes, tuple[str, str], dict[str, pd.DataFrame]], None],
    *,
    x: str,
    y: str,
) -> Figure:
    """A panel for each source and way; `draw` gets the spots behind each trial's fit."""
    used = where(spots, outcome=USED)

    def panel(axes: Axes, *key: str) -> None:
        source, way = key
        groups = [name for name in fits.get((source, way), {}) if name != ALL_PLANES]
        own = where(used, source=source, way=way)
        draw(axes, (source, way), {group: where(own, group=group) for group in groups})

    ways = [way for way in _WAY_COLOURS if any(way == name for _, name in findings.plane_fits)]
    rows = findings.sources
    return small_multiples(
        panel, rows=rows, columns=ways, x=x, y=y, legend_columns=5, sharex=True, sharey="row"
    )


def bias_figure(findings: ValidateFindings, spots: pd.DataFrame) -> Figure:
    """Measured minus true semi-minor axis of each way, against distance."""
    used = where(spots, outcome=USED)

    def draw(axes: Axes, source: str, kind: str) -> None:
        axes.axhline(0, color=GREY, lw=0.8)
        for way, colour in _WAY_COLOURS.items():
            seen = where(used, source=source, way=way)
            seen = seen[seen.group.str.startswith(kind)]
            x, y = seen.d_mm, seen.measured_px - seen.half_max_px
            axes.plot(x, y, ls="", marker=_WAY_MARKERS[way], ms=3, color=colour, label=way)

    return small_multiples(
        draw,
        rows=findings.sources,
        columns=["plane", "sphere"],
        x=DISTANCE,
        y="measured − true $e_1'$ (px)",
        sharex=True,
        sharey="row",
    )


def half_maximum_figure(
    findings: ValidateFindings, ambiguous: tuple[float, float] | None
) -> Figure:
    """The lens's half-maximum radius on the plane against distance, and the measured ones.

    Args:
        ambiguous: distances between which a radius belongs to more than one distance, mm.
    """
    trial = findings.planes("lens")[0]
    scale = trial.scene.microscope.scale_mm_px
    spots = where(findings.spots, trial=trial.name)

    def draw(axes: Axes, *_: str) -> None:
        if ambiguous:
            label = "one radius, several distances"
            axes.axvspan(*ambiguous, color="#F2E6D0", lw=0, label=label)
        rows = where(spots, way=SUBPIXEL.name)
        half, cone = rows.half_max_semi_minor_px * scale, rows.cone_semi_minor_px * scale
        axes.plot(rows.d_mm, half, color=BLACK, lw=1.8, label="half maximum, true")
        axes.plot(rows.d_mm, cone, color=GREY, ls="--", label="straight cone fitted to it")
        for way, colour in _WAY_COLOURS.items():
            seen = where(spots, way=way, used=True)
            x, y = seen.d_mm, seen.semi_minor_px * scale
            axes.plot(x, y, ls="", marker=_WAY_MARKERS[way], ms=3.5, color=colour, label=way)
        axes.set_ylim(bottom=0)

    y = "semi-minor axis on the wall (mm)"
    return small_multiples(
        draw, rows=[""], columns=[""], x=DISTANCE, y=y, height=3.1, legend_columns=3
    )


def error_by_eccentricity(findings: ValidateFindings, height: float) -> Figure:
    """Largest absolute error over all distances and tilts with one pinhole, logarithmic."""
    figure = Figure(figsize=(5.0, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.axhline(ACCEPTABLE_ERROR_MM, color=VERMILION, lw=0.8, ls="--")
    for model, marker in zip(SHOWN, "ovs", strict=True):
        line, points = (
            largest_errors(errors[(errors.model == model) & (errors.z_f_mm == height)])
            for errors in (findings.analytic, findings.rendered)
        )
        colour = MODEL_COLOURS[model]
        # On exact contours `exact` is right to rounding, too small for a logarithmic axis.
        if model != "exact":
            axes.plot(line, color=colour, lw=1)
        axes.plot(points, color=colour, ls="", marker=marker, ms=4.5, label=model)
    axes.set(
        yscale="log",
        ylim=(5e-4, 10.0),
        xlabel=ECCENTRICITY,
        ylabel="largest |estimate − $d$| (mm)",
        title=pinhole_title(height),
    )
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend(loc="lower right", ncols=3)
    return figure


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


_ELLIPSE = ["x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad"]


def shown_frames(findings: ValidateFindings, group: str) -> list[pd.DataFrame]:
    """Spots of one line of frames for each source and exposure, at evenly spaced distances.

    Args:
        group: place of the trials, "plane 1".
    """
    lines = []
    for trial in (trial for trial in findings.trials if trial.group == group):
        for exposure in trial.scene.exposures.kinds:
            frames = where(findings.spots, trial=trial.name, way=_SHOWN[exposure].name)
            chosen = np.linspace(0, len(frames) - 1, min(_COLUMNS, len(frames))).round()
            lines.append(frames.iloc[chosen.astype(int)])
    return lines


def strip_table(lines: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Content of strip.csv: the frames with both ellipses; px and rad."""
    true = {f"half_max_{name}": f"true_{name}" for name in _ELLIPSE}
    about = ["trial", "way", "file_name", "d_mm", "outcome"]
    return pd.concat(lines).rename(columns=true)[[*about, *true.values(), *_ELLIPSE]]


def strip_figure(lines: Sequence[pd.DataFrame], *, stacks: Path) -> Figure:
    """Draw the frames, all at one scale.

    All frames are put into one picture, because an `Axes` for each takes ten times as long.

    Args:
        lines: of `shown_frames`.
    """
    half = round(_MARGIN * max(line.half_max_semi_major_px.max() for line in lines))
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
        frames = rows_of(line)
        stack = read_stack(stacks / frames[0].trial)
        for column, frame in enumerate(frames):
            corner = step * [column, row]
            origin = np.round([frame.half_max_x_px, frame.half_max_y_px]).astype(int) - half
            tile = _tile(stack.image(frame), origin, half)
            picture[corner[1] :, corner[0] :][: 2 * half, : 2 * half] = tile
            _annotate(axes, frame, corner, corner - origin, half, per_px)
        name = f"{frames[0].source}, {frames[0].exposure}\n{frames[0].way.split(',')[0]}"
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


def _tile(image: np.ndarray, origin: np.ndarray, half: int) -> np.ndarray:
    """Square of the image from a pixel (u, v) on, black outside the frame."""
    padded = np.pad(image, ((2 * half, 2 * half), (2 * half, 2 * half), (0, 0)))
    u, v = origin + 2 * half
    return padded[v : v + 2 * half, u : u + 2 * half]


def _halved(picture: np.ndarray) -> np.ndarray:
    """The picture at half the size, which is enough for a page and has a quarter of the bytes."""
    height, width = (2 * (n // 2) for n in picture.shape[:2])
    blocks = picture[:height, :width].reshape(height // 2, 2, width // 2, 2, 3)
    return blocks.mean(axis=(1, 3)).astype(np.uint8)


def _annotate(
    axes: Axes, frame: Any, corner: np.ndarray, shift: np.ndarray, half: int, per_px: float
) -> None:
    """Both ellipses over a tile, its distance under it, and why there is no spot."""
    middle, foot = corner[0] + half, corner[1] + 2 * half
    if frame.result:
        _outline(axes, [getattr(frame, n) for n in _ELLIPSE], shift, color=SKY, lw=1.8)
    else:
        y = foot - 4 / per_px
        axes.text(middle, y, frame.outcome, color="white", ha="center", va="bottom", size=8)
    true = [getattr(frame, f"half_max_{name}") for name in _ELLIPSE]
    _outline(axes, true, shift, color=ORANGE, lw=1.0, ls=_DASHES)
    text = f"$d$ = {frame.d_mm:.2f} mm"
    axes.text(middle, foot + 3 / per_px, text, ha="center", va="top")


def _outline(axes: Axes, ellipse: list[float], shift: np.ndarray, **style: Any) -> None:
    x, y, major, minor, angle = ellipse
    middle, degrees = (x + shift[0], y + shift[1]), math.degrees(angle)
    axes.add_patch(Ellipse(middle, 2 * major, 2 * minor, angle=degrees, fill=False, **style))


_FILM = 5
"""Frames of the first film."""
_STRIPS = {"plane 1": "printed plane", "sphere 1": "eyeball phantom"}


def _measured_spots(study: Study, trials: list[StaticTrial]) -> pd.DataFrame:
    """Spots of every trial in every way whose exposure it has; of the grid in the best way."""
    by_name = {trial.name: trial for trial in trials}

    def measure(name: str, stack: Stack) -> pd.DataFrame:
        trial = by_name[name]
        ways = [way for way in WAYS if way.exposure in trial.scene.exposures.kinds]
        about = {"trial": name, "source": trial.source, "kind": trial.kind, "group": trial.group}
        tables = [
            track_stack(stack, way, spots_file=study.spots_file(f"{name}-{way.slug}")).assign(
                **about, way=way.name
            )
            for way in (ways if trial.kind != "grid" else [SUBPIXEL])
        ]
        return pd.concat(tables)

    found = study.measured({trial.name: trial.scene for trial in trials}, measure)
    return pd.concat(found.values(), ignore_index=True)


# The claims.


def claims(findings: ValidateFindings) -> Iterator[Claim]:
    """All claims of a run: the models' errors first, Table I last."""
    yield from _small_plane(findings)
    yield from _rendered_models(findings)
    yield from _fitted_eccentricity(findings)
    yield from _cone_returned(findings)
    yield from _half_maximum(findings)
    yield from _table_one(findings)
    yield _used(findings)


def _small_plane(findings: ValidateFindings) -> Iterator[Claim]:
    analytic = findings.analytic
    for height, here in grouped(analytic[analytic.model == "small_plane"], "z_f_mm"):
        square = [tuple(square_errors(here, c=c).error_mm) for c in CHOSEN_ECCENTRICITIES_MM]
        yield Claim(
            name=f"small_plane, z_F = {height:g} mm",
            sentence="The error of the paper's model reaches the acceptable {high:g} mm at c = "
            "{reached:.1f} mm (a dash: not up to c = {most:g} mm) and is {value:.3f} mm at most. "
            "With the cone known and the beam square to the wall, it is {first:+.3f} mm at c = "
            "{chosen[0]:g} mm and {second:+.3f} mm at c = {chosen[1]:g} mm, for d = "
            "{distances:g} mm.",
            value=largest(here.error_mm),
            high=ACCEPTABLE_ERROR_MM,
            numbers={
                "reached": limit_eccentricity(here, ACCEPTABLE_ERROR_MM),
                "most": here.c_mm.max(),
                "chosen": CHOSEN_ECCENTRICITIES_MM,
                "first": square[0],
                "second": square[1],
                "distances": CHOSEN_DISTANCES_MM,
            },
        )


def _rendered_models(findings: ValidateFindings) -> Iterator[Claim]:
    for (model, height), own in grouped(accuracy(findings.rendered), "model", "z_f_mm"):
        yield Claim(
            name=f"{model} on rendered spots, z_F = {height:g} mm",
            sentence="The largest error is {value:.3f} mm on {spots} spots of the ideal cone in "
            "sub-pixel mode (acceptable: {high:g} mm). Where the beam's tilt has the azimuth "
            "{azimuths:g}°, it is {errors:.3f} mm. (0° tilts the beam towards growing c.)",
            value=largest(own.max_abs_error_mm),
            high=ACCEPTABLE_ERROR_MM,
            numbers={
                "spots": int(own.spots.sum()),
                "azimuths": tuple(own.azimuth_deg),
                "errors": tuple(own.max_abs_error_mm),
            },
        )


def _fitted_eccentricity(findings: ValidateFindings) -> Iterator[Claim]:
    every = sphere_table(findings)
    if every.empty:
        return
    best = every[(every.source == every.source.iloc[-1]) & (every.way == SUBPIXEL.name)]
    if len(best):
        yield Claim(
            name="a fitted c is smaller than the true c",
            sentence="{value:g} of {low:g} fits give a smaller c than the true one, which hides an "
            "error of the model. Fitted as in Table II ({source}, {way}), c is {fitted:.2f} mm, "
            "the true c {true:.2f} mm; {expected:.2f} mm would make the paper's cos φ the right "
            "factor for this pinhole (z_F = {height:g} mm). The residuals of {residual:.3f} mm at "
            "most do not test the model.",
            value=int((every.c_fitted_mm < every.c_true_mm).sum()),
            low=len(every),
            numbers={
                "source": best.source.iloc[0],
                "way": best.way.iloc[0],
                "fitted": tuple(best.c_fitted_mm),
                "true": tuple(best.c_true_mm),
                "expected": tuple(best.c_expected_mm),
                "height": findings.trials[0].scene.microscope.pinhole_height_mm,
                "residual": best.max_error_mm.max(),
            },
        )


def _cone_returned(findings: ValidateFindings) -> Iterator[Claim]:
    fits = findings.plane_fits.get(("cone", SUBPIXEL.name))
    if fits is not None:
        trial, fit = findings.planes("cone")[0], fits[ALL_PLANES]
        source = trial.scene.source
        contact = where(findings.spots, trial=trial.name).d_mm.iloc[0]
        yield Claim(
            name="the ideal cone is returned",
            sentence="In sub-pixel mode the fitted δk of the ideal cone (k {k:g}, b {b:.3f} mm) "
            "has an error of {value:+.2f} %. The fitted b of {fit.b:.3f} mm has an error of "
            "{b_error:+.3f} mm. d_r is zero at contact, where the tip's rim touches and its centre "
            "is {contact:.3f} mm from the wall.",
            value=100 * (fit.delta_k / (trial.scene.microscope.scale_mm_px * source.cone_k) - 1),
            numbers={
                "k": source.cone_k,
                "b": source.cone_apex_offset_mm,
                "fit": fit,
                "b_error": fit.b - (source.cone_apex_offset_mm - contact),
                "contact": contact,
            },
        )


def _half_maximum(findings: ValidateFindings) -> Iterator[Claim]:
    curve = half_maximum_curve(findings)
    fits = [findings.plane_fits.get(("lens", way.name)) for way in (SUBPIXEL, LITERAL)]
    if curve is None:
        return
    d, radius = curve
    first, last = ambiguous_range(d, radius) or (math.nan, math.nan)
    chosen = sorted({0, int(np.argmin(radius)), len(d) - 1})
    edge, threshold = (fit[ALL_PLANES].r_squared if fit else math.nan for fit in fits)
    seen = where(findings.spots, source="lens", kind="plane", way=SUBPIXEL.name, used=True)
    yield Claim(
        name="the lens's half-maximum radius grows with distance",
        sentence="One radius belongs to several distances over {value:.2f} mm: from {first:.2f} to "
        "{last:.2f} mm. The radius is {radii:.3f} mm at d = {at:.2f} mm. Sub-pixel mode follows it "
        "to {bias:.2f} px (rms). A straight line through its readings has R² {edge:.3f}, one "
        "through those of the fixed threshold {threshold:.3f} (straight: {straight:g} or more).",
        value=0.0 if math.isnan(first) else last - first,
        high=0.0,
        numbers={
            "first": first,
            "last": last,
            "radii": tuple(radius[chosen].tolist()),
            "at": tuple(d[chosen].tolist()),
            "bias": rms(seen.semi_minor_px - seen.half_max_semi_minor_px),
            "edge": edge,
            "threshold": threshold,
            "straight": STRAIGHT,
        },
    )


def _table_one(findings: ValidateFindings) -> Iterator[Claim]:
    for source in findings.sources:
        fits = findings.plane_fits.get((source, LITERAL.name), {})
        if len(fits) < 2:
            continue
        settings = findings.planes(source)[0].scene.source
        name = f"lens {settings.lens}" if source == "lens" else "ideal cone"
        yield from reproduction(fits, name=f"Table I by the {name}").values()
        part = nearest_reproduction(findings, source=source, way=LITERAL)
        if part is not None:
            yield Claim(
                name=f"Table I by the {name}, best part of the range",
                sentence="The range d_r = {low_mm:g} to {high_mm:g} mm meets most criteria, "
                "{value:g} of {low:g}: δk {values[0]:.4f} mm/px, b {values[1]:.2f} mm, "
                "R² {values[2]:.3f} and RMSE {values[3]:.3f} mm of the trials.",
                value=part.met,
                low=len(part.criteria),
                numbers={
                    "low_mm": part.low,
                    "high_mm": part.high,
                    "values": tuple(claim.value for claim in part.criteria.values()),
                },
            )


def _used(findings: ValidateFindings) -> Claim:
    by_way = findings.spots.groupby("way").used
    used, frames = ([int(n[way.name]) for way in WAYS] for n in (by_way.sum(), by_way.size()))
    return Claim(
        name="frames used",
        sentence="The fits use {value:g} of {total} measurements. By way of measuring ({ways}): "
        "{used:g} of {frames:g}.",
        value=sum(used),
        numbers={
            "total": len(findings.spots),
            "ways": "; ".join(way.name for way in WAYS),
            "used": tuple(used),
            "frames": tuple(frames),
        },
    )


# The page.


def report(findings: ValidateFindings) -> Report:
    """The report of a run.

    Raises:
        StackError: a stack that the strips of frames need is missing or broken.
    """
    planes, spheres = plane_table(findings), sphere_table(findings)
    spots, frames = spot_table(findings), frame_table(findings)
    strips = {group: shown_frames(findings, group) for group in _STRIPS}
    film = strips["sphere 1"][-1].iloc[:_FILM]
    left_out = frames[frames.outcome != USED]
    # Of a square beam; the report gives these errors.
    chosen = pd.concat([square_errors(findings.analytic, c=c) for c in CHOSEN_ECCENTRICITIES_MM])
    rendered_accuracy = accuracy(findings.rendered)
    return Report(
        title="How accurate is a distance measured from a spot of light?",
        answer=_answer(findings),
        lead="The static experiment of Zhou et al. 2020 (“Spotlight-based 3D Instrument Guidance "
        "for Retinal Surgery”) on rendered images whose truth is known, and its small-plane model "
        "against the exact geometry.",
        first=[
            Picture(
                "film",
                strip_figure([film], stacks=findings.stacks),
                "The tip withdraws from the eyeball phantom. Blue: the measured ellipse. Orange, "
                "dashed: the true contour at half of the peak.",
                data="strip.csv",
                inline="jpeg",
            ),
            Picture(
                "error_by_eccentricity",
                [error_by_eccentricity(findings, height) for height in PINHOLE_HEIGHTS_MM],
                "The paper's model fails with growing c, and sooner under a microscope (right) "
                "than with its own pinhole on the eyeball's sphere (left). The largest error over "
                "all distances and tilts, on exact contours (lines) and on spots measured in "
                f"rendered frames (marks). Dashed: the {ACCEPTABLE_ERROR_MM:g} mm that the paper "
                "calls acceptable. On exact contours the model exact has no error.",
                data="model_error.csv",
            ),
            _kept(findings),
            *_sentences(findings),
        ],
        claims=list(claims(findings)),
        sections=[
            Section(
                "The models against the exact geometry",
                Picture(
                    "model_error",
                    model_error_figure(findings.analytic, findings.rendered),
                    "The sign of the error: small_plane makes distances too short. Exact contours "
                    "(lines; dotted: square beam) and spots measured in rendered frames of the "
                    "ideal cone (dots, at the rendered distances). Every model is given the true "
                    "k, b, c and r. The paper puts the pinhole F on the eyeball's sphere in its "
                    "equation for FP, and at the eyeball's centre in the caption of the figure "
                    "that goes with it; a real microscope has z_F near 200 mm. Dashed: "
                    f"{ACCEPTABLE_ERROR_MM} mm.",
                    data="model_error.csv",
                ),
            ),
            Section(
                "Frames",
                *(
                    Picture(
                        f"strip_{group.replace(' ', '_')}",
                        strip_figure(lines, stacks=findings.stacks),
                        f"The tip withdraws from the {_STRIPS[group]}; d is the distance from tip "
                        "to wall along the beam. Blue: the measured ellipse (literal mode in paper "
                        "frames, sub-pixel mode in metered ones). Orange, dashed: the true contour "
                        "at half of the noise-free, unoccluded peak. Paper frames share one "
                        "exposure; metered frames put the spot's peak at "
                        f"{findings.trials[0].scene.exposures.metered_peak:.0%} of full scale.",
                        data="strip.csv",
                        inline="jpeg",
                    )
                    for group, lines in strips.items()
                ),
            ),
            _measured(findings, spots),
            _fits(findings, planes, spheres, spots),
        ],
        data={
            "model_error.csv": pd.concat([findings.analytic, findings.rendered]),
            "rendered_accuracy.csv": rendered_accuracy,
            "table_1.csv": planes,
            "table_2.csv": spheres,
            "spots.csv": spots,
            "frames.csv": frames,
            "strip.csv": strip_table([line for lines in strips.values() for line in lines]),
        },
        summary={
            "plane_fits": planes.to_dict("records"),
            "sphere_fits": spheres.to_dict("records"),
            "model_errors": chosen.to_dict("records"),
            "rendered_accuracy": rendered_accuracy.to_dict("records"),
            "left_out": left_out.groupby("outcome", sort=False).frames.sum().to_dict(),
            "left_out_by_trial": left_out.to_dict("records"),
        },
    )


def _reached(findings: ValidateFindings, model: str, height: float) -> float:
    """The c at which a model's error on exact contours reaches the acceptable one, mm, or NaN."""
    errors = findings.analytic
    here = (errors.model == model) & (errors.z_f_mm == height)
    return limit_eccentricity(errors[here], ACCEPTABLE_ERROR_MM)


def _answer(findings: ValidateFindings) -> str:
    low, high = (_reached(findings, "small_plane", height) for height in PINHOLE_HEIGHTS_MM)
    exact = findings.rendered.error_mm[findings.rendered.model == "exact"]
    return (
        f"With the paper's model a distance is off by {ACCEPTABLE_ERROR_MM:g} mm from c = "
        f"{number(low, 1)} mm on, and under a real microscope from c = {number(high, 1)} mm on; "
        f"the exact geometry gives it within {number(largest(exact), 3)} mm on all "
        f"{len(exact)} rendered spots of the ideal cone."
    )


def _kept(findings: ValidateFindings) -> Table:
    """Up to which c each model keeps the acceptable error."""
    most = findings.analytic.c_mm.max()
    rows = []
    for model in COMPARED:
        reached = [_reached(findings, model, height) for height in _ANALYTIC_HEIGHTS_MM]
        rows.append((model, *(f"{most:g} +" if math.isnan(c) else number(c, 1) for c in reached)))
    return Table(
        [Column("model"), *(Column(f"z_F = {height:g} mm") for height in _ANALYTIC_HEIGHTS_MM)],
        rows,
        f"Up to which c (mm) {ACCEPTABLE_ERROR_MM:g} mm is kept at all distances and tilts; + is "
        "the end of the range.",
        data="model_error.csv",
    )


def _sentences(findings: ValidateFindings) -> Iterator[str]:
    """What else the run shows, in a sentence each."""
    yield (
        "The paper's cos φ is the right factor for a pinhole at the eyeball's centre only; a c "
        "that is fitted to the same distances, as in the paper's Table II, hides the error."
    )
    curve = half_maximum_curve(findings)
    if curve is not None and (shared := ambiguous_range(*curve)):
        yield (
            f"Behind the lens one half-maximum radius belongs to several distances from "
            f"{number(shared[0])} to {number(shared[1])} mm, so the radius alone does not "
            "determine the distance there."
        )
    part = nearest_reproduction(findings, source=findings.sources[0], way=LITERAL)
    if part is not None:
        yield (
            f"The {findings.sources[0]} read from {part.low:g} to {part.high:g} mm by the paper's "
            f"fixed threshold meets {part.met} of {len(part.criteria)} criteria of its Table I."
        )


def _measured(findings: ValidateFindings, spots: pd.DataFrame) -> Section:
    pictures = [
        Picture(
            "bias",
            bias_figure(findings, spots),
            "Bias of each way of measuring: measured minus true e₁′. The truth is the half-maximum "
            "contour (for the ideal cone, its edge). The literal mode cuts at grey level 200, "
            "wherever that lies on the spot's profile.",
            data="spots.csv",
        )
    ]
    curve = half_maximum_curve(findings)
    if curve is not None:
        pictures.append(
            Picture(
                "half_maximum",
                half_maximum_figure(findings, ambiguous_range(*curve)),
                "Semi-minor axis of the lens's spot on the first plane. Where the black curve "
                "falls or has the height of another of its points (shaded), a half-maximum radius "
                "alone does not determine the distance. Dashed: the straight cone fitted to the "
                "black curve (label “cone”).",
                data="spots.csv",
            )
        )
    return Section("Measured and true spots", *pictures)


def _fits(
    findings: ValidateFindings,
    planes: pd.DataFrame,
    spheres: pd.DataFrame,
    spots: pd.DataFrame,
) -> Section:
    if planes.empty:
        return Section("The paper's Tables I and II", "Too few spots for any fit.")
    return Section(
        "The paper's Tables I and II",
        Table.of(
            planes,
            {
                "source": Column("source"),
                "way": Column("way"),
                "trial": Column("trial"),
                "delta_k_mm_px": Column("δk, mm/px", 4),
                "delta_k_error_mm_px": Column("±", 4),
                "paper_delta_k_mm_px": Column("paper", 4),
                "b_mm": Column("b, mm"),
                "b_error_mm": Column("±"),
                "paper_b_mm": Column("paper"),
                "r_squared": Column("R²", 4),
                "paper_r_squared": Column("paper", 4),
                "rmse_mm": Column("RMSE, mm", 4),
                "paper_rmse_mm": Column("paper", 4),
                "contact_radius_px": Column("−b/δk, px", 1),
                "spots": Column("spots"),
                "converged": Column("converged"),
            },
            "Table I: fits of d_r = δk e₁′ + b on the plane, with standard errors, and the paper's "
            "values for its own trials. −b/δk is the radius at contact in px. The paper calls b a "
            "diameter, but its value is minus the distance from the virtual apex to the tip.",
            data="table_1.csv",
        ),
        Picture(
            "plane_fit",
            plane_fit_figure(findings, spots),
            "Reading d_r against the measured semi-minor axis e₁′ on the plane, with each trial's "
            "line, the line of all trials and, dotted, the paper's. d_r is 0 at contact, where the "
            "tip's rim touches.",
            data="spots.csv",
        ),
        Table.of(
            spheres,
            {
                "source": Column("source"),
                "way": Column("way"),
                "trial": Column("trial"),
                "c_true_mm": Column("true c, mm"),
                "c_fitted_mm": Column("fitted c, mm"),
                "c_error_mm": Column("±"),
                "c_expected_mm": Column("expected"),
                "standard_deviation_mm": Column("SD, mm", 4),
                "paper_standard_deviation_mm": Column("paper"),
                "mean_absolute_error_mm": Column("mean |error|, mm", 4),
                "paper_mean_absolute_error_mm": Column("paper"),
                "max_error_mm": Column("max |error|, mm", 4),
                "paper_max_error_mm": Column("paper"),
                "spots": Column("spots"),
                "converged": Column("converged"),
                "at_bound": Column("at the bound"),
            },
            "Table II: fits of the small-plane model in the eyeball. δk and b come from all "
            "planes, and c is the only free parameter. The scenes have the c that the paper "
            "prints. “Expected” is the c whose cos φ is the correct first-order factor of the true "
            "c. The largest error is 0.372 mm in the paper's text and 0.396 mm in its table.",
            data="table_2.csv",
        ),
        Picture(
            "sphere_fit",
            sphere_fit_figure(findings, spots),
            "Reading d_r against e₁′ in the eyeball, with the small-plane model at the fitted c.",
            data="spots.csv",
        ),
        Picture(
            "sphere_residuals",
            residual_figure(findings, spots),
            "Residuals of the fits of c, rms over all trials (the paper's error figure, over "
            "distance instead of index). A small residual does not show that the model is right, "
            "because c compensates for the model's error.",
            data="spots.csv",
        ),
    )


# The command.


def validate(
    *,
    out: OutputFolder,
    quick: Quick = False,
    seed: NonNegativeInt = 0,
    source: LightSource = "both",
) -> ValidateFindings:
    """Repeat the paper's static experiment on rendered images and write a report.

    To continue a run that was stopped, start it again with the same folder.

    Args:
        seed: Random seed of noise and wall texture.
    """
    study = Study(
        "validate",
        out=out,
        quick=quick,
        seed=seed,
        options={"source": source},
        command="eyespot validate",
    )
    sources = ("lens", "cone") if source == "both" else (source,)
    trials = [t for kind in sources for t in paper_trials(source=kind, quick=quick, seed=seed)]
    trials += grid_trials(quick=quick, seed=seed)
    with ThreadPoolExecutor(max_workers=1) as beside:
        # These take seconds and need no renderer, so they run beside the trials of the ideal cone.
        analytic = beside.submit(lambda: analytic_errors(quick=quick))
        light = beside.submit(lambda: World(trials[0].scene).light)
        with study.timed("render and measure"):
            spots = _measured_spots(study, [t for t in trials if t.source == "cone"])
            light.result()
            if "lens" in sources:
                behind_lens = _measured_spots(study, [t for t in trials if t.source == "lens"])
                spots = pd.concat([spots, behind_lens], ignore_index=True)
        with study.timed("fit and compare"):
            plane_fits, sphere_fits = fit_tables(trials, spots)
            findings = ValidateFindings(
                stacks=study.folder / "stacks",
                trials=trials,
                spots=spots,
                plane_fits=plane_fits,
                sphere_fits=sphere_fits,
                analytic=analytic.result(),
                rendered=rendered_errors(trials, spots),
            )
    study.publish(report, findings)
    return findings
