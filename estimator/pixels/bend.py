"""What the bend of the likely poses does to a pose's stated errors.

Where only a part of the spot is seen, distant poses put its edge in the same place: as the distance
grows, the spot moves away from its visible side. To the second order they also turn. Along a line
of such poses, s standard deviations from the fit, the best one is off the line by s^2 times a bend,
and what the line says to be known well is not.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from estimator.pixels.beam import POSE
from estimator.pixels.cells import COUNT
from estimator.pixels.frame_state import FrameState
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver

_SMALL = 0.01
"""Standard deviation of the distance over it, or of a turn, below which nothing bends: a spot's
edge moves by 1e-4 of its radius then."""
_FOURTH = 3.0  # mean of the fourth power of a normal number


def bend_covariance(
    solver: Solver, solution: Solution, covariance: Float[np.ndarray, "5 5"]
) -> Float[np.ndarray, "5 5"]:
    """What the bend may do to the newest pose, in the terms of `POSE`.

    Args:
        solver: of the solution.
        solution: with the newest frame last.
        covariance: of the newest pose without the bend.
    """
    frame, fitted = solution.frames[-1], solution.newest_covariance
    sigmas = np.sqrt(np.diag(covariance))
    sizes = np.array([0.0, 0.0, sigmas[2] / frame.pose.distance, *sigmas[3:]])
    earlier = [np.zeros(COUNT**2)] * (len(solution.frames) - 1)
    found = np.zeros((POSE, POSE))
    for k in np.flatnonzero(sizes > _SMALL):
        evenly = _even_part(solver, frame, solution.own, covariance[:, k] / sigmas[k])
        bend = solution.answer([*earlier, evenly])[:POSE]
        bend -= fitted[:, k] / fitted[k, k] * bend[k]  # the best pose at this distance or turn
        # Where the light says too little, the second order says nothing.
        bend = np.clip(bend, -sigmas, sigmas)
        found += _FOURTH * np.outer(bend, bend)
    return found


def _even_part(
    solver: Solver, frame: FrameState, own: Float[np.ndarray, "q"], change: Float[np.ndarray, "5"]
) -> Float[np.ndarray, "n"]:
    """How the log light of a frame's cells changes by a change of its pose and by its opposite."""
    model = solver.model
    light = []
    for way in (change, np.zeros(POSE), -change):
        pose = solver.beam.pose(*frame.pose.moved(way))
        if pose is None:
            return np.zeros(COUNT**2)
        lattice = model.lattice(frame.cells.motion)
        light.append(model.log_light(frame, solver.beam.irradiance_alone(lattice, pose, own)))
    ahead, here, back = light
    return 0.5 * (ahead + back) - here
