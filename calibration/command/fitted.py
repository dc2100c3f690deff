"""What every model of `eyespot fit` takes, and what its fit comes to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from calibration.recordings import Recording
from calibration.spots import Loss, Prior


class Choices(NamedTuple):
    """What a person chooses.

    Attributes:
        free: parameters to fit; None takes the model's own.
        priors: of free parameters, and of `touch`, which recordings have taken already.
        loss: of the paper's fits.
        exposure: of a stack that holds several.
        lens: that the model lens starts from: a preset's name or a file; else empty.
    """

    free: tuple[str, ...] | None
    priors: Mapping[str, Prior]
    loss: Loss
    exposure: str | None = None
    lens: str = ""


class Curve(NamedTuple):
    """A model's curve through one recording: for the figure of distance against spot size.

    Attributes:
        semi_minor_px: e1' of the spots, ascending, px.
        distance: of the model, mm.
        band: half-width of its 95 % confidence band, mm.
    """

    semi_minor_px: Float[np.ndarray, "n"]
    distance: Float[np.ndarray, "n"]
    band: Float[np.ndarray, "n"]


class PixelResiduals(NamedTuple):
    """What a fit to all pixels leaves, in standard deviations of what is averaged.

    Attributes:
        image: mean over the frames, NaN where none was fitted.
        frames: numbers of those of which pixels were fitted.
    """

    image: Float[np.ndarray, "h w"]
    frames: Int[np.ndarray, "n"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """What any model's fit comes to.

    Attributes:
        calibration_model: name in the calibration file.
        values: of the file's parameters.
        covariance: of these.
        converged: whether the solvers say so.
        bounds: that the fit ran into, in words.
        undetermined: directions that the data do not hold, in words.
        chi_squared: None where the noise was estimated from the residuals.
        degrees_of_freedom: data and priors less parameters.
        residuals: by name, of variance 1; of all recordings' usable spots in order, or of the
            frames of a fit to pixels.
        recordings: that the residuals belong to, in their order.
        used: number of spots that had a part in the values, or of frames.
        others: rows (name, value, sigma, unit) of what was fitted beside the file's parameters.
        notes: sentences for the report.
        lines: curves by recording's name.
        pixels: of a fit to all pixels; None where spots were fitted.
    """

    calibration_model: str
    values: dict[str, float]
    covariance: Float[np.ndarray, "p p"]
    converged: bool
    residuals: dict[str, Float[np.ndarray, "n"]]
    recordings: Sequence[Recording]
    used: int
    degrees_of_freedom: int
    chi_squared: float | None = None
    bounds: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    others: list[tuple[str, float, float, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    lines: dict[str, Curve] = field(default_factory=dict)
    pixels: PixelResiduals | None = None

    @property
    def unit(self) -> str:
        """What `used` counts."""
        return "spots" if self.pixels is None else "frames"

    @property
    def chi_squared_per_degree(self) -> float | None:
        """1 where noise and geometry are as assumed."""
        return None if self.chi_squared is None else self.chi_squared / self.degrees_of_freedom
