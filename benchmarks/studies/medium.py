"""`eyespot study medium`: calibrated in air, used in vitreous."""

import math
from collections.abc import Iterator, Mapping
from enum import StrEnum
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot import optics, scenes
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.model_error import DISTANCE
from eyespot.benchmarks.paper import ACCEPTABLE_ERROR_MM, withdrawal
from eyespot.benchmarks.reporting import number, rows_of, where
from eyespot.benchmarks.statistics import largest, rms
from eyespot.benchmarks.study import Study
from eyespot.benchmarks.study_command import command
from eyespot.calibration import fit_plane
from eyespot.estimator import Ranger
from eyespot.formats.calibration import Calibration
from eyespot.formats.microscope import read_microscope
from eyespot.formats.stack import read_stack
from eyespot.scenes import Scene
from eyespot.scenes.world.true_calibration import study_calibration, true_calibration
from eyespot.scenes.world.world import Cone, World, lens_light

# Half-maximum radius of a light in a medium against distance, in closed form.

AIR, VITREOUS = "air", "vitreous"
NEAREST_MM, FARTHEST_MM = 0.5, 6.0
"""Range of distances of calibration and measurement, as in the paper's trials."""

CONE = "cone"  # the light without a lens: the control


class Method(StrEnum):
    """Methods to compute a distance from a radius; the figure's caption says how they work."""

    AIR_CONE = "cone of air"
    LENS_CONE = "cone of the lens model"
    LENS = "lens model"


class Regression(NamedTuple):
    """Row of medium_cones.csv: the cone d = kR + b of a light in a medium (Zhou et al. 2020).

    Between the ambiguous distances one radius has several solutions.
    """

    light: str
    medium: str
    k: float
    b_mm: float
    r_squared: float = 1.0
    ambiguous_from_mm: float = math.nan
    ambiguous_to_mm: float = math.nan


class Curve(NamedTuple):
    """Half-maximum radius (mm) of a light in a medium against distance (mm), and its cone."""

    distance: np.ndarray
    radius: np.ndarray
    cone: Regression


_CURVE_DISTANCES_MM = np.linspace(0.05, 8.0, 1600)


def lens_curve(lens: str, medium: str) -> Curve:
    """The curve of a glue lens; its light takes half a minute the first time and is then kept."""
    table = lens_light(lens, optics.MEDIA[medium]).table
    between = {"from_distance": NEAREST_MM, "to_distance": FARTHEST_MM}
    cone = optics.effective_cone(table, **between)
    unclear = optics.ambiguous_distances(table, **between)
    first, last = (unclear[0][0], unclear[-1][1]) if unclear else (np.nan, np.nan)
    radius = np.asarray(optics.half_maximum_radius(table, distance=_CURVE_DISTANCES_MM))
    fitted = float(cone.k), float(cone.b), float(cone.r_squared)
    return Curve(_CURVE_DISTANCES_MM, radius, Regression(lens, medium, *fitted, first, last))


def cone_curve(cone: Cone, medium: str) -> Curve:
    """The curve of the ideal cone, which is the same in every medium."""
    k = float(1.0 / np.tan(cone.half_angle))
    radius = (_CURVE_DISTANCES_MM - cone.apex_offset) / k
    return Curve(_CURVE_DISTANCES_MM, radius, Regression(CONE, medium, k, cone.apex_offset))


COLUMNS = "source light medium method d_mm radius_mm estimate_mm error_mm ambiguous".split()
"""Of medium_error.csv; error = estimate - truth.

If the result is ambiguous, the analytic estimate is the solution farthest from the truth and the
rendered one is the most likely solution; without a result the estimate is empty.
"""


def analytic_errors(air: Curve, medium: Curve, *, distances: np.ndarray) -> pd.DataFrame:
    """Errors of the three methods on the square wall's half-maximum radii in a medium.

    `air` is the light where it was calibrated, `medium` the same where it is used; may be air.
    """
    rows = []
    for d in distances.tolist():
        radius = float(np.interp(d, medium.distance, medium.radius))
        # All distances at which the light has this radius.
        before, after = (medium.radius - radius)[:-1], (medium.radius - radius)[1:]
        step = np.flatnonzero((before < 0) != (after < 0))
        share = before[step] / (before[step] - after[step])
        solutions = medium.distance[step] + share * np.diff(medium.distance)[step]
        solutions = solutions[(solutions >= NEAREST_MM) & (solutions <= FARTHEST_MM)]
        farthest = solutions[np.argmax(np.abs(solutions - d))] if solutions.size else d
        for method, estimate, ambiguous in (
            (Method.AIR_CONE, air.cone.k * radius + air.cone.b_mm, False),
            (Method.LENS_CONE, medium.cone.k * radius + medium.cone.b_mm, False),
            (Method.LENS, float(farthest), solutions.size > 1),
        ):
            light = ("analytic", medium.cone.light, medium.cone.medium, method)
            rows.append((*light, d, radius, estimate, estimate - d, ambiguous))
    return pd.DataFrame(rows, columns=COLUMNS)


