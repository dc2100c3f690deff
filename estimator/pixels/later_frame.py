"""Which poses explain a frame together with earlier ones that show a part of its wall?

Each `Hypothesis` of the frames so far is continued by the newest one, which is kept if it shows the
wall in another light.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from eyespot.estimator.pixels.beam_on_cells import Sweep
from eyespot.estimator.pixels.first_frame import (
    MOVES_ON_PX,
    REACH,
    Hypothesis,
    Observation,
    learnt_texture,
    lit_px2,
    reach_px,
    without_tool,
)
from eyespot.estimator.pixels.frame_cells import COUNT, CellLight, WallMotion
from eyespot.estimator.pixels.frame_fit import fit_wherever, moved, remodelled
from eyespot.estimator.pixels.frame_model import FrameState
from eyespot.estimator.pixels.frame_pixels import Mix
from eyespot.estimator.pixels.pose_solver import Kept, PoseSolution, PoseSolver
from eyespot.formats.spot import Outline
from eyespot.optics.wall_light.pose_light import beam_at_wall

_STAYS_PX = 0.1
"""Shift of a wall that keeps still; one that moved may move as far again."""
_MAX_EARLIER_FRAMES = 6  # earlier frames
_KEYFRAME_SHIFT = 0.25  # shift over the spot's radius that makes a frame worth keeping
_KEYFRAME_GROWTH = 0.07  # change of the distance's logarithm that does
_OUTGROWN = 4.0
"""Growth of the distance from where the light widens, after which a first frame no longer counts.
On rendered print behind a flat lens, from 0.45 to 6.15 mm, distances were off by up to 19 um
without a limit, and by up to 10 um with 4 as with 2."""
_MORE_WALL = 1.25
"""Growth of the wall that the frames light, after which its texture is learnt again. One small spot
says little of it: vessels and grain that it does not show have the variances of the prior, and what
is larger than the spot may as well be its light."""
_UNLIKE = 1.2
"""Growth of the mean square, in light without a sharp edge, after which it is learnt again as well:
a vessel that comes into a light of the same size is sharper than what the first frames showed. By
noise it scatters by 0.06."""
_MAX_FITS_OF_A_FRAME = 3  # fits of a frame, if it moves the earlier ones far
_AMBIENT_STAYS = 0.2  # standard deviation of its logarithm from frame to frame
_OTHER_DISTANCES = (0.85, 1.0, 1.18)  # over the last one, from which a frame may start


def explained_with(
    hypothesis: Hypothesis,
    observation: Observation,
    mix: Mix,
    spot: Outline,
    last_px: np.ndarray,
    *,
    shake_px: float,
) -> Hypothesis | None:
    """An explanation of the frames so far, continued by the next one.

    Args:
        shake_px: least standard deviation of the image's shake along each side.

    Returns:
        The continued hypothesis; None if no visible cell would be lit.
    """

    def cells(motion: WallMotion) -> CellLight:
        return observation.picture.cells(mix, motion)

    solver, kept, own = hypothesis.solution.solver, hypothesis.kept, hypothesis.solution.own
    motion = hypothesis.solution.newest.cells.motion
    if hypothesis.moved_px > MOVES_ON_PX:  # the wall moves on as it did; else it only shakes
        motion = hypothesis.step.after(motion)
    centre = np.array([spot.x_px, spot.y_px])
    on_map, before = motion.map_px(centre), hypothesis.solution.newest.cells.motion.map_px(last_px)
    reach = reach_px(spot, sharp=solver.beam.sharp)
    window = solver.window.following(on_map, reach, on_map - before)
    if window == solver.window:
        solver = solver.with_map(hypothesis.solution.texture_map)
    else:
        solver, kept = moved(solver, window, kept, own)
    point = solver.beam.wall_points(centre[None])[0][0]
    start = _start(hypothesis.solution.newest, solver, cells(motion), point, own, observation.sweep)
    if start is None:
        return None
    if not solver.beam.sharp:
        picture = without_tool(observation.picture, solver.beam, start.pose)
        observation = observation._replace(picture=picture)
        start = replace(start, cells=cells(motion))
    start = replace(
        start,
        shift_sigma=math.hypot(_STAYS_PX + hypothesis.shake_px, math.sqrt(2.0) * shake_px),
        # Where the microscope drifts, the eye frame moves against the robot, be it by a pixel.
        robot=None if hypothesis.drifted(0.0) else observation.robot,
    )
    found, mean_square, other_wall, kept = _fitted(
        solver, kept, start, own, cells, hypothesis.mean_square
    )
    learnt_px2, learnt_square = hypothesis.learnt_px2, hypothesis.learnt_square
    seen_px2 = lit_px2(found)
    unlike = not solver.beam.sharp and mean_square > _UNLIKE * max(learnt_square, 1.0)
    if (seen_px2 > _MORE_WALL * learnt_px2 or unlike) and not other_wall:
        solver, learnt_px2 = solver.of_texture(learnt_texture(found)), seen_px2
        start, own = found.newest, found.own
        found, mean_square, other_wall, kept = _fitted(
            solver, kept, start, own, cells, hypothesis.mean_square
        )
        learnt_square = mean_square
    return Hypothesis(
        kept=_kept(found, kept),
        solution=found,
        learnt_px2=learnt_px2,
        learnt_square=learnt_square,
        mean_square=mean_square,
        other_wall=other_wall,
        step=found.newest.cells.motion.since(hypothesis.solution.newest.cells.motion),
        shake_before_px=hypothesis.shake_px,
    )


def _fitted(
    solver: PoseSolver,
    kept: Kept,
    start: FrameState,
    own: Float[np.ndarray, "q"],
    cells: Callable[[WallMotion], CellLight],
    usual: float,
) -> tuple[PoseSolution, float, bool, Kept]:
    """What `fit_wherever` finds; and the earlier frames, anew where they have moved far."""
    for _ in range(_MAX_FITS_OF_A_FRAME):
        found, mean_square, other_wall = fit_wherever(solver, kept, start, own, cells, usual=usual)
        fresh = remodelled(kept, found)
        if fresh is None or other_wall:
            break
        kept, start, own = fresh, found.newest, found.own
    return found, mean_square, other_wall, kept


def _start(
    last: FrameState,
    solver: PoseSolver,
    cells: CellLight,
    point: Float[np.ndarray, "3"],
    own: Float[np.ndarray, "q"],
    sweep: Sweep | None,
) -> FrameState | None:
    """The last pose where the spot is now, at the distance that suits its light.

    None if it lights nothing there that is seen.
    """
    prior, axis = (last.log_ambient, _AMBIENT_STAYS), last.pose.axis
    distances = [factor * last.pose.distance for factor in _OTHER_DISTANCES]
    poses = [beam_at_wall(solver.beam.wall, point - d * axis, axis) for d in distances]
    last = replace(last, cells=cells, direction=None, ambient_prior=prior, sweep=sweep)
    frames = [replace(last, pose=pose) for pose in poses if pose is not None]
    found = filter(None, solver.model.scanned(frames, own))
    best = min(found, key=lambda one: one.cost, default=None)
    return None if best is None else replace(best.state, log_ambient=last.log_ambient)


def _kept(solution: PoseSolution, before: Kept) -> Kept:
    """The kept frames, with the newest if it shows the wall in another light.

    A spot that has grown far beyond the first frame's has cells of which that lights a part only.
    It shows the texture of this part, which is not the cell's, so it no longer counts.
    """
    *kept, newest = zip(solution.frames, solution.linear, strict=True)
    # A fit that trusts them less does so for its own frame.
    kept = [
        (state, line._replace(weight=old.weight))
        for (state, line), (_, old) in zip(kept, before, strict=True)
    ]
    pose, solver = newest[0].pose, solution.solver
    spot = pose.spot
    apex_mm = solver.beam.apex_mm
    outgrown = (pose.distance + apex_mm) / _OUTGROWN
    if len(kept) > 1 and kept[0][0].pose.distance + apex_mm < outgrown:
        kept.pop(0)
    radius = 0.5 * COUNT * solver.model.side_mm / REACH[solver.beam.sharp]
    apart = [
        max(
            float(np.linalg.norm(spot - state.pose.spot)) / radius / _KEYFRAME_SHIFT,
            abs(math.log(pose.distance / state.pose.distance)) / _KEYFRAME_GROWTH,
        )
        for state, _ in kept
    ]
    if min(apart, default=math.inf) <= 1.0:
        return kept
    if len(kept) >= _MAX_EARLIER_FRAMES:
        # The first stays; of the others the one nearest to the newest goes.
        kept.pop(1 + int(np.argmin(apart[1:])))
    return [*kept, newest]
