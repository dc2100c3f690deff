"""`eyespot study pose`: tip and axis of the tool from one spot and from three.

DIR/pose_error.csv  every pose, analytic and rendered, with its errors and bounds
    poses/          the rendered poses of the beams
    stacks/, spots/ the frames, and the spots measured in them
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import optics
from benchmarks.evaluation import (
    ECCENTRICITY,
    MICROSCOPE_MM,
    mean,
    require_roomy_eyeball,
    rms,
)
from benchmarks.reporting import (
    BLUE,
    VERMILION,
    Claim,
    Column,
    Picture,
    Report,
    Request,
    Section,
    Study,
    Table,
    grouped,
    limit_lines,
    rows_of,
    small_multiples,
)
from benchmarks.studies.pose import analytic, rendered
from benchmarks.studies.pose.errors import (
    FARTHEST_MM,
    HALF_WIDTH_MM,
    INCIDENCE_DEG,
    NEAREST_MM,
    NOISE_PX,
    PRIOR_DEG,
    REPORTED,
    Prior,
    one_spot,
    three_spots,
)
from scenes import Scene, SceneError
from scenes.world import World

LARGEST_C_MM = 5.0
"""Largest eccentricity of the rendered spots."""
SOURCES = ("analytic", "rendered")
NAMES = {1: "one spot", 3: "three spots"}
REQUIRED_TIP_MM, REQUIRED_AXIS_DEG, REQUIRED_DISTANCE_MM = 0.010, 0.1, 0.005
"""Required root mean square errors of rendered spots."""


def run(request: Request) -> pd.DataFrame:
    """Compute, render, compare and report.

    Returns:
        The rows of pose_error.csv.

    Raises:
        SceneError: the scene is no eyeball lit by a cone, or too small a one.
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    study = Study("pose", request, defaults=("source.kind=cone",), check=check)
    quick = request.quick
    with study.timed("noise on exact contours"):
        rows = _analytic(study, one=64 if quick else 1024, three=32 if quick else 128)
    with study.timed("render and measure"):
        rows += rendered.measure(
            study,
            eccentricities=np.linspace(0.0, LARGEST_C_MM, 2 if quick else 6).tolist(),
            poses=3 if quick else 6,
        )
    errors = pd.DataFrame(rows)
    study.publish(lambda errors: _report(study.scene, errors), errors)
    return errors


def check(scene: Scene) -> None:
    """Refuse a scene whose spots have no pose in the working volume.

    Raises:
        SceneError: saying what to change.
    """
    reach = np.sqrt(2) * HALF_WIDTH_MM
    require_roomy_eyeball(scene, f"spots reach {reach:.1f} mm from the axis")
    if scene.source.kind != "cone":
        raise SceneError(
            "the study computes poses from a spot's sharp edge; got source.kind "
            f"'{scene.source.kind}'. Set source.kind=cone."
        )


def _analytic(study: Study, *, one: int, three: int) -> list[dict[str, Any]]:
    """Errors on exact contours, with the scene's pinhole and with a microscope's."""
    scene = study.scene
    surface = World(scene).wall
    assert isinstance(surface, optics.Sphere)  # by `check`
    given = World(scene).cone
    rows = []
    for height in dict.fromkeys((scene.microscope.pinhole_height_mm, MICROSCOPE_MM)):
        view = optics.microscope(
            scale=scene.microscope.scale_mm_px,
            pinhole_height=height,
            eye_radius=scene.phantom.radius_mm,
        )
        for tool, count in ((one_spot(*given), one), (three_spots(*given), three)):
            every = analytic.places(surface, count=count, seed=study.seed)
            rows += analytic.errors(tool, every, surface, view, seed=study.seed)
    return rows


# Summaries.


def some(errors: pd.DataFrame, source: str, spots: int, prior: Prior) -> pd.DataFrame:
    """The rows of one source, number of spots and prior."""
    return errors[(errors.source == source) & (errors.spots == spots) & (errors.prior == prior)]


