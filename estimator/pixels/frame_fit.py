"""Fits the newest frame. Cells with other light have little weight, and the wall may have moved.

A frame may be noisier than the microscope file says: by JPEG, by a Bayer pattern, or by a line that
comes into the light in the middle of cells. So where a frame's residuals grow, it and the earlier
ones have less weight. The wall is another one only if that explains the frame better.

A frame's light less its model is the wall's log reflectance there, but for what a small change of
the pose or of the ambient light makes of it. So that change is fitted at every shift and turn of
the wall that is tried. Cells that the map does not know have the variance of the wall, so that it
does not pay to leave the map.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize

from eyespot.estimator.pixels.frame_cells import (
    COUNT,
    SIDES,
    STILL,
    CellLight,
    CellWindow,
    WallMotion,
    rolled,
)
from eyespot.estimator.pixels.frame_model import FrameState, Linear
from eyespot.estimator.pixels.pose_solver import Kept, PoseSolution, PoseSolver

FARTHEST = 6
"""Cells, the longest shift that is searched for; 1 mm/s is two or three from frame to frame."""
_TURN_SIGMA_RAD = 0.02  # standard deviation of the turn from frame to frame, rad
_SURE_GAIN = 16.0  # gain of -2 log likelihood: four standard deviations
_MIDDLE = 0.5 * (COUNT - 1)
_CELLS = 0.5 * COUNT * SIDES
"""Columns and rows from the window's middle."""


def registered(
    line: Linear,
    known: Float[np.ndarray, "n"],
    variance: Float[np.ndarray, "n"],
    window: CellWindow,
) -> WallMotion | None:
    """The motion of the wall since the cells of the map were where the frame's are now.

    None if the map is not more likely elsewhere, or only too far away.

    Args:
        line: the frame's model on the cells, fitted without the map.
        known: log reflectance of the cells by earlier frames.
    """
    used = line.weight > 0
    residual, slopes = line.residual[used], line.slopes[:, used]
    noise, unknown = 1.0 / line.weight[used], float(variance.max())
    shape = COUNT, COUNT

    def misfit(moved: Float[np.ndarray, "3"], order: int) -> float:
        rotation = WallMotion(turn=float(moved[2])).rotation
        columns, rows = rotation.T @ (_CELLS[:, used] - moved[:2, None]) + _MIDDLE
        at = np.stack([rows, columns])
        value = map_coordinates(known.reshape(shape), at, order=order, cval=0.0)
        map_variance = map_coordinates(variance.reshape(shape), at, order=1, cval=unknown)
        weight = 1.0 / (noise + map_variance)
        off, weighted = residual - value, slopes * weight
        pull = weighted @ off
        explained = pull @ np.linalg.pinv(weighted @ slopes.T, hermitian=True) @ pull
        turned = (moved[2] / _TURN_SIGMA_RAD) ** 2
        return float(off @ (weight * off) - explained - np.sum(np.log(weight)) + turned)

    along = range(-FARTHEST, FARTHEST + 1)
    whole_cells = [np.array([column, row, 0.0]) for column in along for row in along]
    best = min(whole_cells, key=lambda moved: misfit(moved, 0))
    steps = np.vstack([np.zeros(3), 0.5 * np.eye(3) * [1.0, 1.0, 2.0 / COUNT]])
    found = minimize(
        misfit, best, args=(3,), method="Nelder-Mead", options={"initial_simplex": best + steps}
    ).x
    gain = misfit(np.zeros(3), 3) - misfit(found, 3)
    if gain < _SURE_GAIN or np.abs(found[:2]).max() > FARTHEST + 1:
        return None
    return WallMotion.about(window.middle_px, window.side * found[:2], float(found[2]))


STEPS = 8
_STEPS_AGAIN = 4
_OUTLIER_SIGMAS = 4.0
"""Standard deviations from which a cell is an outlier: a tool, a shadow, a glint."""
_MISFIT_SIGMAS = 4.0  # standard deviations of a mean square
_MISFIT_GROWTH = 1.2  # growth of the mean square from which the wall is looked for elsewhere
_RECUT_SHIFT_PX = 0.1  # a frame's cells are cut anew where the wall has moved by more
_THREADS = 2
_NEW_MODEL_SHARE = 0.01  # share of a frame's light that is worth a new model
_DARK = 1e-6  # sum of the cells' light, 1/mm², below which a frame shows none
_LINEAR = 0.01
"""Change of a distance over it, or turn, up to which a frame's model is linear: a spot's edge is
wrong by 1e-4 of its radius then."""
_WEIGHT_ROUNDS = 3  # the weights of cells with other light are found anew
_SETTLED_WEIGHT_CHANGE = 0.2
"""Change of a weight, over that of a cell that is trusted, that does not matter."""
_EVENEST = 0.03
"""Least standard deviation of a wall's texture in that: what hides or shades a wall, or shines on
it, changes its light by more than a tenth."""
_BLOCK, _AROUND = np.ones((2, 2)), np.ones((4, 4))
"""Cells of the smallest thing that counts as large, and those that it and its border reach."""
_START_PX, _START_ALONG = 4.0, 0.08
"""Largest errors of a pose from which a fit starts: of the spot's outline, px, with an axis that is
some degrees off, and of the distance, relative, by the grid of the starts."""


