"""`eyespot study pose`: tip and axis of the tool from one spot and from three."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import qmc

from eyespot import optics, scenes
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.paper import MICROSCOPE_HEIGHT_MM, require_roomy_eyeball
from eyespot.benchmarks.reporting import listed, number, where
from eyespot.benchmarks.statistics import rms
from eyespot.benchmarks.study import Study, geometry_of
from eyespot.benchmarks.study_command import command
from eyespot.calibration.spots.tool_pose import (
    Tool,
    ToolPose,
    fit_tool,
    tool_beams,
    tool_pose_bound,
)
from eyespot.estimator import Ranger, SubpixelSettings, TrackState
from eyespot.estimator import measure as measured
from eyespot.formats.microscope import read_microscope
from eyespot.formats.spots import NoSpot, Spot
from eyespot.formats.stack import Stack
from eyespot.formats.whole_files import written_whole
from eyespot.scenes import Scene
from eyespot.scenes.world.true_calibration import true_calibration

# The working volume, a pose in it, and how far an estimate is from it.

HALF_WIDTH_MM = 5.0  # O lies in a square around the microscope's axis.
NEAREST_MM, FARTHEST_MM = 0.5, 5.5  # distances from tip to wall along the beam
INCIDENCE_DEG = (10.0, 30.0)
NOISE_PX = 0.05  # standard deviation across the contour of each of 128 points
LARGEST_C_MM = 5.0  # Rendered spots lie within.
PRIOR_DEG = 5.0
"""Standard deviation of the direction prior across the axis, as for a rough robot calibration."""

REPORTED = {1: (0.029, 0.124), 3: (0.025, 0.101)}
"""Mean errors of tip (mm) and axis (degrees) by number of spots: Zhou et al., "Theoretical error
analysis of spotlight-based instrument localization for retinal surgery", Robotica 2023; rendered
in Blender, with another light and eye."""


ROUGH, KNOWN = "5 deg", "axis known"
SIGMA_RAD = {ROUGH: math.radians(PRIOR_DEG), KNOWN: 1e-6}
"""The solver's standard deviation of a prior across the axis, rad."""

_LEAST_MIRRORED_DEG = 2.0  # An axis nearer to the truth is not mirrored.
_FIBRE_MM, _SPLAY_DEG = 0.5, 10.0


def tools_of(half_angle: float, apex_offset: float) -> tuple[Tool, Tool]:
    """A cone (rad, mm) along the tool's axis; and three fibres that touch each other, splayed.

    The tool of Zhou et al. (2023) has three spotlights; more of it is not published. Here they are
    lit one after the other, so that spots neither overlap nor are confused.
    """
    cone, circle = (half_angle, apex_offset), _FIBRE_MM / math.sqrt(3.0)
    return Tool(*cone, 1, 0.0, 0.0), Tool(*cone, 3, circle, math.radians(_SPLAY_DEG))


PLACE = ("c_mm", "d_mm", "incidence_deg", "azimuth_deg")
"""Columns of the CSV files; a place also has `around_deg`, O's azimuth, and `roll_deg`."""


def poses_at(wall: optics.Sphere, places: pd.DataFrame) -> list[ToolPose]:
    """Poses whose axes meet the wall at places; see `optics.beam_at_spot`."""
    found = []
    for place in page.rows_of(places):
        beam = optics.beam_at_spot(
            wall,
            eccentricity=place.c_mm,
            azimuth=math.radians(place.around_deg),
            distance=place.d_mm,
            incidence=math.radians(place.incidence_deg),
            incidence_azimuth=math.radians(place.azimuth_deg),
            half_angle=0.0,
            apex_offset=0.0,
        )
        roll = math.radians(place.roll_deg)
        found.append(ToolPose(np.asarray(beam.tip), np.asarray(beam.axis), roll))
    return found


def bound_of(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of the tip in three dimensions, mm, and of the axis, degrees.

    Of the axis both perpendiculars together; 0 if the covariance has none, since it is known.
    """
    variances = np.diagonal(covariance, axis1=-2, axis2=-1)
    tip, axis = (np.sqrt(part.sum(axis=-1)) for part in (variances[..., :3], variances[..., 3:]))
    return tip, np.degrees(axis)


def drawn_prior(axis: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A direction that is off by `PRIOR_DEG` (standard deviation) along each perpendicular."""
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(axis))
    off = np.radians(PRIOR_DEG) * rng.standard_normal(2)
    turned = axis + off[0] * first + off[1] * second
    return turned / np.linalg.norm(turned)