# The rendered part: calibrated on a plane in air, used in an eyeball full of another medium.


def measure(study: Study, *, frames: int, curves: Mapping[tuple[str, str], Curve]) -> pd.DataFrame:
    """Render, track, calibrate in air and use: errors in the eyeball.

    `curves` are what the lens model says without another fit, by light and medium.
    """
    moves = withdrawal(start_mm=NEAREST_MM, travel_mm=FARTHEST_MM - NEAREST_MM, frames=frames)
    moves["microscope.height_px"] = 600  # The dome's spot in air outgrows the default window.
    places, every = ((AIR, "plane"), (AIR, "eyeball"), (VITREOUS, "eyeball")), {}
    for light, (medium, wall) in product(dict.fromkeys(light for light, _ in curves), places):
        # A lens may be a file.
        name = f"{Path(light).stem}-{medium}-{wall}"
        source = {"source.kind": CONE} if light == CONE else {"source.lens": light}
        world = {"source.medium": medium, "phantom.kind": wall}
        every[light, medium, wall] = name, scenes.changed(study.scene, source | world | moves)
    tracked = study.tracked(dict(every.values()))
    errors = []
    for (light, medium, wall), (name, scene) in every.items():
        spots = tracked[name][tracked[name].used]
        if wall == "plane":
            calibrated = _calibrated(spots, study.scene.microscope.scale_mm_px)
            continue
        calibrations = {Method.AIR_CONE: calibrated}
        if light != CONE and medium == VITREOUS:
            cone = curves[light, medium].cone
            own = study_calibration("planar", {"k": cone.k, "b": cone.b_mm}, medium=medium)
            calibrations |= {Method.LENS_CONE: own, Method.LENS: true_calibration(scene)}
        stack = read_stack(study.folder / "stacks" / name)
        microscope = read_microscope(stack.folder / "microscope.json")
        for method, known in calibrations.items():
            # `corrected` is the cone of a plane, taken to the sphere.
            model = None if known.model == "lens" else "corrected"
            ranger = Ranger(known, microscope, model=model)
            for row in rows_of(spots):
                found = ranger.distance(row.result, frame=stack.image(row))
                radius, estimate = row.semi_minor_px * microscope.scale_mm_px, found.distance_mm
                values = (row.d_mm, radius, estimate, estimate - row.d_mm, bool(found.others_mm))
                errors.append(("rendered", light, medium, method, *values))
    return pd.DataFrame(errors, columns=COLUMNS)


def _calibrated(spots: pd.DataFrame, scale: float) -> Calibration:
    """The cone that spots on a plane in air give; the scale in mm/px."""
    # The robot's reading since the first frame, whose distance is known here.
    reading, e = NEAREST_MM + spots.d_r_mm.to_numpy(), spots.semi_minor_px.to_numpy()
    fit = fit_plane(semi_minor_px=e, distance=reading)
    to_k, values = np.diag([1.0 / scale, 1.0]), {"k": fit.delta_k / scale, "b": fit.b}
    covariance = to_k @ fit.covariance @ to_k
    return study_calibration("planar", values, medium=AIR, covariance=covariance)


_LENSES = ("paper-candidate", "dome")  # a flat end and a round cap: the two kinds of drop


# Figures.

_COLOURS = {Method.AIR_CONE: page.VERMILION, Method.LENS_CONE: page.BLUE, Method.LENS: page.GREEN}


