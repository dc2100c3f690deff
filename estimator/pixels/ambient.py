"""What an error of the ambient light's shape would do to a pose.

The ambient light's logarithm is a polynomial of the second degree over the window, and its texture
is that of the wall. The reflection of a lamp by a wet wall has a shape of its own and no texture.
What the polynomial lacks passes for the wall's texture, as long as the spot is as bright as in the
first frame; then it pulls the pose, in each frame alike.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from estimator.pixels.beam import POSE
from estimator.pixels.cells import SIDES
from estimator.pixels.frame_state import FrameState
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver

_X, _Y = SIDES
_CUBIC = np.stack([_X**3, _X**2 * _Y, _X * _Y**2, _Y**3]) - 0.6 * np.stack(
    [_X, _Y / 1.8, _X / 1.8, _Y]
)
"""Terms of the third degree, without what terms of the first would explain."""
_SHARE = 1.5  # of the third degree over those of the first and second
_LEAST = 0.02  # of the shading's terms, below which the ambient light counts as even


def ambient_covariance(solver: Solver, solution: Solution) -> Float[np.ndarray, "5 5"]:
    """What errors of the ambient light may have done to the newest pose, in the terms of `POSE`.

    Args:
        solver: of the solution.
        solution: with the newest frame last.
    """
    size = float(np.linalg.norm(solution.frames[-1].shade))
    if size < _LEAST:
        return np.zeros((POSE, POSE))
    shares = [_share(solver, solution, frame) for frame in solution.frames]
    pulls = [
        solution.answer([_SHARE * size * share * shape for share in shares])[:POSE]
        for shape in _CUBIC
    ]
    return np.sum([np.outer(pull, pull) for pull in pulls], axis=0)


def _share(solver: Solver, solution: Solution, frame: FrameState) -> Float[np.ndarray, "n"]:
    """The ambient light's share of each cell's light."""
    light = np.maximum(solver.model.light(frame, solution.own), 0.0)
    ambient = np.exp(frame.log_ambient)
    return ambient / (light + ambient)
