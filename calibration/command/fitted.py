"""The choices and the result that all models of `eyespot fit` share."""

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
from calibration.spots import Loss, Prior
from estimator.files import Calibration


class Choices(NamedTuple):
    """The user's choices.

    Attributes:
        free: parameters to fit; None for the model's default.
        priors: priors of free parameters, and of `touch`, which is already part of the recordings.
        loss: loss function of the paper's fits.
        exposure: which exposure to use if the stack has several.
        lens: preset's name or file from which the model lens starts; may be empty.
        cone: calibration of the cone, for the model eye.
    """

    free: tuple[str, ...] | None
    priors: Mapping[str, Prior]
    loss: Loss
    exposure: str | None = None
    lens: str = ""
    cone: Calibration | None = None


class Curve(NamedTuple):
    """A model's curve through one recording, for the figure of distance against spot size.

    Attributes:
        semi_minor_px: e1' of the spots, ascending, px.
        distance: the model's distance, mm.
        band: half-width of the 95 % confidence band, mm.
    """

    semi_minor_px: Float[np.ndarray, "n"]
    distance: Float[np.ndarray, "n"]
    band: Float[np.ndarray, "n"]


class PixelResiduals(NamedTuple):
    """Residuals of a fit to pixels, averaged so that structure is visible, over their sigma.

    Attributes:
        maps: averages over groups of frames and neighbouring pixels; NaN where nothing was fitted.
        groups: first and last frame of each map.
        frames: numbers of the frames with fitted pixels.
        of_frames: mean over the pixels of each of these.
        misfit: what the residuals show.
    """

    maps: Float[np.ndarray, "groups h w"]
    groups: list[tuple[int, int]]
    frames: Int[np.ndarray, "n"]
    of_frames: Float[np.ndarray, "n"]
    misfit: Misfit


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """The result of a fit, in the same form for every model.

    Attributes:
        calibration_model: name in the calibration file.
        values: the calibration file's parameters.
        covariance: covariance of `values`, enlarged by the misfit.
        converged: whether the solvers converged.
        failed: the criterion of convergence that a fit to pixels does not meet; None if it does.
        bounds: bounds that the fit reached, in words.
        undetermined: parameters that the data do not determine, in words.
        chi_squared: None if the noise was estimated from the residuals.
        degrees_of_freedom: number of data and priors minus number of parameters.
        residuals: by name, with variance 1: one per usable spot of all recordings in order; empty
            for a fit to pixels.
        recordings: the recordings of the residuals, in the same order.
        used: number of spots, or of frames, that the fit used.
        others: rows (name, value, sigma, unit) of fitted parameters that the file does not contain.
        notes: sentences for the report.
        lines: curves by recording's name.
        pixels: residuals of a fit to all pixels; None for a fit to spots.
    """

    calibration_model: str
    values: dict[str, float]
    covariance: Float[np.ndarray, "p p"]
    converged: bool
    residuals: dict[str, Float[np.ndarray, "n"]]
    recordings: Sequence[Recording]
    used: int
    degrees_of_freedom: int
    failed: Failure | None = None
    chi_squared: float | None = None
    bounds: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    others: list[tuple[str, float, float, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    lines: dict[str, Curve] = field(default_factory=dict)
    pixels: PixelResiduals | None = None

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