def _error_figure(cones: pd.DataFrame, errors: pd.DataFrame) -> Figure:
    """Error of each method against distance: a panel for each light."""

    def draw(axes: Axes, _: str, light: str) -> None:
        axes.axhline(0, color=page.GREY, lw=0.8)
        for end in (-ACCEPTABLE_ERROR_MM, ACCEPTABLE_ERROR_MM):
            axes.axhline(end, color=page.VERMILION, lw=0.8, ls="--")
        for cone in rows_of(where(cones, light=light, medium=VITREOUS).dropna()):
            axes.axvspan(cone.ambiguous_from_mm, cone.ambiguous_to_mm, color="#EEEEEE", zorder=0)
        shown = [(method, VITREOUS, "-", "o") for method in Method]
        for method, medium, style, shape in [(Method.AIR_CONE, AIR, "--", "s"), *shown]:
            colour = _COLOURS[method]
            own = where(errors, light=light, medium=medium, method=method)
            line, marks = where(own, source="analytic"), where(own, source="rendered")
            clear = line.error_mm.mask(line.ambiguous)
            axes.plot(line.d_mm, clear, ls=style, color=colour, label=f"{method}, in {medium}")
            if line.ambiguous.any():
                axes.plot(line.d_mm, line.error_mm, ls=":", lw=0.9, color=colour)
            for unclear, chosen in marks.groupby("ambiguous"):
                face = "none" if unclear or medium == AIR else colour
                points = chosen.d_mm, chosen.error_mm
                axes.plot(*points, ls="", marker=shape, ms=4, color=colour, mfc=face)

    lights, y = errors.light.unique().tolist(), "estimate − truth (mm)"
    return page.small_multiples(draw, columns=lights, x=DISTANCE, y=y, height=3.4)


# The page.


def _report(scene: Scene, cones: pd.DataFrame, errors: pd.DataFrame) -> page.Report:
    by_method = errors.groupby(["source", "light", "medium", "method"], sort=False)
    summary = by_method.error_mm.agg(spots="size", mean_mm="mean", rms_mm=rms, largest_mm=largest)
    summary = summary.join(by_method.ambiguous.mean()).reset_index()
    indices = ", ".join(f"{medium} {float(optics.MEDIA[medium]):g}" for medium in (AIR, VITREOUS))
    own = where(errors, light=scene.source.lens, medium=VITREOUS)
    computed = where(own, source="analytic", method=Method.AIR_CONE)
    rendered = where(own, source="rendered")
    median = rendered.error_mm.abs().groupby(rendered.method).median()
    return page.Report(
        title="How large is the error of a calibration in air when it is used in vitreous?",
        answer="Calibrated as a cone in air, a distance in vitreous is off by up to "
        f"{number(largest(computed.error_mm), 2)} mm; on rendered spots the median error is "
        f"{number(median.get(Method.AIR_CONE, math.nan), 2)} mm by that cone and "
        f"{number(median.get(Method.LENS, math.nan), 3)} mm by the lens model, which needs "
        "only the medium's name.",
        lead="The cone fitted to a glue lens in air is used in vitreous, and compared with the "
        "lens model for the same spots, which needs no other fit. The control is an ideal cone, "
        "whose light no medium refracts.",
        first=[
            page.Picture(
                "error",
                _error_figure(cones, errors),
                "A cone from air is wrong in vitreous; the lens model is not. Lines: computed from "
                "the lens's light on a square plane. Marks: rendered frames of an eyeball "
                f"(incidence {scene.spot.incidence_deg:g}°), with the cone fitted to rendered "
                "frames of a plane in air; squares are in air, open circles flagged ambiguous. "
                f"“{Method.LENS_CONE}”: k and b computed for vitreous from the scene's lens. "
                f"“{Method.LENS}”: where the lens makes this spot; on its own curve only the "
                "ambiguity is an error. In the grey bands one radius belongs to several distances; "
                "the dotted green line is the solution farthest from the truth. Dashed: the "
                f"{ACCEPTABLE_ERROR_MM:g} mm that the paper calls acceptable.",
                data="medium_error.csv",
            ),
            page.Table(
                where(summary, source="rendered", light=scene.source.lens),
                ["medium", "method", "spots", "rms_mm", "largest_mm"],
                f"Errors of rendered spots of {scene.source.lens}.",
                data="medium_summary.csv",
            ),
        ],
        claims=list(_claims(errors)),
        sections=[
            page.Section(
                "Why",
                page.Table(
                    cones,
                    cones.columns,
                    f"Cones d = kR + b of the half-maximum radius over d = {NEAREST_MM:g} to "
                    f"{FARTHEST_MM:g} mm, and the distances between which one radius belongs to "
                    f"several. Refractive indices: {indices}.",
                    data="medium_cones.csv",
                ),
            ),
        ],
        data={"medium_error.csv": errors, "medium_summary.csv": summary, "medium_cones.csv": cones},
    )


