"""The half maximum of a saturated spot, from the part of its flank that is below full scale."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from estimator.detector.ellipse import Ellipse
from estimator.detector.levels import Levels
from estimator.detector.tuning import RAYS, Saturated
from estimator.detector.unwrap import Patch

_ROUNDING = math.sqrt(np.finfo(float).eps)  # leaves half of the digits


def hidden_edge(
    patch: Patch, ellipse: Ellipse, inliers: np.ndarray, levels: Levels, reach: float
) -> tuple[Levels, float, float] | None:
    """Levels, radius offset and that offset's variance, of an edge whose plateau is at full scale.

    The visible part of the flank is fitted with background + amplitude * Phi((offset - x) / width)
    by damped Gauss-Newton steps (Levenberg 1944): the plateau follows from the flank's curvature,
    so the edge must be a Gaussian-blurred step. The pixels themselves are averaged over the
    contour, because samples between a saturated pixel and its neighbour would be too dark.

    Args:
        patch: signal round the spot.
        ellipse: about which the contour is averaged.
        inliers: rays that show it.
        levels: of the spot, the peak unknown.
        reach: of the profile, units of the radius.

    Returns:
        None if the flank below full scale does not contain half of the peak, or is no blurred step.
    """
    bins = max(int(2 * reach * ellipse.axes()[1] / Saturated.BIN_PX), Saturated.FEWEST_BINS)
    x, mean, number = _pixel_profile(patch, ellipse, inliers, reach, bins)
    bright = np.flatnonzero(mean > Saturated.READABLE * patch.ceiling)
    first = int(bright[-1]) + 1 if bright.size else 0
    x, y = x[first:], (mean[first:] - levels.background) / patch.ceiling
    root = np.sqrt(number[first:])
    if x.size < Saturated.FEWEST_BINS:
        return None
    start = np.array([math.log(1.4), float(x[0]), math.log(levels.width)])
    try:
        fitted, covariance, misfit = _flank(start, x, y, root)
    except np.linalg.LinAlgError:  # too little of the flank to separate height, place and width
        return None
    peak, variance = (
        levels.background + patch.ceiling * math.exp(fitted[0]),
        float(covariance[1, 1]),
    )
    if not (peak < Saturated.BRIGHTEST * patch.ceiling and 0 <= variance < Saturated.VAGUEST**2):
        return None
    if abs(fitted[1]) > reach:  # not on the profile
        return None
    if misfit > Saturated.MISFIT:  # a lamp's reflex, which has a halo
        return None
    return replace(levels, peak=peak, width=math.exp(fitted[2])), float(fitted[1]), variance


def _flank(
    start: np.ndarray, x: np.ndarray, y: np.ndarray, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Fitted (log amplitude, offset, log width), their covariance, and the deviation left.

    Raises:
        LinAlgError: the flank does not determine them.
    """
    fitted = start
    residual, jacobian = _linearised(fitted, x, y, root)
    damping = 1e-3
    for _ in range(Saturated.STEPS):
        gram = jacobian.T @ jacobian
        gram.flat[::4] *= 1 + damping
        step = np.clip(np.linalg.solve(gram, jacobian.T @ residual), -0.5, 0.5)
        trial_residual, trial_jacobian = _linearised(fitted + step, x, y, root)
        if trial_residual @ trial_residual < residual @ residual:
            fitted, residual, jacobian = fitted + step, trial_residual, trial_jacobian
            damping /= 4
        else:
            damping *= 8
        if np.abs(step).max() < Saturated.SMALLEST_STEP:
            break
    information = jacobian.T @ jacobian
    size = np.sqrt(np.diag(information))
    # No light is left on the flank, or it is so short that rounding decides on the inverse.
    if not size.min() > _ROUNDING:
        raise np.linalg.LinAlgError
    if not np.linalg.eigvalsh(information / np.outer(size, size))[0] > _ROUNDING:
        raise np.linalg.LinAlgError
    square = float(residual @ residual)
    covariance = square / (x.size - 3) * np.linalg.inv(information)
    return fitted, covariance, math.sqrt(square / float(root @ root))