def _mean_square(deviations: Float[np.ndarray, "n"]) -> tuple[float, bool]:
    """Of residuals in standard deviations; and whether it is too large for chance."""
    value = float(np.mean(np.square(deviations))) if deviations.size else 1.0
    return value, (value - 1.0) * math.sqrt(0.5 * deviations.size) > _MISFIT_SIGMAS


def robust_fit(
    solver: PoseSolver,
    kept: Kept,
    frame: FrameState,
    own: Float[np.ndarray, "q"],
    *,
    steps: int = STEPS,
) -> tuple[PoseSolution, float, bool]:
    """A solution in which outliers have little weight.

    Also the mean square of the newest frame's residuals against all other data, in standard
    deviations: 1 where the model is right; and whether it is too large for chance.
    """
    line = solver.model.linear(frame, own)
    trust = _trust(_off_wall_at_start(solver, frame, own, line))
    solution = solver.solve(kept, frame, own, steps=steps, trust=trust, line=line)
    line, left_out, deviations = _distances(solution, trust)
    tested = solution.linear[-1].weight > 0
    if kept:  # what comes into the light is new, no outlier
        before = np.sum([line.weight for _, line in kept], axis=0)
        tested &= before * solver.texture.variance > 1.0
    mean_square, grown = _mean_square(np.minimum(left_out, _OUTLIER_SIGMAS)[tested])
    # Where the wall has moved, the residuals are errors of its place, not noise.
    noise, noisy = _mean_square(left_out[tested & (deviations < _OUTLIER_SIGMAS)])
    if not (noisy and frame.cells.motion == STILL):
        noise = 1.0
    kept = [(state, line._replace(weight=line.weight / noise)) for state, line in kept]
    for _ in range(_WEIGHT_ROUNDS):
        last, trust = trust, _trust(deviations) / noise
        if np.abs(trust - last).max() < _SETTLED_WEIGHT_CHANGE:
            break
        start, own = solution.newest, solution.own
        solution = solver.solve(kept, start, own, steps=_STEPS_AGAIN, trust=trust, line=line)
        line, _, deviations = _distances(solution, trust)
    return solution, mean_square, grown


def _distances(
    solution: PoseSolution, trust: Float[np.ndarray, "n"]
) -> tuple[Linear, Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """The newest frame's model with all trust, and its residuals in standard deviations.

    First those against all other data, then the larger of these and those against any wall.
    """
    line = solution.linear[-1]
    line = line._replace(weight=line.weight / trust)
    left_out = np.abs(solution.left_out(trust))
    return line, left_out, np.maximum(left_out, _grown(_off_wall(solution.solver, line)))


def modelled(solver: PoseSolver, frames: list[FrameState], own: Float[np.ndarray, "q"]) -> Kept:
    """Frames with their models, in which outliers from the wall's texture have little weight."""

    def model(frame: FrameState) -> tuple[FrameState, Linear]:
        line = solver.model.linear(frame, own)
        return frame, line._replace(weight=line.weight * _trust(_grown(_off_wall(solver, line))))

    # JAX, and NumPy with whole arrays, let another thread work.
    with ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(model, frames))


def moved(
    solver: PoseSolver, window: CellWindow, kept: Kept, own: Float[np.ndarray, "q"]
) -> tuple[PoseSolver, Kept]:
    """The solver of another window with its map, and kept frames with their models there.

    A frame is modelled anew only if it has some light in cells that are new.
    """
    old, solver = solver.window, solver.at(window)
    right, down = (window.left - old.left) // old.side, (window.top - old.top) // old.side
    if window.side != old.side:
        states = [state for state, _ in kept]
        solver = solver.with_map_of(modelled(solver, states, own))
        return solver, modelled(solver, states, own)
    new = rolled(np.ones(COUNT**2), right, down) == 0
    kept = [(state, line.after(right, down)) for state, line in kept]
    solver = solver.with_map_of(kept)
    lights = solver.model.lights([state for state, _ in kept], own)
    shares = lights[:, new].sum(axis=1) / np.maximum(lights.sum(axis=1), _DARK)
    lit = np.flatnonzero(shares > _NEW_MODEL_SHARE)
    for k, fresh in zip(lit, modelled(solver, [kept[k][0] for k in lit], own), strict=True):
        kept[k] = fresh
    return solver, kept


def remodelled(kept: Kept, solution: PoseSolution) -> Kept | None:
    """Kept frames, with new models of those that a solution moves too far for theirs.

    None if there are none.
    """
    too_far = [
        k
        for k, ((before, _), after) in enumerate(zip(kept, solution.frames, strict=False))
        if abs(after.pose.distance / before.pose.distance - 1.0) > _LINEAR
        or np.linalg.norm(after.pose.axis - before.pose.axis) > _LINEAR
    ]
    if not too_far:
        return None
    kept = kept.copy()
    fresh = modelled(solution.solver, [solution.frames[k] for k in too_far], solution.own)
    for k, one in zip(too_far, fresh, strict=True):
        kept[k] = one
    return kept


