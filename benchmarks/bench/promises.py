"""Do 95 % intervals contain the truth in 95 % of rigs? Simulation-based calibration.

Every rig is drawn: what its file states to a tolerance is off by a draw from that tolerance. Its
withdrawal is fitted as `eyespot fit` does, and one spot is read as `eyespot track` does, with the
same microscope or with another, on a sphere or in a living eye: an ellipsoid that leans and lies
aside, with a clear layer whose surface is read. One withdrawal in five begins anywhere, and rests
on the core's radius. The rank of the truth in the stated distribution is then uniform (Talts et al.
2018). Spots are drawn as ellipses of the exact geometry with noise.
"""

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float
from scipy import stats
from scipy.spatial.transform import Rotation

import eyespot
from eyespot import optics
from eyespot.calibration.spots.cone_trials import LEAN_SIGMA, phantom_wall
from eyespot.estimator.distance.budget import Budgets
from eyespot.estimator.distance.ranger import Ranger
from eyespot.estimator.distance.withdrawal import BORESIGHT_SIGMA
from eyespot.estimator.recording import Recording
from eyespot.formats.calibration import Calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import Pose, PoseTrack, turned
from eyespot.formats.rig import Rig
from eyespot.formats.spot import Spot
from eyespot.formats.spots import SpotRecord, write_spots
from eyespot.optics.viewing.schematic_eye import load_eye

_WIDTH_PX, _HEIGHT_PX = 1280, 960
_FRAMES, _RATE_HZ, _SPEED_MM_S, _START_S = 24, 2.0, 0.5, 1.0
_MODELS = ("exact", "area")
_REFRACTION_D, _LEAN_DEG, _ASIDE_MM = 2.0, 8.0, 0.5
"""Of drawn eyes: standard deviation of the refraction, whose retinas are those of Atchison (2006);
how far they lean, and lie aside, in any direction."""


class _DrawnRig(NamedTuple):
    """What is true of a rig, and what its file states."""

    rig: Rig
    scale: float
    height: float
    radius: float
    robot_scale: float
    clock_s: float
    touch: float
    layer: float
    boresight: Float[np.ndarray, "2"]
    half_angle: float
    b: float

    @property
    def camera(self) -> optics.Microscope:
        """The true microscope, with the principal point (0, 0)."""
        return optics.microscope(
            scale=self.scale, pinhole_height=self.height, eye_radius=self.radius
        )

    @property
    def cone(self) -> Float[Array, "2"]:
        """Half-angle and b; an array, since numbers would be compiled anew for each rig."""
        return jnp.array([self.half_angle, self.b])

    @property
    def wall(self) -> optics.Surface:
        """The true plane or sphere."""
        return phantom_wall(self.rig.wall.kind or "eyeball", eye_radius=self.radius)

    def retina(self, noise: np.random.Generator) -> tuple[optics.Surface, optics.Microscope]:
        """A drawn eye of about this radius, under the microscope at the same working distance."""
        refraction = _REFRACTION_D * np.clip(noise.standard_normal(), -2, 2)
        eye = load_eye("atchison", refraction_d=float(refraction))
        semi_axes = eye.retina_semi_axes * self.radius / float(eye.retina_semi_axes.mean())
        lean, aside = noise.uniform(0, 2 * math.pi, 2)
        wall = optics.Ellipsoid(
            semi_axes,
            shift=(_ASIDE_MM * math.cos(aside), _ASIDE_MM * math.sin(aside)),
            tilt=math.radians(_LEAN_DEG),
            tilt_azimuth=lean,
        )
        pole = wall.frame_at(eccentricity=0.0, azimuth=0.0).origin[2]
        return wall, replace(self.camera, pole_height=pole)