def angle_deg(axis: np.ndarray, other: np.ndarray) -> float:
    """Angle between unit vectors, accurate for small ones too."""
    sine = np.linalg.norm(np.cross(axis, other))
    return math.degrees(math.atan2(sine, float(np.dot(axis, other))))


def is_mirrored(found: np.ndarray, true: np.ndarray, outward: np.ndarray) -> bool:
    """Whether an axis is nearer to the true one's mirror image at the wall than to the true one."""
    mirror = 2.0 * np.dot(outward, true) * outward - true
    off = angle_deg(found, true)
    return off > _LEAST_MIRRORED_DEG and angle_deg(found, mirror) < off


# The bound: what noise on exact contours leaves of a pose, over the working volume.


def volume(*, count: int, seed: int) -> pd.DataFrame:
    """Places that fill the working volume evenly: scrambled Sobol points."""
    engine, half = qmc.Sobol(d=6, scramble=True, rng=np.random.default_rng(seed)), HALF_WIDTH_MM
    low = [-half, -half, NEAREST_MM, INCIDENCE_DEG[0], 0.0, 0.0]
    high = [half, half, FARTHEST_MM, INCIDENCE_DEG[1], 360.0, 360.0]
    x, y, d, incidence, azimuth, roll = qmc.scale(engine.random(count), low, high).T
    place = dict(zip(PLACE, (np.hypot(x, y), d, incidence, azimuth), strict=True))
    return pd.DataFrame(place | {"around_deg": np.degrees(np.arctan2(y, x)), "roll_deg": roll})


def bounds(
    tool: Tool, places: pd.DataFrame, wall: optics.Sphere, view: optics.Microscope
) -> pd.DataFrame:
    """Rows of pose_bound.csv: Cramér-Rao standard deviations at each place for `NOISE_PX`."""
    of_each = jax.vmap(lambda pose: tool_pose_bound(tool, pose, wall, view, sigma_px=NOISE_PX))
    poses = ToolPose(*map(np.array, zip(*poses_at(wall, places), strict=True)))
    tip, axis = bound_of(np.asarray(of_each(poses)))
    about = {"spots": tool.cones, "z_f_mm": float(view.pinhole_height)}
    return places[[*PLACE]].assign(**about, tip_bound_mm=tip, axis_bound_deg=axis)


# The rendered part: frames of an even wall, spots by the estimator, poses by its exact model.

STILL = {
    "phantom.wall": "uniform",
    "instrument.visible": False,
    "exposures.kinds": ["metered"],
    "microscope.width_px": 800,  # three spots need more room than one
    "microscope.height_px": 720,
    "clocks.camera_hz": 1.0,  # a frame a second, in which the tool stands still
}
_HALF_REST_S = 0.45  # The tool rests before and after the middle of an exposure.
_INCIDENCES_DEG = (10.0, 20.0, 30.0)
_FARTHEST_RENDERED_MM = 4.0  # Farther, splayed spots leave the window.
_GOLDEN_DEG = 180.0 * (3.0 - math.sqrt(5.0))  # At steps of the golden angle azimuths never repeat.
_POINTS = 128


def places_at(scene: Scene, *, c: float, poses: int) -> pd.DataFrame:
    """Places at one point of the wall, at several distances and incidences."""
    n = np.arange(poses)
    turns = n * _GOLDEN_DEG
    d = 1.0 + (_FARTHEST_RENDERED_MM - 1.0) * (n + 0.5) / poses
    place = dict(zip(PLACE, (c, d, np.resize(_INCIDENCES_DEG, poses), turns % 360.0), strict=True))
    return pd.DataFrame(place | {"around_deg": scene.spot.azimuth_deg, "roll_deg": turns})


def measure(
    study: Study, tools: Sequence[Tool], *, eccentricities: list[float], poses: int
) -> pd.DataFrame:
    """Render, track and solve with each tool, at each eccentricity (mm): pose_error.csv."""
    wall, trials, every = optics.Sphere(study.scene.phantom.radius_mm), {}, {}
    for c in eccentricities:
        name, places = f"c-{c:g}", places_at(study.scene, c=c, poses=poses)
        every[name] = places[[*PLACE]].to_dict("records"), poses_at(wall, places)
        file = study.folder / "poses" / f"{name}.csv"
        write_poses(file, tools, every[name][1])
        trials[name] = scenes.changed(
            study.scene,
            STILL | {"spot.eccentricity_mm": c, "motion": {"kind": "recorded", "file": str(file)}},
        )

    def track(name: str, stack: Stack) -> tuple[Ranger, list[Spot | NoSpot]]:
        # Single frames, since a tracker rejects the jumps from one frame to the next.
        images, settings = map(stack.image, stack.labels), SubpixelSettings()
        found = [measured(image, TrackState(), settings)[0] for image in images]
        microscope = read_microscope(stack.folder / "microscope.json")
        return Ranger(true_calibration(trials[name]), microscope), found

    rng = np.random.default_rng([study.seed, 2])
    rows = []
    for name, (ranger, results) in study.measured(trials, track).items():
        lit = iter(results)
        for place, pose in zip(*every[name], strict=True):
            prior = drawn_prior(np.asarray(pose.axis), rng)
            for tool in tools:
                seen = [next(lit) for _ in range(tool.cones)]
                found = [result for result in seen if isinstance(result, Spot)]
                if len(found) == tool.cones:
                    rows += [place | row for row in _errors(tool, pose, found, prior, ranger)]
    first = ["spots", "prior", "z_f_mm"]
    return pd.DataFrame(rows).set_index(first).reset_index()


