"""The result of a fit to all pixels."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from calibration.pixels.misfit import Misfit


class Criterion(Enum):
    """What a fit must meet to have converged."""

    STEPS = auto()
    """A further step would hardly lower chi squared."""
    FIRST_ROUND = auto()
    """After the first round the model has most of the light."""
    TABLES = auto()
    """Two tables of a lens's light lead to the same result."""


class Failure(NamedTuple):
    """The criterion of convergence that a fit does not meet, and the reason with its value."""

    criterion: Criterion
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageFit:
    """The free parameters, including nuisances, with their standard errors.

    Attributes:
        parameters: value and standard error by name (see `UNITS`).
        values: values of all parameters, including those that were not fitted.
        covariance: covariance of `parameters` in their order, from camera noise, priors and misfit.
        misfit: the light that the model lacks.
        chi_squared: sum of squared residuals over their sigma, priors included.
        degrees_of_freedom: number of pixels and priors minus number of parameters.
        tips: tips of the frames that were fitted, mm, eye frame.
        axis: unit vector along the beam from the tip towards the wall, eye frame.
        undetermined: parameters that neither data nor priors determine, in words; may be empty.
        failed: the criterion of convergence that the fit does not meet; None if it converged.
        numerical_inflation: largest factor by which numerical errors of the lens's light enlarge a
            standard error; contained in `covariance`.
        textured: whether the wall's texture was learnt; otherwise the wall is even.
        states: standard deviations of what each frame has of its own, learnt from the frames: the
            logarithms of power and exposure, the tip's place, mm, and the image's shift, px.
        residuals: light minus model over sigma, frames x h x w; NaN for pixels not fitted. The
            pixels of a cell all have the residual of its mean.
        side: of the cells, px.
    """

    parameters: dict[str, tuple[float, float]]
    values: dict[str, float]
    covariance: Float[np.ndarray, "p p"]
    chi_squared: float
    degrees_of_freedom: int
    misfit: Misfit
    tips: Float[np.ndarray, "frames 3"]
    axis: Float[np.ndarray, "3"]
    undetermined: tuple[str, ...]
    failed: Failure | None
    numerical_inflation: float
    textured: bool
    states: dict[str, float]
    residuals: Float[np.ndarray, "frames h w"]
    side: int

    @property
    def converged(self) -> bool:
        """Whether the fit meets its criterion of convergence."""
        return self.failed is None

    @property
    def chi_squared_per_dof(self) -> float:
        """Expected to be 1 if camera and model are as assumed."""
        return self.chi_squared / self.degrees_of_freedom