def _drawn(
    noise: np.random.Generator, *, microscope: str, kind: str, tissue: str, free: bool = False
) -> _DrawnRig:
    """A rig whose file has the default tolerances, and what it is.

    Args:
        kind: of the wall: plane or eyeball.
        free: whether the first distance is unknown, and the core's radius is stated.
    """
    keys: dict[str, Any] = {
        "microscope.id": microscope,
        "microscope.width_px": _WIDTH_PX,
        "microscope.height_px": _HEIGHT_PX,
        "microscope.scale_mm_px": float(noise.uniform(0.004, 0.01)),
        "microscope.pinhole_height_mm": 200.0,
        "wall.kind": kind,
        "wall.tissue": tissue,
        "wall.radius_mm": float(noise.uniform(11.0, 12.5)),
        "wall.medium": "vitreous",
        "robot.eye_from_robot": [0.0, 0.0, 0.0, 1.0],
        "robot.touch": [0.15, 0.02],
    }
    core, z = noise.uniform(0.05, 0.24), noise.standard_normal(8)
    if free:
        tip = Rig().instrument
        keys["robot.touch"] = "free"
        keys["instrument.core_radius_mm"] = core * (1 + tip.core_radius_sigma * float(z[6]))
    rig = Rig().changed(keys)
    seen, wall, robot, eye = rig.microscope, rig.wall, rig.robot, rig.stated
    half_angle = float(np.arctan(1 / noise.uniform(5.0, 20.0)))
    return _DrawnRig(
        rig=rig,
        scale=keys["microscope.scale_mm_px"] * (1 + seen.scale_sigma * z[0]),
        height=200.0 + seen.pinhole_height_sigma_mm * z[1],
        radius=keys["wall.radius_mm"] + wall.radius_sigma_mm * z[2],
        robot_scale=1 + robot.scale_sigma * z[3],
        clock_s=robot.clock_sigma_s * z[4],
        touch=float(noise.uniform(0.1, 1.5)) if free else 0.15 + 0.02 * z[5],
        layer=eye.clear_layer_mm + eye.clear_layer_sigma_mm * z[7],
        boresight=0.5 * BORESIGHT_SIGMA * noise.standard_normal(2),
        half_angle=half_angle,
        b=-core / math.tan(half_angle),
    )


@eqx.filter_jit
def _ellipses(
    wall: optics.Surface,
    camera: optics.Microscope,
    cone: Float[Array, "2"],
    spot: Array,
    beam: Array,
    motion: Array,
    distances: Array,
) -> optics.Ellipse:
    """Ellipses of a cone (half-angle, b) that withdraws from a spot along a line."""

    def at(gone: Array) -> optics.Ellipse:
        tip = spot - distances[0] * beam - (gone - distances[0]) * motion
        own = optics.Beam(tip=tip, axis=beam, half_angle=cone[0], apex_offset=cone[1])
        return optics.spot_ellipse(own, wall, camera)

    return jax.vmap(at)(distances)


def _measured(
    ellipse: optics.Ellipse, noise: np.random.Generator, sigma_px: float, size: float
) -> Spot:
    """The spot that contour points with noise give (docs/theory/bounds.md).

    Args:
        sigma_px: standard deviation of the mean radius.
        size: relative error of the size.
    """
    u, v = np.asarray(ellipse.centre).tolist()
    major, minor = float(ellipse.semi_major) * size, float(ellipse.semi_minor) * size
    e = sigma_px * noise.standard_normal(5) * np.array([math.sqrt(2)] * 4 + [1.0])
    mean, long, oblique = (major + minor) / 2 + e[4], (major - minor) / 2 + e[2], e[3]
    half = math.hypot(long, oblique)
    angle = float(ellipse.angle) + math.atan2(oblique, long) / 2
    covariance = sigma_px**2 * np.diag([2.0, 2.0, 3.0, 3.0, 2.0 / (2 * half) ** 2])
    covariance[2, 3] = covariance[3, 2] = -(sigma_px**2)
    return Spot(
        x_px=u + e[0],
        y_px=v + e[1],
        semi_major_px=mean + half,
        semi_minor_px=mean - half,
        angle_rad=(angle + math.pi / 2) % math.pi - math.pi / 2,
        covariance=covariance,
        edge_width_px=0.5,
        coverage=1.0,
        inlier_fraction=1.0,
        saturated=0.0,
    )


def _tool(wall: optics.Surface, c: float, noise: np.random.Generator, tilt_deg: float) -> Any:
    """A spot at c in any direction, and a tool's axis at an incidence."""
    azimuth, turn = noise.uniform(0, 2 * math.pi, 2)
    place = wall.frame_at(eccentricity=c, azimuth=azimuth)
    spot, outward, first, second = (np.asarray(v) for v in place)
    lean, tilt = math.cos(turn) * first + math.sin(turn) * second, math.radians(tilt_deg)
    return spot, math.cos(tilt) * outward + math.sin(tilt) * lean