def _claims(errors: pd.DataFrame) -> Iterator[page.Claim]:
    computed = errors[errors.source == "analytic"].groupby(["light", "medium", "method"])
    worst, rendered = computed.error_mm.agg(largest), where(errors, source="rendered")
    for lens in errors.light[errors.light != CONE].unique():
        off = worst[lens, VITREOUS, Method.AIR_CONE]
        yield page.Claim(
            name=f"air to vitreous, {lens}",
            sentence=f"Calibrated in air, the distance in vitreous is off by up to {off:.2f} mm "
            f"(acceptable: {ACCEPTABLE_ERROR_MM:g} mm). In air it is off by up to "
            f"{worst[lens, AIR, Method.AIR_CONE]:.2f} mm, because a lens is no cone. The cone that "
            "the lens model computes for vitreous is off by up to "
            f"{worst[lens, VITREOUS, Method.LENS_CONE]:.2f} mm.",
            value=off,
            high=ACCEPTABLE_ERROR_MM,
        )
        own = where(rendered, light=lens, medium=VITREOUS)
        rows = where(own, method=Method.LENS)
        sure = rows.error_mm[~rows.ambiguous].dropna().abs()
        cone = where(own, method=Method.AIR_CONE).error_mm.abs()
        yield page.Claim(
            name=f"lens model, {lens}",
            sentence=f"In rendered vitreous the lens model is off by {sure.median():.3f} mm and "
            f"the cone of air by {cone.median():.2f} mm (medians). Of {len(rows)} spots "
            f"{rows.ambiguous.sum()} are flagged ambiguous and {rows.error_mm.isna().sum()} have "
            f"no answer. Of the other {len(sure)} spots {sum(sure > ACCEPTABLE_ERROR_MM)} are off "
            f"by more than {ACCEPTABLE_ERROR_MM:g} mm, the worst by {largest(sure):.3f} mm.",
            value=float(sure.median()),
        )
    control = where(rendered, light=CONE, method=Method.AIR_CONE)
    by_medium = control.pivot(index="d_mm", columns="medium", values="error_mm")
    differences = (by_medium[VITREOUS] - by_medium[AIR]).dropna()
    yield page.Claim(
        name="control",
        sentence=f"The ideal cone's rendered distances differ by {largest(differences):.4f} mm at "
        f"most between the media ({len(differences)} pairs of frames of the same seed). No medium "
        "refracts the cone, so any difference would be an error of the study itself.",
        value=largest(differences),
    )


# The command.

VARIED = (
    *("source.medium", "phantom.kind", "microscope.height_px", "motion.kind"),
    *("motion.start_mm", "motion.travel_mm", "motion.frames", "exposures.kinds"),
)
"""Keys of the scene that the study sets itself."""


def check(scene: Scene) -> None:
    """Refuse a scene without the lens."""
    why = "the study compares one lens in two media, and the ideal cone beside it"
    Study.demand(scene, {"source.kind": "lens"}, why)


@command(check=check, varies=VARIED)
def medium(study: Study) -> pd.DataFrame:
    """Calibrate in air, measure in vitreous: the error, and how much the lens model corrects."""
    base, quick = study.scene, study.quick
    own = base.source.lens
    lenses = (own,) if quick else tuple(dict.fromkeys((own, *_LENSES)))
    with study.timed("light of the lenses"):
        curves = {(n, m): lens_curve(n, m) for n in lenses for m in (AIR, VITREOUS)}
    ideal = scenes.changed(base, {"source.kind": CONE})
    curves |= {(CONE, m): cone_curve(World(ideal).cone, m) for m in (AIR, VITREOUS)}
    distances = np.linspace(NEAREST_MM, FARTHEST_MM, 23 if quick else 111)
    errors = [
        analytic_errors(curves[name, AIR], curve, distances=distances)
        for (name, _), curve in curves.items()
    ]
    with study.timed("render and measure"):
        errors.append(measure(study, frames=6 if quick else 23, curves=curves))
    table = pd.concat(errors, ignore_index=True)
    cones = pd.DataFrame([curve.cone for curve in curves.values()])
    study.publish(_report, base, cones, table)
    return table
