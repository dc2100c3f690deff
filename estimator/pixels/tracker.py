"""Tip and axis of the beam, frame by frame, from all pixels of the spot.

The wall is learnt while it is looked at: a few earlier frames are kept, and the newest one is
fitted together with them (`solver`). The first is always among them, because a chain of frames that
forgets its beginning drifts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.distance import Range, RangeFlag, WallMemory
from estimator.image import CameraNoise, Outline
from estimator.pixels.beam import POSE, BeamLight, Sweep
from estimator.pixels.belief import Belief, distinct
from estimator.pixels.cells import COUNT, CellLight, Window
from estimator.pixels.drift import shake_covariance
from estimator.pixels.frame_fit import (
    STEPS,
    far_moved,
    fit_wherever,
    moved,
    robust_fit,
    unlike_wall,
)
from estimator.pixels.frame_state import Direction, FrameState, Linear
from estimator.pixels.mix import Mix, evener_mix
from estimator.pixels.picture import Picture
from estimator.pixels.reference import Reference
from estimator.pixels.registration import farthest_px
from estimator.pixels.robot import RobotPose
from estimator.pixels.solution import Solution
from estimator.pixels.solver import Solver
from estimator.pixels.starts import (
    blurred_starts,
    likely_directions,
    mirrored_start,
    scanned_starts,
)
from estimator.pixels.texture import Texture, texture_of
from estimator.pixels.verdict import flag_of, range_of
from estimator.pixels.wall_motion import WallMotion

_REACH = (2.0, 1.2)
"""Of the window over the half-maximum ellipse, for light without and with a sharp edge: farther out
there is hardly any light. The smaller the cells, the less texture averages out within them."""
_BESIDE_PX, _BESIDE_EDGE = 6.0, 2.5  # beside it, px, and in widths of the edge
_KEPT = 6  # earlier frames
_NEW = 0.25  # shift over the spot's radius that makes a frame worth keeping
_GROWN = 0.07  # change of the distance's logarithm that does
_STEPS_FIRST = 14
_FEWEST = 30  # cells of a first frame; it has sixteen states
_ANEW = 3  # fits of a frame, if it moves the earlier ones far
_AMBIENT = (-4.0, 3.0)  # log of ambient light over the beam's power: nearly nothing is known
_AMBIENT_STAYS = 0.2  # standard deviation of its logarithm from frame to frame
_CLEAR = 3.0
"""Least light of the beam over the ambient one, from which the mixture of colours is chosen. Where
a lamp's reflection is as bright, the mixture that is even may lack the beam's colour."""
_SURPRISE = 1.5
"""Square of a first frame's surprise, above which its wall is not that of the reference."""
_OTHER_DISTANCES = (0.85, 1.0, 1.18)  # over the last one, from which a frame may start
_DRIFTED_PX = 1.0  # of the wall since the first frame, which is worth a word
_AGAINST = 5.0  # standard deviations from the robot's axis that no pose has
_LIKE_LAST = 1.5  # ratio of areas within which an outline may be that of the last frame


class _Look(NamedTuple):
    """A frame, and what the robot says of it; see `PoseTracker.read`."""

    picture: Picture
    direction: Direction | None
    sweep: Sweep | None
    robot: RobotPose | None


