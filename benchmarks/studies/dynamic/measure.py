"""What a moving tip adds to the error of a distance, part by part.

The estimate from a frame is compared with the robot's reading, the distance along the beam at the
pose that is taken for the frame's. With the estimate d' from the blurred frame and d'_0 from the
same frame without blur, the true distance d in the middle of the exposure, the reading d_s of the
pose with that stamp, and d_l of one that is read late,

    d' - d_l = (d'_0 - d) + (d' - d'_0) + (d - d_s) + (d_s - d_l)
      error  =    rest    +    blur     +  stamps   +   latency

At constant withdrawal speed v a pose that is late by L gives the part latency = -v L: the robot has
gone on since the frame was taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd

import optics
from benchmarks.evaluation import (
    LITERAL,
    SUBPIXEL,
    VISIBLE_ENOUGH,
    Way,
    largest,
    mean,
    rms,
    track_stack,
)
from benchmarks.reporting import grouped
from benchmarks.studies.dynamic.trials import MovingTrial, nearest_speed
from calibration import fit_plane
from estimator import (
    MicroscopeFile,
    PoseTrack,
    Ranger,
    Reader,
    Reading,
    Stack,
    read_microscope,
    read_poses,
)
from scenes import Scene
from scenes.world import World, study_calibration, true_calibration

COMPARED = (LITERAL, SUBPIXEL)
"""The paper's way of measuring, at its fixed exposure, and ours."""

MOTIONS = {"withdrawal": "along the beam", "scan": "across the wall", "hand": "in a hand"}

LATENCIES_S = (0.0, 0.05, 0.1)
"""Delays with which a pose without a time stamp is read."""

PARTS = ("rest", "blur", "stamps", "latency")


class Parts(NamedTuple):
    """Error and its parts, mm; see the module."""

    error: float
    rest: float
    blur: float
    stamps: float
    latency: float


def parts(*, estimate: float, frozen: float, d: float, stamped: float, late: float) -> Parts:
    """Split an error; all in mm.

    Args:
        estimate: from the frame as it is.
        frozen: from the frame without blur.
        d: true, in the middle of the exposure.
        stamped: the robot's reading of the pose with that stamp.
        late: of the pose that is taken for the frame's.
    """
    return Parts(estimate - late, frozen - d, estimate - frozen, d - stamped, stamped - late)


def reading(poses: PoseTrack, time_s: float, wall: optics.Surface) -> float:
    """The distance by the robot, from the pose that was known at a time.

    Args:
        poses: as the robot stamped them.
        time_s: at which they are looked up.
        wall: of the eye, which the robot is given.

    Returns:
        From the tip along the beam to the wall, mm; NaN before the first pose.
    """
    found = poses.at(time_s)
    if found is None:
        return math.nan
    pose, _ = found
    meets = wall.intersect(jnp.array(pose.position_mm), jnp.array(pose.axis))
    return float(meets.distance)


_SAME_FRAME = (0.0, 0.0, 0.0, 1.0)  # the rendered robot reports in the eye's frame


def ranger(rest: Stack, scene: Scene, way: Way, *, spots_file: Path) -> Ranger:
    """The ranger that computes distances from a way's spots.

    Literal mode has the paper's model with the k and b fitted to the withdrawal at rest, as on
    the paper's rig; the sub-pixel mode has the true source and its exact geometry.

    Args:
        rest: of `dynamic_trials.at_rest(scene)`.
        scene: of the study, with its source.
        spots_file: file to write, with the spots that k and b come from.

    Raises:
        InputError: too few spots at rest.
    """
    microscope = read_microscope(rest.folder / "microscope.json")
    if way is not LITERAL:
        return Ranger(true_calibration(scene), microscope)
    tracked = track_stack(rest, way, spots_file=spots_file)
    values = small_plane_line(
        semi_minor_px=tracked.semi_minor_px,
        phi=np.array([row.phi_rad for row in tracked.used_labels]),
        distance=np.array([row.d_mm for row in tracked.used_labels]),
        microscope=microscope,
    )
    found = study_calibration(
        "small_plane", values, medium=scene.source.medium, fitted_on=rest.folder.name
    )
    return Ranger(found, microscope)


def small_plane_line(
    *, semi_minor_px: np.ndarray, phi: np.ndarray, distance: np.ndarray, microscope: MicroscopeFile
) -> dict[str, float]:
    """k and b of the paper's model: a line, after subtracting its sagitta from the distance.

    d - (r - sqrt(r^2 - e1^2)) = k e1 + b with e1 = delta e1' cos(phi) (Zhou et al. 2020, eq. 10).

    Args:
        semi_minor_px: e1', px.
        phi: asin(c/r) of the spots, rad.
        distance: d, mm.
        microscope: has delta and r.

    Raises:
        InputError: fewer than 3 spots, or all of one size.
    """
    scale, r = microscope.scale_mm_px, microscope.eye_radius_mm
    seen = semi_minor_px * np.cos(phi)
    sagitta = r - np.sqrt(r**2 - (scale * seen) ** 2)
    line = fit_plane(semi_minor_px=seen, distance=distance - sagitta)
    return {"k": line.delta_k / scale, "b": line.b}


