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
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation
from scipy.optimize import brentq

from eyespot.calibration.least_squares import MOST_STEPS, Minimum, NormalEquations, minimise
from eyespot.calibration.pixels.data import Footage, possible
from eyespot.calibration.pixels.lens_light import NEAREST_MM, Coordinates, LinearLensLight
from eyespot.calibration.pixels.light import SHIFT, STATES, TIP, Cells, FrameLight, Light
from eyespot.calibration.spots.cone_trials import JointPrior, Prior, prior_terms
from eyespot.formats.inputs import InputError
from eyespot.optics.wall_light.lens_flux import TABLE_ERROR

_UNITS = np.array([0.02, 0.02, 0.003, 0.003, 0.003, 0.1, 0.1])
"""Standard deviations of the states before they are learnt."""
_LEAST, _MOST = _UNITS / 3000.0, _UNITS * 30.0
_MIN_FRAMES = 2  # frames
_FREE_TAU = 1.0  # tau of a wall with texture: nothing is known
EVEN = 1e-9  # tau of an even wall
_LIT_SHARE = 1e-3  # part of a frame's peak above which a cell counts as lit by the beam
_RING_CELLS = {True: 4, False: 2}  # cells around these; more while the beam is a guess
_MARGIN_PX = {True: 10.0, False: 3.0}  # around the instrument; larger while its pose is a guess
_GUESSED = 0.01
"""Error of the model in the first fit, relative to a frame's brightest cell."""
_OF_TABLE = 0.25 * TABLE_ERROR
"""Error of a lens's light in a cell, relative to the frame's brightest. A mean errs less than a
sample of the table."""
_NEAREST_CONE_MM = 0.03  # from the tip's plane; nearer, the rim touches the wall
_TOUCH_MM = 0.1  # size of steps of the first distance where nobody states it
_FAR_SIGMAS = 4.0  # standard deviations from the model beyond which a cell loses weight
_VARIANCE_ROUNDS = 30  # the variances are learnt with the model as it is
_UNEVEN_SIGMAS = 5.0  # standard deviations of chi squared beyond which a wall is not even
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


@dataclass(frozen=True, kw_only=True, eq=False)
class CellFrames:
    """Frames of a withdrawal in cells, and what is fitted to them.

    Attributes:
        numbers: of the frames that are used.
        names: of the free parameters.
        lens: the light of a lens; None for a cone.
        light: the model's; it is linear around where it last looked (`Light.look`).
        seen: means of the cells in each frame, full wells.
        clear: cells of each frame without a pixel that is black or saturated.
        inside: cells inside of the image.
        prior_means, prior_weights: see `prior_terms`.
        progress: called with chi squared at every step.
    """

    footage: Footage
    cells: Cells
    numbers: list[int]
    names: tuple[str, ...]
    lens: LinearLensLight | None
    light: Light
    seen: Float[np.ndarray, "used n"]
    clear: Bool[np.ndarray, "used n"]
    inside: Bool[np.ndarray, "n"]
    priors: Mapping[str, Prior]
    prior_means: Float[np.ndarray, "p"]
    prior_weights: Float[np.ndarray, "q p"]
    progress: Callable[[float], None]

    @property
    def is_linear(self) -> bool:
        """Whether the model is linear in parameters around those of a table or of a view."""
        return self.lens is not None or bool(self.light.of_view)