def scatter(rows: pd.DataFrame) -> pd.Series:
    """Root mean squares and means; rows that share a source, number of spots and prior.

    The errors of tip and axis exclude mirrored solutions; `tip_all_mm` and `distance_mm` include
    them.
    """
    right = rows[~rows.mirrored]
    first = rows.iloc[0]
    return pd.Series(
        {
            "source": first.source,
            "spots": first.spots,
            "prior": first.prior,
            "z_f_mm": first.z_f_mm if rows.z_f_mm.nunique() == 1 else np.nan,
            "poses": len(rows),
            "mirrored": 1.0 - len(right) / len(rows),
            "tip_mm": rms(right.tip_error_mm),
            "tip_mean_mm": mean(right.tip_error_mm),
            "tip_bound_mm": rms(right.tip_bound_mm),
            "tip_all_mm": rms(rows.tip_error_mm),
            "axis_deg": rms(right.axis_error_deg),
            "axis_mean_deg": mean(right.axis_error_deg),
            "axis_bound_deg": rms(right.axis_bound_deg),
            "distance_mm": rms(rows.distance_error_mm),
            "sigma_distance_mm": rms(rows.sigma_distance_mm),
        }
    )


# Figures.

_COLOURS = {1: BLUE, 3: VERMILION}
_MARKS: dict[str, dict[str, Any]] = {
    "analytic": {"marker": ".", "ms": 4, "alpha": 0.45},
    "rendered": {"marker": "x", "ms": 6},
}
_ASIDE = 0.1
"""Spots of one eccentricity are drawn side by side, in the order of their distances."""

_QUANTITIES = {"error of the tip (mm)": "tip_{}_mm", "error of the axis (°)": "axis_{}_deg"}


def _by_incidence(errors: pd.DataFrame) -> Figure:
    """Errors of tip and axis against the incidence, for the first row's pinhole."""
    height = errors.z_f_mm.iloc[0]
    edges = np.linspace(*INCIDENCE_DEG, 6)

    def draw(axes: Axes, _: str, quantity: str) -> None:
        error, bound = (_QUANTITIES[quantity].format(name) for name in ("error", "bound"))
        for spots, colour in _COLOURS.items():
            for source, marks in _MARKS.items():
                rows = some(errors, source, spots, Prior.ROUGH)
                shown = rows[~rows.mirrored & (rows.z_f_mm == height)]
                points = shown.incidence_deg, shown[error]
                axes.plot(*points, ls="", color=colour, label=f"{NAMES[spots]}, {source}", **marks)
            rows = some(errors, "analytic", spots, Prior.ROUGH)
            bins = pd.cut(rows.incidence_deg, edges.tolist(), right=False)
            bounds = rows[bound].groupby(bins, observed=False).agg(rms)
            axes.plot(0.5 * (edges[:-1] + edges[1:]), bounds, color=colour, lw=1.6)
            reported = dict(zip(_QUANTITIES, REPORTED[spots], strict=True))[quantity]
            axes.axhline(reported, color=colour, ls=":", lw=1.0)
        axes.set(yscale="log")

    columns = list(_QUANTITIES)
    return small_multiples(draw, rows=[""], columns=columns, x="incidence (°)", y="", height=3.7)


def _known_axis(errors: pd.DataFrame) -> Figure:
    """Errors of the distance in rendered frames with a known axis, against c."""
    rows = some(errors, "rendered", 1, Prior.KNOWN)

    def draw(axes: Axes, *_: str) -> None:
        limit_lines(axes, 1e3 * REQUIRED_DISTANCE_MM)
        axes.errorbar(
            rows.c_mm + _ASIDE * (rows.d_mm - rows.d_mm.mean()),
            1e3 * rows.distance_error_mm,
            yerr=1e3 * rows.sigma_distance_mm,
            fmt="x",
            capsize=2,
            color=BLUE,
        )

    y = "error of $d$ (µm)"
    return small_multiples(
        draw, rows=[""], columns=[""], x=ECCENTRICITY, y=y, height=3.2, legend_columns=0
    )


# The page.

_FILE = "pose_error.csv"


_COLUMNS = {
    "source": Column("source"),
    "spots": Column("spots"),
    "prior": Column("prior"),
    "z_f_mm": Column("z_F, mm", 1),
    "poses": Column("poses"),
    "mirrored": Column("mirrored, %", 1, scale=100),
    "tip_mm": Column("tip, µm", scale=1e3),
    "tip_mean_mm": Column("mean, µm", scale=1e3),
    "tip_bound_mm": Column("bound, µm", scale=1e3),
    "tip_all_mm": Column("tip with mirrored, µm", scale=1e3),
    "axis_deg": Column("axis, °"),
    "axis_mean_deg": Column("mean, °"),
    "axis_bound_deg": Column("bound, °"),
    "distance_mm": Column("distance, µm", scale=1e3),
    "sigma_distance_mm": Column("its σ, µm", scale=1e3),
}


