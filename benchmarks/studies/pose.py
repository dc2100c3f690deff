"""`eyespot study pose`: tip and axis of the tool from one spot and from three."""

import math
from collections.abc import Callable, Iterator
from enum import StrEnum
from itertools import product
from operator import itemgetter
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
from eyespot.benchmarks.paper import MICROSCOPE_MM, require_roomy_eyeball, write_results
from eyespot.benchmarks.reporting import listed, number, where
from eyespot.benchmarks.statistics import rms
from eyespot.benchmarks.study import Study, command
from eyespot.calibration.spots.tool_pose import (
    Tool,
    ToolPose,
    contour_mismatch_covariance,
    contour_normals,
    fit_tool,
    tool_beams,
    tool_contours,
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

_MIRRORED_DEG = 2.0  # an axis that is nearer to the truth than this is not mirrored
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
    return off > _MIRRORED_DEG and angle_deg(found, mirror) < off


# The analytic part: exact contours with noise, over the working volume.


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


def errors(
    tool: Tool, every: list[Place], wall: optics.Sphere, view: optics.Microscope, *, seed: int
) -> list[dict[str, Any]]:
    """Rows of pose_error.csv from a noisy contour at each place, with each kind of prior.

    One spot is solved by `optics.pose_from_contour`, several by `fit_tool` from the
    ellipses of the same noisy contours.
    """
    rng = np.random.default_rng([seed, tool.cones])
    poses = ToolPose(*map(np.array, zip(*(place.pose for place in every), strict=True)))

    def of_each(function: Callable[..., jax.Array], **how: Any) -> np.ndarray:
        return np.asarray(jax.vmap(lambda pose: function(tool, pose, wall, view, **how))(poses))

    clean, bounds = of_each(tool_contours), of_each(tool_pose_bound, sigma_px=NOISE_PX)
    known = of_each(tool_pose_bound, sigma_px=NOISE_PX, axis_known=True)
    noise = NOISE_PX * rng.standard_normal(clean.shape[:-1])
    noisy = clean + noise[..., None] * np.asarray(contour_normals(clean))
    truth = np.asarray(poses.axis)
    drawn = np.stack([drawn_prior(axis, rng) for axis in truth])
    height, rows = float(view.pinhole_height), []
    if tool.cones > 1:
        ellipses, spreads = _ellipses(noisy)
    for prior, sigma in SIGMA_RAD.items():
        axes, covariances = (truth, known) if prior == AxisPrior.KNOWN else (drawn, bounds)
        if tool.cones == 1:
            cone = tool.half_angle, tool.apex_offset
            best = _one_by_contour(noisy[:, 0], axes, np.asarray(sigma), wall, view, *cone)
            columns = best.tip, best.axis, best.distance, best.distance_error
            found: list[Estimate] = list(zip(*map(np.asarray, columns), strict=True))
        else:
            found = []
            for i, axis in enumerate(axes):
                seen, spread = jax.tree.map(itemgetter(i), ellipses), np.asarray(spreads[i])
                beside = optics.DirectionPrior(jnp.asarray(axis), sigma)
                pose, distance = fit_tool(tool, seen, spread, wall, view, beside)
                found.append((pose.tip, pose.axis, distance, math.nan))
        about = {"source": "analytic", "spots": tool.cones, "prior": prior, "z_f_mm": height}
        rows += [
            pose_error(place, one, covariance=bound, noise_px=NOISE_PX, **about)
            for place, one, bound in zip(every, found, covariances, strict=True)
        ]
    return rows


@jax.jit
def _one_by_contour(
    noisy: Any, axes: Any, sigma: Any, wall: Any, view: Any, half_angle: Any, b: Any
) -> optics.BeamPose:
    def one(contour: Any, axis: Any) -> optics.BeamPose:
        return optics.pose_from_contour(
            contour,
            wall,
            view,
            half_angle=half_angle,
            apex_offset=b,
            sigma_px=NOISE_PX,
            prior=optics.DirectionPrior(axis, sigma),
        ).best

    return jax.vmap(one)(noisy, axes)


@jax.jit
def _ellipses(noisy: Any) -> tuple[optics.Ellipse, Any]:
    ellipses = optics.ellipse_of_contour(noisy)
    of = jax.vmap(jax.vmap(lambda c, e: contour_mismatch_covariance(c, e, NOISE_PX)))
    return ellipses, of(noisy, ellipses)


# The rendered part: frames of an even wall, spots by the estimator, poses by its exact model.

STILL = {
    "phantom.wall": "uniform",
    "instrument.visible": False,
    "exposures.kinds": ["metered"],
    "microscope.width_px": 800,  # three spots need more room than one
    "microscope.height_px": 720,
    "clocks.camera_hz": 1.0,  # a frame a second, in which the tool stands still
}
_REST_S = 0.45  # time at rest before and after the middle of an exposure
_INCIDENCES_DEG = (10.0, 20.0, 30.0)
_FAR_MM = 4.0  # farther, splayed spots leave the window
_GOLDEN_DEG = 180.0 * (3.0 - math.sqrt(5.0))  # the golden angle: azimuths never repeat
_POINTS = 128


def places_at(scene: Scene, *, c: float, poses: int) -> list[Place]:
    """Poses with their axis through one point of the wall, at several distances and incidences."""
    return [
        place_at(
            optics.Sphere(scene.phantom.radius_mm),
            c=c,
            around_deg=scene.spot.azimuth_deg,
            d=1.0 + (_FAR_MM - 1.0) * (i + 0.5) / poses,
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
        write_results(study.spots_file(name), stack.labels, found, mode="subpixel")
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
        for time in (i - _REST_S * (i > 0), i + _REST_S * (i < len(lit) - 1))
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
            beside, own = optics.DirectionPrior(jnp.asarray(axis), sigma_rad), math.nan
            best, distance = fit_tool(tool, ellipses, missed, surface, view, beside)
            if known:
                # A shift of the tip along the wall does not change the distance, to first order.
                per_mm = place.outward / float(place.outward @ true)
                own = math.sqrt(per_mm @ covariance @ per_mm)
            found = best.tip, best.axis, distance, own
        height = microscope.pinhole_height_mm
        about = {"source": "rendered", "spots": tool.cones, "prior": kind, "z_f_mm": height}
        rows.append(pose_error(place, found, noise_px=sigma, covariance=covariance, **about))
    return rows


_mismatch_covariances = jax.jit(jax.vmap(optics.mismatch_covariance))


NAMES = {1: "one spot", 3: "three spots"}
REQUIRED_TIP_MM, REQUIRED_AXIS_DEG, REQUIRED_DISTANCE_MM = 0.010, 0.1, 0.005


def check(scene: Scene) -> None:
    """Refuse a scene whose spots have no pose in the working volume."""
    reach = np.sqrt(2) * HALF_WIDTH_MM
    require_roomy_eyeball(scene, f"spots reach {reach:.1f} mm from the axis")
    Study.demand(
        scene, {"source.kind": "cone"}, "the study computes poses from a spot's sharp edge"
    )


# Summaries.


def scatter(rows: pd.DataFrame) -> pd.Series:
    """Root mean squares and means; rows that share a source, number of spots and prior.

    The errors of tip and axis exclude mirrored solutions; `tip_all_mm` and `distance_mm` include
    them.
    """
    right = rows[~rows.mirrored]
    first = rows.iloc[0]
    return pd.Series(
        {
            **first[["source", "spots", "prior"]],
            "z_f_mm": first.z_f_mm,
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

_MARKS: dict[str, dict[str, Any]] = {
    "analytic": {"marker": ".", "ms": 4, "alpha": 0.45},
    "rendered": {"marker": "x", "ms": 6},
}
_QUANTITIES = {"error of the tip (mm)": "tip_{}_mm", "error of the axis (°)": "axis_{}_deg"}


def _by_incidence(rough: pd.DataFrame) -> Figure:
    """Errors of tip and axis against the incidence, for the first row's pinhole."""
    height = rough.z_f_mm.iloc[0]
    edges = np.linspace(*INCIDENCE_DEG, 6)

    def draw(axes: Axes, _: str, quantity: str) -> None:
        error, bound = (_QUANTITIES[quantity].format(name) for name in ("error", "bound"))
        for spots, colour in ((1, page.BLUE), (3, page.VERMILION)):
            for source, marks in _MARKS.items():
                rows = where(rough, source=source, spots=spots)
                shown = rows[~rows.mirrored & (rows.z_f_mm == height)]
                points = shown.incidence_deg, shown[error]
                axes.plot(*points, ls="", color=colour, label=f"{NAMES[spots]}, {source}", **marks)
            rows = where(rough, source="analytic", spots=spots)
            bins = pd.cut(rows.incidence_deg, edges.tolist(), right=False)
            bounds = rows[bound].groupby(bins, observed=False).agg(rms)
            axes.plot(0.5 * (edges[:-1] + edges[1:]), bounds, color=colour, lw=1.6)
            reported = dict(zip(_QUANTITIES, REPORTED[spots], strict=True))[quantity]
            axes.axhline(reported, color=colour, ls=":", lw=1.0)
        axes.set(yscale="log")

    return page.small_multiples(draw, columns=list(_QUANTITIES), x="incidence (°)", height=3.7)


# The page.

_FILE = "pose_error.csv"


def _report(errors: pd.DataFrame) -> page.Report:
    keys = ["prior", "source", "spots", "z_f_mm"]
    # A summary by prior, source, number of spots and pinhole.
    scatters = pd.DataFrame([scatter(rows) for _, rows in errors.groupby(keys, sort=False)])
    rough = where(errors, prior=AxisPrior.ROUGH)
    one, three = (scatter(where(rough, source="rendered", spots=spots)) for spots in REPORTED)
    return page.Report(
        title="How accurately do one spot and three spots give the tool's pose?",
        answer=f"One rendered spot gives the tip to {number(1e3 * one.tip_mm, 1)} µm and the axis "
        f"to {number(one.axis_deg, 3)}°, three spots give them to "
        f"{number(1e3 * three.tip_mm, 1)} µm and {number(three.axis_deg, 3)}° (root mean square, "
        f"the direction known to {PRIOR_DEG:g}°).",
        lead="Tip and axis, five parameters, of an ideal cone: from exact contours with noise of "
        f"{NOISE_PX:g} px across each of 128 points over a working volume of 10 × 10 × 5 mm, and "
        "from rendered frames of an even wall. Three spots are three such cones on one rigid tool, "
        f"their tips {_FIBRE_MM:g} mm apart, splayed by {_SPLAY_DEG:g}° and lit one after the "
        "other; the tool's roll is found with its pose.",
        first=[
            page.Picture(
                "incidence",
                _by_incidence(rough),
                "A tilted beam tells tip and axis better than a square one. Dots: contours with "
                f"noise of {NOISE_PX:g} px. Crosses: rendered frames. Lines: root mean square of "
                f"the Cramér–Rao bound. Direction prior {PRIOR_DEG:g}°, without mirrored "
                "solutions. Dotted: the mean errors reported by Zhou et al. (2023).",
                data=_FILE,
            ),
            page.Table(
                where(scatters, prior=AxisPrior.ROUGH),
                "source spots z_f_mm tip_mm tip_bound_mm axis_deg axis_bound_deg".split(),
                "Root mean square errors and bounds, without mirrored solutions.",
                data=_FILE,
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
                    data=_FILE,
                ),
                "A beam that is tilted the other way explains a spot almost as well, at the same "
                "distance but with another tip. For one spot the two differ only in the contour's "
                "deviation from an ellipse. This deviation decreases with the incidence, and an "
                "estimator that reports ellipses does not measure it. For three splayed spots "
                "their positions distinguish the two solutions.",
            ),
        ],
        data={_FILE: errors},
    )


def _claims(errors: pd.DataFrame, rough: pd.DataFrame) -> Iterator[page.Claim]:
    for source, (spots, (tip, axis)) in product(("analytic", "rendered"), REPORTED.items()):
        found = scatter(where(rough, source=source, spots=spots))
        yield page.Claim(
            name=f"{source}, {NAMES[spots]}, tip",
            sentence=f"The mean error of the tip is {found.tip_mean_mm:.4f} mm (reported by "
            f"others, with another light, eye and camera: {tip:g} mm). Root mean square "
            f"{found.tip_mm:.4f} mm over {found.poses} poses without mirrored ones; the bound is "
            f"{found.tip_bound_mm:.4f} mm.",
            value=found.tip_mean_mm,
            high=tip,
        )
        yield page.Claim(
            name=f"{source}, {NAMES[spots]}, axis",
            sentence=f"The mean error of the axis is {found.axis_mean_deg:.3f}° (reported by "
            f"others: {axis:g}°). Root mean square {found.axis_deg:.3f}°; the bound is "
            f"{found.axis_bound_deg:.3f}°.",
            value=found.axis_mean_deg,
            high=axis,
        )
    single = where(rough, source="rendered", spots=1)
    found = scatter(single)
    each = pd.DataFrame({deg: scatter(rows) for deg, rows in single.groupby("incidence_deg")}).T
    at = listed(each.index, "g")
    yield page.Claim(
        name="requirement, tip",
        sentence=f"Single rendered spots give the tip to {found.tip_mm:.4f} mm (required: "
        f"{REQUIRED_TIP_MM:g} mm), root mean square of {found.poses} frames without mirrored ones. "
        f"At incidences of {at}° it is {listed(each.tip_mm, '.4f')} mm. In {found.mirrored:.0%} of "
        f"the frames a prior drawn with {PRIOR_DEG:g}° led to the mirrored solution; with these "
        f"the tip is off by {found.tip_all_mm:.3f} mm.",
        value=found.tip_mm,
        high=REQUIRED_TIP_MM,
    )
    yield page.Claim(
        name="requirement, axis",
        sentence=f"Single rendered spots give the axis to {found.axis_deg:.3f}° (required: "
        f"{REQUIRED_AXIS_DEG:g}°). At incidences of {at}° it is {listed(each.axis_deg, '.3f')}°, "
        f"with bounds of {listed(each.axis_bound_deg, '.3f')}°.",
        value=found.axis_deg,
        high=REQUIRED_AXIS_DEG,
    )
    known = where(errors, source="rendered", spots=1, prior=AxisPrior.KNOWN)
    worst = float(known.groupby("c_mm").distance_error_mm.agg(rms).max())
    yield page.Claim(
        name="requirement, distance",
        sentence=f"With the axis known the distance is off by {worst:.4f} mm (root mean square) at "
        f"the worst eccentricity up to c = {LARGEST_C_MM:g} mm (required: "
        f"{REQUIRED_DISTANCE_MM:g} mm), and by {rms(known.distance_error_mm):.4f} mm over all "
        f"{len(known)} rendered frames.",
        value=worst,
        high=REQUIRED_DISTANCE_MM,
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
    wall, rows = optics.Sphere(study.scene.phantom.radius_mm), []
    with study.timed("noise on exact contours"):
        own, tools = study.scene.microscope, tools_of(*World(study.scene).cone)
        for height in dict.fromkeys((own.pinhole_height_mm, MICROSCOPE_MM)):
            view = optics.microscope(
                scale=own.scale_mm_px, pinhole_height=height, eye_radius=wall.radius
            )
            for tool, count in zip(tools, (64, 32) if study.quick else (1024, 128), strict=True):
                every = places(wall, count=count, seed=study.seed)
                rows += errors(tool, every, wall, view, seed=study.seed)
    with study.timed("render and measure"):
        c = np.linspace(0.0, LARGEST_C_MM, 2 if study.quick else 6).tolist()
        rows += measure(study, eccentricities=c, poses=3 if study.quick else 6)
    found = pd.DataFrame(rows)
    study.publish(_report, found)
    return found
