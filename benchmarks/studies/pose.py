"""`eyespot study pose`: tip and axis of the tool from one spot and from three."""

import math
from collections.abc import Iterator, Sequence
from itertools import chain, product
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
from eyespot.benchmarks.model_error import Geometry
from eyespot.benchmarks.paper import MICROSCOPE_HEIGHT_MM, require_roomy_eyeball
from eyespot.benchmarks.reporting import listed, number, where
from eyespot.benchmarks.statistics import rms
from eyespot.benchmarks.study import Study, geometry_of
from eyespot.benchmarks.study_command import command
from eyespot.calibration.spots import tool_pose
from eyespot.calibration.spots.tool_pose import Tool, ToolPose
from eyespot.estimator import SubpixelSettings, TrackState, measure
from eyespot.formats.microscope import read_microscope
from eyespot.formats.spot import Spot
from eyespot.formats.stack import KINEMATICS, Stack
from eyespot.formats.whole_files import written_whole
from eyespot.scenes import Scene

# The working volume, a pose in it, and how far an estimate is from it.

HALF_WIDTH_MM = 5.0  # O lies in a square around the microscope's axis.
NEAREST_MM, FARTHEST_MM = 0.5, 5.5  # distances from tip to wall along the beam
INCIDENCE_DEG = (10.0, 30.0)
NOISE_PX = 0.05  # standard deviation across the contour of each of 128 points
LARGEST_C_MM = 5.0  # Rendered spots lie within.
PRIOR_DEG = 5.0  # Of the direction across the axis, as for a rough robot calibration.
ROUGH, KNOWN = "5 deg", "axis known"
SIGMA_RAD = {ROUGH: math.radians(PRIOR_DEG), KNOWN: 1e-6}
"""The solver's standard deviation of a prior across the axis, rad."""

_LEAST_MIRRORED_DEG = 2.0  # An axis nearer to the truth is not mirrored.
_FIBRE_MM, _SPLAY_DEG = 0.5, 10.0


def tools_of(half_angle: float, apex_offset: float) -> tuple[Tool, Tool]:
    """A cone (rad, mm) along the tool's axis; and three fibres that touch each other, splayed.

    The tool of Zhou et al. (2023) has three spotlights; more of it is not published.
    """
    cone, circle = (half_angle, apex_offset), _FIBRE_MM / math.sqrt(3.0)
    return Tool(*cone, 1, 0.0, 0.0), Tool(*cone, 3, circle, math.radians(_SPLAY_DEG))


PLACE = ("c_mm", "d_mm", "incidence_deg", "azimuth_deg", "around_deg", "roll_deg")
"""Columns of places; the CSV files have all but O's azimuth and the tool's roll."""


def poses_at(wall: optics.Sphere, places: pd.DataFrame) -> list[ToolPose]:
    """Poses whose axes meet the wall at places; see `optics.beam_at_spot`."""
    found, thin = [], {"half_angle": 0.0, "apex_offset": 0.0}
    for c, d, *degrees in places[[*PLACE]].to_numpy().tolist():
        incidence, towards, azimuth, roll = map(math.radians, degrees)
        at = {"eccentricity": c, "azimuth": azimuth, "distance": d, "incidence": incidence}
        beam = optics.beam_at_spot(wall, **at, incidence_azimuth=towards, **thin)
        found.append(ToolPose(np.asarray(beam.tip), np.asarray(beam.axis), roll))
    return found