def _truly(axis: np.ndarray, world: _DrawnRig, noise: np.random.Generator) -> Any:
    """The tool's pose that the robot reports, the true motion and the true beam."""
    pose = Pose.along(tuple(axis.tolist()), time_s=0.0, position_mm=(0.0, 0.0, 0.0))
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(jnp.asarray(axis)))
    lean = LEAN_SIGMA * noise.standard_normal(2)
    # Turned so that the axis moves by `lean` along the two vectors.
    turn = Rotation.from_rotvec(np.cross(axis, lean[0] * first + lean[1] * second))
    in_tool = np.array([*world.boresight, 1.0])
    beam = np.array(turned(tuple((in_tool / np.linalg.norm(in_tool)).tolist()), pose.rotation))
    return pose, turn.apply(axis), turn.apply(beam)


def _calibrated(world: _DrawnRig, noise: np.random.Generator, folder: Path) -> Calibration | None:
    """The calibration of a drawn withdrawal; None if it is refused."""
    spot, axis = _tool(world.wall, noise.uniform(0, 3), noise, noise.uniform(10, 30))
    pose, motion, beam = _truly(axis, world, noise)
    times = np.arange(_FRAMES) / _RATE_HZ

    def gone(at: np.ndarray) -> np.ndarray:
        """Way of a robot that begins at rest and takes a second to its speed."""
        started = np.clip(at - 0.25, 0.0, _START_S)
        return _SPEED_MM_S * (started**2 / (2 * _START_S) + np.maximum(at - 0.25 - _START_S, 0.0))

    distances = world.touch + gone(times) - gone(times[:1])
    ways = map(jnp.asarray, (spot, beam, motion, distances))
    seen = _ellipses(world.wall, world.camera, world.cone, *ways)
    sigma, size = noise.uniform(0.005, 0.03), 1 + 1e-4 * noise.standard_normal()
    centre = np.array([(_WIDTH_PX - 1) / 2, (_HEIGHT_PX - 1) / 2])
    records = [
        SpotRecord(
            frame=n,
            file_name=f"{n}.png",
            time_s=float(times[n]),
            mode="subpixel",
            result=_measured(_at(seen, n, centre), noise, sigma, size),
        )
        for n in range(_FRAMES)
    ]
    path = folder / "spots.csv"
    path.unlink(missing_ok=True)
    write_spots(path, records)
    at_s = np.arange(-1.0, times[-1] + 1.0, 0.05)
    places = -np.outer(gone(at_s) / world.robot_scale, axis)
    turns = np.tile(pose.rotation, (at_s.size, 1))
    poses = PoseTrack.of_arrays(at_s - world.clock_s, places, turns)
    try:
        found = eyespot.fit(Recording.open(path, rig=world.rig, poses=poses), model="cone")
    except InputError:
        return None
    return found.calibration if found.good else None


def _at(ellipses: optics.Ellipse, n: int, centre: np.ndarray) -> optics.Ellipse:
    own = optics.Ellipse(*(leaf[n] for leaf in ellipses))
    return own._replace(centre=own.centre + centre)


