"""Poses of some frames on one unknown wall, by Gauss-Newton with the wall's texture eliminated.

The logarithm of a cell's light in frame k is

    y_k = log g_k + log(B_k E(pose_k) + A_k) + m + noise,

with the gain g_k, the ambient light A_k, which may have a gradient, the image's blur B_k, and the
logarithm m of the cell's reflectance, which all frames share. m is a Gaussian process,
so it is eliminated exactly from the normal equations. A filter that keeps only each cell's mean and
variance would forget that the errors of map and poses hang together, and drift.

A `PoseSolution` has the frames' states, how well they are known, and the wall's map.
"""

import copy
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve, lapack, solve_triangular

from eyespot.estimator.information import Information
from eyespot.estimator.pixels.beam_on_cells import LEAST_KURTOSIS, MOST_KURTOSIS, BeamLight
from eyespot.estimator.pixels.frame_cells import COUNT, CellWindow
from eyespot.estimator.pixels.frame_model import (
    AMBIENT,
    BLUR,
    GAIN,
    OWN,
    SHADE,
    SHIFT,
    TAILS,
    FrameModel,
    FrameState,
    Linear,
    RobotMotion,
    robot_motions,
)
from eyespot.estimator.pixels.texture import TextureVariances
from eyespot.optics.wall_light.pose_light import POSE

Kept = list[tuple[FrameState, Linear]]
"""Earlier frames with their models, which are fitted again with each new one."""
_ONE_POSE_SIGMAS = 3.0  # standard deviations within which two poses are one
Factor = tuple[np.ndarray, bool]
"""A Cholesky factor, as `scipy.linalg.cho_factor` has it."""


