"""`eyespot study pose`: tip and axis of the tool from one spot and from three."""

import math
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

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
from eyespot.benchmarks.study import Study
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
from eyespot.scenes.world.world import World

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


class AxisPrior(StrEnum):
    """Prior knowledge of the axis."""

    ROUGH = "5 deg"
    NONE = "none"
    KNOWN = "axis known"


SIGMA_RAD = {AxisPrior.ROUGH: math.radians(PRIOR_DEG), AxisPrior.NONE: 1e6, AxisPrior.KNOWN: 1e-6}
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


class Place(NamedTuple):
    """A pose of the working volume, the wall's normal where its axis meets it, and `where` that is.

    `where` has the columns c_mm, d_mm, incidence_deg and azimuth_deg of pose_error.csv.
    """

    pose: ToolPose
    outward: np.ndarray
    where: dict[str, float]


def place_at(
    wall: optics.Sphere,
    *,
    c: float,
    around_deg: float,
    d: float,
    incidence_deg: float,
    azimuth_deg: float,
    roll: float = 0.0,
) -> Place:
    """The pose whose axis meets the wall there; arguments as of `optics.beam_at_spot`."""
    beam = optics.beam_at_spot(
        wall,
        eccentricity=c,
        azimuth=math.radians(around_deg),
        distance=d,
        incidence=math.radians(incidence_deg),
        incidence_azimuth=math.radians(azimuth_deg),
        half_angle=0.0,
        apex_offset=0.0,
    )
    tip, axis = np.asarray(beam.tip), np.asarray(beam.axis)
    outward = (tip + d * axis) / float(wall.radius)
    at = {"c_mm": c, "d_mm": d, "incidence_deg": incidence_deg, "azimuth_deg": azimuth_deg}
    return Place(ToolPose(tip, axis, roll), outward, at)


Estimate = tuple[Any, Any, float, float]
"""An estimated pose: tip (3,), mm, axis (3,), distance and the distance's own sigma, mm."""


def pose_error(
    place: Place, found: Estimate, *, covariance: np.ndarray, noise_px: float, **about: Any
) -> dict[str, Any]:
    """Row of pose_error.csv; errors are estimate - truth, or lengths and angles between the two.

    `mirrored`: whether the solution has the reversed incidence. The bounds, of tip and axis or of
    the tip only, are the Cramér-Rao standard deviations for the noise of the contour's points.
    `sigma_distance_mm` is what the estimator states. `about` has the first columns.
    """
    tip, axis, distance, sigma_distance = map(np.asarray, found)
    true = np.asarray(place.pose.axis)
    return {
        **about,
        **place.where,
        "noise_px": noise_px,
        "mirrored": is_mirrored(axis, true, place.outward),
        "tip_error_mm": float(np.linalg.norm(tip - np.asarray(place.pose.tip))),
        "axis_error_deg": angle_deg(axis, true),
        "distance_error_mm": float(distance - place.where["d_mm"]),
        "tip_bound_mm": tip_bound(covariance),
        "axis_bound_deg": axis_bound_deg(covariance),
        "sigma_distance_mm": float(sigma_distance),
    }


def tip_bound(covariance: np.ndarray) -> float:
    """Standard deviation of the tip in three dimensions, mm."""
    return float(np.sqrt(np.trace(covariance[:3, :3])))


def axis_bound_deg(covariance: np.ndarray) -> float:
    """Standard deviation of the axis, both perpendiculars together; 0 if the axis is known."""
    return math.degrees(np.sqrt(np.trace(covariance[3:, 3:])))


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


def places(wall: optics.Sphere, *, count: int, seed: int) -> list[Place]:
    """Poses that fill the working volume evenly: scrambled Sobol points."""
    engine, half = qmc.Sobol(d=6, scramble=True, rng=np.random.default_rng(seed)), HALF_WIDTH_MM
    low = [-half, -half, NEAREST_MM, INCIDENCE_DEG[0], 0.0, 0.0]
    high = [half, half, FARTHEST_MM, INCIDENCE_DEG[1], 360.0, 360.0]
    return [
        place_at(
            wall,
            c=math.hypot(x, y),
            around_deg=math.degrees(math.atan2(y, x)),
            d=d,
            incidence_deg=incidence,
            azimuth_deg=azimuth,
            roll=math.radians(roll),
        )
        for x, y, d, incidence, azimuth, roll in qmc.scale(engine.random(count), low, high)
    ]


def bounds(
    tool: Tool, every: list[Place], wall: optics.Sphere, view: optics.Microscope
) -> pd.DataFrame:
    """Rows of pose_bound.csv: Cramér-Rao standard deviations at each place for `NOISE_PX`."""
    poses = ToolPose(*map(np.array, zip(*(place.pose for place in every), strict=True)))
    of_each = jax.vmap(lambda pose: tool_pose_bound(tool, pose, wall, view, sigma_px=NOISE_PX))
    covariances = [*np.asarray(of_each(poses))]
    about = {"spots": tool.cones, "z_f_mm": float(view.pinhole_height)}
    return pd.DataFrame([place.where for place in every]).assign(
        **about,
        tip_bound_mm=[*map(tip_bound, covariances)],
        axis_bound_deg=[*map(axis_bound_deg, covariances)],
    )


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


