"""Which poses explain a frame by itself?

Several explanations of the frames so far may be possible; each is a `Hypothesis`. Behind a lens one
radius may belong to several distances, and without the robot's axis a spot may lean to either side.
So the first frame's distances and directions are scanned, and every one that might become the best
is fitted. `later_frame` continues each explanation.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from eyespot.estimator.camera_noise import CameraNoise
from eyespot.estimator.pixels.beam_on_cells import BeamLight, Sweep
from eyespot.estimator.pixels.frame_cells import COUNT, STILL, CellWindow, WallMotion
from eyespot.estimator.pixels.frame_fit import (
    STEPS,
    outliers,
    robust_fit,
)
from eyespot.estimator.pixels.frame_model import (
    SHIFT,
    Direction,
    FrameState,
    RobotPose,
    contrast,
    lit,
)
from eyespot.estimator.pixels.frame_pixels import FramePixels, Mix, Reference, evener_mix
from eyespot.estimator.pixels.pose_solver import Kept, PoseSolution, PoseSolver, together
from eyespot.estimator.pixels.texture import TextureVariances, texture_of
from eyespot.formats.spot import Outline
from eyespot.optics.wall_light.pose_light import BeamFrame, beam_at_wall

REACH = (2.0, 1.2)
"""Of the window over the half-maximum ellipse, for light without and with a sharp edge: farther out
there is hardly any light. The smaller the cells, the less texture averages out within them."""
_BESIDE_PX, _BESIDE_EDGE = 6.0, 2.5  # beside it, px, and in widths of the edge


class Observation(NamedTuple):
    """A frame, and what the robot says of it.

    Attributes:
        direction: of the beam, from the robot.
        sweep: motion during the exposure, from the robot; None if unknown.
    """

    picture: FramePixels
    direction: Direction | None
    sweep: Sweep | None
    robot: RobotPose | None


def reach_px(spot: Outline, *, sharp: bool) -> float:
    """From a spot's centre to where there is hardly any light."""
    beside = _BESIDE_PX + _BESIDE_EDGE * spot.edge_width_px * sharp
    return REACH[sharp] * spot.semi_major_px + beside


def without_tool(picture: FramePixels, beam: BeamLight, pose: BeamFrame) -> FramePixels:
    """A picture without what the instrument hides, which a map would take for the wall's texture.

    Only light without a sharp edge needs it: what hides a sharp one was found by its darkness.
    """
    return replace(picture, usable=picture.usable & ~beam.hidden(pose))


_UNDECIDED_DIFFERENCE = 16.0
"""Difference of -2 log likelihoods that keeps a second pose possible: four standard deviations."""
_SHAKE_DECAY = 0.9  # the share of the shake that is expected to last until the next frame
MOVES_ON_PX = 4.0
"""Motion of the wall from frame to frame above which it moves on; a microscope shakes by 1 or 2."""
_DRIFTED_PX, _SURELY = 1.0, 3.0
"""Least drift of the wall since the first frame that is worth a word: px, standard deviations."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One explanation of the frames so far.

    Attributes:
        kept: frames that are fitted again with each new one.
        solution: of the newest frame and those that were kept then.
        learnt_px2: `lit_px2` when the texture was learnt.
        learnt_square: `mean_square` then.
        mean_square: of the newest frame's residuals; see `frame_fit.robust_fit`.
        other_wall: whether the newest frame shows another wall than the earlier ones or the
            reference.
        step: motion of the wall in the image since the frame before.
    """

    kept: Kept
    solution: PoseSolution
    learnt_px2: float
    learnt_square: float = 1.0
    mean_square: float = 1.0
    other_wall: bool = False
    step: WallMotion = STILL
    shake_before_px: float = 0.0

    @cached_property
    def shift_variance_px2(self) -> float:
        """Variance of the newest frame's shift, of both sides together."""
        return float(np.trace(self.solution.newest_states(SHIFT)))

    @cached_property
    def moved_px(self) -> float:
        """How far the wall has moved in the image since the frame before.

        Less the errors of both frames' shifts, by which a wall of which little is seen would seem
        to move on, ever farther.
        """
        middle = self.solution.solver.window.middle_px + self.solution.drifts_px[-1]
        along_wall = self.step.image_px(middle) - middle
        return math.sqrt(max(float(along_wall @ along_wall) - 2.0 * self.shift_variance_px2, 0.0))

    @cached_property
    def shake_px(self) -> float:
        """How far the image may jump from frame to frame, as it did of late."""
        return max(min(self.moved_px, MOVES_ON_PX), _SHAKE_DECAY * self.shake_before_px)

    @property
    def outline(self) -> Outline:
        """The half-maximum ellipse of the newest frame's light, good to a part of a cell."""
        centres = self.solution.solver.window.centres().reshape(-1, 2)
        places = centres[lit(self.solution.lights[-1])]
        middle = self.solution.newest.cells.motion.image_px(places.mean(axis=0))
        # Half of an axis is twice the standard deviation along it.
        variances, axes = np.linalg.eigh(4.0 * np.cov(places.T))
        semi_minor, semi_major = np.sqrt(variances).tolist()
        x, y = middle.tolist()
        angle = math.atan2(axes[1, 1], axes[0, 1])
        return Outline(x, y, semi_major, semi_minor, angle, measured=False)

    def drifted(self, shake_px: float) -> bool:
        """Whether the wall has moved since the map's begin, beyond errors and a shake of the image.

        Args:
            shake_px: standard deviation of the shake along each side, in the first frame and now.
        """
        variance = self.shift_variance_px2 + 4.0 * shake_px**2
        return math.hypot(*self.solution.drifts_px[-1]) > max(
            _DRIFTED_PX, _SURELY * math.sqrt(variance)
        )


