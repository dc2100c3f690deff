"""The result that all models of `eyespot fit` share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from calibration.pixels import Failure, Misfit
from calibration.recordings import Recording
from calibration.solvers import excess_variance
from estimator.files import QUANTITIES


class Curve(NamedTuple):
    """A model's curve through one recording, for the figure of distance against spot size."""

    semi_minor_px: Float[np.ndarray, "n"]
    """e1' of the spots, ascending."""
    distance: Float[np.ndarray, "n"]
    band: Float[np.ndarray, "n"]
    """Half-width of the 95 % confidence band, mm."""


class PixelResiduals(NamedTuple):
    """Residuals of a fit to pixels, averaged so that structure is visible, over their sigma."""

    maps: Float[np.ndarray, "groups h w"]
    """Averages over groups of frames and neighbouring pixels; NaN where nothing was fitted."""
    groups: list[tuple[int, int]]
    """First and last frame of each map."""
    frames: Int[np.ndarray, "n"]
    """Numbers of the frames with fitted pixels."""
    of_frames: Float[np.ndarray, "n"]
    """Mean over the pixels of each of these."""
    misfit: Misfit


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """The result of a fit, in the same form for every model."""

    calibration_model: str
    """Name in the calibration file."""
    values: dict[str, float]
    """The calibration file's parameters."""
    covariance: Float[np.ndarray, "p p"]
    """Of `values`, enlarged by the misfit."""
    converged: bool
    residuals: dict[str, Float[np.ndarray, "n"]]
    """By name, with variance 1: one per usable spot of `recordings` in order; empty for a fit to
    pixels. Ordered so that a misfit affects neighbours alike."""
    recordings: Sequence[Recording]
    used: int
    """Number of spots, or of frames, that the fit used."""
    degrees_of_freedom: int
    """Number of data and priors minus number of parameters."""
    failed: Failure | None = None
    """The criterion of convergence that a fit to pixels does not meet."""
    chi_squared: float | None = None
    """None if the noise was estimated from the residuals."""
    bounds: tuple[str, ...] = ()
    """Bounds that the fit reached, in words."""
    undetermined: tuple[str, ...] = ()
    """Parameters that the data do not determine, in words."""
    others: list[tuple[str, float, float, str]] = field(default_factory=list)
    """Name, value, sigma and unit of fitted parameters that the file does not contain."""
    notes: list[str] = field(default_factory=list)
    """Sentences for the report."""
    lines: dict[str, Curve] = field(default_factory=dict)
    """By the recording's name."""
    pixels: PixelResiduals | None = None
    """None for a fit to spots."""

    @property
    def rows(self) -> list[tuple[str, float, float, str]]:
        """Name, value, sigma and unit of all parameters, those of the file first."""
        sigma = np.sqrt(np.diag(self.covariance)).tolist()
        in_file = zip(self.values.items(), sigma, strict=True)
        return [
            *((name, value, error, QUANTITIES[name].unit) for (name, value), error in in_file),
            *self.others,
        ]

    @property
    def unit(self) -> str:
        """What `used` counts: spots or frames."""
        return "spots" if self.pixels is None else "frames"

    @property
    def chi_squared_per_degree(self) -> float | None:
        """Expected to be 1 if noise and geometry are as assumed."""
        return None if self.chi_squared is None else self.chi_squared / self.degrees_of_freedom

    @property
    def inflation(self) -> float:
        """Largest factor by which a misfit enlarges a standard error; 1 without."""
        if self.pixels is not None:
            return self.pixels.misfit.inflation
        value = self.chi_squared_per_degree
        return 1.0 if value is None else math.sqrt(excess_variance(value, self.degrees_of_freedom))


def bounds_hit(values: Mapping[str, float]) -> tuple[str, ...]:
    """Parameters outside their physical range, in words."""
    found = []
    for name, value in values.items():
        unit, low, high, low_included = QUANTITIES[name]
        if not low < value < high and not (low_included and value == low):
            found.append(f"{name} = {value:.6g} {unit}, outside of ({low:g}, {high:g})")
    return tuple(found)
