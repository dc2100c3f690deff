"""`eyespot study eccentricity`: how wrong each model is, where, and by which cause."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot import optics, scenes
from eyespot.benchmarks import model_error, paper
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.reporting import grouped, listed, number, where
from eyespot.benchmarks.statistics import largest
from eyespot.benchmarks.studies import error_causes
from eyespot.benchmarks.studies.error_causes import CAUSES, WRONG_C_MM, WRONG_R_MM
from eyespot.benchmarks.study import Study, geometry_of
from eyespot.benchmarks.study_command import command
from eyespot.calibration import fit_eccentricity
from eyespot.formats.rig_keys import WorkspaceKeys
from eyespot.scenes import Scene

# The c at which a model's error reaches a limit, with the true c and with a fitted one.

SHOWN_C_MM = 4.0
"""Where the report splits the error, in c and in d."""
LIMITS_MM = (0.1, 0.5)
"""Errors whose crossing is reported; the paper calls 0.5 mm acceptable."""
DISTANCES_MM = tuple(0.5 * n for n in range(1, 13))
"""Of one withdrawal; a rig's [workspace] may have others."""


def withdrawals(
    geometry: model_error.Geometry,
    *,
    eccentricities: np.ndarray,
    medium: str,
    distances: Sequence[float] = DISTANCES_MM,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors of all models on exact contours at each c and all distances, mm; and refit.csv."""
    c, d = (axis.ravel() for axis in np.meshgrid(eccentricities, distances, indexing="ij"))
    seen = model_error.exact_spots(geometry, c=c, d=d).semi_minor
    about: dict[str, Any] = {"source": "analytic", "medium": medium}
    errors = model_error.errors_of(geometry, optics.MODELS, c=c, d=d, semi_minor_px=seen, **about)
    small_plane = where(errors, model="small_plane").assign(semi_minor_px=seen)
    refits = [refitted(geometry, rows) for _, rows in grouped(small_plane, "c_mm")]
    return errors, pd.DataFrame(refits)


def refitted(geometry: model_error.Geometry, before: pd.DataFrame) -> dict[str, Any]:
    """A row of refit.csv: c fitted to one withdrawal itself, as in the paper's Table II.

    From the errors of small_plane with the true c, and `semi_minor_px`; k, b and r are given to the
    fit as they are.
    """
    d, k = before.d_mm.to_numpy(), 1.0 / math.tan(geometry.half_angle)
    spots: dict[str, Any] = {
        "semi_minor_px": before.semi_minor_px.to_numpy(),
        "scale": geometry.scale,
        "b": geometry.apex_offset,
        "eye_radius": geometry.eye_radius,
    }
    fit = fit_eccentricity(**spots, distance=d, delta_k=geometry.scale * k)
    estimate = np.asarray(optics.small_plane_distance(**spots, k=k, eccentricity=fit.c))
    error, residual = largest(before.error_mm), largest(estimate - d)
    return {
        **{name: before[name].iloc[0] for name in ("source", "z_f_mm", "incidence_deg", "c_mm")},
        "fitted_c_mm": fit.c,
        "at_bound": fit.at_bound,
        "largest_error_mm": error,
        "largest_residual_mm": residual,
        "hidden_mm": error - residual,
    }


def limits(errors: pd.DataFrame) -> pd.DataFrame:
    """Content of limits.csv: the smallest c at which the largest error over all d reaches a limit.

    `c_mm` is empty if the limit is not reached, 0 if it is exceeded from the start.
    """
    keys = ["model", "z_f_mm", "incidence_deg"]
    rows = [
        (*key, limit, model_error.limit_eccentricity(group, limit))
        for key, group in grouped(errors, *keys)
        for limit in LIMITS_MM
    ]
    return pd.DataFrame(rows, columns=[*keys, "limit_mm", "c_mm"])


# The rendered part: frames, the spots measured in them, and what rendering adds to their size.

_OVERSAMPLING, _FINE = 2, "-noise-free"  # Of frames without noise, along each side.
_NOISE_FREE = {
    "camera.full_well_e": 1e9,
    "camera.read_noise_e": 0.0,
    "camera.dark_signal_e": 0.0,
    "camera.prnu": 0.0,
    "camera.dsnu_e": 0.0,
    "camera.bit_depth": 16,
    "camera.bayer": "none",
    "camera.jpeg_quality": 0,
}


def trials(scene: Scene, space: WorkspaceKeys, *, quick: bool) -> dict[str, Scene]:
    """Withdrawals at the scene's incidence and square ones without the instrument, by name.

    The instrument would hide a square beam. Some of the former are there again, at twice the
    resolution without noise; their names end with `_FINE`.
    """
    least, most = space.eccentricity_mm or (0.0, 0.0)
    every = np.linspace(least, most, 3 if quick else 9).tolist()
    few = every[1:] if quick else every[::2]
    start, end = space.distance_mm
    moves = paper.withdrawal(start_mm=start, travel_mm=end - start, frames=3 if quick else 12)
    view, found = scene.microscope, {}
    finer = _NOISE_FREE | {
        "microscope.scale_mm_px": view.scale_mm_px / _OVERSAMPLING,
        "microscope.width_px": view.width_px * _OVERSAMPLING,
        "microscope.height_px": view.height_px * _OVERSAMPLING,
    }
    for height, kind in product(pinhole_heights(scene), ("tilted", "square")):
        bare = {"spot.incidence_deg": 0.0, "instrument.visible": False} if kind == "square" else {}
        for c in few if bare else every:
            place = {"spot.eccentricity_mm": c, "microscope.pinhole_height_mm": height}
            name = f"{kind}-pinhole-{height:g}-c-{c:g}"
            found[name] = scenes.changed(scene, place | moves | bare)
            if c in few and not bare:
                found[f"{name}{_FINE}"] = scenes.changed(found[name], finer)
    return found


def measure(study: Study, every: Mapping[str, Scene]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Render and track: errors of all models on every spot that counts, and errors by cause."""
    tracked = study.tracked(every)
    # Empty tables first, so that a run without spots has tables, too.
    errors = [pd.DataFrame(columns=model_error.MODEL_ERROR)]
    shares = [pd.DataFrame(columns=["model", "z_f_mm"])]
    for name, scene in every.items():
        if name.endswith(_FINE):
            continue
        seen, geometry, medium = tracked[name], geometry_of(scene), scene.source.medium
        if seen.used.any():
            own = seen[seen.used]
            errors.append(model_error.errors_of_spots(geometry, own, optics.MODELS))
        finer = tracked.get(f"{name}{_FINE}")
        if finer is not None and (both := seen.used & finer.used).any():
            fine = finer.semi_minor_px[both].to_numpy() / _OVERSAMPLING
            columns = ["semi_minor_px", "cone_semi_minor_px", "c_mm", "d_mm"]
            measured, ideal, c, d = seen.loc[both, columns].to_numpy().T
            length = error_causes.spread_length(scene)
            spread = error_causes.spread_shift(geometry, c=c, d=d, length=length)
            # A wall that spreads light does so in the frames already.
            edge = fine - ideal - (spread if scene.phantom.spread != "none" else 0.0)
            shift = np.stack([edge, measured - fine, spread])
            shares.append(error_causes.shares(geometry, medium=medium, c=c, d=d, shift=shift))
    both_tables = errors[1:] or errors, shares[1:] or shares
    rendered, causes = (pd.concat(tables, ignore_index=True) for tables in both_tables)
    return rendered, causes


Tables = Mapping[str, pd.DataFrame]


def pinhole_heights(scene: Scene) -> tuple[float, ...]:
    """z_F of the paper's geometry, on the sphere, of a microscope, and of the scene's own, mm."""
    own = scene.microscope.pinhole_height_mm
    known = scene.phantom.radius_mm, paper.MICROSCOPE_HEIGHT_MM
    return known if own in (*known, 0.0, math.inf) else (*known, own)


# Figures.

_GEOMETRIC = page.BLUE, page.VERMILION, page.ORANGE, page.BLACK, page.GREEN
_OTHERS = page.SKY, page.PURPLE, "#8C6D31", "#B8B8B8", "#6E6E6E"
_CAUSE_COLOURS = dict(zip(CAUSES, (*_GEOMETRIC, *_OTHERS), strict=True))


def worst_errors(scene: Scene, tables: Tables) -> Figure:
    """Largest error over d against c: a panel for each pinhole (row) and incidence (column)."""

    def draw(axes: Axes, height: float, incidence: float) -> None:
        exact, seen, refits = (
            where(tables[name], z_f_mm=height, incidence_deg=incidence)
            for name in ("withdrawals", "rendered", "refits")
        )
        model_error.draw_largest_errors(axes, exact, seen, limits=LIMITS_MM)
        fitted: dict[str, Any] = {"color": page.VERMILION, "label": "small_plane, c fitted"}
        axes.plot(refits.c_mm, refits.largest_residual_mm, ls="--", **fitted)

    return page.small_multiples(
        draw,
        rows=pinhole_heights(scene),
        columns=tables["withdrawals"].incidence_deg.unique().tolist(),
        title=lambda height, tilt: f"{model_error.pinhole_title(height)}, incidence {tilt:g}°",
        x=model_error.ECCENTRICITY,
        y="largest |error| (mm)",
        height=2.4,
        legend_columns=6,
        sharex=True,
        sharey=True,
    )


def _causes_figure(shares: pd.DataFrame, *, d: float) -> Figure:
    """Shapley's shares stacked against c: a row for each pinhole, a column for each model."""
    chosen = shares[(shares.d_mm - d).abs() < 1e-6]

    def draw(axes: Axes, height: float, model: str) -> None:
        here = where(chosen, z_f_mm=height, model=model)
        c = np.unique(here.c_mm.round(6))
        width = 0.7 * (np.diff(c).min() if c.size > 1 else 1.0)
        above, below = np.zeros(c.size), np.zeros(c.size)
        for cause, colour in _CAUSE_COLOURS.items():
            size = here.part_mm[here.cause == cause].to_numpy()
            foot = np.where(size >= 0, above, below)
            axes.bar(c, size, width, bottom=foot, color=colour, label=cause)
            above += np.maximum(size, 0.0)
            below += np.minimum(size, 0.0)
        whole = here.whole_mm[here.cause == CAUSES[0]]
        axes.plot(c, whole, ls="", marker="D", ms=4, mfc="white", mec=page.BLACK, label="whole")
        axes.axhline(0, color=page.BLACK, lw=0.6)

    return page.small_multiples(
        draw,
        rows=chosen.z_f_mm.unique().tolist(),
        columns=model_error.SHOWN,
        title=lambda height, model: f"{model}, {model_error.pinhole_title(height)}",
        x=model_error.ECCENTRICITY,
        y="part of the error (mm)",
        legend_columns=5,
        sharex=True,
    )


# The page.


def _report(scene: Scene, space: WorkspaceKeys, tables: Tables) -> page.Report:
    heights, incidence = pinhole_heights(scene), scene.spot.incidence_deg
    (low, high), largest_mm = space.distance_mm, LIMITS_MM[-1]
    limits = where(tables["limits"], limit_mm=largest_mm)
    limits = limits[limits.z_f_mm.isin(heights)].pivot(
        index=["z_f_mm", "incidence_deg"], columns="model", values="c_mm"
    )
    places = (
        "on the eyeball's sphere",
        "at 200 mm, as under a microscope",
        "at the rig's own height",
    )
    said = ", and from ".join(
        f"{number(limits.small_plane[height, incidence])} mm on if the pinhole lies {at}"
        for height, at in zip(heights, places, strict=False)
    )
    refits = tables["refits"]
    chosen = np.isclose(refits.c_mm % 1.0, 0.0) & (refits.c_mm > 0)
    chosen &= refits.z_f_mm.isin(heights) & (refits.incidence_deg == incidence)
    return page.Report(
        title="How wrong is the distance, at which eccentricity, and why?",
        answer=f"The paper's model is off by {largest_mm:g} mm from c = {said}.",
        lead="Five models from spot size to distance against the exact geometry, on exact contours "
        "and on spots measured in rendered frames.",
        first=[
            page.Picture(
                "largest_error",
                worst_errors(scene, tables),
                "The paper's model fails with growing c, and sooner under a microscope. Largest "
                f"absolute error over d = {low:g} to {high:g} mm, on exact contours (lines) and on "
                "rendered spots (dots). Dashed: with c fitted to the withdrawal itself. Dotted: "
                f"{' and '.join(f'{limit:g}' for limit in LIMITS_MM)} mm. On exact contours the "
                "model exact has no error except rounding and is not drawn.",
                data="model_error.csv",
            ),
            page.Table(
                limits.reset_index(),
                {
                    "z_f_mm": page.Column("z_F, mm", 1),
                    "incidence_deg": page.Column("incidence, °", 1),
                }
                | {model: page.Column(model, 1) for model in model_error.SHOWN},
                f"Smallest c in mm at which the largest error over d reaches {largest_mm:g} mm; a "
                f"dash: not up to c = {tables['withdrawals'].c_mm.max():g} mm.",
                data="limits.csv",
            ),
        ],
        claims=list(_claims(tables)),
        sections=[
            page.Section(
                "The error that a fit of c hides",
                "The paper fits c to the same distances with which it then tests the model (Table "
                "II). A wrong c compensates for a wrong factor as long as the correct factor is "
                "below 1. If the correct factor is above 1, the fit ends at c = 0.",
                page.Table(
                    refits[chosen],
                    "z_f_mm c_mm fitted_c_mm largest_error_mm largest_residual_mm "
                    "hidden_mm".split(),
                    "Largest error over d with the true c, largest residual with the fitted one, "
                    "and the difference, which the fit hides; exact contours.",
                    data="refit.csv",
                ),
            ),
            page.Section("Causes", *_causes(scene, tables["causes"])),
            page.Section(
                "An eye is no sphere, and its retina is clear",
                page.Table(
                    tables["eye"],
                    tables["eye"].columns,
                    "Errors of exact in a living eye. Shape: the largest on Atchison's emmetropic "
                    f"ellipsoid, and on one tilted by {error_causes.LEAN_DEG:g}° and shifted by "
                    f"{error_causes.ASIDE_MM:g} mm, read on a sphere; the beam is square to the "
                    "wall. Besides, light comes back from below the clear retina, so a distance is "
                    f"{error_causes.LAYER_MM[0]:g} to {error_causes.LAYER_MM[1]:g} mm longer than "
                    "that to the surface which a tool touches.",
                    data="eye.csv",
                ),
            ),
        ],
        data={
            "model_error.csv": pd.concat([tables["withdrawals"], tables["rendered"]]),
            "refit.csv": refits,
            **{f"{name}.csv": tables[name] for name in ("limits", "causes", "eye")},
        },
    )


def _claims(tables: Tables) -> Iterator[page.Claim]:
    for height, here in grouped(where(tables["causes"], model="small_plane"), "z_f_mm"):
        spot = _nearest(here, SHOWN_C_MM, SHOWN_C_MM)
        parts = where(here, c_mm=spot.c_mm, d_mm=spot.d_mm)
        parts = parts.sort_values("part_mm", key=lambda part: -part.abs(), kind="stable")
        exact = where(tables["withdrawals"], model="small_plane", z_f_mm=height)
        own = _nearest(where(exact, incidence_deg=spot.incidence_deg), spot.c_mm, spot.d_mm)
        yield page.Claim(
            name=f"z_F = {height:g} mm, causes",
            sentence=f"At c = {spot.c_mm:.1f} mm and d = {spot.d_mm:.1f} mm the error of "
            f"small_plane is {spot.whole_mm:+.3f} mm if it is also given an r too large by "
            f"{WRONG_R_MM:g} mm and a c too large by {WRONG_C_MM:g} mm; its own error on the exact "
            f"contour is {own.error_mm:+.3f} mm (c = {own.c_mm:g}, d = {own.d_mm:g} mm). The "
            f"causes, the largest first: {', '.join(parts.cause)}. Their shares in mm: "
            f"{listed(parts.part_mm, '+.3f')}. (Shapley's values: a cause alone can do more or "
            "less.)",
            value=spot.whole_mm,
        )
    eye = where(tables["eye"], z_f_mm=paper.MICROSCOPE_HEIGHT_MM)
    yield page.Claim(
        name="a living eye",
        sentence=f"Under a microscope the retina's shape adds up to {listed(eye.shape_mm, '.3f')} "
        f"mm to the error of exact at c = {listed(eye.c_mm, 'g')} mm, and up to "
        f"{listed(eye.tilted_mm, '.2f')} mm if the eye is tilted and shifted; the clear layer adds "
        f"{listed(error_causes.LAYER_MM, 'g')} mm.",
        value=float(eye.tilted_mm.max()),
    )


def _nearest(rows: pd.DataFrame, c: float, d: float) -> Any:
    """The row that is nearest in c, then in d (mm)."""
    far = pd.DataFrame({"c": (rows.c_mm - c).abs(), "d": (rows.d_mm - d).abs()})
    return rows.loc[far.sort_values(["c", "d"], kind="stable").index[0]]


def _causes(scene: Scene, shares: pd.DataFrame) -> list[str | page.Picture]:
    text = (
        "Each link between distance and spot is real or ideal, together with the model's own term "
        f"for it, in all {1 << len(CAUSES):,} sets of causes; the parts are Shapley's values. Edge "
        "and pixels are measured in rendered frames, light spread in the wall is that of L = "
        f"{error_causes.spread_length(scene):.3f} mm. The models are given an r {WRONG_R_MM:g} mm "
        f"and a c {WRONG_C_MM:g} mm too large. The paper's cos φ counts as a term for "
        "foreshortening."
    )
    if shares.empty:
        return [text, "No rendered spot counts in this run."]
    # The distance that most spots share, nearest to the middle of the range.
    d = min(shares.d_mm.round(6).unique(), key=lambda d: abs(d - SHOWN_C_MM))
    caption = (
        f"Parts of the error at d = {d:.3g} mm, {scene.spot.incidence_deg:g}° incidence; diamonds: "
        "the error, their sum. Each panel has a scale of its own."
    )
    return [text, page.Picture("causes", _causes_figure(shares, d=d), caption, "causes.csv")]


# The command.

VARIED = (
    *("spot.eccentricity_mm", "motion.kind", "motion.start_mm", "motion.travel_mm"),
    *("motion.frames", "exposures.kinds"),
)
"""Keys of the scene that the study sets itself."""


@command(defaults=("source.kind=cone",), varies=VARIED, in_workspace=True)
def eccentricity(study: Study) -> dict[str, pd.DataFrame]:
    """Measure how wrong each model is, at which eccentricity, and by which cause."""
    base, medium, quick = study.scene, study.scene.source.medium, study.quick
    distances = np.linspace(*study.space.distance_mm, len(DISTANCES_MM)).tolist()
    least, most = study.space.eccentricity_mm or (0.0, 0.0)
    c = np.linspace(least, most, 17 if quick else 81)
    with study.timed("render and measure"):
        rendered, shares = measure(study, trials(base, study.space, quick=quick))
    with study.timed("withdrawals on exact contours"):
        # Four pinholes, square to the wall and at the scene's incidence.
        found = []
        for height in (0.0, *pinhole_heights(base), np.inf):
            for tilt in dict.fromkeys((0.0, base.spot.incidence_deg)):
                view = {"microscope.pinhole_height_mm": height, "spot.incidence_deg": tilt}
                geometry = geometry_of(scenes.changed(base, view))
                found.append(
                    withdrawals(geometry, eccentricities=c, medium=medium, distances=distances)
                )
        on_exact, refits = (pd.concat(part, ignore_index=True) for part in zip(*found, strict=True))
    upright = geometry_of(base)._replace(incidence=0.0)
    square = [upright._replace(pinhole_height=height) for height in pinhole_heights(base)]
    tables = {
        "withdrawals": on_exact,
        "refits": refits,
        "limits": limits(on_exact),
        "rendered": rendered,
        "causes": shares,
        "eye": pd.concat([error_causes.of_an_eye(own) for own in square], ignore_index=True),
    }
    study.publish(_report, base, study.space, tables)
    return tables
