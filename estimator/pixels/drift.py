"""What a drift of the microscope would do to a pose.

The wall moves in the image when the eye turns or when the microscope drifts, and one spot cannot
tell which. If it is the eye, the microscope file still says where the wall is. If it is the
microscope, each pixel sees another part of the wall than the file says, with another slope. The
pose is right in the first case and pulled in the second, so the pull belongs to its errors.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from estimator.pixels.beam import POSE
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver
from estimator.pixels.wall_motion import WallMotion

_STEP_PX = 0.5  # of the numerical derivative
_SHARE = 0.3
"""Error of the pull, over its size: it is a linear forecast. On rendered drifts of up to 1.3 mm
shifts and turns were within 10 to 30 % of it, mostly."""
_TURN_PER_MM = 0.3  # most turn by a drift, rad/mm; the wall's slope changes by 0.09
_PER_WAY = 0.03  # error of the distance's pull, over the drift


def drift_covariance(
    solver: Solver, solution: Solution, drifts_px: list[Float[np.ndarray, "2"]]
) -> Float[np.ndarray, "5 5"]:
    """What a drift of the view may have done to the newest pose, in the terms of `POSE`.

    Args:
        solver: of the solution.
        solution: with the newest frame last.
        drifts_px: shift of the image in each frame since the microscope file was right.
    """
    pull = _pulled(solver, solution, drifts_px)
    way = float(np.linalg.norm(pull[:2]))
    # Where the light hardly says anything, a linear forecast has no bound of its own.
    pull[2] = np.clip(pull[2], -way, way)
    pull[3:] *= min(1.0, _TURN_PER_MM * way / max(float(np.linalg.norm(pull[3:])), 1e-12))
    turn = np.linalg.norm(pull[3:])
    distance = np.hypot(pull[2], _PER_WAY / _SHARE * way)
    return np.outer(pull, pull) + np.diag([way, way, distance, turn, turn]) ** 2 * _SHARE**2


def shake_covariance(solver: Solver, solution: Solution) -> Float[np.ndarray, "5 5"]:
    """What a shake of the view by a pixel along each side does to all poses on a map, per px².

    Args:
        solver: of the solution.
        solution: of the map's first frame, which nobody knows the shake of.
    """
    shaken = [drift_covariance(solver, solution, [way]) for way in np.eye(2)]
    return np.sum(shaken, axis=0)


def _pulled(
    solver: Solver, solution: Solution, drifts_px: list[Float[np.ndarray, "2"]]
) -> Float[np.ndarray, "5"]:
    """How far the newest pose would be off."""
    model, beam, own = solver.model, solver.beam, solution.own
    changes, way = [], np.zeros(3)
    for frame, drift in zip(solution.frames, drifts_px, strict=True):
        length, motion = float(np.linalg.norm(drift)), frame.cells.motion
        part = _STEP_PX / max(length, _STEP_PX)
        middle = motion.image_px(solver.window.middle_px)
        (here, there), _ = beam.wall_points(np.stack([middle, middle - part * drift]))
        way = (there - here) / part
        other = beam.pose(frame.pose.tip + there - here, frame.pose.axis)
        if other is None:
            return np.zeros(POSE)
        right, down = (-part * drift).tolist()
        drifted = WallMotion(right, down).after(motion)
        seen, fitted = (
            model.log_light(frame, beam.irradiance_alone(model.lattice(where), at, own))
            for where, at in ((drifted, other), (motion, frame.pose))
        )
        changes.append((seen - fitted) / part)
    pull = solution.answer(changes)[:POSE]
    newest = solution.frames[-1].pose
    pull[:2] -= way @ np.stack([newest.right, newest.down], axis=-1)
    return pull