def hidden_bell(
    patch: Patch, ellipse: Ellipse, inliers: np.ndarray, levels: Levels
) -> tuple[Levels, float, float] | None:
    """As `hidden_edge`, of a bell whose top is at full scale.

    The flank is fitted with background + peak * (1 + (2^(1/m) - 1) t^p)^-m, where t is the radius
    over that of the half maximum: Gaussian for p = 2 and large m (Moffat 1969 has p = 2). Power and
    tail are free within what bells have, so that the error of the radius contains that of the
    shape.
    """
    from scipy.optimize import least_squares

    x, y, number = _pixel_profile(
        patch, ellipse, inliers, Saturated.BELL_REACH, Saturated.BELL_BINS
    )
    bright = np.flatnonzero(y > Saturated.READABLE * patch.ceiling)
    first = int(bright[-1]) + 1 if bright.size else 0
    t, y, root = (
        1 + x[first:],
        (y[first:] - levels.background) / patch.ceiling,
        np.sqrt(number[first:]),
    )
    if t.size < Saturated.FEWEST_BINS:
        return None
    root /= root.mean()

    def residuals(at: np.ndarray, error: float) -> np.ndarray:
        height, radius, power, tail = at
        lift = np.expm1(np.log(2) * tail) / tail
        falling = np.log1p(tail * lift * (t / np.exp(radius)) ** np.exp(power)) / tail
        prior = (power - math.log(2)) / Saturated.POWER, tail / Saturated.TAIL
        return np.append((y - np.exp(height - falling)) * root / error, prior)

    fitted, error = np.array([0.1, 0.0, math.log(2), 0.1]), Saturated.MISFIT
    for _ in range(2):
        found = least_squares(
            residuals,
            fitted,
            bounds=([-2, -1, math.log(Saturated.CUSP), 1e-3], [2, 1, math.log(8), 1]),
            args=(error,),
        )
        fitted, left = found.x, found.fun[:-2] * error
        error = max(math.sqrt(float(left @ left) / (t.size - 4)), 1e-6)
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    radius, variance = math.exp(fitted[1]), float(covariance[1, 1])
    peak = levels.background + patch.ceiling * math.exp(fitted[0])
    height, _, power, tail = fitted.tolist()
    # Where the bell on its background reaches full scale, over the radius of its half maximum.
    height -= math.log1p(-levels.background / patch.ceiling)
    full = max(math.expm1(height * tail) / math.expm1(math.log(2) * tail), 0.0) ** math.exp(-power)
    hidden = full**2
    cusp = power < math.log(Saturated.CUSP) + 1e-3
    if cusp or hidden > Saturated.MOST_HIDDEN or error > Saturated.BELL_MISFIT:
        return None
    return replace(levels, peak=peak, variance=0.0), radius - 1, radius**2 * variance


def _pixel_profile(
    patch: Patch, ellipse: Ellipse, inliers: np.ndarray, reach: float, bins: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radius offsets of bins along the edge, their mean signal, and their number of pixels."""
    height, width = patch.signal.shape
    u = np.arange(width, dtype=np.float32) + np.float32(patch.x0 - ellipse.centre[0])
    v = np.arange(height, dtype=np.float32) + np.float32(patch.y0 - ellipse.centre[1])
    to_circle = np.linalg.inv(ellipse.shape).astype(np.float32)
    cos = to_circle[0, 0] * u + to_circle[0, 1] * v[:, None]
    sin = to_circle[1, 0] * u + to_circle[1, 1] * v[:, None]
    offset = np.sqrt(cos * cos + sin * sin) - 1
    band = np.abs(offset) < reach
    ray = np.rint(np.arctan2(sin[band], cos[band]) * (RAYS / (2 * math.pi))).astype(int) % RAYS
    offset, signal = offset[band][inliers[ray]], patch.signal[band][inliers[ray]]
    index = np.minimum(((offset + reach) * (bins / (2 * reach))).astype(int), bins - 1)
    number = np.bincount(index, minlength=bins)
    sums = np.bincount(index, offset, bins), np.bincount(index, signal, bins)
    filled = number > 0
    number = number[filled]
    return sums[0][filled] / number, sums[1][filled] / number, number


def _linearised(
    parameters: np.ndarray, x: np.ndarray, y: np.ndarray, root: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted residual of (log amplitude, offset, log width) and the model's Jacobian."""
    amplitude, width = math.exp(parameters[0]), math.exp(parameters[2])
    z = (parameters[1] - x) / width
    edge = amplitude * np.array([0.5 * math.erfc(-v / math.sqrt(2)) for v in z.tolist()])
    density = amplitude * np.exp(-0.5 * z * z) / math.sqrt(2 * math.pi)
    jacobian = np.stack([edge, density / width, -density * z], axis=1)
    return (y - edge) * root, jacobian * root[:, None]