def bound_of(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of the tip (mm) and the axis (degrees), in space."""
    variances = np.diagonal(covariance, axis1=-2, axis2=-1)
    tip, axis = (np.sqrt(part.sum(axis=-1)) for part in (variances[..., :3], variances[..., 3:]))
    return tip, np.degrees(axis)


def drawn_prior(axis: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A direction that is off by `PRIOR_DEG` (standard deviation) along each perpendicular."""
    off = np.radians(PRIOR_DEG) * rng.standard_normal(2)
    turned = axis + off @ np.stack(optics.perpendicular_frame(axis))
    return np.asarray(turned / np.linalg.norm(turned))


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
    columns = np.hypot(x, y), d, incidence, azimuth, np.degrees(np.arctan2(y, x)), roll
    return pd.DataFrame(dict(zip(PLACE, columns, strict=True)))


def bounds(tool: Tool, places: pd.DataFrame, geometry: Geometry) -> pd.DataFrame:
    """Rows of pose_bound.csv: Cramér-Rao standard deviations at each place for `NOISE_PX`."""
    wall, view = geometry.world
    poses = ToolPose(*map(np.array, zip(*poses_at(wall, places), strict=True)))
    own = jax.vmap(lambda of: tool_pose.tool_pose_bound(tool, of, wall, view, sigma_px=NOISE_PX))
    tip, axis = bound_of(np.asarray(own(poses)))
    about = {"spots": tool.cones, "z_f_mm": geometry.pinhole_height}
    return places[[*PLACE[:4]]].assign(**about, tip_bound_mm=tip, axis_bound_deg=axis)


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
_mismatch_covariances = jax.jit(jax.vmap(optics.mismatch_covariance))


def places_at(scene: Scene, *, c: float, poses: int) -> pd.DataFrame:
    """Places at one point of the wall, at several distances and incidences."""
    n = np.arange(poses)
    turns, incidence = n * _GOLDEN_DEG, np.resize(_INCIDENCES_DEG, poses)
    d = 1.0 + (_FARTHEST_RENDERED_MM - 1.0) * (n + 0.5) / poses
    columns = c, d, incidence, turns % 360.0, scene.spot.azimuth_deg, turns
    return pd.DataFrame(dict(zip(PLACE, columns, strict=True)))


def rendered(
    study: Study, tools: Sequence[Tool], *, eccentricities: list[float], poses: int
) -> pd.DataFrame:
    """Render, track and solve with each tool, at each eccentricity (mm): pose_error.csv."""
    wall, rng = optics.Sphere(study.scene.phantom.radius_mm), np.random.default_rng([study.seed, 2])
    trials, wanted = {}, {}
    for c in eccentricities:
        name, places = f"c-{c:g}", places_at(study.scene, c=c, poses=poses)
        there = poses_at(wall, places)
        priors = [drawn_prior(np.asarray(pose.axis), rng) for pose in there]
        wanted[name] = [*zip(places[[*PLACE[:4]]].to_dict("records"), there, priors, strict=True)]
        file = study.folder / "poses" / f"{name}.csv"
        write_poses(file, tools, there)
        recorded = {"motion": {"kind": "recorded", "file": str(file)}}
        trials[name] = scenes.changed(study.scene, STILL | recorded | {"spot.eccentricity_mm": c})

    def solve(name: str, stack: Stack) -> list[dict[str, Any]]:
        microscope, settings = read_microscope(stack.folder / "microscope.json"), SubpixelSettings()
        # Single frames, since a tracker rejects the jumps from one frame to the next.
        lit = (measure(image, TrackState(), settings)[0] for image in stack.images("metered"))
        rows = []
        for (place, pose, prior), tool in product(wanted[name], tools):
            seen = [next(lit) for _ in range(tool.cones)]
            found = [result for result in seen if isinstance(result, Spot)]
            if len(found) == tool.cones:
                errors = pose_errors(tool, pose, found, prior=prior, view=microscope.pinhole())
                rows += [{"spots": tool.cones} | place | row for row in errors]
        return rows

    found = pd.DataFrame(chain.from_iterable(study.measured(trials, solve).values()))
    return found.assign(z_f_mm=study.scene.microscope.pinhole_height_mm)


def write_poses(file: Path, tools: Sequence[Tool], poses: list[ToolPose]) -> None:
    """Write one beam a second, at rest while the camera exposes."""
    file.parent.mkdir(exist_ok=True)
    beams = [tool_pose.tool_beams(tool, pose) for pose in poses for tool in tools]
    lit = np.concatenate([np.hstack([beam.tip, beam.axis]) for beam in beams])
    times = np.add.outer(np.arange(len(lit)), [-_HALF_REST_S, _HALF_REST_S]).ravel()
    # The first frame is due at the first row, the last at the last.
    times[[0, -1]] = 0, len(lit) - 1
    rows = pd.DataFrame(np.column_stack([times, lit.repeat(2, axis=0)]), columns=KINEMATICS)
    with written_whole(file, replace=True) as partial:
        rows.to_csv(partial, index=False)


def pose_errors(
    tool: Tool, pose: ToolPose, seen: list[Spot], *, prior: np.ndarray, view: optics.Microscope
) -> Iterator[dict[str, Any]]:
    """Columns of pose_error.csv with each kind of prior, from the same spots.

    Errors are estimate - truth, or lengths and angles between the two. `mirrored`: whether the
    solution has the reversed incidence.
    """
    wall, true_axis = optics.Sphere(-view.pole_height), np.asarray(pose.axis)
    met = wall.intersect(np.asarray(pose.tip), true_axis)
    x, y, *columns = jnp.array([spot.ellipse for spot in seen]).T
    ellipses = optics.Ellipse(jnp.stack([x, y], axis=1), *columns)
    missed = _mismatch_covariances(ellipses, jnp.array([spot.covariance for spot in seen]))
    for kind, sigma_rad in SIGMA_RAD.items():
        expected = jnp.asarray(true_axis if kind == KNOWN else prior)
        beside = optics.DirectionPrior(expected, sigma_rad)
        found, distance = tool_pose.fit_tool(tool, ellipses, np.asarray(missed), wall, view, beside)
        axis = np.asarray(found.axis)
        yield {
            "prior": kind,
            "mirrored": is_mirrored(axis, true_axis, -np.asarray(met.normal)),
            "tip_error_mm": float(np.linalg.norm(np.asarray(found.tip) - np.asarray(pose.tip))),
            "axis_error_deg": angle_deg(axis, true_axis),
            "distance_error_mm": float(distance - met.distance),
        }


# The page.


def scatter(errors: pd.DataFrame, by: str) -> pd.DataFrame:
    """Root mean squares of poses by the values of a column, those of mirrored ones left out."""
    return errors[~errors.mirrored].groupby(by)[["tip_error_mm", "axis_error_deg"]].agg(rms)


_QUANTITIES = {"error of the tip (mm)": "tip_{}_mm", "error of the axis (°)": "axis_{}_deg"}


def _by_incidence(rough: pd.DataFrame, bounds: pd.DataFrame) -> Figure:
    """Errors of tip and axis in rendered frames, and bounds, against the incidence."""
    edges = np.linspace(*INCIDENCE_DEG, 6)

    def draw(axes: Axes, _: str, quantity: str) -> None:
        error, bound = (_QUANTITIES[quantity].format(name) for name in ("error", "bound"))
        for spots, colour in ((1, page.BLUE), (3, page.VERMILION)):
            shown = where(rough, spots=spots, mirrored=False)
            axes.plot(shown.incidence_deg, shown[error], "x", c=colour, label=f"spots: {spots}")
            own = where(bounds, spots=spots, z_f_mm=rough.z_f_mm.iloc[0])
            bins = pd.cut(own.incidence_deg, edges.tolist(), right=False)
            sizes = own[bound].groupby(bins, observed=False).agg(rms)
            axes.plot(0.5 * (edges[:-1] + edges[1:]), sizes, color=colour, lw=1.6)
        axes.set(yscale="log")

    return page.small_multiples(draw, columns=list(_QUANTITIES), x="incidence (°)", height=3.7)


def _report(errors: pd.DataFrame, bounds: pd.DataFrame) -> page.Report:
    rough = where(errors, prior=ROUGH)
    one, three = page.rows_of(scatter(rough, "spots"))
    by_tool = bounds.groupby(["spots", "z_f_mm"], sort=False)
    return page.Report(
        title="How accurately do one spot and three spots give the tool's pose?",
        answer=f"One rendered spot gives the tip to {number(1e3 * one.tip_error_mm, 1)} µm and the "
        f"axis to {number(one.axis_error_deg, 3)}°, three spots give them to "
        f"{number(1e3 * three.tip_error_mm, 1)} µm and {number(three.axis_error_deg, 3)}° (root "
        f"mean square, the direction known to {PRIOR_DEG:g}°).",
        lead="Tip and axis, five parameters, of an ideal cone in rendered frames of an even wall. "
        f"Three spots are three such cones on one rigid tool, their tips {_FIBRE_MM:g} mm apart, "
        f"splayed by {_SPLAY_DEG:g}° and lit one after the other. Zhou et al. (Robotica 2023) "
        "report mean errors of 0.029 mm and 0.124° for one spot, 0.025 mm and 0.101° for three, "
        "rendered in Blender with another light and eye.",
        first=[
            page.Picture(
                "incidence",
                _by_incidence(rough, bounds),
                "A tilted beam tells tip and axis better than a square one. Crosses: rendered "
                f"frames, direction prior {PRIOR_DEG:g}°, without mirrored solutions: a beam that "
                "is tilted the other way explains a single spot almost as well. Lines: the "
                f"Cramér–Rao bound for {NOISE_PX:g} px across each of 128 points of a contour.",
                data="pose_error.csv",
            ),
            page.Table(
                by_tool[["tip_bound_mm", "axis_bound_deg"]].agg(rms).reset_index(),
                ["spots", "z_f_mm", "tip_bound_mm", "axis_bound_deg"],
                "The bound, root mean square over a working volume of 10 × 10 × 5 mm.",
                data="pose_bound.csv",
            ),
        ],
        claims=list(_claims(errors)),
        data={"pose_error.csv": errors, "pose_bound.csv": bounds},
    )


_REQUIRED = {"tip_error_mm": 0.010, "axis_error_deg": 0.1, "distance_error_mm": 0.005}


def _claims(errors: pd.DataFrame) -> Iterator[page.Claim]:
    single, known = (where(errors, spots=1, prior=prior) for prior in (ROUGH, KNOWN))
    sizes, at = scatter(single, "spots").iloc[0], scatter(single, "incidence_deg")
    for column, unit, digits in (("tip_error_mm", " mm", 4), ("axis_error_deg", "°", 3)):
        part = column.partition("_")[0]
        yield page.Claim(
            name=f"requirement, {part}",
            sentence=f"Single spots give the {part} to {sizes[column]:.{digits}f}{unit} "
            f"(required: {_REQUIRED[column]:g}{unit}), at incidences of {listed(at.index, 'g')}° "
            f"to {listed(at[column], f'.{digits}f')}{unit}. The {single.mirrored.mean():.0%} "
            "mirrored solutions do not count.",
            value=sizes[column],
            high=_REQUIRED[column],
        )
    column = "distance_error_mm"
    worst = float(known.groupby("c_mm")[column].agg(rms).max())
    yield page.Claim(
        name="requirement, distance",
        sentence=f"With the axis known the distance is off by {worst:.4f} mm at the worst c up to "
        f"{LARGEST_C_MM:g} mm (required: {_REQUIRED[column]:g} mm), and by "
        f"{rms(known[column]):.4f} mm over all {len(known)} frames (root mean squares).",
        value=worst,
        high=_REQUIRED[column],
    )


# The command.


def check(scene: Scene) -> None:
    """Refuse a scene whose spots have no pose in the working volume."""
    reach = math.sqrt(2) * HALF_WIDTH_MM
    require_roomy_eyeball(scene, f"spots reach {reach:.1f} mm from the axis")
    Study.demand(scene, {"source.kind": "cone"}, "poses are computed from a spot's sharp edge")


VARIED = (  # Keys that the study sets itself, or that these switch off.
    *STILL,
    *("motion", "spot.eccentricity_mm", "spot.incidence_deg", "spot.incidence_azimuth_deg"),
    *("instrument.gauge", "instrument.fibre_length_mm", "phantom.texture_seed"),
)


@command(defaults=("source.kind=cone",), check=check, varies=VARIED)
def pose(study: Study) -> pd.DataFrame:
    """Estimate the tool's tip and axis from one spot and from three, beside their bounds."""
    geometry = geometry_of(study.scene)
    tools = tools_of(geometry.half_angle, geometry.apex_offset)
    with study.timed("bounds"):
        places = volume(count=128, seed=study.seed)
        heights = dict.fromkeys((geometry.pinhole_height, MICROSCOPE_HEIGHT_MM))
        eyes = [geometry._replace(pinhole_height=height) for height in heights]
        least = [bounds(tool, places, own) for own in eyes for tool in tools]
    with study.timed("render and measure"):
        c = np.linspace(0.0, LARGEST_C_MM, 2 if study.quick else 6).tolist()
        found = rendered(study, tools, eccentricities=c, poses=3 if study.quick else 6)
    study.publish(_report, found, pd.concat(least, ignore_index=True))
    return found