def write_poses(file: Path, tools: Sequence[Tool], poses: list[ToolPose]) -> None:
    """Write one beam a second, at rest while the camera exposes."""
    file.parent.mkdir(exist_ok=True)
    beams = [tool_beams(tool, pose) for pose in poses for tool in tools]
    lit = np.concatenate([np.hstack([beam.tip, beam.axis]) for beam in beams])
    times = np.add.outer(np.arange(len(lit)), [-_HALF_REST_S, _HALF_REST_S]).ravel()
    times[[0, -1]] = (
        0,
        len(lit) - 1,
    )  # The first frame is due at the first row, the last at the last.
    columns = "time_s x_mm y_mm z_mm axis_x axis_y axis_z".split()
    rows = pd.DataFrame(np.column_stack([times, lit.repeat(2, axis=0)]), columns=columns)
    with written_whole(file, replace=True) as partial:
        rows.to_csv(partial, index=False)


def _errors(
    tool: Tool, pose: ToolPose, seen: list[Spot], prior: np.ndarray, ranger: Ranger
) -> Iterator[dict[str, Any]]:
    """Rows of pose_error.csv without the place: with each kind of prior, from the same spots.

    Errors are estimate - truth, or lengths and angles between the two. `mirrored`: whether the
    solution has the reversed incidence. The bounds, of tip and axis or of the tip only, are the
    Cramér-Rao standard deviations for the noise of the contour's points.
    """
    microscope = ranger.microscope
    wall, view = optics.Sphere(microscope.eye_radius_mm), microscope.pinhole()
    # The noise of each of n = 128 points that gives a circle's semi-axis this standard error. The
    # semi-axis is the sum of two independent terms of the radius, of 1 and of cos 2t, whose
    # variances are 1/n and 2/n of the noise's.
    sigma = float(np.mean([spot.sigma_semi_minor_px for spot in seen])) * math.sqrt(_POINTS / 3)
    true_tip, true_axis = np.asarray(pose.tip), np.asarray(pose.axis)
    met = wall.intersect(true_tip, true_axis)
    for kind, sigma_rad in SIGMA_RAD.items():
        known = kind == KNOWN
        expected = true_axis if known else prior
        tip: Any
        axis: Any
        # With a fixed axis the ranger may end with the cone's apex on the wall; see `fit_tool`.
        if tool.cones == 1 and not known:
            alone = ranger.distance(seen[0], axis=expected, axis_sigma_rad=sigma_rad)
            tip, axis, distance = alone.poses[0].tip_mm, alone.poses[0].axis, alone.distance_mm
        else:
            x, y, *columns = jnp.array([spot.ellipse for spot in seen]).T
            ellipses = optics.Ellipse(jnp.stack([x, y], axis=1), *columns)
            spread = jnp.stack([jnp.asarray(spot.covariance) for spot in seen])
            missed = np.asarray(_mismatch_covariances(ellipses, spread))
            beside = optics.DirectionPrior(jnp.asarray(expected), sigma_rad)
            (tip, axis, _), distance = fit_tool(tool, ellipses, missed, wall, view, beside)
        covariance = tool_pose_bound(tool, pose, wall, view, sigma_px=sigma, axis_known=known)
        tip_bound, axis_bound = bound_of(np.asarray(covariance))
        yield {
            "spots": tool.cones,
            "prior": kind,
            "z_f_mm": microscope.pinhole_height_mm,
            "noise_px": sigma,
            "mirrored": is_mirrored(np.asarray(axis), true_axis, -np.asarray(met.normal)),
            "tip_error_mm": float(np.linalg.norm(np.asarray(tip) - true_tip)),
            "axis_error_deg": angle_deg(np.asarray(axis), true_axis),
            "distance_error_mm": float(distance - met.distance),
            "tip_bound_mm": tip_bound,
            "axis_bound_deg": axis_bound,
        }