def _report(scene: Scene, errors: pd.DataFrame) -> Report:
    def scatters(*priors: Prior) -> pd.DataFrame:
        """Summaries by prior, source, number of spots and pinhole."""
        return pd.DataFrame(
            [
                scatter(rows)
                for prior in priors
                for source in SOURCES
                for spots in REPORTED
                for _, rows in grouped(some(errors, source, spots, prior), "z_f_mm")
            ]
        )

    return Report(
        title="How accurately do one spot and three spots give the tool's pose?",
        lead="Tip and axis, five parameters, of an ideal cone: from exact contours with noise "
        "over a working volume of 10 × 10 × 5 mm, and from rendered frames.",
        claims=list(_claims(errors)),
        sections=[
            Section(
                "Errors",
                Table.of(
                    scatters(Prior.ROUGH),
                    _COLUMNS,
                    "Root mean square errors, mean errors and bounds, direction prior "
                    f"{PRIOR_DEG:g}°. Mirrored solutions are left out of the errors of tip and "
                    "axis.",
                    data=_FILE,
                ),
                Picture(
                    "incidence",
                    _by_incidence(errors),
                    f"Errors of tip and axis against the incidence, direction prior {PRIOR_DEG:g}°,"
                    f" without mirrored solutions. Dots: contours with noise of {NOISE_PX:g} px. "
                    "Crosses: rendered frames. Lines: root mean square of the Cramér–Rao bound. "
                    "Dotted: the mean errors reported by Zhou et al. (2023).",
                    data=_FILE,
                ),
                _method(scene, errors),
            ),
            Section(
                "The mirror solution",
                Table.of(
                    scatters(Prior.ROUGH, Prior.NONE),
                    _COLUMNS,
                    "How often the mirrored solution is taken, and the tip's root mean square "
                    "error without and with it.",
                    data=_FILE,
                ),
                _MIRROR,
            ),
            Section(
                "Axis known",
                Table.of(
                    scatters(Prior.KNOWN),
                    _COLUMNS,
                    "Root mean square errors if the robot gives the axis. The last column is the "
                    "standard deviation of the distance that the estimator reports.",
                    data=_FILE,
                ),
                Picture(
                    "known",
                    _known_axis(errors),
                    "Error of the distance with the axis known, one spot in rendered frames, "
                    "against the eccentricity (farther ones to the right of nearer ones). Bars: "
                    "the estimator's own standard deviation. Dashed: the requirement.",
                    data=_FILE,
                ),
            ),
        ],
        data={_FILE: errors},
    )