def places_at(scene: Scene, *, c: float, poses: int) -> list[Place]:
    """Poses with their axis through one point of the wall, at several distances and incidences."""
    return [
        place_at(
            optics.Sphere(scene.phantom.radius_mm),
            c=c,
            around_deg=scene.spot.azimuth_deg,
            d=1.0 + (_FARTHEST_RENDERED_MM - 1.0) * (i + 0.5) / poses,
            incidence_deg=_INCIDENCES_DEG[i % len(_INCIDENCES_DEG)],
            azimuth_deg=(i * _GOLDEN_DEG) % 360.0,
            roll=i * math.radians(_GOLDEN_DEG),
        )
        for i in range(poses)
    ]


def measure(study: Study, *, eccentricities: list[float], poses: int) -> list[dict[str, Any]]:
    """Render, track and solve with one spot and with three, at each eccentricity (mm)."""
    tools = tools_of(*World(study.scene).cone)
    trials, every = {}, {}
    for c in eccentricities:
        name = f"c-{c:g}"
        every[name] = places_at(study.scene, c=c, poses=poses)
        file = study.folder / "poses" / f"{name}.csv"
        write_poses(file, tools, every[name])
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
        for place in every[name]:
            of_tool = {tool: [next(lit) for _ in range(tool.cones)] for tool in tools}
            prior = drawn_prior(np.asarray(place.pose.axis), rng)
            for tool, seen in of_tool.items():
                found = [result for result in seen if isinstance(result, Spot)]
                if len(found) == tool.cones:
                    rows += _errors(tool, place, found, prior, ranger)
    return rows


def write_poses(file: Path, tools: tuple[Tool, ...], every: list[Place]) -> None:
    """Write one beam a second, at rest while the camera exposes."""
    file.parent.mkdir(exist_ok=True)
    beams = [tool_beams(tool, place.pose) for place in every for tool in tools]
    lit = np.concatenate([np.hstack([beam.tip, beam.axis]) for beam in beams]).tolist()
    # The first frame is due at the first row, the last at the last.
    rows = [
        (time, *pose)
        for i, pose in enumerate(lit)
        for time in (i - _HALF_REST_S * (i > 0), i + _HALF_REST_S * (i < len(lit) - 1))
    ]
    columns = "time_s x_mm y_mm z_mm axis_x axis_y axis_z".split()
    with written_whole(file, replace=True) as partial:
        pd.DataFrame(rows, columns=columns).to_csv(partial, index=False)


def _errors(
    tool: Tool, place: Place, seen: list[Spot], prior: np.ndarray, ranger: Ranger
) -> list[dict[str, Any]]:
    """Errors with each kind of prior, all from the same spots."""
    microscope = ranger.microscope
    surface, view = optics.Sphere(microscope.eye_radius_mm), microscope.pinhole()
    # The noise of each of n = 128 points that gives a circle's semi-axis this standard error. The
    # semi-axis is the sum of two independent terms of the radius, of 1 and of cos 2t, whose
    # variances are 1/n and 2/n of the noise's.
    sigma = float(np.mean([spot.sigma_semi_minor_px for spot in seen])) * math.sqrt(_POINTS / 3)
    true, rows = np.asarray(place.pose.axis), []
    found: Estimate
    for kind, sigma_rad in SIGMA_RAD.items():
        known = kind == AxisPrior.KNOWN
        axis = true if known else prior
        covariance = np.asarray(
            tool_pose_bound(tool, place.pose, surface, view, sigma_px=sigma, axis_known=known)
        )
        # With a fixed axis the ranger may end with the cone's apex on the wall; see `fit_tool`.
        if tool.cones == 1 and not known:
            alone = ranger.distance(seen[0], axis=axis, axis_sigma_rad=sigma_rad)
            pose = alone.poses[0]
            found = pose.tip_mm, pose.axis, alone.distance_mm, alone.sigma_mm
        else:
            x, y, *columns = jnp.array([spot.ellipse for spot in seen]).T
            ellipses = optics.Ellipse(jnp.stack([x, y], axis=1), *columns)
            spread = jnp.stack([jnp.asarray(spot.covariance) for spot in seen])
            missed = np.asarray(_mismatch_covariances(ellipses, spread))
            beside = optics.DirectionPrior(jnp.asarray(axis), sigma_rad)
            best, distance = fit_tool(tool, ellipses, missed, surface, view, beside)
            found = best.tip, best.axis, distance, math.nan
        height = microscope.pinhole_height_mm
        about = {"spots": tool.cones, "prior": kind, "z_f_mm": height}
        rows.append(pose_error(place, found, noise_px=sigma, covariance=covariance, **about))
    return rows


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


