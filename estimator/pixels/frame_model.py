"""The model of one frame: the light of a window's cells at a state, and what it weighs.

See `solver` for the formula.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter, minimum_filter

from estimator.pixels.beam import POSE, BeamLight
from estimator.pixels.blur import blurred
from estimator.pixels.cells import COUNT, SHADES, Window
from estimator.pixels.frame_state import FrameState, Linear, prior_cost
from estimator.pixels.saturation import CUT, covered
from estimator.pixels.texture import Texture

_SHADED = 3.0  # largest logarithm of ambient light over that in the middle
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
_DARKEST = 1e-6  # full wells
_NO_LIGHT = 1e-6  # 1/mm², above what rounding leaves of none
_HIDDEN = 16.0  # largest square of a cell's residual that counts for a start, in variances
_BRIGHTEST = 100.0  # ambient light over that of the beam, 1/mm², from which a fit starts
_OVER = 4.0  # light of a saturated spot over full scale, from which a fit starts
_BRIGHTER, _DIM = 0.75, 0.2
"""Quantiles: of the lit cells' light, most of which may be hidden; and of all cells by the beam's
light, of which the dimmer ones show the ambient light."""


class FrameModel:
    """Models frames on the cells of a window.

    Args:
        beam: the light of the beam.
        window: the cells.
        texture: of the wall.
        grain: how the wall's map grows to the right and downwards, 1/px; None if there is no map.
    """

    def __init__(
        self,
        beam: BeamLight,
        window: Window,
        texture: Texture,
        grain: Float[np.ndarray, "2 n"] | None = None,
    ) -> None:
        self.beam, self.window, self.texture, self.grain = beam, window, texture, grain
        self.lattice = functools.partial(beam.lattice, window)
        self.side_mm = window.side * beam.scale_mm_px

    def linear(
        self, frame: FrameState, own: np.ndarray, *, trust: np.ndarray | None = None
    ) -> Linear:
        """A frame's model at its state."""
        light, usable = (part.ravel() for part in frame.cells.means(self.window))
        seen = self.beam.irradiance(
            self.window,
            frame.cells.motion,
            frame.pose,
            own,
            sweep=frame.sweep,
            blur_px2=frame.blur_px2,
            kurtosis=frame.kurtosis,
        )
        shade = np.clip(np.array(frame.shade) @ SHADES, -_SHADED, _SHADED)
        ambient = np.exp(frame.log_ambient + shade)
        # Between the samples of a table, light that is nearly none may be less than none.
        value = np.maximum(seen.value, 0.0)
        of_beam = np.concatenate([seen.slopes, seen.bend[None], seen.tails[None]])
        by_gain, uncovered = np.ones(value.size), np.ones(value.size)
        if frame.saturated:
            spot = covered(
                value, self._room(frame, ambient), of_beam, pixel_mm=self.beam.scale_mm_px
            )
            value, of_beam, uncovered = spot.light, spot.slopes, 1.0 - spot.cover
            usable = usable & ~spot.whole
            by_gain = np.where(spot.over, ambient * uncovered / (value + ambient), 1.0)
        total = value + ambient
        model = np.exp(frame.log_gain) * total
        shaped = frame.blur_px2 / (frame.blur_px2 + _SHAPED_PX2)
        error = np.hypot(_SMEAR * seen.by_motion, _BLURRED * shaped * seen.by_blur) / total
        weight = self._weight(frame, light, usable, model, error=error)
        deviation = np.sqrt(frame.cells.variance(np.maximum(light, 0.0))) / self.window.side
        light = np.maximum(light, np.maximum(deviation, _DARKEST))
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
            weight=weight if trust is None else weight * trust,
        )

    def changes(
        self, frame: FrameState, own: np.ndarray, moves: list[Float[np.ndarray, "3"]]
    ) -> Float[np.ndarray, "k n"]:
        """How the log light of cells changes if the spot moves; also by not at all.

        Args:
            frame: at its state.
            own: changes of the beam's own parameters.
            moves: of the spot to the right and downwards on the wall, and of the distance, mm.
        """
        lattice, seen = self.lattice(frame.cells.motion), []
        for move in [np.zeros(3), *moves]:
            pose = self.beam.pose(*frame.pose.moved(np.concatenate([move, np.zeros(2)])))
            light = self.beam.irradiance_alone(lattice, pose or frame.pose, own)
            seen.append(self.log_light(frame, light))
        return np.array(seen) - seen[0]

    def log_light(self, frame: FrameState, light: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Logarithm of a frame's light over its gain, where the beam's is some before the blur."""
        light = blurred(light, frame.blur_px2 / self.window.side**2, frame.kurtosis)
        light, ambient = np.maximum(light, 0.0), math.exp(frame.log_ambient)
        if frame.saturated:
            light = covered(light, self._room(frame, ambient)).light
        return np.log(light + ambient)

    def _room(
        self, frame: FrameState, ambient: Float[np.ndarray, "n"] | float
    ) -> Float[np.ndarray, "n"]:
        """Light of the beam that takes a cell to full scale, beside the ambient light."""
        return np.full(COUNT**2, frame.cells.ceiling * math.exp(-frame.log_gain)) - ambient

    def light(self, frame: FrameState, own: np.ndarray) -> Float[np.ndarray, "n"]:
        """Irradiance of the cells in a frame per unit power, 1/mm², without motion and blur."""
        return self.beam.irradiance_alone(self.lattice(frame.cells.motion), frame.pose, own)

    def scanned(self, frame: FrameState, own: np.ndarray) -> tuple[FrameState, float] | None:
        """A frame with the gain and ambient light that suit its pose, and its cost.

        None if the beam lights no cell that is usable.

        Where something hides the spot or casts a shadow on it, it is darker. So the gain is that of
        the brighter cells.
        """
        light, usable = (part.ravel() for part in frame.cells.means(self.window))
        irradiance = self.light(frame, own)
        lit = usable & (irradiance > 0.5 * irradiance.max(where=usable, initial=_NO_LIGHT))
        if not lit.any():
            return None
        dim = usable & (irradiance <= np.quantile(irradiance[usable], _DIM))
        gain = offset = 0.0
        for _ in range(2):
            gain = float(np.quantile((light - offset)[lit] / irradiance[lit], _BRIGHTER))
            gain *= _OVER if frame.saturated else 1.0
            offset = float(np.median((light - gain * irradiance)[dim]))
        gain = max(gain, _DARKEST)
        ambient = np.clip(offset / gain, 1e-4, _BRIGHTEST)
        suited = replace(frame, log_gain=float(np.log(gain)), log_ambient=float(np.log(ambient)))
        model = np.maximum(irradiance, 0.0)
        if frame.saturated:
            model = covered(model, self._room(suited, ambient)).light
        model = gain * (model + ambient)
        weight = self._weight(suited, light, usable, model)
        # Here the texture counts as noise without correlation: this finds starts, not poses.
        spread = 1.0 / np.where(usable, weight, 1.0) + self.texture.variance
        residual = np.log(np.maximum(light, _DARKEST) / np.maximum(model, _DARKEST))
        squares = np.minimum(np.square(residual) / spread, _HIDDEN)
        return suited, float(np.sum(np.where(usable, squares, 0.0))) + prior_cost(suited)

    def _weight(
        self,
        frame: FrameState,
        light: np.ndarray,
        usable: np.ndarray,
        model: np.ndarray,
        *,
        error: np.ndarray | float = 0.0,
    ) -> np.ndarray:
        """1 over the variances of the cells' log light, by camera, image model and its error."""
        # The level is that of both, so that neither a wrong model nor a dark cell has too much
        # weight.
        level = np.maximum(np.sqrt(np.maximum(light, _DARKEST) * model), _DARKEST)
        variance = frame.cells.variance(level) / self.window.side**2 / level**2
        slope = np.hypot(*np.gradient(np.log(model).reshape(COUNT, COUNT))).ravel()
        # Light enters at the bright side of a cell, where the reflectance differs.
        aside = np.minimum(slope / 12.0, 0.5) * self.side_mm
        variance += np.square(error) + _FLOOR**2 + 0.5 * self.texture.variogram(aside)
        # As many pixels as a side is long are cut by a sharp edge, if the cell is one between a
        # brighter and a darker one. Its light is wrong then, and all the more its logarithm.
        brighter = maximum_filter(model.reshape(COUNT, COUNT), 3).ravel()
        darker = minimum_filter(model.reshape(COUNT, COUNT), 3).ravel()
        step = 2.0 * np.sqrt((brighter - model) * (model - darker))
        cut = CUT if frame.saturated else self.beam.cut
        variance += np.square(cut * step / level) / self.window.side**3
        return np.where(usable, 1.0 / variance, 0.0)


def lit(light: Float[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Cells in which a beam's light is above half of its maximum."""
    return light > 0.5 * light.max()


def contrast(light: Float[np.ndarray, "n"], frame: FrameState) -> float:
    """A beam's light in a frame over the ambient light, where it is brightest."""
    return float(light.max() / np.exp(frame.log_ambient))


def share(light: Float[np.ndarray, "n"], cells: Bool[np.ndarray, "n"]) -> float:
    """How much of a beam's light falls on some cells."""
    return float(light[cells].sum() / max(light.sum(), _DARKEST))
