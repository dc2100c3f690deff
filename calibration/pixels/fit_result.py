"""What a fit to pixels found: parameters with their covariance, misfit, residuals, ghost."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from eyespot.calibration.least_squares import covariance_and_lost, propagated
from eyespot.calibration.pixels.beam_fit import BeamFit
from eyespot.calibration.pixels.light import STATES
from eyespot.calibration.pixels.misfit import Misfit, Pixels, found_misfit
from eyespot.calibration.spots.cone_trials import Prior
from eyespot.estimator.ghost import Ghost, strongest_ghost

_GHOST_FRAMES = 6  # evenly over the withdrawal, in which a ghost is looked for
_LEAST_LIGHT = 1e-6  # over the frame's peak: there may be no light at all, and weights need some

Failure = tuple[Literal["STEPS", "FIRST_ROUND", "TABLES"], str]
"""The criterion of convergence that a fit does not meet, and the reason with its value: a further
step would still lower chi squared, after the first rounds the model misses light, or two tables of
a lens's light lead to different results."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImageFit:
    """The free parameters, including nuisances, with their standard errors.

    Attributes:
        parameters: value and standard error by name (see `UNITS`).
        values: values of all parameters, including those that were not fitted.
        priors: of free parameters.
        considered: part of each standard error by errors of what was taken as stated.
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
        over_bound: largest standard error of the beam's own parameters over its Cramér-Rao bound,
            with the camera's noise, the priors, and a wall that nobody knows.
        textured: whether the wall's texture was learnt; otherwise the wall is even.
        states: standard deviations of what each frame has of its own, learnt from the frames: the
            logarithms of power and exposure, the tip's place, mm, and the image's shift, px.
        residuals: light minus model over sigma, frames x h x w; NaN for pixels not fitted. The
            pixels of a cell all have the residual of its mean.
        side: of the cells, px.
        ghost: a second image of the spot, the one that explains best what is left of the light.
    """

    parameters: dict[str, tuple[float, float]]
    values: dict[str, float]
    priors: Mapping[str, Prior]
    considered: Mapping[str, float]
    covariance: Float[np.ndarray, "p p"]
    chi_squared: float
    degrees_of_freedom: int
    misfit: Misfit
    tips: Float[np.ndarray, "frames 3"]
    axis: Float[np.ndarray, "3"]
    undetermined: tuple[str, ...]
    failed: Failure | None
    numerical_inflation: float
    over_bound: float
    textured: bool
    states: dict[str, float]
    residuals: Float[np.ndarray, "frames h w"]
    side: int
    ghost: Ghost | None = None

    @property
    def converged(self) -> bool:
        """Whether the fit meets its criterion of convergence."""
        return self.failed is None

    @property
    def chi_squared_per_dof(self) -> float:
        """Expected to be 1 if camera and model are as assumed."""
        return self.chi_squared / self.degrees_of_freedom


def covariance_with(
    fit: BeamFit, information: Float[np.ndarray, "p p"], considered: Mapping[str, Prior]
) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, "p p"], tuple[str, ...]]:
    """Covariance by noise, with infinite variances of what is considered; that of the considered.

    And what the data do not determine. All are of parameters over their sizes, as the fit's
    effective information is. See Schmidt (1966) for parameters whose errors are considered, though
    they are not estimated.
    """
    names, values = fit.of.names, fit.point.values
    held = np.array([names.index(name) for name in considered], int)
    fitted = np.delete(np.arange(len(names)), held)
    own, lost = covariance_and_lost(
        information[np.ix_(fitted, fitted)],
        [names[k] for k in fitted],
        [values[names[k]] for k in fitted],
    )
    by_noise = np.zeros_like(information)
    by_noise[np.ix_(fitted, fitted)] = own
    by_noise[held, held] = np.inf
    known = np.isfinite(np.diag(own))
    follows = np.zeros((len(names), len(held)))
    follows[fitted[known]] = -own[np.ix_(known, known)] @ information[np.ix_(fitted[known], held)]
    follows[held, range(len(held))] = 1.0
    sigmas = [prior.sigma / fit.sizes[names.index(name)] for name, prior in considered.items()]
    root = follows * sigmas
    return by_noise, root @ root.T, lost


