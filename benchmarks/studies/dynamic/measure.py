"""From stacks to rows of dynamic_error.csv: calibrate at rest, read frames, split the errors."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.evaluation import (
    LITERAL,
    VISIBLE_ENOUGH,
    Way,
    track_stack,
)
from benchmarks.studies.dynamic import parts as dynamic_parts
from benchmarks.studies.dynamic.findings import LATENCIES_S, DynamicError
from benchmarks.studies.dynamic.trials import MovingTrial
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

_SAME_FRAME = (0.0, 0.0, 0.0, 1.0)  # the rendered robot reports in the eye's frame


def ranger(rest: Stack, scene: Scene, way: Way, *, spots_file: Path) -> Ranger:
    """The ranger that computes distances from a way's spots.

    Literal mode has the paper's model with the k and b fitted to the withdrawal at rest, as on
    the paper's rig; the sub-pixel mode has the true source and its exact geometry.

    Args:
        rest: of `dynamic_trials.at_rest(scene)`.
        scene: of the study, with its source.
        way: of measuring.
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
) -> Iterator[DynamicError]:
    """Rows of a trial, latency by latency; its first frame and its last are not among them.

    They are at the ends of the motion, where the tip is at rest for half of the exposure.
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
        stamped = dynamic_parts.reading(poses, row.time_s, wall)
        for latency_s in LATENCIES_S:
            late = dynamic_parts.reading(poses, row.time_s + latency_s, wall)
            found = dynamic_parts.parts(
                estimate=estimate,
                frozen=math.nan if rest_doubt else still[n].distance_mm,
                d=row.d_mm,
                stamped=stamped,
                late=late,
            )
            sizes = {f"{name}_mm": value for name, value in found._asdict().items()}
            yield DynamicError(
                source=trial.moving.source.kind,
                motion=trial.motion,
                way=trial.way.name,
                set_speed_mm_s=trial.speed_mm_s,
                run=trial.run,
                frame=row.frame,
                time_s=row.time_s,
                exposure_s=row.exposure_s,
                speed_mm_s=row.speed_mm_s,
                d_mm=row.d_mm,
                latency_s=latency_s,
                doubt=doubt,
                rest_doubt=rest_doubt,
                estimate_mm=estimate,
                reading_mm=late,
                **sizes,
            )


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