def outliers(solution: PoseSolution) -> Bool[np.ndarray, "n"]:
    """Outliers of a first frame from the wall's texture: hidden, or in other light."""
    line = solution.solver.model.linear(solution.newest, solution.own)
    return _grown(_off_wall(solution.solver, line)) > _OUTLIER_SIGMAS


def _trust(deviations: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """The weight of Geman and McClure: a cell's pull falls with the cube of its residual."""
    return (_OUTLIER_SIGMAS / np.maximum(deviations, _OUTLIER_SIGMAS)) ** 4


def _off_wall_at_start(
    solver: PoseSolver, frame: FrameState, own: Float[np.ndarray, "q"], line: Linear
) -> Float[np.ndarray, "n"]:
    """As `_off_wall`, at a pose from which a fit starts, near which any pose may be right."""
    if not _large(_off_wall(solver, line)).any():
        return np.zeros(line.weight.size)
    place, along = _START_PX * solver.beam.scale_mm_px, _START_ALONG * frame.pose.distance
    shifts = np.diag([place, place, along, 0.0, 0.0])
    wall = solver.beam.wall
    near = [
        replace(frame, pose=frame.pose.moved_on(wall, shift) or frame.pose)
        for shift in (shifts[-1], *shifts[:3], *-shifts[:3])  # the first is none
    ]
    seen = solver.model.log_lights(near, solver.model.lights(near, own))
    changes = seen - seen[0]
    residual = line.residual - np.clip(line.residual, changes.min(axis=0), changes.max(axis=0))
    return _grown(_off_wall(solver, line._replace(residual=residual)))


def _grown(deviations: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Deviations, in which the neighbours of a large outlier are outliers as well.

    Each shows a part of it, and where it hides the edge of the light, it passes for that edge.
    """
    return np.maximum(deviations, cv2.dilate(_large(deviations), _AROUND, anchor=(1, 1)).ravel())


def _large(deviations: Float[np.ndarray, "n"]) -> Float[np.ndarray, "count count"]:
    """Deviations of blocks of cells that are all outliers; 0 elsewhere."""
    grid = deviations.reshape(COUNT, COUNT)
    least = cv2.erode(grid, _BLOCK, borderType=cv2.BORDER_REPLICATE)
    return np.where(least > _OUTLIER_SIGMAS, least, 0.0)


def _off_wall(solver: PoseSolver, line: Linear) -> Float[np.ndarray, "n"]:
    """Residuals against any place of such a wall, in standard deviations.

    What hides a part of the wall, or a light on it, is as even as a wall is. So its cells are as
    their neighbours say, but too dark or too bright.
    """
    used = line.weight > 0
    wall = max(solver.texture.variance, _EVENEST**2)
    variance = wall + 1.0 / np.where(used, line.weight, 1.0)
    return np.where(used, np.abs(line.residual) / np.sqrt(variance), 0.0)


def fit_wherever(
    solver: PoseSolver,
    kept: Kept,
    frame: FrameState,
    own: Float[np.ndarray, "q"],
    cells: Callable[[WallMotion], CellLight],
    *,
    usual: float,
) -> tuple[PoseSolution, float, bool]:
    """As `robust_fit`, wherever the wall is now.

    Args:
        frame: the newest one, where its wall is expected.
        cells: the newest frame's light after a motion of the wall.
        usual: the mean square of the frame before. No other place is looked for where it has hardly
            grown, because each search takes as long as two frames.

    Returns:
        The solution, the mean square of its residuals, and whether it is another wall: the frame is
        more likely by itself than with the earlier ones.
    """
    solution, mean_square, grown = robust_fit(solver, kept, frame, own)
    other_wall = False
    if grown and mean_square > _MISFIT_GROWTH * usual:
        alone, *_ = robust_fit(solver.with_map(None), [], frame, own)
        known, variance = solver.known([line for _, line in kept])
        step = registered(alone.linear[0], known, variance, solver.window)
        if step is not None:
            moved = replace(frame, cells=cells(frame.cells.motion.after(step)))
            again, less, _ = robust_fit(solver, kept, moved, own)
            if _deviance(again) < _deviance(solution) - _SURE_GAIN:
                solution, mean_square = again, less
        other_wall = _deviance(solution) > _deviance(alone) + _SURE_GAIN
    newest = solution.newest
    if math.hypot(*newest.shift) > _RECUT_SHIFT_PX:
        motion = newest.cells.motion.after(WallMotion(*newest.shift))
        newest = replace(newest, cells=cells(motion), shift=(0.0, 0.0))
        # With the weights that the solution's other parts have.
        line = solver.model.linear(newest, solution.own)
        line = line._replace(weight=solution.linear[-1].weight)
        solution = replace(solution, newest=newest, linear=[*solution.linear[:-1], line])
    return solution, mean_square, other_wall


def _deviance(solution: PoseSolution) -> float:
    """-2 log likelihood of the newest frame, given the earlier ones."""
    *earlier, _ = zip(solution.frames, solution.linear, strict=True)
    before = solution.solver.deviance_of(earlier, solution.own) if earlier else 0.0
    return solution.deviance - before