def _one(number: int, folder: Path) -> dict[str, Any]:
    """One rig: its fit, and the reading of one spot."""
    noise = np.random.default_rng([63, number])
    same, tissue = number % 4 < 2, "retina" if number % 3 == 0 else "phantom"
    kind, free = ("plane", "eyeball")[number % 2], number % 5 == 0
    world = _drawn(noise, microscope="A", kind=kind, tissue="phantom", free=free)
    c, d, tilt = noise.uniform(0, 4), noise.uniform(0.5, 5), noise.uniform(5, 30)
    row = {"c_mm": c, "d_mm": d, "tilt_deg": tilt, "same": same, "tissue": tissue, "core": free}
    row["refused"] = True
    beam = _calibrated(world, noise, folder)
    if beam is None:
        return row
    # The reading's eye, and its microscope if that is another one.
    other = _drawn(noise, microscope="A" if same else "B", kind="eyeball", tissue=tissue)
    if same:
        scale = world.rig.microscope.scale_mm_px
        there = other.rig.changed({"microscope.scale_mm_px": scale})
        kappa = 1 / (world.height + world.radius)
        other = other._replace(rig=there, scale=world.scale, height=1 / kappa - other.radius)
    wall, camera = other.wall, other.camera
    if tissue == "retina":
        wall, camera = other.retina(noise)
    spot, axis = _tool(wall, c, noise, tilt)
    pose, motion, true = _truly(axis, world, noise)
    ways = map(jnp.asarray, (spot, true, motion, [d]))
    seen = _ellipses(wall, camera, world.cone, *ways)
    view, stated = other.rig.view, other.rig.stated.model_copy(update={"touch_sigma_mm": 0.0})
    assert view is not None
    measured = _measured(_at(seen, 0, np.array(view.principal_point_px)), noise, 0.02, 1.0)
    model = _MODELS[number // 4 % 2]
    ranger = Ranger(beam.seen_by(other.rig.microscope.id), view, model=model)
    told = np.array(turned(beam.beam_in_tool, pose.rotation))
    found = ranger.distance(measured, axis=told, axis_sigma_rad=math.radians(stated.axis_sigma_deg))
    budget = Budgets(ranger, stated).of(measured, found, axis=told)
    if budget is None:
        return row
    if tissue == "retina":
        budget = budget.surface
        outward = np.asarray(wall.frame_at(eccentricity=c, azimuth=math.atan2(spot[1], spot[0]))[1])
        d -= other.layer / float(true @ outward)
    low, high = budget.interval_mm
    error = budget.corrected_mm - d
    rank = float(stats.t.cdf(-error / budget.sigma_mm, min(budget.freedom, 1e6)))
    sigmas = {f"u_{part.cause.value}_mm": part.sigma_mm for part in budget.parts}
    return (
        row
        | sigmas
        | {
            "refused": False,
            "model": model,
            "error_mm": error,
            "sigma_mm": budget.sigma_mm,
            "inside": low <= d <= high,
            "rank": rank,
        }
    )


def uniform_p(ranks: Float[np.ndarray, "n"]) -> float:
    """Probability of ranks that are less even in ten bins, if they are uniform (chi squared)."""
    return float(stats.chisquare(np.histogram(ranks, 10, (0, 1))[0]).pvalue)


def readings_of_cones(count: int, first: int = 0) -> pd.DataFrame:
    """One reading of each of some drawn rigs."""
    with tempfile.TemporaryDirectory() as folder:
        return pd.DataFrame([_one(n, Path(folder)) for n in range(first, first + count)])


def judged(found: pd.DataFrame) -> pd.DataFrame:
    """Coverage and evenness of readings, of all and of parts of them."""
    read = found[~found.refused]
    parts = {"all": read, "same microscope": read[read.same], "another": read[~read.same]}
    parts |= {"on a sphere": read[read.tissue == "phantom"]}
    parts |= {"in an eye, to the surface": read[read.tissue == "retina"]}
    parts |= {"distances that rest on the core": read[read.core]}
    parts |= {f"model {name}": read[read.model == name] for name in _MODELS}
    for name in ("c_mm", "d_mm", "tilt_deg"):
        thirds = pd.qcut(read[name], 3, labels=False)
        parts |= {f"{name}, third {n + 1}": read[thirds == n] for n in range(3)}
    rows = [
        {
            "readings": len(own),
            "inside_percent": 100 * own.inside.mean(),
            "rms_error_um": 1e3 * math.sqrt((own.error_mm**2).mean()),
            "rms_sigma_um": 1e3 * math.sqrt((own.sigma_mm**2).mean()),
            "p_of_ranks": uniform_p(own["rank"].to_numpy()),
        }
        for own in parts.values()
    ]
    table = pd.DataFrame(rows, index=pd.Index(parts, name="part"))
    table["refused_percent"] = 100 * found.refused.mean()
    return table


def cones(full: bool = False) -> pd.DataFrame:
    """Readings of rigs with cones, one each, with every tolerance drawn."""
    return judged(readings_of_cones(450 if full else 60))
