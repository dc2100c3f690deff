"""The model of one frame: its states, its light on the cells of a window, and the priors.

`solver` has the formula, `texture` the wall's part in it. The model is made from three parts, in
this order:

- The robot knows its own motion much better than where the eye is and how the fibre sits in the
  tool. So the first frame of a wall may be anywhere, and the others are where the robot moved from
  there.
- Within a saturated spot every pixel is at full scale, whatever the light is. A cell at the sharp
  edge of such a spot is as bright as the share of it that the spot covers. Pixels that the edge
  cuts are at full scale as well if a part of them is enough for that, so the spot looks larger.
- The states of a frame are its pose, gain, ambient light and blur, each with its prior.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter
from scipy.spatial.transform import Rotation

from eyespot.estimator.pixels.beam_on_cells import BeamLight, Sweep, blurred_each
from eyespot.estimator.pixels.frame_cells import COUNT, SHADES, CellLight, CellWindow, rolled
from eyespot.estimator.pixels.texture import TextureVariances
from eyespot.optics.wall_light.pose_light import POSE, BeamFrame

_FRAME_ERROR = 0.02
"""Relative error of a motion in the eye's frame, for an `eye_from_robot` that is 1 degree off."""
_TURN_SIGMA_RAD = math.radians(0.05)  # error of the robot's own turn
_ROBOT_FREEDOM = 10.0  # of Student's distribution: a robot that is wrong loses its weight


class RobotPose(NamedTuple):
    """The tool, in the middle of an exposure.

    Attributes:
        tip: place of the tip, mm, in axes along the eye frame's.
        axis: direction of the beam by the tool's, which may be off by some degrees, but always
            alike as long as the tool does not roll.
        sigma: standard deviation of `tip`, mm, by the robot and its clock.
    """

    tip: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    sigma: float


class RobotMotion(NamedTuple):
    """The robot's motion between two frames, less that of the hypothesis.

    Attributes:
        rest: of the change of the tip, mm, and of two turns of the axis, rad.
        slopes: derivatives of the hypothesis by the later pose.
        precision: 1 over the variances of `rest`.
    """

    rest: Float[np.ndarray, "5"]
    slopes: Float[np.ndarray, "5 5"]
    first_slopes: Float[np.ndarray, "5 5"]
    precision: Float[np.ndarray, "5"]

    def after(self, by: Float[np.ndarray, "5"], by_first: Float[np.ndarray, "5"]) -> "RobotMotion":
        """After small changes of the two poses."""
        rest = self.rest - self.slopes @ by - self.first_slopes @ by_first
        return self._replace(rest=rest)

    @property
    def cost(self) -> float:
        """-2 log likelihood, up to a constant."""
        return float(_ROBOT_FREEDOM * math.log1p(self._chi_squared / _ROBOT_FREEDOM))

    @property
    def weight(self) -> Float[np.ndarray, "5"]:
        """`precision`, less where the robot is wrong."""
        return self.precision / (1.0 + self._chi_squared / _ROBOT_FREEDOM)

    @property
    def _chi_squared(self) -> float:
        return float(self.precision @ np.square(self.rest))


def motion_between(
    first: tuple[BeamFrame, RobotPose | None], later: tuple[BeamFrame, RobotPose | None]
) -> RobotMotion | None:
    """The motion between two frames with their poses; None if the robot says nothing of one."""
    (pose_0, robot_0), (pose, robot) = first, later
    if robot_0 is None or robot is None:
        return None
    motions = robot.tip - robot_0.tip
    least, _ = Rotation.align_vectors(robot.axis, robot_0.axis)
    turn, angle = least.as_matrix(), least.magnitude()
    across = np.stack([pose.first, pose.second])
    rest = np.concatenate(
        [motions - (pose.tip - pose_0.tip), across @ (turn @ pose_0.axis - pose.axis)]
    )
    first_slopes = np.zeros((POSE, POSE))
    first_slopes[:3] = -pose_0.slopes[:3]
    first_slopes[3:, 3:] = -across @ turn @ np.stack([pose_0.first, pose_0.second], axis=-1)
    place = math.hypot(robot.sigma, robot_0.sigma, _FRAME_ERROR * float(np.linalg.norm(motions)))
    return RobotMotion(
        rest=rest,
        slopes=pose.slopes,
        first_slopes=first_slopes,
        precision=np.repeat([place, math.hypot(_TURN_SIGMA_RAD, _FRAME_ERROR * angle)], [3, 2])
        ** -2.0,
    )


