r"""The fit of a beam to a withdrawal over a wall that nobody knows.

The light of cell c in frame i is t_c f_i(x) with the reflectance t_c of the cell over the mean, and
the light f_i of an even wall. The sum of squares is linear in t, so t is eliminated exactly
(variable projection, Golub and Pereyra 1973):

$$ t_c = \frac{\sum_i w_{ic} y_{ic} f_{ic} + \tau^{-2}}{\sum_i w_{ic} f_{ic}^2 + \tau^{-2}}. $$

On an even wall tau is 0, and t is 1. A wall with texture is free: every cell is lit in many frames,
so that knowing the texture's size adds little, and being wrong about it harms.

Each frame has states of its own (`STATES`), with a normal prior. Their variances are learnt from
the frames (MacKay 1992), so a robot, a lamp and a microscope that keep still cost nothing.

The cells' weights are of the camera's noise, and of an error in proportion to the light, such as
texture within cells makes. It is as large as makes chi squared what it should be.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation
from scipy.optimize import brentq

from eyespot.calibration.least_squares import MOST_STEPS, Minimum, NormalEquations, minimise
from eyespot.calibration.pixels.data import Footage, possible
from eyespot.calibration.pixels.lens_light import (
    CAP,
    CLEAR,
    NEAREST_MM,
    LinearLensLight,
    cap_of,
    cap_sag,
    cap_shape,
    cap_slopes,
)
from eyespot.calibration.pixels.light import SHIFT, STATES, TIP, Cells, FrameLight, Light
from eyespot.calibration.spots.cone_trials import JointPrior, Prior, prior_terms
from eyespot.formats.inputs import InputError
from eyespot.optics.wall_light.lens import TABLE_ERROR

_UNITS = np.array([0.02, 0.02, 0.003, 0.003, 0.003, 0.1, 0.1])
"""Standard deviations of the states before they are learnt."""
_LEAST, _MOST = _UNITS / 3000.0, _UNITS * 30.0
_FEW = 2  # frames
_FREE = 1.0  # tau of a wall with texture: nothing is known
EVEN = 1e-9  # tau of an even wall
_LIT = 1e-3  # part of a frame's peak above which a cell counts as lit by the beam
_RING = {True: 4, False: 2}  # cells around these; more while the beam is a guess
_MARGIN_PX = {True: 10.0, False: 3.0}  # around the instrument; larger while its pose is a guess
_GUESSED = 0.01
"""Error of the model in the first fit, relative to a frame's brightest cell."""
_OF_TABLE = 0.25 * TABLE_ERROR
"""Error of a lens's light in a cell, relative to the frame's brightest. A mean errs less than a
sample of the table."""
_NEAREST_CONE_MM = 0.03  # from the tip's plane; nearer, the rim touches the wall
_TOUCH_MM = 0.1  # size of steps of the first distance where nobody states it
_FAR = 4.0  # standard deviations from the model beyond which a cell loses weight
_VARIANCE_ROUNDS = 30  # the variances are learnt with the model as it is
_SURE = 5.0  # standard deviations of chi squared beyond which a wall is not even
_TEXTURED = 1.5
"""Mean square of a cell's texture over its variance, above which the wall is surely not even."""


@dataclass(frozen=True)
class Point:
    """Where the model is evaluated.

    Attributes:
        values: of all parameters.
        states: of all frames, see `STATES`.
    """

    values: dict[str, float]
    states: Float[np.ndarray, "frames 7"]

    def halfway(self, other: "Point") -> "Point":
        """The point in the middle of the two."""
        values = {name: 0.5 * (own + other.values[name]) for name, own in self.values.items()}
        return Point(values, 0.5 * (self.states + other.states))


class _At(NamedTuple):
    """The model at a point.

    Attributes:
        rest: light less the model, for each frame.
        map: t, for all cells.
        information: of the cells' t.
    """

    frames: list[FrameLight]
    rest: list[np.ndarray]
    map: Float[np.ndarray, "n"]
    information: Float[np.ndarray, "n"]


