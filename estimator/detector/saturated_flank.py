"""Where is the half maximum of a spot whose top is at full scale?

It follows from the part of the flank below full scale: of a blurred edge, or of a bell.
"""

import math
from dataclasses import replace

import numpy as np

from eyespot.estimator.detector.ellipse_rays import AffineEllipse, Patch
from eyespot.estimator.detector.levels import Levels
from eyespot.estimator.detector.tuning import RAYS, Saturated
from eyespot.estimator.information import Information

_ROUNDING = math.sqrt(np.finfo(float).eps)  # leaves half of the digits


def hidden_edge(
    patch: Patch, ellipse: AffineEllipse, inliers: np.ndarray, levels: Levels, reach: float
) -> tuple[Levels, float, float] | None:
    """Levels, radius offset and that offset's variance, of an edge whose plateau is at full scale.

    The visible part of the flank is fitted with background + amplitude * Phi((offset - x) / width)
    by damped Gauss-Newton steps (Levenberg 1944): the plateau follows from the flank's curvature,
    so the edge must be a Gaussian-blurred step. SciPy's solver settles on other flanks, too.

    Args:
        ellipse: about which the contour is averaged over the inliers' rays.

    Returns:
        None if the flank below full scale does not contain half of the peak, or is no blurred step.
    """
    bins = max(int(2 * reach * ellipse.axes[1] / 0.25), 8)  # a quarter of a px wide
    flank = _visible_flank(patch, ellipse, inliers, reach, bins, levels.background)
    if flank is None:
        return None
    start = np.array([math.log(1.4), float(flank[0][0]), math.log(levels.width)])
    try:
        fitted, covariance, misfit = _flank(start, *flank)
    except np.linalg.LinAlgError:  # too little of the flank to separate height, place and width
        return None
    peak = levels.background + patch.ceiling * math.exp(fitted[0])
    variance = float(covariance[1, 1])
    vague = not (
        peak < 2 * Saturated.READABLE * patch.ceiling and 0 <= variance < Saturated.VAGUEST**2
    )
    # A lamp's reflex has a halo, and misfits.
    if vague or abs(fitted[1]) > reach or misfit > Saturated.MISFIT:
        return None
    return replace(levels, peak=peak, width=math.exp(fitted[2])), float(fitted[1]), variance