_mismatch_covariances = jax.jit(jax.vmap(optics.mismatch_covariance))


NAMES = {1: "one spot", 3: "three spots"}


def check(scene: Scene) -> None:
    """Refuse a scene whose spots have no pose in the working volume."""
    reach = np.sqrt(2) * HALF_WIDTH_MM
    require_roomy_eyeball(scene, f"spots reach {reach:.1f} mm from the axis")
    Study.demand(
        scene, {"source.kind": "cone"}, "the study computes poses from a spot's sharp edge"
    )


# Summaries.


def scatter(errors: pd.DataFrame, by: str) -> pd.DataFrame:
    """Root mean squares and means of poses by the values of a column.

    The errors of tip and axis exclude mirrored solutions; `tip_all_mm` includes them.
    """
    sizes = ["tip_error_mm", "tip_bound_mm", "axis_error_deg", "axis_bound_deg"]
    right = errors.assign(tip_all_mm=errors.tip_error_mm)
    right[sizes] = errors[sizes].where(~errors.mirrored)
    return right.groupby(by).agg(
        poses=("mirrored", "size"),
        mirrored=("mirrored", "mean"),
        tip_mm=("tip_error_mm", rms),
        tip_mean_mm=("tip_error_mm", "mean"),
        tip_bound_mm=("tip_bound_mm", rms),
        tip_all_mm=("tip_all_mm", rms),
        axis_deg=("axis_error_deg", rms),
        axis_mean_deg=("axis_error_deg", "mean"),
        axis_bound_deg=("axis_bound_deg", rms),
    )


# Figures.

_QUANTITIES = {"error of the tip (mm)": "tip_{}_mm", "error of the axis (°)": "axis_{}_deg"}


def _by_incidence(rough: pd.DataFrame, bounds: pd.DataFrame) -> Figure:
    """Errors of tip and axis in rendered frames, and bounds, against the incidence."""
    edges = np.linspace(*INCIDENCE_DEG, 6)

    def draw(axes: Axes, _: str, quantity: str) -> None:
        error, bound = (_QUANTITIES[quantity].format(name) for name in ("error", "bound"))
        for spots, colour in ((1, page.BLUE), (3, page.VERMILION)):
            shown = where(rough, spots=spots, mirrored=False)
            points = shown.incidence_deg, shown[error]
            axes.plot(*points, ls="", marker="x", ms=6, color=colour, label=NAMES[spots])
            own = where(bounds, spots=spots, z_f_mm=rough.z_f_mm.iloc[0])
            bins = pd.cut(own.incidence_deg, edges.tolist(), right=False)
            sizes = own[bound].groupby(bins, observed=False).agg(rms)
            axes.plot(0.5 * (edges[:-1] + edges[1:]), sizes, color=colour, lw=1.6)
            reported = dict(zip(_QUANTITIES, REPORTED[spots], strict=True))[quantity]
            axes.axhline(reported, color=colour, ls=":", lw=1.0)
        axes.set(yscale="log")

    return page.small_multiples(draw, columns=list(_QUANTITIES), x="incidence (°)", height=3.7)


# The page.

_ERRORS, _BOUNDS = "pose_error.csv", "pose_bound.csv"


def _report(errors: pd.DataFrame, bounds: pd.DataFrame) -> page.Report:
    rough = where(errors, prior=ROUGH)
    one, three = page.rows_of(scatter(rough, "spots"))
    by_tool = bounds.groupby(["spots", "z_f_mm"], sort=False)
    return page.Report(
        title="How accurately do one spot and three spots give the tool's pose?",
        answer=f"One rendered spot gives the tip to {number(1e3 * one.tip_mm, 1)} µm and the axis "
        f"to {number(one.axis_deg, 3)}°, three spots give them to "
        f"{number(1e3 * three.tip_mm, 1)} µm and {number(three.axis_deg, 3)}° (root mean square, "
        f"the direction known to {PRIOR_DEG:g}°).",
        lead="Tip and axis, five parameters, of an ideal cone in rendered frames of an even wall. "
        "Three spots are three such cones on one rigid tool, "
        f"their tips {_FIBRE_MM:g} mm apart, splayed by {_SPLAY_DEG:g}° and lit one after the "
        "other; the tool's roll is found with its pose.",
        first=[
            page.Picture(
                "incidence",
                _by_incidence(rough, bounds),
                "A tilted beam tells tip and axis better than a square one. Crosses: rendered "
                f"frames, direction prior {PRIOR_DEG:g}°, without mirrored solutions: a beam that "
                "is tilted the other way explains a single spot almost as well. Lines: the "
                f"Cramér–Rao bound for {NOISE_PX:g} px across each of {_POINTS} points of exact "
                "contours. Dotted: the mean errors reported by Zhou et al. (2023).",
                data=_ERRORS,
            ),
            page.Table(
                by_tool[["tip_bound_mm", "axis_bound_deg"]].agg(rms).reset_index(),
                ["spots", "z_f_mm", "tip_bound_mm", "axis_bound_deg"],
                "The bound, root mean square over a working volume of 10 × 10 × 5 mm.",
                data=_BOUNDS,
            ),
        ],
        claims=list(_claims(errors, rough)),
        sections=[],
        data={_ERRORS: errors, _BOUNDS: bounds},
    )