def result_of(
    fit: BeamFit,
    considered: Mapping[str, Prior],
    failed: Failure | None,
    of_table: np.ndarray | None = None,
) -> ImageFit:
    """What a fit found, with the light and the derivatives of its end.

    Args:
        considered: what it took as stated.
        failed: the criterion of convergence that it does not meet.
        of_table: covariance by numerical errors of a lens's light, of parameters over their sizes.
    """
    values, names = fit.point.values, fit.of.names
    information, slopes_of = fit.effective()
    covariance, of_considered, lost = covariance_with(fit, information, considered)
    held = [names.index(name) for name in considered]
    frames = fit.now.frames
    places = fit.of.cells.centres()

    def pixels(k: int) -> Pixels:
        own, rest = frames[k], fit.now.rest[k]
        weight = np.sqrt(fit.weight[k, own.cells])
        used = weight > 0
        u, v = places[own.cells[used]].T
        light = (fit.now.map[own.cells] * own.light)[used]
        slopes = slopes_of(k)[:, used]
        off = -(weight * rest)[used]
        number = fit.of.numbers[k]
        return Pixels(number, u, v, own.direct[used], light, weight[used], off, slopes)

    degrees = fit.degrees_of_freedom
    misfit, covariance = found_misfit(
        (pixels(k) for k in range(len(frames))),
        covariance,
        share=fit.error,
    )
    inflation = 1.0
    if of_table is not None:
        known = np.isfinite(np.diag(covariance))
        grown = np.diag(of_table)[known] / np.diag(covariance)[known]
        inflation = float(np.sqrt(1 + np.max(grown)))
        covariance = covariance + of_table
    covariance[held, held] = 0.0
    sizes = np.diag(fit.sizes)
    covariance = propagated(sizes, covariance + of_considered)
    stated = (fit.sizes * np.sqrt(np.diag(of_considered))).tolist()
    errors = np.sqrt(np.diag(covariance)).tolist()
    residuals = np.full(fit.of.footage.light.shape, np.nan, np.float32)
    cells = fit.of.cells
    side, count = cells.side, cells.along
    height, width = fit.of.footage.light[0].shape
    for k, own in enumerate(frames):
        off = np.full(count**2, np.nan, np.float32)
        weight = np.sqrt(fit.weight[k, own.cells])
        off[own.cells] = np.where(weight > 0, weight * fit.now.rest[k], np.nan)
        whole = np.kron(off.reshape(count, count), np.ones((side, side), np.float32))
        rows, columns = (
            slice(-cells.top, height - cells.top),
            slice(-cells.left, width - cells.left),
        )
        residuals[fit.of.numbers[k]] = whole[rows, columns]
    ghost = _ghost_of(fit)
    by_noise = fit.weighed_by_noise()
    least, of_considered, _ = covariance_with(by_noise, by_noise.effective()[0], considered)
    least[held, held] = 0.0
    beam = [number for number, name in enumerate(names) if name in fit.of.light.own]
    with np.errstate(invalid="ignore"):  # of what is not determined
        over = (
            np.array(errors)[beam]
            / np.sqrt(np.diag(propagated(sizes, least + of_considered)))[beam]
        )
    return ImageFit(
        parameters={n: (values[n], error) for n, error in zip(names, errors, strict=True)},
        values=values,
        priors={n: prior for n, prior in {**fit.of.priors, **considered}.items() if n in names},
        considered=dict(zip(names, stated, strict=True)),
        covariance=covariance,
        chi_squared=fit.chi_squared,
        degrees_of_freedom=degrees,
        misfit=misfit,
        tips=np.array([own.tip for own in frames]),
        axis=frames[0].axis,
        undetermined=lost,
        failed=failed,
        textured=fit.textured,
        states=fit.states,
        residuals=residuals,
        numerical_inflation=inflation,
        over_bound=float(np.max(over, initial=0.0, where=np.isfinite(over))),
        side=side,
        ghost=ghost,
    )


def _ghost_of(fit: BeamFit) -> Ghost | None:
    """The ghost that explains best what some frames leave of the light."""
    cells = fit.of.cells
    some = np.unique(np.linspace(0, len(fit.of.numbers) - 1, _GHOST_FRAMES).round().astype(int))
    shape = len(some), cells.along**2
    residual, weight, light = (np.zeros(shape) for _ in range(3))
    total, slopes = np.ones(shape), []
    for row, k in enumerate(some):
        own = fit.now.frames[k]
        at, modelled = own.cells, fit.now.map[own.cells] * own.light
        modelled = np.maximum(modelled, _LEAST_LIGHT * modelled.max())
        residual[row, at] = fit.now.rest[k] / modelled
        weight[row, at] = fit.weight[k, at] * modelled**2
        light[row, at], total[row, at] = np.maximum(own.direct, 0.0), own.light
        by = np.zeros((len(fit.of.names) + len(STATES), cells.along**2))
        by[:, at] = fit.slopes(k) / modelled
        slopes.append(by)
    square = len(some), cells.along, cells.along
    return strongest_ghost(
        residual, weight, light.reshape(square), total.reshape(square), slopes, side_px=cells.side
    )