def _visible_flank(
    patch: Patch,
    ellipse: AffineEllipse,
    inliers: np.ndarray,
    reach: float,
    bins: int,
    background: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Mean light of bins along the edge beyond what is at full scale; None for too few of them.

    Pixels are averaged over the contour, because samples between a saturated pixel and its
    neighbour would be too dark. By bin: radius offset; light over the background, in full scales;
    and the root of the number of pixels.
    """
    cos, sin = patch.on_circle(ellipse)
    offset = np.sqrt(cos * cos + sin * sin) - 1
    band = np.abs(offset) < reach
    ray = np.rint(np.arctan2(sin[band], cos[band]) * (RAYS / (2 * math.pi))).astype(int) % RAYS
    offset, signal = offset[band][inliers[ray]], patch.signal[band][inliers[ray]]
    index = np.minimum(((offset + reach) * (bins / (2 * reach))).astype(int), bins - 1)
    number = np.bincount(index, minlength=bins)
    filled = number > 0
    number = number[filled]
    x, mean = (np.bincount(index, of, bins)[filled] / number for of in (offset, signal))
    bright = np.flatnonzero(mean > Saturated.READABLE * patch.ceiling)
    first = int(bright[-1]) + 1 if bright.size else 0
    if x.size - first < 8:  # three parameters and five degrees of freedom
        return None
    return x[first:], (mean[first:] - background) / patch.ceiling, np.sqrt(number[first:])


def _flank(
    start: np.ndarray, x: np.ndarray, y: np.ndarray, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fitted (log amplitude, offset, log width), their covariance, and the deviation left.

    Raises:
        LinAlgError: the flank does not determine them.
    """

    def linearised(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        amplitude, width = math.exp(at[0]), math.exp(at[2])
        z = (at[1] - x) / width
        edge = amplitude * np.array([0.5 * math.erfc(-v / math.sqrt(2)) for v in z.tolist()])
        density = amplitude * np.exp(-0.5 * z * z) / math.sqrt(2 * math.pi)
        jacobian = np.stack([edge, density / width, -density * z], axis=1)
        return (y - edge) * root, jacobian * root[:, None]

    fitted, damping = start, 1e-3
    residual, jacobian = linearised(fitted)
    for _ in range(25):
        step = Information(jacobian.T @ jacobian).solved(jacobian.T @ residual, damping)
        step = np.clip(step, -0.5, 0.5)
        trial_residual, trial_jacobian = linearised(fitted + step)
        if trial_residual @ trial_residual < residual @ residual:
            fitted, residual, jacobian = fitted + step, trial_residual, trial_jacobian
            damping /= 4
        else:
            damping *= 8
        if np.abs(step).max() < 1e-5:  # a thousandth of a px
            break
    found = Information(jacobian.T @ jacobian)
    # No light is left on the flank, or it is so short that rounding decides on the inverse.
    if not (np.linalg.norm(jacobian, axis=0).min() > _ROUNDING and found.least > _ROUNDING):
        raise np.linalg.LinAlgError
    square = float(residual @ residual)
    covariance = square / (x.size - 3) * found.inverse()
    return fitted, covariance, math.sqrt(square / float(root @ root))


def hidden_bell(
    patch: Patch, ellipse: AffineEllipse, inliers: np.ndarray, levels: Levels
) -> tuple[Levels, float, float] | None:
    """As `hidden_edge`, of a bell whose top is at full scale.

    The flank is fitted with background + peak * (1 + (2^(1/m) - 1) t^p)^-m, where t is the radius
    over that of the half maximum: Gaussian for p = 2 and large m (Moffat 1969 has p = 2). Power and
    tail are free within what bells have, so that the error of the radius contains that of the
    shape.
    """
    from scipy.optimize import least_squares

    # From its centre to where a Gaussian has 6 % left; texture in such bins is hardly correlated.
    flank = _visible_flank(patch, ellipse, inliers, 1.0, 32, levels.background)
    if flank is None or levels.background >= patch.ceiling:
        return None
    x, y, root = flank
    t, root = 1 + x, root / root.mean()

    def residuals(at: np.ndarray, error: float) -> np.ndarray:
        height, radius, power, tail = at
        lift = np.expm1(np.log(2) * tail) / tail
        falling = np.log1p(tail * lift * (t / np.exp(radius)) ** np.exp(power)) / tail
        prior = (power - math.log(2)) / Saturated.POWER, tail / Saturated.TAIL
        return np.append((y - np.exp(height - falling)) * root / error, prior)

    fitted, error = np.array([0.1, 0.0, math.log(2), 0.1]), Saturated.MISFIT
    bounds = [-2, -1, math.log(Saturated.CUSP), 1e-3], [2, 1, math.log(8), 1]
    for _ in range(2):
        found = least_squares(residuals, fitted, bounds=bounds, args=(error,))
        fitted, left = found.x, found.fun[:-2] * error
        error = max(math.sqrt(float(left @ left) / (t.size - 4)), 1e-6)
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    radius, variance = math.exp(fitted[1]), float(covariance[1, 1])
    peak = levels.background + patch.ceiling * math.exp(fitted[0])
    height, _, power, tail = fitted.tolist()
    # Where the bell on its background reaches full scale, over the radius of its half maximum.
    height -= math.log1p(-levels.background / patch.ceiling)
    full = max(math.expm1(height * tail) / math.expm1(math.log(2) * tail), 0.0) ** math.exp(-power)
    cusp = power < math.log(Saturated.CUSP) + 1e-3
    if cusp or full**2 > Saturated.MOST_HIDDEN or error > Saturated.BELL_MISFIT:
        return None
    return replace(levels, peak=peak, variance=0.0), radius - 1, radius**2 * variance