_ASKED = {"tip": (" mm", "mm", 4, 0.010), "axis": ("°", "deg", 3, 0.1)}
"""Unit, end of a column's name, digits and the required error of each part of a pose."""
_REQUIRED_DISTANCE_MM = 0.005


def _claims(errors: pd.DataFrame, rough: pd.DataFrame) -> Iterator[page.Claim]:
    by_spots = page.rows_of(scatter(rough, "spots").reset_index())
    by_incidence = scatter(where(rough, spots=1), "incidence_deg")
    for n, (part, (unit, end, digits, required)) in enumerate(_ASKED.items()):
        for found in by_spots:
            reported = REPORTED[found.spots][n]
            columns = (f"{part}_{which}{end}" for which in ("mean_", "", "bound_"))
            mean, size, bound = (getattr(found, column) for column in columns)
            yield page.Claim(
                name=f"{NAMES[found.spots]}, {part}",
                sentence=f"The mean error of the {part} is {mean:.{digits}f}{unit} (reported by "
                f"others, with another light, eye and camera: {reported:g}{unit}), root mean "
                f"square {size:.{digits}f}{unit} over {found.poses} poses without mirrored "
                f"ones, the bound {bound:.{digits}f}{unit}.",
                value=mean,
                high=reported,
            )
        single, column = by_spots[0], f"{part}_{end}"
        size = getattr(single, column)
        yield page.Claim(
            name=f"requirement, {part}",
            sentence=f"Single spots give the {part} to {size:.{digits}f}{unit} "
            f"(required: {required:g}{unit}), at incidences of {listed(by_incidence.index, 'g')}° "
            f"to {listed(by_incidence[column], f'.{digits}f')}{unit}. A prior drawn with "
            f"{PRIOR_DEG:g}° led to the mirrored solution in {single.mirrored:.0%} of the frames; "
            f"with these the tip is off by {single.tip_all_mm:.3f} mm.",
            value=size,
            high=required,
        )
    known = where(errors, spots=1, prior=KNOWN)
    worst = float(known.groupby("c_mm").distance_error_mm.agg(rms).max())
    yield page.Claim(
        name="requirement, distance",
        sentence=f"With the axis known the distance is off by {worst:.4f} mm (root mean square) at "
        f"the worst eccentricity up to c = {LARGEST_C_MM:g} mm (required: "
        f"{_REQUIRED_DISTANCE_MM:g} mm), and by {rms(known.distance_error_mm):.4f} mm over all "
        f"{len(known)} frames.",
        value=worst,
        high=_REQUIRED_DISTANCE_MM,
    )


# The command.

VARIED = (
    *STILL,
    *("motion", "spot.eccentricity_mm", "spot.incidence_deg", "spot.incidence_azimuth_deg"),
    *("instrument.gauge", "instrument.fibre_length_mm", "phantom.texture_seed"),
)
"""Keys of the scene that the study sets itself, or that what it sets switches off."""


@command(defaults=("source.kind=cone",), check=check, varies=VARIED)
def pose(study: Study) -> pd.DataFrame:
    """Estimate the tool's tip and axis from one spot and from three, beside their bounds."""
    geometry, least = geometry_of(study.scene), []
    tools = tools_of(geometry.half_angle, geometry.apex_offset)
    with study.timed("bounds"):
        places = volume(count=128, seed=study.seed)
        for height in dict.fromkeys((geometry.pinhole_height, MICROSCOPE_HEIGHT_MM)):
            wall, view = geometry._replace(pinhole_height=height).world
            least += [bounds(tool, places, wall, view) for tool in tools]
    with study.timed("render and measure"):
        c = np.linspace(0.0, LARGEST_C_MM, 2 if study.quick else 6).tolist()
        found = measure(study, tools, eccentricities=c, poses=3 if study.quick else 6)
    study.publish(_report, found, pd.concat(least, ignore_index=True))
    return found