@dataclass(frozen=True, kw_only=True, eq=False)
class BeamFit:
    """A fit at one of its points; each step of the fit makes another one.

    Attributes:
        of: the frames.
        sizes: scales of the free parameters.
        coordinates: what it steps in.
        tau: standard deviation of a cell's texture.
        error: of the model, relative to the light.
        spread: standard deviations of the states, in their units.
        trust: of cells, less where they are far off.
        by_shift: derivatives of all cells' light by a shift of the image, zero until learnt,
            because the tiles near a beam change with its pose.
        weight, variance: of cells, by the model that they were chosen with.
        now, equations: the model at the point, once it was evaluated there.
        chi_squared: without the model's error, once that was learnt.
    """

    of: CellFrames
    point: Point
    sizes: Float[np.ndarray, "p"]
    coordinates: Coordinates
    tau: float
    error: float
    spread: Float[np.ndarray, "7"]
    trust: Float[np.ndarray, "used n"]
    by_shift: Float[np.ndarray, "used 2 n"]
    weight: Float[np.ndarray, "used n"]
    variance: Float[np.ndarray, "used n"]
    now: _At
    equations: NormalEquations
    chi_squared: float = math.nan

    @classmethod
    def begun(
        cls,
        footage: Footage,
        cells: Cells,
        numbers: list[int],
        point: Point,
        *,
        names: tuple[str, ...],
        priors: Mapping[str, Prior],
        joint_prior: JointPrior | None,
        lens: LinearLensLight | None,
        progress: Callable[[float], None],
    ) -> Self:
        """The fit of the frames with these numbers, before its first step."""
        means = [cells.means(footage.light[i], footage.clear[i]) for i in numbers]
        image, count = footage.light[0], cells.along**2
        prior_means, prior_weights = prior_terms(names, priors, joint_prior)
        of = CellFrames(
            footage=footage,
            cells=cells,
            numbers=numbers,
            names=names,
            lens=lens,
            light=Light(footage, cells, names, lens),
            seen=np.array([mean for mean, _ in means]),
            clear=np.array([clear for _, clear in means]),
            inside=cells.means(image, np.ones(image.shape, bool))[1],
            priors=priors,
            prior_means=prior_means,
            prior_weights=prior_weights,
            progress=progress,
        )
        sizes = np.array([_size(name, point.values, priors) for name in names])
        return cls(
            of=of,
            point=point,
            sizes=sizes,
            coordinates=Coordinates.sized(names, sizes, point.values),
            # In one or two frames nothing tells a wall from a beam, so the wall counts as even.
            tau=_FREE_TAU if len(numbers) > _MIN_FRAMES else EVEN,
            error=0.0,
            spread=np.ones(len(STATES)),
            trust=np.ones(of.seen.shape),
            by_shift=np.zeros((len(numbers), 2, count), np.float32),
            weight=np.zeros(of.seen.shape),
            variance=np.ones(of.seen.shape),
            now=_At([], [], np.ones(count), np.zeros(count)),
            equations=NormalEquations(np.inf, np.zeros(0), np.zeros((0, 0))),
        )

    @property
    def data(self) -> int:
        """Number of cells that are used, over all frames."""
        return int(np.count_nonzero(self.weight))

    def look(self) -> None:
        """Make the light linear in the view around that of the point."""
        self.of.light.look(self.point.values, self.point.states, self.of.numbers)

    def chosen(self, *, guess: bool) -> Self:
        """With the cells and weights that the model chooses, and a light that looked here.

        Args:
            guess: whether the point is only a guess, so that only the frames say what is clear.

        Raises:
            InputError: hardly any cell is usable.
        """
        footage, side = self.of.footage, self.of.cells.side
        self.look()
        view = self.of.light.view(self.point.values)
        margin = (_MARGIN_PX[guess] + 0.5**0.5 * (side - 1)) * footage.microscope.scale_mm_px
        nearest = _NEAREST_CONE_MM if self.of.lens is None else NEAREST_MM
        used, variance = np.zeros(self.of.seen.shape), np.ones(self.of.seen.shape)
        # With the derivatives, which the fit asks for next, at the same point.
        found = self.of.light.frames(self.point.values, self.point.states, self.of.numbers)
        reached = shown = 0
        for k, own in enumerate(found or ()):
            at = own.cells
            usable = (own.along > nearest) & self._reached(own, _RING_CELLS[guess])
            reached += int(usable.sum())
            if footage.in_view:
                usable &= ~footage.instrument.hides(
                    view.point[at], view.sight[at], tip=own.tip, axis=own.axis, margin=margin
                )
            shown += int(usable.sum())
            level = self.of.seen[k, at] if guess else self.now.map[at] * own.light
            usable &= (
                self.of.clear[k, at]
                if guess
                else self.of.inside[at] & footage.noise.is_clear(level)
            )
            variance[k, at] = footage.noise.variance(level) / side**2
            if self.of.lens is not None:
                # Of a frame whose peak is saturated, the rest may be too dim for the table.
                variance[k, at] += (_OF_TABLE * own.direct.max()) ** 2
            if guess:
                variance[k, at] += (_GUESSED * level.max(where=usable, initial=0.0)) ** 2
            used[k, at] = usable
        fit = replace(self, weight=used, variance=variance)._reweighed()
        of_wall = np.count_nonzero(fit.weight.any(axis=0)) if fit.textured else 0
        if fit.data <= len(self.of.names) + len(self.of.numbers) + of_wall:
            raise InputError(
                f"{fit.data} cells of {side} x {side} pixels are usable; a fit of "
                f"{len(self.of.names)} parameters and of the wall behind the cells needs more. The "
                f"instrument hides {1 - shown / max(reached, 1):.0%} of the cells that the beam "
                f"reaches; others are black, saturated, or nearer than {nearest} mm to the tip. "
                "Change the exposure, tilt the beam against the line of sight, or withdraw farther."
            )
        return fit

    def _reached(self, own: FrameLight, ring: int) -> Bool[np.ndarray, "n"]:
        """Cells that the beam reaches, and a ring around them."""
        count = self.of.cells.along
        lit = np.zeros(count**2, bool)
        lit[own.cells] = own.direct > _LIT_SHARE * own.direct.max()
        near = binary_dilation(lit.reshape(count, count), np.ones((3, 3)), iterations=ring)
        return np.asarray(near.ravel()[own.cells])

    def _reweighed(self) -> Self:
        """With weights of the used cells by noise, the model's relative error, and trust."""
        total = self.variance + (self.error * self.of.seen) ** 2
        return replace(self, weight=np.where(self.weight > 0, self.trust / total, 0.0))

    def brightened(self) -> Self:
        """With sensitivity and illumination by linear least squares, and all else as it is.

        Raises:
            InputError: the light is not where the beam is.
        """
        found = self.of.light.frames(self.point.values, self.point.states, self.of.numbers) or ()
        light, weight = (
            np.concatenate([row[own.cells] for row, own in zip(rows, found, strict=True)])
            for rows in (self.of.seen, np.sqrt(self.weight))
        )
        lamp = self.of.names.index("illumination")
        basis = np.hstack([[own.by_state[0], own.slopes[lamp]] for own in found]) * weight
        basis /= self.point.values["sensitivity"]
        sensitivity, product = np.linalg.lstsq(basis.T, light * weight, rcond=None)[0].tolist()
        if not sensitivity > 0:
            raise InputError("the spot is not near its place in the start values. Check these.")
        lit = {"sensitivity": sensitivity, "illumination": max(product / sensitivity, 0.0)}
        is_gain = np.array([name == "sensitivity" for name in self.of.names])
        return replace(
            self,
            point=Point(self.point.values | lit, self.point.states),
            sizes=np.where(is_gain, sensitivity, self.sizes),
            coordinates=self.coordinates._replace(
                steps=np.where(is_gain, sensitivity, self.coordinates.steps)
            ),
        )

    def minimised(
        self,
        tolerance: float,
        *,
        follow: bool,
        keep_chord: bool = False,
        most_steps: int = MOST_STEPS,
    ) -> tuple[Self, Minimum]:
        """The least chi squared with the weights and variances as they are.

        Args:
            tolerance: of chi squared.
            follow: whether a lens's table is computed anew where the lens moves far.
            keep_chord: whether a free cap keeps its chord. Behind a high drop the light hardly
                shows it, so that steps from far off lead to a half ball.
            most_steps: after which it ends anyway.
        """
        size, best = len(self.of.names), self
        least = math.inf
        begin = self.coordinates.of(self.point.values)

        def evaluate(x: np.ndarray) -> NormalEquations:
            nonlocal best, least
            values = self.coordinates.values(begin + x[:size], self.point.values)
            states = self.point.states.copy()
            states[self.of.numbers] += x[size:].reshape(-1, len(STATES)) * _UNITS
            none = NormalEquations(np.inf, np.zeros(x.size), np.zeros((x.size, x.size)))
            if not possible(values):
                return none
            if follow and self.of.lens is not None:
                self.of.lens.follow(values)
            fit = self._evaluated_at(Point(values, states))
            if fit is None:
                return none
            found = fit.equations
            if keep_chord and self.coordinates.shapes_cap:
                chord = self.of.names.index("aperture_radius")
                found.gradient[chord] = 0.0
                found.information[chord] = found.information[:, chord] = np.eye(x.size)[chord]
            self.of.progress(found.cost)
            if found.cost < least:
                least, best = found.cost, fit
            return self.coordinates.within_bound(found, values)

        start = np.zeros(size + len(STATES) * len(self.of.numbers))
        found = minimise(evaluate, start, tolerance=tolerance, most_steps=most_steps)
        return best, found

    def evaluated(self) -> Self:
        """With the model at the point, which a fit has reached before."""
        fit = self._evaluated_at(self.point)
        assert fit is not None
        return fit

    def _evaluated_at(self, point: Point) -> Self | None:
        """The fit at another point; None if a beam meets no wall there."""
        now = self._at(point)
        if now is None:
            return None
        return replace(self, point=point, now=now, equations=self._equations(point, now))

    def _at(self, point: Point) -> _At | None:
        frames = self.of.light.frames(point.values, point.states, self.of.numbers)
        if frames is None:
            return None
        stiff = self.tau**-2.0
        information, pull = np.full(self.now.map.shape, stiff), np.full(self.now.map.shape, stiff)
        lights = []
        for k, own in enumerate(frames):
            light = self.of.seen[k, own.cells]
            light = light - point.states[self.of.numbers[k], SHIFT] @ self.by_shift[k][:, own.cells]
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
        p, q = len(self.of.names), len(STATES)
        total = p + q * len(self.of.numbers)
        information, gradient = np.zeros((total, total)), np.zeros(total)
        mixed = np.zeros((total, self.now.map.size))
        cost = float(np.sum(np.square(at.map - 1.0))) * self.tau**-2.0
        by = self.coordinates.slopes(point.values)
        for k, (own, rest) in enumerate(zip(at.frames, at.rest, strict=True)):
            slopes, weight = self._slopes(k, own, at.map, by), self.weight[k, own.cells]
            rows = np.r_[:p, p + q * k : p + q * (k + 1)]
            weighted = slopes * weight
            information[np.ix_(rows, rows)] += weighted @ slopes.T
            gradient[rows] -= weighted @ rest
            mixed[np.ix_(rows, own.cells)] += weighted * own.light
            cost += float(weight @ np.square(rest))
        information -= (mixed / at.information) @ mixed.T
        stiff = np.tile(self.spread**-2.0, len(self.of.numbers))
        states = (point.states[self.of.numbers] / _UNITS).ravel()
        information[np.arange(p, total), np.arange(p, total)] += stiff
        gradient[p:] += stiff * states
        cost += float(stiff @ np.square(states))
        values = np.array([point.values[name] for name in self.of.names])
        off = self.of.prior_weights @ (values - self.of.prior_means)
        slopes = self.of.prior_weights @ by
        cost += float(off @ off)
        gradient[:p] += slopes.T @ off
        information[:p, :p] += slopes.T @ slopes
        return NormalEquations(cost, gradient, information)

    def difference(self, before: Point, after: Point) -> Float[np.ndarray, "p"]:
        """Difference of the free parameters over their sizes."""
        return np.array([after.values[n] - before.values[n] for n in self.of.names]) / self.sizes

    def distance(self, other: Point) -> float:
        """Standard errors between the point of the fit and another one."""
        step = self.difference(other, self.point)
        return math.sqrt(max(float(step @ self.effective()[0] @ step), 0.0))

    def slopes(self, k: int) -> Float[np.ndarray, "p+7 n"]:
        """Derivatives of a frame's light by the parameters' coordinates, and by its states."""
        by = self.coordinates.slopes(self.point.values)
        return self._slopes(k, self.now.frames[k], self.now.map, by)

    def _slopes(
        self, k: int, own: FrameLight, texture: np.ndarray, by: Float[np.ndarray, "p p"]
    ) -> Float[np.ndarray, "p+7 n"]:
        """Derivatives of a frame's light by the parameters' coordinates, and by its states.

        Args:
            by: of the parameters by their coordinates.
        """
        by_shift = self.by_shift[k][:, own.cells]
        by_state = np.concatenate([texture[own.cells] * own.by_state, by_shift])
        by_name = by.T @ own.slopes * texture[own.cells]
        return np.concatenate([by_name, _UNITS[:, None] * by_state])

    def learnt(self) -> Self:
        """With the states' variances and the model's error; cells far off lose their weight."""
        p, q = len(self.of.names), len(STATES)
        states = (self.point.states[self.of.numbers] / _UNITS).ravel()
        data, pull = self.equations.information.copy(), -self.equations.gradient
        at = np.arange(p, len(data))
        stiff = np.tile(self.spread**-2.0, len(self.of.numbers))
        data[at, at] -= stiff
        pull[p:] += stiff * states
        # From above: a spread that was learnt too small hides what would enlarge it.
        spread = np.ones(len(STATES))
        for _ in range(_VARIANCE_ROUNDS):
            stiff = np.tile(spread**-2.0, len(self.of.numbers))
            whole = data.copy()
            whole[at, at] += stiff
            covariance = np.linalg.inv(whole)
            step = pull.copy()
            step[p:] -= stiff * states
            moved = (states + (covariance @ step)[p:]).reshape(-1, q)
            share = 1.0 - np.diag(covariance)[p:].reshape(-1, q) * spread**-2.0
            free = np.maximum(share.sum(axis=0), 1e-3)
            wide = np.sqrt(np.square(moved).sum(axis=0) / free)
            # A robot errs alike along all axes, and a microscope shakes alike along both.
            for alike in (TIP, SHIFT):
                wide[alike] = np.sqrt(np.mean(np.square(wide[alike])))
            spread = np.clip(wide, _LEAST / _UNITS, _MOST / _UNITS)
        by_shift = np.zeros_like(self.by_shift)
        count = self.of.cells.along
        for k, own in enumerate(self.now.frames):
            lit = np.zeros(count**2)
            lit[own.cells] = self.now.map[own.cells] * own.light
            down, right = np.gradient(lit.reshape(count, count), self.of.cells.side)
            by_shift[k] = -np.stack([right.ravel(), down.ravel()])
        return replace(self, spread=spread, by_shift=by_shift)._with_error()

    def _with_error(self) -> Self:
        """With the relative error that makes chi squared what it should be, and robust weights."""
        used = self.weight > 0
        rest = np.zeros(self.of.seen.shape)
        for k, (own, off) in enumerate(zip(self.now.frames, self.now.rest, strict=True)):
            rest[k, own.cells] = off
        square, noise = np.square(rest[used]), self.variance[used]
        signal, degrees = np.square(self.of.seen[used]), self.degrees_of_freedom

        def excess(error: float) -> float:
            far = square / (noise + error**2 * signal)
            return float(np.sum(np.minimum(far, _FAR_SIGMAS**2))) - degrees

        error = 0.0 if excess(0.0) <= 0 else brentq(excess, 0.0, 1.0) if excess(1.0) < 0 else 1.0
        far = np.abs(rest) / np.sqrt(self.variance + (float(error) * self.of.seen) ** 2)
        # The weight of Geman and McClure, as in the estimator.
        trust = (_FAR_SIGMAS / np.maximum(far, _FAR_SIGMAS)) ** 4
        chi_squared = float(np.sum(square / noise))
        return replace(self, error=float(error), trust=trust, chi_squared=chi_squared)._reweighed()

    @property
    def degrees_of_freedom(self) -> int:
        """Number of data less that of all that was fitted to them."""
        known = 1.0 - self.tau**-2.0 / self.now.information
        return max(self.data - round(float(known.sum())) - len(self.of.names), 1)

    @property
    def misfit(self) -> float:
        """Mean square of the residuals, in variances; far ones count as `_FAR_SIGMAS`."""
        squares = (
            np.minimum(self.weight[k, own.cells] * np.square(rest), _FAR_SIGMAS**2).sum()
            for k, (own, rest) in enumerate(zip(self.now.frames, self.now.rest, strict=True))
        )
        return float(sum(squares)) / self.data

    def flattened(self) -> Self:
        """With an even wall, unless that explains the frames worse than chance allows."""
        cells = float(np.sum(1.0 - self.tau**-2.0 / self.now.information))
        even, _ = replace(self, tau=EVEN).minimised(1.0, follow=False)
        if even.equations.cost - self.equations.cost > cells + _UNEVEN_SIGMAS * math.sqrt(
            2.0 * cells
        ):
            return self
        # Weights by a map that the frames' noise has shaped prefer the cells that it darkened.
        even, _ = even.chosen(guess=False).minimised(1.0, follow=False)
        return even.learnt()

    @property
    def textured(self) -> bool:
        """Whether the wall is not even."""
        return self.tau == _FREE_TAU

    @property
    def states(self) -> dict[str, float]:
        """Learnt standard deviations of the frames' own states."""
        return dict(zip(STATES, (self.spread * _UNITS).tolist(), strict=True))

    @property
    def surely_textured(self) -> bool:
        """Whether the cells differ by more than an even wall's do."""
        used = self.weight.any(axis=0)
        far = np.square(self.now.map[used] - 1.0) * self.now.information[used]
        return float(np.mean(far)) > _TEXTURED

    def weighed_by_noise(self) -> Self:
        """With cells weighed by the camera's noise alone, as if the model missed nothing."""
        fit = replace(self, error=0.0, trust=np.ones(self.of.seen.shape))
        return fit._reweighed().evaluated()

    def effective(self) -> tuple[Float[np.ndarray, "p p"], Callable[[int], np.ndarray]]:
        """Information of the parameters over their sizes, and derivatives by these in a frame.

        Both with all else eliminated: the states and the map.
        """
        p, q = len(self.of.names), len(STATES)
        whole = self.equations.information
        by_state = np.linalg.solve(whole[p:, p:], whole[p:, :p]).T
        information = whole[:p, :p] - by_state @ whole[p:, :p]
        by = self.coordinates.slopes(self.point.values)
        over_size = np.linalg.solve(by, np.diag(self.sizes))  # derivatives of the coordinates
        projected = []
        mixed = np.zeros((p, self.now.map.size))
        for k, own in enumerate(self.now.frames):
            slopes = self._slopes(k, own, self.now.map, by)
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
