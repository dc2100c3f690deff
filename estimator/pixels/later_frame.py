"""Explains a frame together with earlier ones, which have shown a part of its wall."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from estimator.image import Outline
from estimator.pixels.beam import Sweep
from estimator.pixels.belief import Belief, lit_px2
from estimator.pixels.cells import COUNT, CellLight
from estimator.pixels.first_frame import learnt_texture
from estimator.pixels.frame_fit import far_moved, fit_wherever, moved
from estimator.pixels.frame_state import FrameState, Linear
from estimator.pixels.look import REACH, Look, reach_px
from estimator.pixels.mix import Mix
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver
from estimator.pixels.wall_motion import WallMotion

_KEPT = 6  # earlier frames
_NEW = 0.25  # shift over the spot's radius that makes a frame worth keeping
_GROWN = 0.07  # change of the distance's logarithm that does
_MORE_WALL = 1.25
"""Growth of the wall that the frames light, after which its texture is learnt again. One small spot
says little of it: vessels and grain that it does not show have the variances of the prior, and what
is larger than the spot may as well be its light."""
_ANEW = 3  # fits of a frame, if it moves the earlier ones far
_AMBIENT_STAYS = 0.2  # standard deviation of its logarithm from frame to frame
_OTHER_DISTANCES = (0.85, 1.0, 1.18)  # over the last one, from which a frame may start


def explained_with(
    belief: Belief, look: Look, mix: Mix, spot: Outline, last_px: np.ndarray, *, shake_px: float
) -> Belief | None:
    """An explanation of the frames so far, continued by the next one.

    Args:
        belief: that explanation.
        look: the next frame.
        mix: the mixture of channels.
        spot: the outline in it.
        last_px: where the spot was.
        shake_px: least standard deviation of the image's shake along each side.

    Returns:
        It, or None if the beam would light nothing that is seen.
    """

    def cells(motion: WallMotion) -> CellLight:
        return look.picture.cells(mix, motion)

    solver, kept, own = belief.solver, belief.kept, belief.solution.own
    motion = belief.expected_motion
    centre = np.array([spot.x_px, spot.y_px])
    on_map, before = motion.map_px(centre), belief.newest.cells.motion.map_px(last_px)
    reach = reach_px(spot, sharp=solver.beam.sharp)
    window = solver.window.following(on_map, reach, on_map - before)
    if window == solver.window:
        solver = solver.with_map(belief.solution.texture_map)
    else:
        solver, kept = moved(solver, window, kept, own)
    point = solver.beam.wall_points(centre[None])[0][0]
    start = _start(belief.newest, solver, cells(motion), point, own, look.sweep)
    if start is None:
        return None
    start = replace(
        start,
        shift_sigma=math.hypot(belief.shift_sigma_px, math.sqrt(2.0) * shake_px),
        # Where the microscope drifts, the eye frame moves against the robot.
        robot=None if belief.drifted else look.robot,
    )
    found, surprise, lost, kept = _fitted(solver, kept, start, own, cells, belief.surprise)
    learnt_px2, seen_px2 = belief.learnt_px2, lit_px2(solver, found)
    if seen_px2 > _MORE_WALL * learnt_px2 and not lost:
        solver, learnt_px2 = solver.of_texture(learnt_texture(solver, found)), seen_px2
        start, own = found.frames[-1], found.own
        found, surprise, lost, kept = _fitted(solver, kept, start, own, cells, belief.surprise)
    return Belief(
        solver=solver,
        kept=_kept(solver, found, kept),
        solution=found,
        learnt_px2=learnt_px2,
        surprise=surprise,
        lost=lost,
        step=found.frames[-1].cells.motion.since(belief.newest.cells.motion),
        shake_before_px=belief.shake_px,
    )


def _fitted(
    solver: Solver,
    kept: list[tuple[FrameState, Linear]],
    start: FrameState,
    own: Float[np.ndarray, "q"],
    cells: Callable[[WallMotion], CellLight],
    usual: float,
) -> tuple[Solution, float, bool, list[tuple[FrameState, Linear]]]:
    """What `fit_wherever` finds; and the earlier frames, anew where they have moved far."""
    for _ in range(_ANEW):
        found, surprise, lost = fit_wherever(solver, kept, start, own, cells, usual=usual)
        fresh = far_moved(solver, kept, found)
        if fresh is None or lost:
            break
        kept, start, own = fresh, found.frames[-1], found.own
    return found, surprise, lost, kept


def _start(
    last: FrameState,
    solver: Solver,
    cells: CellLight,
    point: Float[np.ndarray, "3"],
    own: Float[np.ndarray, "q"],
    sweep: Sweep | None,
) -> FrameState | None:
    """The last pose where the spot is now, at the distance that suits its light.

    None if it lights nothing there that is seen.
    """
    prior = (last.log_ambient, _AMBIENT_STAYS)
    found = []
    for factor in _OTHER_DISTANCES:
        axis = last.pose.axis
        pose = solver.beam.pose(point - factor * last.pose.distance * axis, axis)
        if pose is not None:
            frame = replace(
                last, cells=cells, pose=pose, direction=None, ambient_prior=prior, sweep=sweep
            )
            found.append(solver.model.scanned(frame, own))
    best = min(filter(None, found), key=lambda one: one[1], default=None)
    return None if best is None else replace(best[0], log_ambient=last.log_ambient)


def _kept(
    solver: Solver, solution: Solution, before: list[tuple[FrameState, Linear]]
) -> list[tuple[FrameState, Linear]]:
    """The kept frames, with the newest if it shows the wall in another light."""
    *kept, newest = zip(solution.frames, solution.linear, strict=True)
    # A fit that trusts them less does so for its own frame.
    kept = [
        (state, line._replace(weight=old.weight))
        for (state, line), (_, old) in zip(kept, before, strict=True)
    ]
    pose = newest[0].pose
    radius = 0.5 * COUNT * solver.model.side_mm / REACH[solver.beam.sharp]
    apart = [
        max(
            float(np.linalg.norm(pose.spot - state.pose.spot)) / radius / _NEW,
            abs(math.log(pose.distance / state.pose.distance)) / _GROWN,
        )
        for state, _ in kept
    ]
    if min(apart, default=math.inf) <= 1.0:
        return kept
    if len(kept) >= _KEPT:
        # The first stays; of the others the one nearest to the newest goes.
        kept.pop(1 + int(np.argmin(apart[1:])))
    return [*kept, newest]