def _claims(errors: pd.DataFrame) -> Iterator[Claim]:
    def found_for(source: str, spots: int, prior: Prior) -> Any:
        """The summary of one source, number of spots and prior."""
        return rows_of(pd.DataFrame([scatter(some(errors, source, spots, prior))]))[0]

    for source in SOURCES:
        for spots, (tip, axis) in REPORTED.items():
            found = found_for(source, spots, Prior.ROUGH)
            yield Claim(
                name=f"{source}, {NAMES[spots]}, tip",
                sentence="The mean error of the tip is {value:.4f} mm (reported by others, with "
                "another light, eye and camera: {high:g} mm). Root mean square {all.tip_mm:.4f} "
                "mm over {all.poses} poses without mirrored ones; the bound is "
                "{all.tip_bound_mm:.4f} mm.",
                value=found.tip_mean_mm,
                high=tip,
                numbers={"all": found},
            )
            yield Claim(
                name=f"{source}, {NAMES[spots]}, axis",
                sentence="The mean error of the axis is {value:.3f}° (reported by others: "
                "{high:g}°). Root mean square {all.axis_deg:.3f}°; the bound is "
                "{all.axis_bound_deg:.3f}°.",
                value=found.axis_mean_deg,
                high=axis,
                numbers={"all": found},
            )
    single = some(errors, "rendered", 1, Prior.ROUGH)
    found = found_for("rendered", 1, Prior.ROUGH)
    by_incidence = [(deg, scatter(rows)) for deg, rows in single.groupby("incidence_deg")]
    incidences = tuple(deg for deg, _ in by_incidence)
    yield Claim(
        name="requirement, tip",
        sentence="Single rendered spots give the tip to {value:.4f} mm (required: {high:g} mm), "
        "root mean square of {all.poses} frames without mirrored ones. At incidences of "
        "{incidences:g}° it is {each:.4f} mm. In {all.mirrored:.0%} of the frames a prior drawn "
        "with {prior:g}° led to the mirrored solution; with these the tip is off by "
        "{all.tip_all_mm:.3f} mm.",
        value=found.tip_mm,
        high=REQUIRED_TIP_MM,
        numbers={
            "all": found,
            "incidences": incidences,
            "each": tuple(part.tip_mm for _, part in by_incidence),
            "prior": PRIOR_DEG,
        },
    )
    yield Claim(
        name="requirement, axis",
        sentence="Single rendered spots give the axis to {value:.3f}° (required: {high:g}°). At "
        "incidences of {incidences:g}° it is {each:.3f}°, with bounds of {bounds:.3f}°.",
        value=found.axis_deg,
        high=REQUIRED_AXIS_DEG,
        numbers={
            "incidences": incidences,
            "each": tuple(part.axis_deg for _, part in by_incidence),
            "bounds": tuple(part.axis_bound_deg for _, part in by_incidence),
        },
    )
    known = some(errors, "rendered", 1, Prior.KNOWN)
    yield Claim(
        name="requirement, distance",
        sentence="With the axis known the distance is off by {value:.4f} mm (root mean square) at "
        "the worst eccentricity up to c = {largest_c:g} mm (required: {high:g} mm), and by "
        "{rms:.4f} mm over all {frames} rendered frames.",
        value=float(known.groupby("c_mm").distance_error_mm.agg(rms).max()),
        high=REQUIRED_DISTANCE_MM,
        numbers={
            "largest_c": LARGEST_C_MM,
            "rms": rms(known.distance_error_mm),
            "frames": len(known),
        },
    )
    free, led = (found_for("analytic", 1, p) for p in (Prior.NONE, Prior.ROUGH))
    yield Claim(
        name="mirror",
        sentence="Without a prior, one spot gives the mirror solution in {value:.1%} of the "
        "poses, three spots in {three.mirrored:.1%}. With a direction prior of {prior:g}° it is "
        "{led.mirrored:.1%} for one spot, and the tip is off by {led.tip_all_mm:.3f} mm (root mean "
        "square of all poses; {free.tip_all_mm:.3f} mm without a prior). The distance is off by "
        "{free.distance_mm:.4f} mm "
        "without a prior, mirrored solutions included.",
        value=free.mirrored,
        numbers={
            "three": found_for("analytic", 3, Prior.NONE),
            "free": free,
            "led": led,
            "prior": PRIOR_DEG,
        },
    )


_MIRROR = (
    "A beam that is tilted the other way explains a spot almost as well, at the same distance but "
    "with another tip. For one spot the two differ only in the contour's deviation from an "
    "ellipse. This deviation decreases with the incidence, and an estimator that reports ellipses "
    "does not measure it. For three splayed spots their positions distinguish the two solutions."
)


def _method(scene: Scene, errors: pd.DataFrame) -> str:
    noise = errors.noise_px[errors.source == "rendered"].median()
    low, high = INCIDENCE_DEG
    source = scene.source
    return (
        f"k = {source.cone_k:g}, b = {source.cone_apex_offset_mm:g} mm, "
        f"{1e3 * scene.microscope.scale_mm_px:g} µm/px; O anywhere in 10 × 10 mm round "
        f"the microscope's axis, d = {NEAREST_MM:g} to {FARTHEST_MM:g} mm, incidence {low:g} to "
        f"{high:g}° from all sides; {NOISE_PX:g} px of noise across each of 128 points of a "
        "contour. Three spots are three such cones on one rigid tool, their tips 0.5 mm apart and "
        "splayed by 10°, lit one after the other; the tool's roll is found with its pose. Rendered "
        "frames have an even wall, camera noise and no instrument in front of the spot. The "
        "estimator's standard errors of their ellipses correspond to noise of "
        f"{noise:.3f} px on 128 points (median)."
    )