def lit_px2(solution: PoseSolution) -> float:
    """Area of the window's wall that any frame of a solution lights."""
    seen = lit(solution.lights).any(axis=0)
    return float(np.count_nonzero(seen)) * solution.solver.window.side**2


def distinct(hypotheses: list[Hypothesis]) -> list[Hypothesis]:
    """The best explanation, and others that are different and nearly as good."""
    if len(hypotheses) < 2:  # a likelihood takes some milliseconds
        return hypotheses
    best, *others = sorted(hypotheses, key=lambda one: one.solution.deviance)
    kept = [best]
    for hypothesis in others:
        near = hypothesis.solution.deviance - best.solution.deviance < _UNDECIDED_DIFFERENCE
        if near and all(hypothesis.solution.differs(other.solution) for other in kept):
            kept.append(hypothesis)
    return kept


_DISTANCES_MM = np.geomspace(0.4, 7.0, 20)
_ROUND_SPOT_RATIO = 1.02  # ratio of the axes below which a spot shows no tilt
_MAX_STARTS = 3  # starts that are fitted
_SIZE, _TINY = (0.2, 0.05), 1e-6
"""Standard deviation of the logarithm of the spot's area, for light without and with a sharp edge:
the contour of a bell follows the texture, and cells are counted."""
_MAX_INCIDENCE_DEG = 60.0  # incidence, degrees
_BLURRED_PX = 1.5  # width of an edge, above which its blur has a shape
_SHAPES = ((-1.0, 2.0 / np.pi), (0.0, 1.0), (2.0, 6.0 / np.pi))
"""Kurtosis of a blur, and its variance over the square of the edge width (`Spot.edge_width_px`),
which is that of the Gaussian whose step is as steep in the middle: 2/pi for a disc, and 6/pi for
exp(-r/L)."""


def scanned_starts(
    solver: PoseSolver,
    frame_at: Callable[[BeamFrame], FrameState],
    spot: Outline,
    own: np.ndarray,
    axes: Iterable[np.ndarray],
) -> list[FrameState]:
    """The frame at the poses that are the likeliest along each direction, best first."""
    found: list[tuple[float, FrameState]] = []
    spot_px2, beam = np.pi * spot.semi_major_px * spot.semi_minor_px, solver.beam
    point = beam.wall_points(np.array([[spot.x_px, spot.y_px]]))[0][0]
    for axis in axes:
        poses = [beam_at_wall(beam.wall, point - d * axis, axis) for d in _DISTANCES_MM]
        meeting = {k: frame_at(pose) for k, pose in enumerate(poses, 1) if pose is not None}
        scanned = dict(zip(meeting, solver.model.scanned([*meeting.values()], own), strict=True))
        suited = {k: one for k, one in scanned.items() if one is not None}
        costs = np.full(_DISTANCES_MM.size + 2, np.inf)
        lights = np.reshape([one.light for one in suited.values()], (-1, COUNT**2))
        lit_cells = np.count_nonzero(lit(lights), axis=1)
        for (k, one), count in zip(suited.items(), lit_cells, strict=True):
            size = count * solver.window.side**2 / spot_px2
            costs[k] = one.cost + (np.log(max(size, _TINY)) / _SIZE[beam.sharp]) ** 2
        for k, one in suited.items():
            if costs[k] <= min(costs[k - 1], costs[k + 1]):
                found.append((costs[k], one.state))
    found.sort(key=lambda one: one[0])
    return [state for _, state in found[:_MAX_STARTS]]


def mirrored_start(solver: PoseSolver, frame: FrameState, own: np.ndarray) -> FrameState | None:
    """A frame with the beam leaning to the other side of the wall's normal, as alike in the image.

    Returns:
        The frame, or None if such a beam meets no wall that is seen.
    """
    pose = frame.pose
    normal = np.cross(pose.right, pose.down)
    axis = 2.0 * (pose.axis @ normal) * normal - pose.axis
    other = beam_at_wall(solver.beam.wall, pose.spot - pose.distance * axis, axis)
    frames = [] if other is None else [replace(frame, pose=other)]
    return next((one.state for one in solver.model.scanned(frames, own) if one), None)


