"""The result of a fit to all pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageFit:
    """Parameters that were free, nuisances included, and how well the pixels know them.

    Attributes:
        parameters: by name (see `UNITS`), value and standard error.
        values: of all parameters, the given ones too.
        covariance: of `parameters` in their order, from the camera's noise and the priors.
        chi_squared: sum of squared residuals over their sigma, priors included.
        degrees_of_freedom: pixels and priors minus parameters.
        tips: of the frames, mm, eye frame.
        axis: of the beam, unit vector from the tip towards the wall, eye frame.
        undetermined: directions that neither data nor priors hold, in words; empty if none.
        converged: whether less than 0.001 of chi squared was still to be had.
        residuals: frames x h x w, light minus model over sigma; NaN where not fitted.
    """

    parameters: dict[str, tuple[float, float]]
    values: dict[str, float]
    covariance: Float[np.ndarray, "p p"]
    chi_squared: float
    degrees_of_freedom: int
    tips: Float[np.ndarray, "frames 3"]
    axis: Float[np.ndarray, "3"]
    undetermined: tuple[str, ...]
    converged: bool
    residuals: Float[np.ndarray, "frames h w"]

    @property
    def chi_squared_per_dof(self) -> float:
        """1 where camera and model are as assumed."""
        return self.chi_squared / self.degrees_of_freedom