class PoseTracker:
    """Follows the pose of one beam.

    Args:
        beam: its light.
        noise: of the camera.
        reference: the wall without the spot; None if there is no image of it.
        shake_px: least standard deviation of the image's shake along each side, px.
    """

    def __init__(
        self,
        beam: BeamLight,
        noise: CameraNoise,
        reference: Reference | None = None,
        *,
        shake_px: float = 0.0,
    ) -> None:
        self.beam, self.noise, self._shake_px = beam, noise, shake_px
        self._reference = reference
        self._beliefs: list[Belief] = []
        self._last: Outline | None = None  # in the last frame with a pose
        self._mix: Mix | None = None
        self._shaken = np.zeros((POSE, POSE))  # what the first frame's shake does, per px²
        self._drift = np.zeros(2)  # of the view, px, by the maps that were forgotten
        self._unknown_px = 0.0  # what it may have drifted since, if no map was found again

    def forget(self) -> None:
        """Start anew with the next frame, on a wall that is not known."""
        if self._beliefs:
            self._drift = self._drift + self._beliefs[0].drift(self._beliefs[0].newest)
        self._beliefs = []

    def read(
        self,
        image: np.ndarray,
        outlines: Sequence[Outline],
        direction: Direction | None = None,
        sweep: Sweep | None = None,
        robot: RobotPose | None = None,
    ) -> Range:
        """The pose in the next frame, or why there is none.

        Args:
            image: H x W x 3.
            outlines: where the spot is, see `detector.outlines_of`.
            direction: of the beam, from the robot.
            sweep: motion during the exposure, from the robot; None if unknown.
            robot: where the robot says the tool is; None if it does not.
        """
        look = _Look(Picture.of(image, self.noise), direction, sweep, robot)
        if any(outline.measured for outline in outlines):
            return self._read_spot(look, outlines[0])
        return self._read_unmeasured(look, outlines)

    def _read_spot(self, look: _Look, outline: Outline) -> Range:
        """The pose of a measured spot."""
        look = self._shown(look, outline)
        flag, wall = RangeFlag.NOT_CONVERGED, WallMemory.NEW
        if self._beliefs:
            flag, wall = self._followed(look, outline)
        if flag is not RangeFlag.NONE:
            # Where the past does not explain the frame, it may be wrong.
            wall = WallMemory.DROPPED if self._beliefs else WallMemory.NEW
            if self._beliefs:
                self._reference = None  # nor does it
            self.forget()
            flag = self._begun(look, outline)
            if self._reference is not None:
                wall = WallMemory.KNOWN
                if flag is not RangeFlag.NONE or self._beliefs[0].lost:
                    self._reference, wall = None, WallMemory.DROPPED
                    flag = self._begun(look, outline)
        if flag is not RangeFlag.NONE:
            self.forget()
            return _missing(flag, wall)
        return self._range(wall, outline)

    def _read_unmeasured(self, look: _Look, outlines: Sequence[Outline]) -> Range:
        """The pose of a spot that was not measured, if earlier frames explain the light."""
        before = self._beliefs
        if not before or self._last is None:
            return _missing(RangeFlag.NOT_CONVERGED, WallMemory.NEW)
        outline = _like(self._last, outlines)
        flag, wall = self._followed(self._shown(look, outline), outline)
        if flag is RangeFlag.NONE:
            return self._range(wall, outline)
        self._beliefs = before
        return _missing(flag, wall)

    def _shown(self, look: _Look, outline: Outline) -> _Look:
        """The frame without what hides the spot, where that can be told."""
        if not self.beam.sharp:
            return look
        return look._replace(picture=look.picture.with_sharp(outline))

    def _followed(self, look: _Look, outline: Outline) -> tuple[RangeFlag, WallMemory]:
        """Explain a frame by the earlier ones: why that failed, if so, and what the wall did."""
        followed = self._follow(look, outline)
        if not followed:
            return RangeFlag.NOT_CONVERGED, WallMemory.DROPPED
        self._beliefs = followed
        best = followed[0]
        wall = WallMemory.MOVED if best.drifted_px > _DRIFTED_PX else WallMemory.KNOWN
        flag = flag_of(best, outline)
        if flag is RangeFlag.NONE and best.lost:
            flag = RangeFlag.MISFIT  # of the wall that was learnt
        return flag, wall

    def _begun(self, look: _Look, outline: Outline) -> RangeFlag:
        """Explain a frame by itself: why that failed, if so."""
        self._begin(look, outline)
        flag = flag_of(self._beliefs[0] if self._beliefs else None, outline)
        if flag is RangeFlag.NONE:
            best = self._beliefs[0]
            self._shaken = shake_covariance(best.solver, best.solution)
        return flag

    def _range(self, wall: WallMemory, outline: Outline) -> Range:
        best, *others = self._beliefs
        self._last = outline if outline.measured else best.outline
        if wall is WallMemory.DROPPED:
            self._unknown_px = max(self._unknown_px, farthest_px(best.solver.window))
        return range_of(
            best,
            tuple(float(one.newest.pose.distance) for one in others),
            wall,
            shake_px=self._shake_px,
            shaken=self._shaken,
            drift_px=self._drift,
            unknown_px=self._unknown_px,
        )

    def _begin(self, look: _Look, spot: Outline) -> None:
        """Explain a frame by itself."""
        picture, direction, sweep, robot = look
        window = Window.around(np.array([spot.x_px, spot.y_px]), self._reach(spot))
        mix = picture.plain_mix(spot)
        cells = picture.cells(mix)
        solver = Solver(self.beam, window, Texture.usual(), self._known(mix))
        own = np.zeros(self.beam.spread.shape[1])
        starts = scanned_starts(
            solver,
            lambda pose: FrameState(cells, pose, 0.0, 0.0, direction, _AMBIENT, sweep, robot),
            spot,
            own,
            likely_directions(self.beam, spot, direction),
        )
        if self.beam.sharp:
            starts = [blurred for start in starts for blurred in blurred_starts(start, spot)]
        found = [robust_fit(solver, [], start, own, steps=_STEPS_FIRST)[0] for start in starts]
        if not found:
            self._beliefs = []
            return
        best = min(found, key=solver.unlikelihood_of)
        mirrored = mirrored_start(solver, best.frames[0], own)
        if mirrored is not None:
            found.append(robust_fit(solver, [], mirrored, own, steps=_STEPS_FIRST)[0])
        # Again with this wall's texture, in the channels in which it has the least.
        usable = picture.usable & ~window.pixels(unlike_wall(solver, best), picture.usable.shape)
        picture = replace(picture, usable=usable)
        clear = solver.model.contrast(best.frames[0], best.own) > _CLEAR
        if clear and not (self.noise.coarse_colours or picture.saturated.any()):
            mix = evener_mix(picture.channels, usable, window, best, mix)
        self._mix = mix
        cells = picture.cells(mix)
        found = [
            solver.solve([], replace(one.frames[0], cells=cells), own, steps=STEPS) for one in found
        ]
        line = min(found, key=solver.unlikelihood_of).linear[0]
        if np.count_nonzero(line.weight) < _FEWEST:
            self._beliefs = []
            return
        texture = texture_of(
            line.residual, line.weight, line.slopes, count=COUNT, side_mm=solver.model.side_mm
        )
        solver = Solver(self.beam, window, texture, self._known(mix))
        again = [robust_fit(solver, [], one.frames[0], own) for one in found]
        # A pose may explain the light by chance, but not against the robot.
        as_told = [one for one in again if one[0].frames[0].axis_off < _AGAINST]
        again = as_told or again
        self._beliefs = distinct(
            [
                Belief(
                    solver=solver,
                    kept=[(one.frames[0], one.linear[0])],
                    solution=one,
                    surprise=surprise.square,
                    lost=surprise.square > _SURPRISE,
                )
                for one, surprise in again
            ]
        )

    def _known(self, mix: Mix) -> Callable[[Window], tuple[np.ndarray, np.ndarray]] | None:
        """What the reference says of the wall in a mixture of channels."""
        return None if self._reference is None else self._reference.seen_in(mix).known

    def _follow(self, look: _Look, spot: Outline) -> list[Belief]:
        """Explanations of a frame together with earlier ones."""
        picture, _, sweep, robot = look
        assert self._mix is not None and self._last is not None
        mix, last = self._mix, np.array([self._last.x_px, self._last.y_px])

        def cells(motion: WallMotion) -> CellLight:
            return picture.cells(mix, motion)

        centre, reach = np.array([spot.x_px, spot.y_px]), self._reach(spot)
        point = self.beam.wall_points(centre[None])[0][0]
        followed = []
        for belief in self._beliefs:
            solver, kept, own = belief.solver, belief.kept, belief.solution.own
            motion = belief.expected_motion
            on_map, texture_map = motion.map_px(centre), belief.solution.texture_map
            before = belief.newest.cells.motion.map_px(last)
            window = solver.window.following(on_map, reach, on_map - before)
            if window != solver.window:
                solver, kept = moved(solver, window, kept, own)
                texture_map, _ = solver.known([line for _, line in kept])
            start = self._start(belief.newest, solver, cells(motion), point, own, sweep)
            if start is None:
                continue
            start = replace(
                start,
                grain=solver.grain(texture_map),
                shift_sigma=math.hypot(belief.shift_sigma_px, math.sqrt(2.0) * self._shake_px),
                # Where the microscope drifts, the eye frame moves against the robot.
                robot=robot if belief.drifted_px < _DRIFTED_PX else None,
            )
            for _ in range(_ANEW):
                found, surprise, lost = fit_wherever(
                    solver, kept, start, own, cells, usual=belief.surprise
                )
                fresh = far_moved(solver, kept, found)
                if fresh is None or lost:
                    break
                kept, start, own = fresh, found.frames[-1], found.own
            followed.append(
                Belief(
                    solver=solver,
                    kept=self._kept(solver, found, kept),
                    solution=found,
                    surprise=surprise,
                    lost=lost,
                    step=found.frames[-1].cells.motion.since(belief.newest.cells.motion),
                    shake_before_px=belief.shake_px,
                )
            )
        return distinct(followed)

    def _start(
        self,
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
            pose = self.beam.pose(point - factor * last.pose.distance * axis, axis)
            if pose is not None:
                frame = replace(
                    last, cells=cells, pose=pose, direction=None, ambient_prior=prior, sweep=sweep
                )
                found.append(solver.model.scanned(frame, own))
        best = min(filter(None, found), key=lambda one: one[1], default=None)
        return None if best is None else replace(best[0], log_ambient=last.log_ambient)

    def _kept(
        self, solver: Solver, solution: Solution, before: list[tuple[FrameState, Linear]]
    ) -> list[tuple[FrameState, Linear]]:
        """The kept frames, with the newest if it shows the wall in another light."""
        *kept, newest = zip(solution.frames, solution.linear, strict=True)
        # A fit that trusts them less does so for its own frame.
        kept = [
            (state, line._replace(weight=old.weight))
            for (state, line), (_, old) in zip(kept, before, strict=True)
        ]
        pose = newest[0].pose
        radius = 0.5 * COUNT * solver.model.side_mm / _REACH[self.beam.sharp]
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

    def _reach(self, spot: Outline) -> float:
        """From the spot's centre, px, to where there is hardly any light."""
        beside = _BESIDE_PX + _BESIDE_EDGE * spot.edge_width_px * self.beam.sharp
        return _REACH[self.beam.sharp] * spot.semi_major_px + beside


def _missing(flag: RangeFlag, wall: WallMemory) -> Range:
    return Range(distance_mm=math.nan, sigma_mm=math.nan, missing=flag, wall=wall)


def _like(last: Outline, outlines: Sequence[Outline]) -> Outline:
    """The outline that may be the last one's, or else that itself."""

    def way(outline: Outline) -> float:
        return math.hypot(outline.x_px - last.x_px, outline.y_px - last.y_px)

    def alike(outline: Outline) -> bool:
        size = outline.semi_major_px * outline.semi_minor_px
        ratio = size / (last.semi_major_px * last.semi_minor_px)
        return 1.0 / _LIKE_LAST < ratio < _LIKE_LAST and way(outline) < last.semi_major_px

    return min(filter(alike, outlines), key=way, default=last._replace(measured=False))