def likely_axes(beam: BeamLight, spot: Outline) -> Iterator[np.ndarray]:
    """Axes of the beam to start from: square to the wall, and tilted as the spot."""
    along = np.array([np.cos(spot.angle_rad), np.sin(spot.angle_rad)])
    middle = np.array([spot.x_px, spot.y_px])
    points, normals = beam.wall_points(np.stack([middle, middle + along]))
    normal = normals[0]
    yield -normal
    ratio = spot.semi_major_px / spot.semi_minor_px
    if ratio > _ROUND_SPOT_RATIO:
        along_wall = points[1] - points[0]
        along_wall -= (along_wall @ normal) * normal
        along_wall /= np.linalg.norm(along_wall)
        tilt = min(np.arccos(1.0 / ratio), np.radians(_MAX_INCIDENCE_DEG))
        for side in (-1.0, 1.0):
            yield -np.cos(tilt) * normal + side * np.sin(tilt) * along_wall


_STEPS_FIRST = 14
_MIN_CELLS = 30  # cells of a first frame; it has sixteen states
_LOG_AMBIENT_RANGE = (
    -4.0,
    3.0,
)  # log of ambient light over the beam's power: nearly nothing is known
_CLEAR_SIGMAS = 3.0
"""Least light of the beam over the ambient one, from which the mixture of colours is chosen. Where
a lamp's reflection is as bright, the mixture that is even may lack the beam's colour."""
_OTHER_WALL = 1.5
"""Mean square of a first frame's residuals, above which its wall is not that of the reference."""
_MAX_AXIS_SIGMAS = 5.0  # standard deviations from the robot's axis that no pose has


def explained_alone(
    beam: BeamLight,
    noise: CameraNoise,
    reference: Reference | None,
    observation: Observation,
    spot: Outline,
) -> tuple[list[Hypothesis], Mix]:
    """Explain a frame by itself: the best explanation and others that are nearly as good, if any.

    They hold in the mixture of channels that is returned as well.

    Args:
        reference: the wall without the spot; None if there is no image of it.
    """

    def solver_for(mix: Mix, texture: TextureVariances) -> PoseSolver:
        known = None if reference is None else reference.known_in(mix)
        return PoseSolver(beam, window, texture, known)

    picture, direction, sweep, robot = observation
    window = CellWindow.around(np.array([spot.x_px, spot.y_px]), reach_px(spot, sharp=beam.sharp))
    mix = picture.plain_mix(spot)
    cells = picture.cells(mix)
    solver = solver_for(mix, TextureVariances.usual())
    own = np.zeros(beam.spread.shape[1])
    starts = scanned_starts(
        solver,
        lambda pose: FrameState(cells, pose, 0.0, 0.0, direction, _LOG_AMBIENT_RANGE, sweep, robot),
        spot,
        own,
        likely_axes(beam, spot) if direction is None else [direction.axis],
    )
    if beam.sharp and spot.edge_width_px >= _BLURRED_PX:
        # With the blurs that a sharp edge may have which looks as wide as the spot's.
        blurs = [(share * spot.edge_width_px**2, kurtosis) for kurtosis, share in _SHAPES]
        starts = [replace(s, blur_px2=b, kurtosis=k) for s in starts for b, k in blurs]
    found = [robust_fit(solver, [], start, own, steps=_STEPS_FIRST)[0] for start in starts]
    if not found:
        return [], mix
    best = min(found, key=lambda one: one.deviance)
    mirrored = mirrored_start(solver, best.frames[0], own)
    if mirrored is not None:
        found.append(robust_fit(solver, [], mirrored, own, steps=_STEPS_FIRST)[0])
    # Several starts may lead to one pose.
    found.sort(key=lambda one: one.deviance)
    found = [one for k, one in enumerate(found) if all(map(one.differs, found[:k]))]
    # Again with this wall's texture, in the channels in which it has the least.
    usable = picture.usable & ~window.pixels(outliers(best), picture.usable.shape)
    picture = replace(picture, usable=usable)
    if not beam.sharp:
        picture = without_tool(picture, beam, best.newest.pose)
    clear = contrast(best.lights[0], best.frames[0]) > _CLEAR_SIGMAS
    if clear and not (noise.sheet.jpeg or picture.saturated.any()):
        mix = evener_mix(picture.channels, usable, window, best, mix)
    cells = picture.cells(mix)
    found = [
        solver.solve([], replace(one.frames[0], cells=cells), own, steps=STEPS) for one in found
    ]
    best = min(found, key=lambda one: one.deviance)
    if np.count_nonzero(best.linear[0].weight) < _MIN_CELLS:
        return [], mix
    solver = solver_for(mix, learnt_texture(best))
    again = [robust_fit(solver, [], one.frames[0], own) for one in found]
    # A pose may explain the light by chance, but not against the robot.
    consistent = [one for one in again if one[0].frames[0].axis_off < _MAX_AXIS_SIGMAS]
    hypotheses = [
        Hypothesis(
            kept=[(one.frames[0], one.linear[0])],
            solution=one,
            learnt_px2=lit_px2(one),
            mean_square=mean_square,
            other_wall=mean_square > _OTHER_WALL,
        )
        for one, mean_square, _ in consistent or again
    ]
    return distinct(hypotheses), mix


def learnt_texture(solution: PoseSolution) -> TextureVariances:
    """The texture that all frames of a solution show."""
    return texture_of(
        *together(solution.linear), count=COUNT, side_mm=solution.solver.model.side_mm
    )