def errors(
    trial: MovingTrial, *, moving: Stack, frozen: Stack, ranger: Ranger
) -> Iterator[dict[str, Any]]:
    """Rows of dynamic_error.csv, latency by latency; error = estimate - reading.

    `set_speed_mm_s` is the speed of a straight motion or the highest speed of a hand. `speed_mm_s`
    is the tip's speed in the middle of the exposure. `doubt` is the reason why an estimate does not
    count; `rest_doubt` is the same for the frame without blur. NaN: there is no estimate.

    The first frame and the last are left out. They are at the ends of the motion, where the tip is
    at rest for half of the exposure.
    """
    poses = read_poses(moving.folder / "kinematics.csv")
    wall = World(trial.moving).wall
    seen, still = (list(_readings(stack, trial.way, ranger, poses)) for stack in (moving, frozen))
    labels = moving.exposed(trial.way.exposure)
    for n in range(1, len(labels) - 1):
        row, doubt, rest_doubt = labels[n], _doubt(seen[n]), _doubt(still[n])
        if row.visible_fraction < VISIBLE_ENOUGH:
            doubt = doubt or "less than half of the contour in view"
        estimate = math.nan if doubt else seen[n].distance_mm
        stamped = reading(poses, row.time_s, wall)
        for latency_s in LATENCIES_S:
            late = reading(poses, row.time_s + latency_s, wall)
            found = parts(
                estimate=estimate,
                frozen=math.nan if rest_doubt else still[n].distance_mm,
                d=row.d_mm,
                stamped=stamped,
                late=late,
            )
            yield {
                "source": trial.moving.source.kind,
                "motion": trial.motion,
                "way": trial.way.name,
                "set_speed_mm_s": trial.speed_mm_s,
                "run": trial.run,
                "frame": row.frame,
                "time_s": row.time_s,
                "exposure_s": row.exposure_s,
                "speed_mm_s": row.speed_mm_s,
                "d_mm": row.d_mm,
                "latency_s": latency_s,
                "doubt": doubt,
                "rest_doubt": rest_doubt,
                "estimate_mm": estimate,
                "reading_mm": late,
                **{f"{name}_mm": value for name, value in found._asdict().items()},
            }


def _readings(stack: Stack, way: Way, ranger: Ranger, poses: PoseTrack) -> Iterator[Reading]:
    labels = stack.exposed(way.exposure)
    first = labels[0]
    reader = Reader(
        way.settings,
        start=(first.half_max_x_px, first.half_max_y_px) if way.clicked else None,
        ranger=ranger,
        eye_from_robot=_SAME_FRAME,
    )
    for row, image in zip(labels, stack.images(way.exposure), strict=True):
        yield reader.read(image, time_s=row.time_s, exposure_s=row.exposure_s, poses=poses)


def _doubt(reading: Reading) -> str:
    return reading.doubt.replace("_", " ")


# Sizes.


def spreads(errors: pd.DataFrame, speeds: tuple[float, ...]) -> pd.DataFrame:
    """Content of dynamic_spread.csv: all frames of about one speed, the nearest to the tip's own.

    `left_out` is the number of frames without an estimate.
    """
    keys = ["source", "motion", "way", "speed_mm_s", "latency_s"]
    near = [nearest_speed(speed, speeds) for speed in errors.speed_mm_s]
    rows = []
    for key, group in sorted(grouped(errors.assign(speed_mm_s=near), *keys), key=lambda of: of[0]):
        used = group[group.doubt == ""]
        columns = {name: used[f"{name}_mm"] for name in ("error", *PARTS)}
        sizes = {f"rms_{name}_mm": rms(values) for name, values in columns.items()}
        means = {f"mean_{name}_mm": mean(values) for name, values in columns.items()}
        first = sizes.pop("rms_error_mm")
        rows.append(
            dict(zip(keys, key, strict=True))
            | {"spots": len(used), "left_out": len(group) - len(used), "rms_error_mm": first}
            | {"largest_error_mm": largest(columns["error"])}
            | sizes
            | means
        )
    return pd.DataFrame(rows)


def speed_at(rows: pd.DataFrame, limit_mm: float) -> float:
    """Speed at which the RMS error of rows that differ in the speed only reaches a limit, mm/s.

    Linear between the speeds, from the error at rest; NaN if the limit is not reached.
    """
    known = rows.dropna(subset="rms_error_mm").sort_values("speed_mm_s") if len(rows) else rows
    if known.empty:
        return math.nan
    errors = np.array([rms(known.rms_rest_mm), *known.rms_error_mm])
    speeds = np.array([0.0, *known.speed_mm_s])
    reached = np.flatnonzero(errors >= limit_mm)
    if not reached.size:
        return math.nan
    n = reached[0]
    if n == 0:
        return 0.0
    share = (limit_mm - errors[n - 1]) / (errors[n] - errors[n - 1])
    return float(speeds[n - 1] + share * (speeds[n] - speeds[n - 1]))