class BeamSolver:
    """A running fit on one lattice of cells.

    Args:
        numbers: of the frames that are used.
        names: names of the free parameters.
        lens: the light of a lens; None for a cone.
        progress: called with chi squared at every step.
    """

    def __init__(
        self,
        footage: Footage,
        cells: Cells,
        numbers: Sequence[int],
        point: Point,
        *,
        names: tuple[str, ...],
        priors: Mapping[str, Prior],
        joint_prior: JointPrior | None,
        lens: LinearLensLight | None,
        progress: Callable[[float], None],
    ) -> None:
        self.footage, self.cells, self.numbers, self.point = footage, cells, list(numbers), point
        self.names, self.lens, self.progress = names, lens, progress
        self.priors = priors
        self._prior_means, self._prior_weights = prior_terms(names, priors, joint_prior)
        self.light = Light(footage, cells, names, lens)
        means = [cells.means(footage.light[i], footage.clear[i]) for i in self.numbers]
        self.seen = np.array([mean for mean, _ in means])
        self.clear = np.array([clear for _, clear in means])
        image = footage.light[0]
        self.inside = cells.means(image, np.ones(image.shape, bool))[1]
        self.sizes = np.array([_size(name, point.values, priors) for name in names])
        self._steps = self.sizes.copy()  # of the coordinates
        self._shapes_cap = set(CAP) <= set(names)
        self.least_rim = CLEAR  # over the core, of a cap whose sag is free as well
        if self._shapes_cap:
            self._steps[names.index("sag")] /= cap_slopes(point.values)[0, 0]
        self.spread = np.ones(len(STATES))  # of the states, in their units
        # In one or two frames nothing tells a wall from a beam, so the wall counts as even.
        self.tau, self.error = _FREE if len(self.numbers) > _FEW else EVEN, 0.0
        self.trust = np.ones(self.seen.shape)  # of cells that are far off
        self.map = np.ones(cells.along**2)
        # Of all cells, because the tiles near a beam change with its pose; zero until learnt.
        self._by_shift = np.zeros((len(self.numbers), 2, cells.along**2), np.float32)

    @property
    def data(self) -> int:
        """Number of cells that are used, over all frames."""
        return int(np.count_nonzero(self.weight))

    @property
    def is_linear(self) -> bool:
        """Whether the model is linear in parameters around those of a table or of a view."""
        return self.lens is not None or bool(self.light.of_view)

    def look(self) -> None:
        """Make the light linear in the view around that of the point."""
        self.light.look(self.point.values, self.point.states, self.numbers)

    def choose(self, *, guess: bool) -> None:
        """Choose the cells and their weights by the model.

        Args:
            guess: whether the point is only a guess, so that only the frames say what is clear.

        Raises:
            InputError: hardly any cell is usable.
        """
        footage, side = self.footage, self.cells.side
        self.look()
        view = self.light.view(self.point.values)
        margin = (_MARGIN_PX[guess] + 0.5**0.5 * (side - 1)) * footage.microscope.scale_mm_px
        nearest = _NEAREST_CONE_MM if self.lens is None else NEAREST_MM
        self.weight, self.variance = np.zeros(self.seen.shape), np.ones(self.seen.shape)
        # With the derivatives, which the fit asks for next, at the same point.
        found = self.light.frames(self.point.values, self.point.states, self.numbers)
        reached = shown = 0
        for k, own in enumerate(found or ()):
            at = own.cells
            usable = (own.along > nearest) & self._reached(own, _RING[guess])
            reached += int(usable.sum())
            if footage.in_view:
                usable &= ~footage.instrument.hides(
                    view.point[at], view.sight[at], tip=own.tip, axis=own.axis, margin=margin
                )
            shown += int(usable.sum())
            level = self.seen[k, at] if guess else self.map[at] * own.light
            usable &= (
                self.clear[k, at] if guess else self.inside[at] & footage.noise.is_clear(level)
            )
            self.variance[k, at] = footage.noise.variance(level) / side**2
            if self.lens is not None:
                # Of a frame whose peak is saturated, the rest may be too dim for the table.
                self.variance[k, at] += (_OF_TABLE * own.direct.max()) ** 2
            if guess:
                self.variance[k, at] += (_GUESSED * level.max(where=usable, initial=0.0)) ** 2
            self.weight[k, at] = usable
        self._reweigh()
        of_wall = np.count_nonzero(self.weight.any(axis=0)) if self.textured else 0
        if self.data <= len(self.names) + len(self.numbers) + of_wall:
            raise InputError(
                f"{self.data} cells of {side} x {side} pixels are usable; a fit of "
                f"{len(self.names)} parameters and of the wall behind the cells needs more. The "
                f"instrument hides {1 - shown / max(reached, 1):.0%} of the cells that the beam "
                f"reaches; others are black, saturated, or nearer than {nearest} mm to the tip. "
                "Change the exposure, tilt the beam against the line of sight, or withdraw farther."
            )

    def _reached(self, own: FrameLight, ring: int) -> Bool[np.ndarray, "n"]:
        """Cells that the beam reaches, and a ring around them."""
        count = self.cells.along
        lit = np.zeros(count**2, bool)
        lit[own.cells] = own.direct > _LIT * own.direct.max()
        near = binary_dilation(lit.reshape(count, count), np.ones((3, 3)), iterations=ring)
        return np.asarray(near.ravel()[own.cells])

    def _reweigh(self) -> None:
        """Weights of the used cells by the noise, the model's relative error, and their trust."""
        total = self.variance + (self.error * self.seen) ** 2
        self.weight = np.where(self.weight > 0, self.trust / total, 0.0)

    def brighten(self) -> None:
        """Set sensitivity and illumination by linear least squares, with all else fixed.

        Raises:
            InputError: the light is not where the beam is.
        """
        found = self.light.frames(self.point.values, self.point.states, self.numbers) or ()
        light, weight = (
            np.concatenate([row[own.cells] for row, own in zip(rows, found, strict=True)])
            for rows in (self.seen, np.sqrt(self.weight))
        )
        lamp = self.names.index("illumination")
        basis = np.hstack([[own.by_state[0], own.slopes[lamp]] for own in found]) * weight
        basis /= self.point.values["sensitivity"]
        sensitivity, product = np.linalg.lstsq(basis.T, light * weight, rcond=None)[0].tolist()
        if not sensitivity > 0:
            raise InputError("the spot is not near its place in the start values. Check these.")
        self.point.values["sensitivity"] = sensitivity
        self.point.values["illumination"] = max(product / sensitivity, 0.0)
        at = self.names.index("sensitivity")
        self.sizes[at] = self._steps[at] = sensitivity

    def minimise(
        self,
        tolerance: float,
        *,
        follow: bool,
        keep_chord: bool = False,
        most_steps: int = MOST_STEPS,
    ) -> Minimum:
        """Fit with the weights and variances as they are.

        Args:
            tolerance: of chi squared.
            follow: whether a lens's table is computed anew where the lens moves far.
            keep_chord: whether a free cap keeps its chord. Behind a high drop the light hardly
                shows it, so that steps from far off lead to a half ball.
            most_steps: after which it ends anyway.
        """
        start, size, best = self.point, len(self.names), math.inf
        begin = self.coordinates(start.values)

        def evaluate(x: np.ndarray) -> NormalEquations:
            nonlocal best
            values = self._values(begin + x[:size])
            states = start.states.copy()
            states[self.numbers] += x[size:].reshape(-1, len(STATES)) * _UNITS
            point = Point(values, states)
            none = NormalEquations(np.inf, np.zeros(x.size), np.zeros((x.size, x.size)))
            if not possible(values):
                return none
            if follow and self.lens is not None:
                self.lens.follow(values)
            at = self._at(point)
            if at is None:
                return none
            found = self._equations(point, at)
            if keep_chord and self._shapes_cap:
                chord = self.names.index("aperture_radius")
                found.gradient[chord] = 0.0
                found.information[chord] = found.information[:, chord] = np.eye(x.size)[chord]
            self.progress(found.cost)
            if found.cost < best:  # the fit goes on from there
                best, self.point, self.now, self.equations = found.cost, point, at, found
            return self._within_bound(found, values)

        start_at = np.zeros(size + len(STATES) * len(self.numbers))
        found = minimise(evaluate, start_at, tolerance=tolerance, most_steps=most_steps)
        self.map = self.now.map
        return found

    def evaluate(self) -> None:
        """Compute the model at the point where the fit is, which a fit has reached before."""
        at = self._at(self.point)
        assert at is not None
        self.now, self.equations, self.map = at, self._equations(self.point, at), at.map

    def _at(self, point: Point) -> _At | None:
        frames = self.light.frames(point.values, point.states, self.numbers)
        if frames is None:
            return None
        stiff = self.tau**-2.0
        information, pull = np.full(self.map.shape, stiff), np.full(self.map.shape, stiff)
        lights = []
        for k, own in enumerate(frames):
            light = self.seen[k, own.cells]
            light = light - point.states[self.numbers[k], SHIFT] @ self._by_shift[k][:, own.cells]
            weighted = self.weight[k, own.cells] * own.light
            information[own.cells] += weighted * own.light
            pull[own.cells] += weighted * light
            lights.append(light)
        texture = pull / information
        rest = [
            light - texture[own.cells] * own.light
            for own, light in zip(frames, lights, strict=True)
        ]
        return _At(frames, rest, texture, information)

    def _equations(self, point: Point, at: _At) -> NormalEquations:
        """Normal equations of all parameters and states, the map eliminated."""
        p, q = len(self.names), len(STATES)
        total = p + q * len(self.numbers)
        information, gradient = np.zeros((total, total)), np.zeros(total)
        mixed = np.zeros((total, self.map.size))
        cost = float(np.sum(np.square(at.map - 1.0))) * self.tau**-2.0
        by = self.by_coordinates(point.values)
        for k, (own, rest) in enumerate(zip(at.frames, at.rest, strict=True)):
            slopes, weight = self._slopes(k, own, at.map, by), self.weight[k, own.cells]
            rows = np.r_[:p, p + q * k : p + q * (k + 1)]
            weighted = slopes * weight
            information[np.ix_(rows, rows)] += weighted @ slopes.T
            gradient[rows] -= weighted @ rest
            mixed[np.ix_(rows, own.cells)] += weighted * own.light
            cost += float(weight @ np.square(rest))
        information -= (mixed / at.information) @ mixed.T
        stiff = np.tile(self.spread**-2.0, len(self.numbers))
        states = (point.states[self.numbers] / _UNITS).ravel()
        information[np.arange(p, total), np.arange(p, total)] += stiff
        gradient[p:] += stiff * states
        cost += float(stiff @ np.square(states))
        values = np.array([point.values[name] for name in self.names])
        off = self._prior_weights @ (values - self._prior_means)
        slopes = self._prior_weights @ by
        cost += float(off @ off)
        gradient[:p] += slopes.T @ off
        information[:p, :p] += slopes.T @ slopes
        return NormalEquations(cost, gradient, information)

    def coordinates(self, values: Mapping[str, float]) -> Float[np.ndarray, "p"]:
        """What the fit steps in: the free parameters, over the sizes of steps.

        In place of sag and rim it is the cap's `cap_shape`. The light follows the curvature, so the
        valley of equal light is almost straight.
        """
        own = dict(values)
        if self._shapes_cap:
            own |= zip(CAP, cap_shape(values), strict=True)
        return np.array([own[name] for name in self.names]) / self._steps

    def _values(self, at: Float[np.ndarray, "p"]) -> dict[str, float]:
        """All parameters at these coordinates."""
        own = dict(zip(self.names, (at * self._steps).tolist(), strict=True))
        if self._shapes_cap:
            curvature, chord = (own[name] for name in CAP)
            sag, rim = cap_of(np.array([curvature, chord]))
            least = self.least_rim * (self.point.values | own)["core_radius"]
            if rim < least and abs(curvature) * least < 1.0:
                sag, rim = cap_sag(curvature, least), least
            own |= zip(CAP, (sag, rim), strict=True)
        return self.point.values | own

    def is_at_bound(self, values: Mapping[str, float]) -> bool:
        """Whether the rim of a free cap is the least that it may be."""
        if not self._shapes_cap:
            return False
        return values["aperture_radius"] <= (1.0 + 1e-9) * self.least_rim * values["core_radius"]

    def _within_bound(self, found: NormalEquations, values: dict[str, float]) -> NormalEquations:
        """The equations of a step that keeps the rim at its bound, where it would go inside.

        A step then changes the chord only as curvature and core demand it.
        """
        if not self.is_at_bound(values):
            return found
        at = self.names.index("aperture_radius")
        if found.gradient[at] <= 0.0:
            return found
        rim = self.by_coordinates(values)[at]
        along = np.eye(len(found.gradient))
        along[at, : len(rim)] = -rim / rim[at]
        if "core_radius" in self.names:
            core = self.names.index("core_radius")
            along[at, core] += self.least_rim * self._steps[core] / rim[at]
        along[at, at] = 0.0
        information = along.T @ found.information @ along
        information[at, at] = 1.0
        return NormalEquations(found.cost, along.T @ found.gradient, information)

    def by_coordinates(self, values: Mapping[str, float]) -> Float[np.ndarray, "p p"]:
        """Derivatives of the free parameters by their coordinates."""
        slopes = np.eye(len(self.names))
        if self._shapes_cap:
            cap = [self.names.index(name) for name in CAP]
            slopes[np.ix_(cap, cap)] = cap_slopes(values)
        return slopes * self._steps

    def difference(self, before: Point, after: Point) -> Float[np.ndarray, "p"]:
        """Difference of the free parameters over their sizes."""
        return np.array([after.values[n] - before.values[n] for n in self.names]) / self.sizes

    def distance(self, other: Point) -> float:
        """Standard errors between the point of the fit and another one."""
        step = self.difference(other, self.point)
        return math.sqrt(max(float(step @ self.effective()[0] @ step), 0.0))

    def slopes(self, k: int) -> Float[np.ndarray, "p+7 n"]:
        """Derivatives of a frame's light by the parameters' coordinates, and by its states."""
        by = self.by_coordinates(self.point.values)
        return self._slopes(k, self.now.frames[k], self.map, by)

    def _slopes(
        self, k: int, own: FrameLight, texture: np.ndarray, by: Float[np.ndarray, "p p"]
    ) -> Float[np.ndarray, "p+7 n"]:
        """Derivatives of a frame's light by the parameters' coordinates, and by its states.

        Args:
            by: `by_coordinates` of the parameters.
        """
        by_shift = self._by_shift[k][:, own.cells]
        by_state = np.concatenate([texture[own.cells] * own.by_state, by_shift])
        by_name = by.T @ own.slopes * texture[own.cells]
        return np.concatenate([by_name, _UNITS[:, None] * by_state])

    def learn(self) -> None:
        """Learn the states' variances and the model's error; cells far off lose their weight."""
        p, q = len(self.names), len(STATES)
        states = (self.point.states[self.numbers] / _UNITS).ravel()
        data, pull = self.equations.information.copy(), -self.equations.gradient
        at = np.arange(p, len(data))
        stiff = np.tile(self.spread**-2.0, len(self.numbers))
        data[at, at] -= stiff
        pull[p:] += stiff * states
        # From above: a spread that was learnt too small hides what would enlarge it.
        self.spread = np.ones(len(STATES))
        for _ in range(_VARIANCE_ROUNDS):
            stiff = np.tile(self.spread**-2.0, len(self.numbers))
            whole = data.copy()
            whole[at, at] += stiff
            covariance = np.linalg.inv(whole)
            step = pull.copy()
            step[p:] -= stiff * states
            moved = (states + (covariance @ step)[p:]).reshape(-1, q)
            share = 1.0 - np.diag(covariance)[p:].reshape(-1, q) * self.spread**-2.0
            free = np.maximum(share.sum(axis=0), 1e-3)
            learnt = np.sqrt(np.square(moved).sum(axis=0) / free)
            # A robot errs alike along all axes, and a microscope shakes alike along both.
            for alike in (TIP, SHIFT):
                learnt[alike] = np.sqrt(np.mean(np.square(learnt[alike])))
            self.spread = np.clip(learnt, _LEAST / _UNITS, _MOST / _UNITS)
        self._learn_error()
        count = self.cells.along
        for k, own in enumerate(self.now.frames):
            lit = np.zeros(count**2)
            lit[own.cells] = self.map[own.cells] * own.light
            down, right = np.gradient(lit.reshape(count, count), self.cells.side)
            self._by_shift[k] = -np.stack([right.ravel(), down.ravel()])

    def _learn_error(self) -> None:
        """The relative error that makes chi squared what it should be, and robust weights."""
        used = self.weight > 0
        rest = np.zeros(self.seen.shape)
        for k, (own, off) in enumerate(zip(self.now.frames, self.now.rest, strict=True)):
            rest[k, own.cells] = off
        square, noise = np.square(rest[used]), self.variance[used]
        signal, degrees = np.square(self.seen[used]), self.degrees_of_freedom

        def excess(error: float) -> float:
            far = square / (noise + error**2 * signal)
            return float(np.sum(np.minimum(far, _FAR**2))) - degrees

        self.chi_squared = float(np.sum(square / noise))
        error = 0.0 if excess(0.0) <= 0 else brentq(excess, 0.0, 1.0) if excess(1.0) < 0 else 1.0
        self.error = float(error)
        far = np.abs(rest) / np.sqrt(self.variance + (self.error * self.seen) ** 2)
        # The weight of Geman and McClure, as in the estimator.
        self.trust = (_FAR / np.maximum(far, _FAR)) ** 4
        self._reweigh()

    @property
    def degrees_of_freedom(self) -> int:
        """Number of data less that of all that was fitted to them."""
        known = 1.0 - self.tau**-2.0 / self.now.information
        return max(self.data - round(float(known.sum())) - len(self.names), 1)

    @property
    def misfit(self) -> float:
        """Mean square of the residuals, in variances; cells that are far off count as `_FAR`."""
        squares = (
            np.minimum(self.weight[k, own.cells] * np.square(rest), _FAR**2).sum()
            for k, (own, rest) in enumerate(zip(self.now.frames, self.now.rest, strict=True))
        )
        return float(sum(squares)) / self.data

    def flatten(self) -> None:
        """Take the wall for even, unless that explains the frames worse than chance allows."""
        before = self.point, self.now, self.equations, self.map
        cells = float(np.sum(1.0 - self.tau**-2.0 / self.now.information))
        self.tau = EVEN
        self.minimise(1.0, follow=False)
        if self.equations.cost - before[2].cost > cells + _SURE * math.sqrt(2.0 * cells):
            self.tau = _FREE
            self.point, self.now, self.equations, self.map = before
        else:
            # Weights by a map that the frames' noise has shaped prefer the cells that it darkened.
            self.choose(guess=False)
            self.minimise(1.0, follow=False)
            self.learn()

    @property
    def textured(self) -> bool:
        """Whether the wall is not even."""
        return self.tau == _FREE

    @property
    def states(self) -> dict[str, float]:
        """Learnt standard deviations of the frames' own states."""
        return dict(zip(STATES, (self.spread * _UNITS).tolist(), strict=True))

    @property
    def surely_textured(self) -> bool:
        """Whether the cells differ by more than an even wall's do."""
        used = self.weight.any(axis=0)
        far = np.square(self.map[used] - 1.0) * self.now.information[used]
        return float(np.mean(far)) > _TEXTURED

    def weigh_by_noise(self) -> None:
        """Weigh the cells by the camera's noise alone, as if the model missed nothing."""
        self.error, self.trust = 0.0, np.ones(self.seen.shape)
        self._reweigh()
        self.evaluate()

    def effective(self) -> tuple[Float[np.ndarray, "p p"], Callable[[int], np.ndarray]]:
        """Information of the parameters over their sizes, and derivatives by these in a frame.

        Both with all else eliminated: the states and the map.
        """
        p, q = len(self.names), len(STATES)
        whole = self.equations.information
        by_state = np.linalg.solve(whole[p:, p:], whole[p:, :p]).T
        information = whole[:p, :p] - by_state @ whole[p:, :p]
        by = self.by_coordinates(self.point.values)
        over_size = np.linalg.solve(by, np.diag(self.sizes))  # derivatives of the coordinates
        projected = []
        mixed = np.zeros((p, self.map.size))
        for k, own in enumerate(self.now.frames):
            slopes = self._slopes(k, own, self.map, by)
            alone = over_size.T @ (slopes[:p] - by_state[:, q * k : q * (k + 1)] @ slopes[p:])
            projected.append(alone)
            mixed[:, own.cells] += alone * (self.weight[k, own.cells] * own.light)
        of_map = mixed / self.now.information

        def slopes_of(k: int) -> np.ndarray:
            own = self.now.frames[k]
            root = np.sqrt(self.weight[k, own.cells])
            return root * (projected[k] - of_map[:, own.cells] * own.light)

        return over_size.T @ information @ over_size, slopes_of


def _size(name: str, values: Mapping[str, float], priors: Mapping[str, Prior]) -> float:
    """Scale of a parameter's coordinate; with it, the damping affects all of them equally."""
    value = values[name]
    own = {"u": 1.0, "v": 1.0, "sag": max(value, 0.01)}
    own["illumination"] = max(value, 0.01)
    if name == "touch":
        return min(priors[name].sigma, _TOUCH_MM)
    return priors[name].sigma if name in priors else own.get(name) or abs(value) or 1.0