def scatter(rows: pd.DataFrame) -> pd.Series:
    """Root mean squares and means of poses; their number of spots and prior are those of the first.

    The errors of tip and axis exclude mirrored solutions; `tip_all_mm` and `distance_mm` include
    them.
    """
    right = rows[~rows.mirrored]
    return pd.Series(
        {
            **rows.iloc[0][["prior", "spots"]],
            "poses": len(rows),
            "mirrored": 1.0 - len(right) / len(rows),
            "tip_mm": rms(right.tip_error_mm),
            "tip_mean_mm": right.tip_error_mm.mean(),
            "tip_bound_mm": rms(right.tip_bound_mm),
            "tip_all_mm": rms(rows.tip_error_mm),
            "axis_deg": rms(right.axis_error_deg),
            "axis_mean_deg": right.axis_error_deg.mean(),
            "axis_bound_deg": rms(right.axis_bound_deg),
            "distance_mm": rms(rows.distance_error_mm),
            "sigma_distance_mm": rms(rows.sigma_distance_mm),
        }
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
    by_prior = errors.groupby(["prior", "spots"], sort=False)
    scatters = pd.DataFrame([scatter(rows) for _, rows in by_prior])
    rough = where(errors, prior=AxisPrior.ROUGH)
    one, three = (scatter(where(rough, spots=spots)) for spots in REPORTED)
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
                f"frames, direction prior {PRIOR_DEG:g}°, without mirrored solutions. Lines: the "
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
        sections=[
            page.Section(
                "The mirror solution",
                page.Table(
                    scatters,
                    scatters.columns,
                    "Root mean square errors with every prior: how often the mirrored solution is "
                    "taken, and the tip's error without and with it.",
                    data=_ERRORS,
                ),
                "A beam that is tilted the other way explains a spot almost as well, at the same "
                "distance but with another tip: for one spot only the contour's deviation from an "
                "ellipse differs, which an estimator that reports ellipses does not measure. The "
                "positions of three splayed spots distinguish the two.",
            ),
        ],
        data={_ERRORS: errors, _BOUNDS: bounds},
    )


_ASKED = {"tip": (" mm", "mm", 4, 0.010), "axis": ("°", "deg", 3, 0.1)}
"""Unit, end of a column's name, digits and the required error of each part of a pose."""
_REQUIRED_DISTANCE_MM = 0.005


def _claims(errors: pd.DataFrame, rough: pd.DataFrame) -> Iterator[page.Claim]:
    single = where(rough, spots=1)
    each = pd.DataFrame({deg: scatter(rows) for deg, rows in single.groupby("incidence_deg")}).T
    for n, (part, (unit, end, digits, required)) in enumerate(_ASKED.items()):
        for spots, reported in REPORTED.items():
            found = scatter(where(rough, spots=spots))
            mean, size, bound = found[[f"{part}_{x}{end}" for x in ("mean_", "", "bound_")]]
            yield page.Claim(
                name=f"{NAMES[spots]}, {part}",
                sentence=f"The mean error of the {part} is {mean:.{digits}f}{unit} (reported by "
                f"others, with another light, eye and camera: {reported[n]:g}{unit}), root mean "
                f"square {size:.{digits}f}{unit} over {found.poses} poses without mirrored ones, "
                f"the bound {bound:.{digits}f}{unit}.",
                value=mean,
                high=reported[n],
            )
        found = scatter(single)
        size, by_incidence = found[f"{part}_{end}"], listed(each[f"{part}_{end}"], f".{digits}f")
        yield page.Claim(
            name=f"requirement, {part}",
            sentence=f"Single spots give the {part} to {size:.{digits}f}{unit} (required: "
            f"{required:g}{unit}), at incidences of {listed(each.index, 'g')}° to "
            f"{by_incidence}{unit}. A prior drawn with {PRIOR_DEG:g}° led to the mirrored solution "
            f"in {found.mirrored:.0%} of the frames; with these the tip is off by "
            f"{found.tip_all_mm:.3f} mm.",
            value=size,
            high=required,
        )
    known = where(errors, spots=1, prior=AxisPrior.KNOWN)
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
    wall, least = optics.Sphere(study.scene.phantom.radius_mm), []
    with study.timed("bounds"):
        own, every = study.scene.microscope, places(wall, count=128, seed=study.seed)
        for height in dict.fromkeys((own.pinhole_height_mm, MICROSCOPE_HEIGHT_MM)):
            view = optics.microscope(
                scale=own.scale_mm_px, pinhole_height=height, eye_radius=wall.radius
            )
            tools = tools_of(*World(study.scene).cone)
            least += [bounds(tool, every, wall, view) for tool in tools]
    with study.timed("render and measure"):
        c = np.linspace(0.0, LARGEST_C_MM, 2 if study.quick else 6).tolist()
        rows = measure(study, eccentricities=c, poses=3 if study.quick else 6)
    found = pd.DataFrame(rows)
    study.publish(_report, found, pd.concat(least, ignore_index=True))
    return found