@dataclass(frozen=True, eq=False)
class PoseSolution:
    """The states of all frames, and how well they are known.

    Attributes:
        solver: that found it, with the window and the wall's texture.
        earlier: frames with their states before; `change` is that of all states.
        newest: the newest frame with its new state.
        linear: models of all frames at their new states.
        own: changes of the beam's own parameters, see `BeamLight`.
        information: of all states: `OWN` of each frame, then the beam's own.
        cost: -2 log likelihood, up to a constant of the data.
        texture_map: log reflectance of the cells.
        factor: of the precision of this map.
    """

    solver: "PoseSolver"
    earlier: list[FrameState]
    change: Float[np.ndarray, "s"]
    newest: FrameState
    linear: list[Linear]
    own: Float[np.ndarray, "q"]
    information: Information
    cost: float
    texture_map: Float[np.ndarray, "n"]
    factor: Factor
    converged: bool

    @functools.cached_property
    def frames(self) -> list[FrameState]:
        """All frames with their new states; the newest is the last."""
        changes = self.change[: OWN * len(self.earlier)].reshape(-1, OWN)
        both = zip(self.earlier, changes, strict=True)
        return [*(self.solver.moved(one, by) or one for one, by in both), self.newest]

    @functools.cached_property
    def covariance(self) -> Float[np.ndarray, "s s"]:
        """Of all states."""
        return self.information.inverse()

    @functools.cached_property
    def deviance(self) -> float:
        """-2 log likelihood of all frames; an outlier has its price, too."""
        return self.solver.deviance(self.cost, self.linear, self.factor)

    @functools.cached_property
    def lights(self) -> Float[np.ndarray, "k n"]:
        """Irradiance of the cells per unit power, 1/mm², without motion and blur, by frame."""
        return self.solver.model.lights(self.frames, self.own)

    @functools.cached_property
    def log_lights(self) -> Float[np.ndarray, "k n"]:
        """Logarithm of the light over the gain, by frame, see `FrameModel.log_lights`."""
        return self.solver.model.log_lights(self.frames, self.lights)

    @functools.cached_property
    def drifts_px(self) -> Float[np.ndarray, "k 2"]:
        """How far the wall has moved in the image from the map's begin to each frame."""
        window = self.solver.window
        motions = [frame.cells.motion for frame in self.frames]
        return window.middles_after(motions) - window.middle_px

    @property
    def chi_squared(self) -> float:
        """Of all data given texture and noise, by their number; 1 where the model is right.

        The noise's part, and that of the map by the texture. Both are sums of squares, also where a
        weight has changed since the map was made.
        """
        total = sum(
            line.weight @ np.square(line.residual - self.texture_map) for line in self.linear
        )
        total += self.solver.texture_cost(self.texture_map)
        return float(total / max(sum(np.count_nonzero(line.weight) for line in self.linear), 1))

    @functools.cached_property
    def newest_covariance(self) -> Float[np.ndarray, "5 5"]:
        """Of the newest pose."""
        return self.newest_states(slice(POSE))

    @property
    def shown_covariance(self) -> Float[np.ndarray, "5 5"]:
        """The same as if the beam's own parameters were known: what the frames leave open."""
        if not len(self.own):
            return self.newest_covariance
        at, own = OWN * len(self.earlier), len(self.own)
        with_own = self.covariance[at : at + POSE, -own:]
        slopes = np.linalg.solve(self.covariance[-own:, -own:], with_own.T)
        return self.newest_covariance - with_own @ slopes

    def newest_states(self, states: slice) -> Float[np.ndarray, "k k"]:
        """Covariance of some of the newest frame's states."""
        at = OWN * len(self.earlier)
        newest = self.covariance[at : at + OWN, at : at + OWN]
        return newest[states, states]

    def differs(self, other: "PoseSolution") -> bool:
        """Whether the newest pose is another one."""
        mine, its = self.newest.pose, other.newest.pose
        turned = mine.axis - its.axis
        change = np.array([mine.distance - its.distance, turned @ its.first, turned @ its.second])
        sigmas = np.sqrt(np.diag(other.newest_covariance))[2:]
        return bool((np.abs(change) > _ONE_POSE_SIGMAS * sigmas).any())

    def answers(self, changes: Float[np.ndarray, "m k n"]) -> Float[np.ndarray, "m 5"]:
        """How the newest pose moves, by each of some changes of all frames' log light."""
        weights = np.stack([line.weight for line in self.linear])
        weighted = changes * weights
        texture_maps = solved(self.factor, weighted.sum(axis=1).T).T
        rest = weighted - weights * texture_maps[:, None]
        pulls = [rest[:, k] @ line.slopes.T for k, line in enumerate(self.linear)]
        shared = sum(rest[:, k] @ line.shared.T for k, line in enumerate(self.linear))
        at = OWN * len(self.earlier)
        states = np.concatenate([*pulls, shared], axis=1) @ self.covariance[at : at + POSE].T
        return np.asarray(states)

    def left_out(self, trust: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Residuals of the newest frame's cells against the other data, in standard deviations.

        Args:
            trust: factors on the weights of its cells, which are not taken for noise.
        """
        line = self.linear[-1]
        spread = 1.0 / inverse_diagonal(self.factor)
        rest = np.maximum(spread - line.weight, 1e-9 * spread)  # precision without this datum
        used = line.weight > 0
        mean = (spread * self.texture_map - line.weight * line.residual) / rest
        variance = 1.0 / rest + trust / np.where(used, line.weight, 1.0)
        return np.where(used, (line.residual - mean) / np.sqrt(variance), 0.0)


def together(
    lines: list[Linear],
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"], Float[np.ndarray, "p n"]]:
    """What frames say of the wall, as if they were one frame of many states.

    Residual, weight and derivatives, as `texture_of` takes them. How the frames differ from each
    other says nothing of the reflectance.
    """
    weight = np.sum([line.weight for line in lines], axis=0)
    shares = [line.weight / np.where(weight > 0, weight, 1.0) for line in lines]
    parts = list(zip(shares, lines, strict=True))
    residual = np.sum([share * line.residual for share, line in parts], axis=0)
    return residual, weight, np.concatenate([share * line.slopes for share, line in parts])


def solved(factor: Factor, values: np.ndarray) -> np.ndarray:
    """A positive definite system solved by the Cholesky factor of its matrix."""
    return cho_solve(factor, values, check_finite=False)


def inverse_diagonal(factor: Factor) -> Float[np.ndarray, "n"]:
    """Diagonal of a positive definite matrix's inverse, by its lower Cholesky factor."""
    inverse, _ = lapack.dtrtri(factor[0], lower=True)
    return np.square(np.tril(inverse)).sum(axis=0)


_DONE, _SMALL, _ROUGH = 0.1, 0.3, 0.6
"""In standard deviations: a shorter step ends the iteration; a last step as short is an answer, the
third where the spot is saturated: cells that come to full scale make the cost rough."""
_DAMPING = 1e-3
"""Share of a state's own information that is added to it at first, and at least after a step that
failed. It falls after each that succeeds: what frames tell only together, as their gains on a wall
that is not known, has far less information, and a damping that stays would hold it where it is."""


class PoseSolver:
    """Fits frames in one window.

    Args:
        reference: what an image without the spot says of a window's cells: information, and its
            product with the best guess of their log reflectance; None without such an image.
    """

    def __init__(
        self,
        beam: BeamLight,
        window: CellWindow,
        texture: TextureVariances,
        reference: Callable[[CellWindow], tuple[np.ndarray, np.ndarray]] | None = None,
        grain: Float[np.ndarray, "2 n"] | None = None,
    ) -> None:
        self.beam, self.window, self.texture = beam, window, texture
        self._reference = reference
        self.model = FrameModel(beam, window, texture, grain)
        self._precision = _precision(texture, self.model.side_mm)
        self._pull = np.zeros(COUNT**2)
        if reference is not None:
            information, self._pull = reference(window)
            self._precision = self._precision + information

    def at(self, window: CellWindow) -> "PoseSolver":
        """The solver of another window on the same wall."""
        return PoseSolver(self.beam, window, self.texture, self._reference)

    def of_texture(self, texture: TextureVariances) -> "PoseSolver":
        """The solver of the same window for another texture."""
        return PoseSolver(self.beam, self.window, texture, self._reference, self.model.grain)

    def with_map(self, texture_map: Float[np.ndarray, "n"] | None) -> "PoseSolver":
        """This solver, whose models take the wall's grain from a map; from none, if it is None."""
        grain = None
        if texture_map is not None:
            down, right = np.gradient(texture_map.reshape(COUNT, COUNT), self.window.side)
            grain = np.stack([right.ravel(), down.ravel()])
        # Not made anew, because that takes as long as a frame.
        fresh = copy.copy(self)
        fresh.model = FrameModel(self.beam, self.window, self.texture, grain)
        return fresh

    def with_map_of(self, kept: Kept) -> "PoseSolver":
        """The same with the map that frames show."""
        lines = [line for _, line in kept]
        return self.with_map(self._map(lines, self._factor(lines)))

    def known(self, lines: list[Linear]) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Log reflectance of the cells by frames, and its variance."""
        factor = self._factor(lines)
        return self._map(lines, factor), inverse_diagonal(factor)

    def solve(
        self,
        kept: Kept,
        frame: FrameState,
        own: Float[np.ndarray, "q"],
        *,
        steps: int,
        trust: Float[np.ndarray, "n"] | float = 1.0,
        line: Linear | None = None,
    ) -> PoseSolution:
        """Iterate from the frames' states.

        The loop is its own: a step ends where a blur is impossible, only the newest frame is
        modelled anew, and the cost contains the eliminated map.

        Args:
            kept: earlier frames with their models, which change little and stay linear.
            trust: factors on the weights of the newest frame's cells.
            line: its model, with all trust, where it is known already.
        """
        frames = [*(state for state, _ in kept), frame]
        newest, size = len(kept), OWN * (len(kept) + 1) + len(own)
        blur = OWN * newest + BLUR
        change, damping, converged = np.zeros(size), _DAMPING, False
        line = self.model.linear(frame, own) if line is None else line
        lines = [*(line for _, line in kept), line._replace(weight=line.weight * trust)]
        motions = robot_motions(frames) if kept else []
        hessian, gradient, cost, factor = self._system(frames, lines, motions, own, change)
        information = Information(hessian)
        small = _ROUGH if frame.cells.saturated else _SMALL
        for _ in range(steps):
            # How far the minimum is, the step without damping says: one with it is always short.
            limits = {
                blur: (-frame.blur_px2, np.inf),  # no image is sharper than sharp
                blur + 1: (LEAST_KURTOSIS - frame.kurtosis, MOST_KURTOSIS - frame.kurtosis),
            }
            step, damped = (
                information.solved_within(gradient, one, limits) for one in (0.0, damping)
            )
            distance = float(np.sqrt(step @ hessian @ step / size))
            if distance >= _DONE:
                step = damped
            moved = self.moved(frame, step[OWN * newest : OWN * (newest + 1)])
            if distance < _DONE and moved is not None:
                # So near, the model is linear.
                lines = [_shifted(line, step, k, size) for k, line in enumerate(lines)]
                cost -= float(2.0 * step @ gradient - step @ hessian @ step)
                frame, own, change = moved, own + step[size - len(own) :], change + step
                frames[-1], converged = frame, True
                break
            trial = None
            if moved is not None:
                new_own = own + step[size - len(own) :]
                # With the weights of before, so that costs compare.
                trial = [_shifted(line, step, k, size) for k, line in enumerate(lines[:-1])]
                fresh = self.model.linear(moved, new_own)
                trial.append(fresh._replace(weight=lines[-1].weight))
                here = change + step
                here[OWN * newest : OWN * (newest + 1)] = 0.0
                then = [*frames[:-1], moved]
                new_motions = motions
                if kept:
                    new_motions = [*motions[:-1], *robot_motions([frames[0], moved])]
                new_cost = self._cost(then, trial, new_motions, new_own, here, factor)
            if trial is None or not new_cost <= cost + 1e-9 * abs(cost):
                if distance < small:
                    converged = True  # at the minimum, within what the derivatives are good for
                    break
                damping = max(10 * damping, _DAMPING)
                if damping > 1e6:
                    break
                continue
            assert moved is not None
            frame, own, change = moved, new_own, here
            damping *= 0.1
            fresh = fresh._replace(weight=fresh.weight * trust)
            frames[-1], lines, motions = frame, [*trial[:-1], fresh], new_motions
            hessian, gradient, cost, factor = self._system(frames, lines, motions, own, change)
            information = Information(hessian)
            converged = distance < small
        return PoseSolution(
            solver=self,
            earlier=frames[:-1],
            change=change,
            newest=frame,
            linear=lines,
            own=own,
            information=information,
            cost=cost,
            texture_map=self._map(lines, factor),
            factor=factor,
            converged=converged,
        )

    def texture_cost(self, texture_map: Float[np.ndarray, "n"]) -> float:
        """Square of a map's deviation from what is known of the wall before any frame."""
        off = texture_map
        if self._reference is not None:
            off = off - solved(cho_factor(self._precision, lower=True), self._pull)
        return float(off @ self._precision @ off)

    def deviance_of(self, kept: Kept, own: Float[np.ndarray, "q"]) -> float:
        """-2 log likelihood of frames at their states, whatever the wall's texture is."""
        frames, lines = [state for state, _ in kept], [line for _, line in kept]
        factor = self._factor(lines)
        change = np.zeros(OWN * len(kept) + len(own))
        cost = self._cost(frames, lines, robot_motions(frames), own, change, factor)
        return self.deviance(cost, lines, factor)

    def deviance(self, cost: float, lines: list[Linear], factor: Factor) -> float:
        """The same of frames with this cost and this factor of the map's precision."""
        # The determinant of the data's covariance, by that of the map's precision.
        noise = -sum(float(np.sum(np.log(line.weight[line.weight > 0]))) for line in lines)
        return cost + noise + _log_determinant(factor) - self._prior_log_determinant

    @functools.cached_property
    def _prior_log_determinant(self) -> float:
        return _log_determinant(cho_factor(self._precision, lower=True))

    def _system(
        self,
        frames: list[FrameState],
        lines: list[Linear],
        motions: list[RobotMotion | None],
        own: np.ndarray,
        change: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, float, Factor]:
        """Hessian of all states, gradient downhill, cost, and the factor of the map's precision."""
        size = change.size
        factor = self._factor(lines)
        cross = np.zeros((size, COUNT**2))
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        texture_map = self._map(lines, factor)
        for k, (frame, line) in enumerate(zip(frames, lines, strict=True)):
            at = np.r_[OWN * k : OWN * (k + 1), size - len(own) : size]
            slopes = np.concatenate([line.slopes, line.shared])
            weighted = slopes * line.weight
            hessian[np.ix_(at, at)] += weighted @ slopes.T
            gradient[at] += weighted @ (line.residual - texture_map)
            cross[at] += weighted
            prior, mine = frame.prior, slice(OWN * k, OWN * (k + 1))
            hessian[mine, mine] += prior.precision
            gradient[mine] += prior.pull - prior.precision @ change[mine]
        for k, motion in _motions_after(motions, change):
            slopes = np.concatenate([motion.first_slopes, motion.slopes], axis=1)
            weighted = slopes.T * motion.weight
            at = np.r_[:POSE, OWN * k : OWN * k + POSE]
            hessian[np.ix_(at, at)] += weighted @ slopes
            gradient[at] += weighted @ motion.rest
        half = solve_triangular(factor[0], cross.T, lower=True, check_finite=False)
        hessian -= half.T @ half
        last = np.arange(size - len(own), size)
        hessian[last, last] += 1.0
        gradient[last] -= own
        return hessian, gradient, self._cost(frames, lines, motions, own, change, factor), factor

    def _map(self, lines: list[Linear], factor: Factor) -> np.ndarray:
        """Log reflectance of the cells by frames."""
        return solved(factor, self._weighted(lines))

    def _weighted(self, lines: list[Linear]) -> np.ndarray:
        return self._pull + np.sum([line.weight * line.residual for line in lines], axis=0)

    def _factor(self, lines: list[Linear]) -> Factor:
        """Cholesky factor of the precision of the map by frames."""
        weight = np.sum([line.weight for line in lines], axis=0)
        precision = self._precision.copy()
        precision[np.diag_indices(COUNT**2)] += weight
        return cho_factor(precision, lower=True, overwrite_a=True, check_finite=False)

    def _cost(
        self,
        frames: list[FrameState],
        lines: list[Linear],
        motions: list[RobotMotion | None],
        own: np.ndarray,
        change: np.ndarray,
        factor: Factor,
    ) -> float:
        weighted = self._weighted(lines)
        cost = float(sum(line.weight @ np.square(line.residual) for line in lines))
        cost -= float(weighted @ solved(factor, weighted))
        for k, frame in enumerate(frames):
            here = change[OWN * k : OWN * (k + 1)]
            prior = frame.prior
            cost += prior.cost + float(here @ prior.precision @ here - 2.0 * prior.pull @ here)
        cost += sum(motion.cost for _, motion in _motions_after(motions, change))
        return float(cost + own @ own)

    def moved(self, frame: FrameState, change: np.ndarray) -> FrameState | None:
        """A frame after a change of its states; None if such a frame is impossible."""
        turns = np.abs(change[3:POSE]).max()
        if not (frame.pose.distance + change[2] > 0 and turns < 0.5):
            return None
        if not np.abs(change[[GAIN, AMBIENT]]).max() < 5.0:
            return None
        pose = frame.pose.moved_on(self.beam.wall, change)
        if pose is None:
            return None
        return replace(
            frame,
            pose=pose,
            log_gain=frame.log_gain + change[GAIN],
            log_ambient=frame.log_ambient + change[AMBIENT],
            shade=tuple(np.add(frame.shade, change[SHADE]).tolist()),
            blur_px2=max(frame.blur_px2 + float(change[BLUR]), 0.0),  # not less by rounding
            kurtosis=frame.kurtosis + float(change[TAILS]),
            shift=tuple(np.add(frame.shift, change[SHIFT]).tolist()),
        )


@functools.lru_cache(maxsize=8)
def _precision(texture: TextureVariances, side_mm: float) -> Float[np.ndarray, "n n"]:
    """Of the cells' log reflectance before any frame. A window of the same cells has the same."""
    covariance = texture.covariance(COUNT, side_mm)
    return solved(cho_factor(covariance, lower=True), np.eye(COUNT**2))


def _log_determinant(factor: Factor) -> float:
    return 2.0 * float(np.sum(np.log(np.diag(factor[0]))))


def _shifted(line: Linear, step: np.ndarray, k: int, size: int) -> Linear:
    """A linear model after a step of all states."""
    own = step[OWN * k : OWN * (k + 1)]
    shared = step[size - len(line.shared) :]
    return line._replace(residual=line.residual - own @ line.slopes - shared @ line.shared)


def _motions_after(
    motions: list[RobotMotion | None], change: np.ndarray
) -> Iterator[tuple[int, RobotMotion]]:
    """What the robot says, by the frame's number, after changes of the states."""
    for k, motion in enumerate(motions, 1):
        if motion is not None:
            yield k, motion.after(change[OWN * k : OWN * k + POSE], change[:POSE])