def robot_motions(frames: Sequence["FrameState"]) -> list[RobotMotion | None]:
    """What the robot says of the later frames and the first one."""
    first, *later = frames
    return [motion_between((first.pose, first.robot), (one.pose, one.robot)) for one in later]


_BLOOM_PX, BLOOM_SIGMA_PX = 0.45, 0.1
"""How far the edge of a saturated spot is outside of the spot's, px, and its standard deviation. An
edge cuts 1.27 pixels per pixel of its length, in the mean over all directions. Light of r full
scales fills each of them of which it covers 1/r, so that the edge is 0.64 (1 - 1/r) too far
outside: between 0.3 and 0.6 for any r above 2."""
CUT = 0.3  # error of a pixel that such an edge cuts, over the step: those of 0 and 1 are alike
_WHOLLY_COVERED = 0.98  # share of a cell that is saturated, above which no light of it is seen
_MIN_LIGHT = 1e-9  # 1/mm²


def covered(
    light: Float[np.ndarray, "n"],
    room: Float[np.ndarray, "n"],
    slopes: Float[np.ndarray, "k n"] | None = None,
    *,
    pixel_mm: float = 0.0,
) -> tuple[
    Float[np.ndarray, "n"], Bool[np.ndarray, "n"], Float[np.ndarray, "n"], Float[np.ndarray, "k n"]
]:
    """The light of a beam as far as a camera shows it.

    Args:
        light: per unit power, 1/mm².
        room: light that takes a cell to full scale.
        slopes: derivatives of the light, the first two by shifts of the spot along the wall, mm.
            Without them, the edge is where the spot's is.
        pixel_mm: side of a pixel on the wall.

    Returns:
        This light; whether a cell or one beside it is at full scale; the share of such a cell that
        the spot covers, 0 for others; and the derivatives of this light.
    """
    # For each cell the number of the brightest of it and those around it.
    numbers = np.pad(np.arange(light.size).reshape(COUNT, COUNT), 1, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(numbers, (3, 3))
    near = windows.reshape(light.size, 9)
    brightest = near[np.arange(light.size), np.argmax(light[near], axis=1)]
    full = np.maximum(light[brightest], _MIN_LIGHT)
    over = (full > room) & (room > 0)
    cover = np.where(over, light / full, 0.0)
    if slopes is None:
        return np.where(over, room * cover, light), over, cover, np.zeros((0, light.size))
    by_state = (slopes - cover * slopes[:, brightest]) / full
    bloom = _BLOOM_PX * pixel_mm * np.hypot(*by_state[:2])
    cover = np.where(over, np.minimum(cover + bloom, 1.0), 0.0)
    slopes = np.where(over, room * by_state, slopes)
    return np.where(over, room * cover, light), over, cover, slopes


def halo(light: Float[np.ndarray, "n"], lit: Bool[np.ndarray, "n"]) -> float:
    """Light beside a spot over that farther away, in which no tool and no vessel counts."""
    spot, grid = lit.reshape(COUNT, COUNT), light.reshape(COUNT, COUNT)
    edge, beside = (binary_dilation(spot, iterations=cells) for cells in (1, 3))
    near, deviations = grid[beside & ~edge], grid[~beside]
    return (
        float(np.median(near) / max(np.median(deviations), _MIN_LIGHT))
        if near.size and deviations.size
        else 1.0
    )


GAIN, AMBIENT, SHADE, BLUR, TAILS = POSE, POSE + 1, slice(POSE + 2, POSE + 7), POSE + 7, POSE + 8
SHIFT = slice(POSE + 9, POSE + 11)
OWN = POSE + 11
"""States of a frame: those of its pose, log gain, log ambient light and its shading by `SHADES`,
the variance of the blur, px², its excess kurtosis, and how far the wall has moved to the right and
downwards in the image, px."""
_SHADE = np.array([0.5, 0.5, 0.3, 0.3, 0.3])
"""Standard deviations. A film of water that reflects a lamp adds a bump to the ambient light."""
_BLUR_PX2 = 2.0
"""Half width of the Cauchy distribution of the blur's variance. Most images are in focus, at NA
0.05 within 0.4 mm. Nobody knows how far the others are out of focus."""
_SATURATED_PX2 = 0.02
"""Standard deviation of that variance where the spot is saturated: its blur cannot be separated
from its size there, and counts as part of what makes it look larger (`covered`)."""
_KURTOSIS_SIGMA = 1.0  # standard deviation of the blur's excess kurtosis; a disc has -1


class Direction(NamedTuple):
    """What the robot says about the beam: a unit vector and its standard deviation, rad."""

    axis: Float[np.ndarray, "3"]
    sigma: float


class Linear(NamedTuple):
    """A frame's model at its state on the cells of a window.

    Attributes:
        residual: log of the measured light, less its model.
        slopes: derivatives of the model by the frame's states.
        weight: 1 over the variance; 0 for cells that are not used.
    """

    residual: Float[np.ndarray, "n"]
    slopes: Float[np.ndarray, "16 n"]
    shared: Float[np.ndarray, "q n"]
    weight: Float[np.ndarray, "n"]

    def after(self, right: int, down: int) -> "Linear":
        """The model after the window has moved by some cells; new cells have no weight."""
        rows = rolled(np.vstack(self), right, down)
        shared = 1 + len(self.slopes)
        return Linear(rows[0], rows[1:shared], rows[shared:-1], rows[-1])


class StatePrior(NamedTuple):
    """What is known of a frame's states before it is seen.

    Attributes:
        precision: of the states.
        pull: towards their means.
        cost: -2 log of their probability, up to a constant.
    """

    precision: Float[np.ndarray, "s s"]
    pull: Float[np.ndarray, "s"]
    cost: float


@dataclass(frozen=True, eq=False)
class FrameState:
    """A frame and its states.

    Attributes:
        log_gain: of full wells over irradiance per unit power, mm².
        log_ambient: of the ambient light over the beam's power, 1/mm².
        ambient_prior: mean and standard deviation of `log_ambient`.
        shade: logarithm of the ambient light less that in the middle, in terms of `SHADES`.
        blur_px2: variance of the image's blur.
        shift: of the wall since `cells` were cut, px.
        shift_sigma: its standard deviation before the frame was seen, px. The map begins with the
            first frame, so that hardly any is its own.
    """

    cells: CellLight
    pose: BeamFrame
    log_gain: float
    log_ambient: float
    direction: Direction | None
    ambient_prior: tuple[float, float]
    sweep: Sweep | None = None
    robot: RobotPose | None = None
    shade: tuple[float, ...] = (0.0,) * len(SHADES)
    blur_px2: float = 0.0
    kurtosis: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    shift_sigma: float = 1e-3

    @property
    def axis_off(self) -> float:
        """How far the axis is from the robot's, in standard deviations; 0 if it says nothing."""
        if self.direction is None:
            return 0.0
        return math.acos(min(1.0, float(self.pose.axis @ self.direction.axis))) / (
            self.direction.sigma
        )

    @functools.cached_property
    def prior(self) -> StatePrior:
        """What is known of the states before the frame is seen."""
        precision, pull = np.zeros((OWN, OWN)), np.zeros(OWN)
        mean, sigma = self.ambient_prior
        precision[AMBIENT, AMBIENT] = sigma**-2
        pull[AMBIENT] = (mean - self.log_ambient) / sigma**2
        cost = ((self.log_ambient - mean) / sigma) ** 2
        precision[SHADE, SHADE] = np.diag(_SHADE**-2)
        pull[SHADE] = np.array(self.shade) / -(_SHADE**2)
        cost += float(np.sum(np.square(self.shade / _SHADE)))
        if self.cells.saturated:
            blur = _SATURATED_PX2
            cost += (self.blur_px2 / blur) ** 2
        else:
            # Of Cauchy's distribution the normal one that pulls alike.
            blur = math.hypot(_BLUR_PX2, self.blur_px2)
            cost += math.log1p((self.blur_px2 / _BLUR_PX2) ** 2)
        precision[BLUR, BLUR] = 1.0 / blur**2
        pull[BLUR] = -precision[BLUR, BLUR] * self.blur_px2
        precision[TAILS, TAILS] = _KURTOSIS_SIGMA**-2
        pull[TAILS] = -self.kurtosis / _KURTOSIS_SIGMA**2
        cost += (self.kurtosis / _KURTOSIS_SIGMA) ** 2
        precision[SHIFT, SHIFT] = self.shift_sigma**-2 * np.eye(2)
        pull[SHIFT] = np.array(self.shift) / -(self.shift_sigma**2)
        cost += sum(x * x for x in self.shift) / self.shift_sigma**2
        if self.direction is not None:
            across = np.stack([self.pose.first, self.pose.second])
            weight = self.direction.sigma**-2
            precision[3:POSE, 3:POSE] = weight * np.eye(2)
            pull[3:POSE] = weight * across @ self.direction.axis
            off = np.cross(self.pose.axis, self.direction.axis)
            cost += float(off @ off) / self.direction.sigma**2
        return StatePrior(precision, pull, cost)


_MAX_LOG_SHADING = 3.0  # largest logarithm of ambient light over that in the middle
_SMEAR = 0.04
"""Error of what motion changes in the light, over the change. Between two of a robot's poses, 5 ms
apart, a tremor of 10 Hz leaves the straight line by an eighth of its turn of 0.3 rad."""
_BLURRED, _SHAPED_PX2 = 0.3, 1.0
"""Error of what a blur changes in the light, over the change: its shape is not known. The share is
half of that at the second number, the variance of a blur as wide as a few pixels; narrower ones
show their width only, and none where the image is sharp."""
_FLOOR = 5e-4
"""Relative error of the light, of a cone in closed form and of a lens from a table. In the cells of
rendered even walls the residuals have the variance of the photons within 5 %, also where that is
1e-3 and less."""
_MIN_SIGNAL = 1e-6  # full wells
_NO_LIGHT = 1e-6  # 1/mm², above what rounding leaves of none
_MAX_SQUARED_RESIDUAL = 16.0
"""Largest square of a cell's residual that counts for a start, in variances."""
_START_AMBIENT = 100.0  # ambient light over that of the beam, 1/mm², from which a fit starts
_START_SATURATION = 4.0  # light of a saturated spot over full scale, from which a fit starts
_BRIGHTER, _DIM = 0.75, 0.2
"""Quantiles: of the lit cells' light, most of which may be hidden; and of all cells by the beam's
light, of which the dimmer ones show the ambient light."""


class Scanned(NamedTuple):
    """A frame with the gain and ambient light that suit its pose.

    Attributes:
        cost: -2 log likelihood, up to a constant of the frame, as if texture were noise.
        light: irradiance of the cells per unit power, 1/mm².
    """

    state: FrameState
    cost: float
    light: Float[np.ndarray, "n"]


class FrameModel:
    """Models frames on the cells of a window.

    Args:
        grain: how the wall's map grows to the right and downwards, 1/px; None if there is no map.
    """

    def __init__(
        self,
        beam: BeamLight,
        window: CellWindow,
        texture: TextureVariances,
        grain: Float[np.ndarray, "2 n"] | None = None,
    ) -> None:
        self.beam, self.window, self.texture, self.grain = beam, window, texture, grain
        self.side_mm = window.side * beam.scale_mm_px

    def linear(self, frame: FrameState, own: np.ndarray) -> Linear:
        """A frame's model at its state."""
        light, usable, sigma = frame.cells.means(self.window)
        seen = self.beam.irradiance(
            self.window,
            frame.cells.motion,
            frame.pose,
            own,
            sweep=frame.sweep,
            blur_px2=frame.blur_px2,
            kurtosis=frame.kurtosis,
        )
        shade = np.clip(np.array(frame.shade) @ SHADES, -_MAX_LOG_SHADING, _MAX_LOG_SHADING)
        ambient = np.exp(frame.log_ambient + shade)
        # Between the samples of a table, light that is nearly none may be less than none.
        value = np.maximum(seen.value, 0.0)
        of_beam = np.concatenate([seen.slopes, seen.bend[None], seen.tails[None]])
        by_gain, uncovered = np.ones(value.size), np.ones(value.size)
        if frame.cells.saturated:
            room, pixel_mm = self._room(frame, ambient), self.beam.scale_mm_px
            value, over, cover, of_beam = covered(value, room, of_beam, pixel_mm=pixel_mm)
            uncovered = 1.0 - cover
            # A cell that is covered says no more than that.
            usable = usable & ~(over & (cover > _WHOLLY_COVERED))
            by_gain = np.where(over, ambient * uncovered / (value + ambient), 1.0)
        total = value + ambient
        model = np.exp(frame.log_gain) * total
        shaped = frame.blur_px2 / (frame.blur_px2 + _SHAPED_PX2)
        error = np.hypot(_SMEAR * seen.by_motion, _BLURRED * shaped * seen.by_blur) / total
        weight = self._weight(frame.cells, usable, model, error=error)
        light = np.maximum(light, np.maximum(sigma, _MIN_SIGNAL))
        grain = np.zeros((2, total.size)) if self.grain is None else self.grain
        by_beam, by_ambient = of_beam / total, ambient * uncovered / total
        return Linear(
            residual=np.where(usable, np.log(light / model) + np.array(frame.shift) @ grain, 0.0),
            slopes=np.concatenate(
                [
                    by_beam[:POSE],
                    by_gain[None],
                    by_ambient[None],
                    by_ambient * SHADES,
                    by_beam[-2:],
                    -grain,
                ]
            ),
            shared=by_beam[POSE:-2],
            weight=weight,
        )

    def log_lights(
        self, frames: Sequence[FrameState], lights: Float[np.ndarray, "k n"]
    ) -> Float[np.ndarray, "k n"]:
        """Logarithm of frames' light over their gains, where the beam's is some before the blur."""
        blurs = [(one.blur_px2 / self.window.side**2, one.kurtosis) for one in frames]
        seen = blurred_each(lights, blurs)
        return np.stack([self._log_light(*both) for both in zip(frames, seen, strict=True)])

    def _log_light(
        self, frame: FrameState, light: Float[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        light, ambient = np.maximum(light, 0.0), math.exp(frame.log_ambient)
        if frame.cells.saturated:
            light, *_ = covered(light, self._room(frame, ambient))
        return np.log(light + ambient)

    def _room(
        self, frame: FrameState, ambient: Float[np.ndarray, "n"] | float
    ) -> Float[np.ndarray, "n"]:
        """Light of the beam that takes a cell to full scale, beside the ambient light."""
        return np.full(COUNT**2, frame.cells.ceiling * math.exp(-frame.log_gain)) - ambient

    def lights(self, frames: Sequence[FrameState], own: np.ndarray) -> Float[np.ndarray, "k n"]:
        """Irradiance of the cells in frames per unit power, 1/mm², without motion and blur."""
        return self.beam.lights(self.window, [(one.cells.motion, one.pose) for one in frames], own)

    def scanned(self, frames: Sequence[FrameState], own: np.ndarray) -> list[Scanned | None]:
        """A frame at several poses, with the gain and ambient light that suit them.

        None for those in which the beam lights no cell that is usable.
        """
        both = zip(frames, self.lights(frames, own), strict=True)
        suited = [self._suited(frame, light) for frame, light in both]
        found = [one for one in suited if one is not None]
        if not found:
            return [None for _ in frames]
        cells, models = frames[0].cells, np.stack([model for _, model, _ in found])
        light, usable, _ = cells.means(self.window)
        weights = self._weight(cells, usable, models)
        # Here the texture counts as noise without correlation: this finds starts, not poses.
        spread = 1.0 / np.where(usable, weights, 1.0) + self.texture.variance
        residuals = np.log(np.maximum(light, _MIN_SIGNAL) / np.maximum(models, _MIN_SIGNAL))
        squares = np.minimum(np.square(residuals) / spread, _MAX_SQUARED_RESIDUAL)
        costs = iter(np.where(usable, squares, 0.0).sum(axis=-1).tolist())
        return [
            None if one is None else Scanned(one[0], next(costs) + one[0].prior.cost, one[2])
            for one in suited
        ]

    def _suited(
        self, frame: FrameState, irradiance: Float[np.ndarray, "n"]
    ) -> tuple[FrameState, Float[np.ndarray, "n"], Float[np.ndarray, "n"]] | None:
        """A frame with the gain and ambient light that suit its pose, its model, its irradiance.

        Where something hides the spot or casts a shadow on it, it is darker. So the gain is that of
        the brighter cells.
        """
        light, usable, _ = frame.cells.means(self.window)
        lit = usable & (irradiance > 0.5 * irradiance.max(where=usable, initial=_NO_LIGHT))
        if not lit.any():
            return None
        dim = usable & (irradiance <= np.quantile(irradiance[usable], _DIM))
        gain = offset = 0.0
        for _ in range(2):
            gain = float(np.quantile((light - offset)[lit] / irradiance[lit], _BRIGHTER))
            gain *= _START_SATURATION if frame.cells.saturated else 1.0
            offset = float(np.median((light - gain * irradiance)[dim]))
        gain = max(gain, _MIN_SIGNAL)
        ambient = np.clip(offset / gain, 1e-4, _START_AMBIENT)
        suited = replace(frame, log_gain=float(np.log(gain)), log_ambient=float(np.log(ambient)))
        model = np.maximum(irradiance, 0.0)
        if frame.cells.saturated:
            model, *_ = covered(model, self._room(suited, ambient))
        return suited, gain * (model + ambient), irradiance

    def _weight(
        self,
        cells: CellLight,
        usable: Bool[np.ndarray, "n"],
        model: Float[np.ndarray, "*k n"],
        *,
        error: Float[np.ndarray, "n"] | float = 0.0,
    ) -> Float[np.ndarray, "*k n"]:
        """1 over the variances of the cells' log light, by camera, image model and its error."""
        light, grids = cells.means(self.window).light, model.reshape(-1, COUNT, COUNT)
        # The level is that of both, so that neither a wrong model nor a dark cell has too much
        # weight.
        level = np.maximum(np.sqrt(np.maximum(light, _MIN_SIGNAL) * model), _MIN_SIGNAL)
        variance = cells.variance(level) / self.window.side**2 / level**2
        slope = np.hypot(*np.gradient(np.log(grids), axis=(1, 2))).reshape(model.shape)
        # Light enters at the bright side of a cell, where the reflectance differs.
        aside = np.minimum(slope / 12.0, 0.5) * self.side_mm
        variance += np.square(error) + _FLOOR**2 + 0.5 * self.texture.variogram(aside)
        # As many pixels as a side is long are cut by a sharp edge, if the cell is one between a
        # brighter and a darker one. Its light is wrong then, and all the more its logarithm.
        brighter = maximum_filter(grids, (1, 3, 3)).reshape(model.shape)
        darker = minimum_filter(grids, (1, 3, 3)).reshape(model.shape)
        step = 2.0 * np.sqrt((brighter - model) * (model - darker))
        cut = CUT if cells.saturated else self.beam.cut
        variance += np.square(cut * step / level) / self.window.side**3
        return np.where(usable, 1.0 / variance, 0.0)


def lit(light: Float[np.ndarray, "*k n"]) -> Bool[np.ndarray, "*k n"]:
    """Cells in which a beam's light is above half of its maximum."""
    return light > 0.5 * light.max(axis=-1, keepdims=True)


def contrast(light: Float[np.ndarray, "n"], frame: FrameState) -> float:
    """A beam's light in a frame over the ambient light, where it is brightest."""
    return float(light.max() / np.exp(frame.log_ambient))
