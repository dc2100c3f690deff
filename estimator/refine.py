"""One refinement of an ellipse with a definite edge: profiles in a band along the contour."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from .censored import READABLE, hidden_edge
from .ellipse import Ellipse, robust_step
from .levels import Levels
from .spot import NoSpot, Reason
from .unwrap import DESIGN, Patch

FURTHEST = 0.1
"""Largest error, in units of the radius, of an edge that belongs to an ellipse."""

_SAMPLING = 0.7  # px between samples across the edge
_PLATEAU = 2.6  # edge widths from the edge to where its blur no longer shows


@dataclass(frozen=True, eq=False)
class Refined:
    """An ellipse after a refinement.

    Attributes:
        ellipse: px.
        move: how far the contour moved at most, units of the radius.
        size_variance: of the contour's common offset, beyond what the offsets' scatter shows.
        levels: sharpened by what the refinement saw.
        offsets: (RAYS,) radial distance of each ray's edge from the ellipse, units of the radius.
        found: (RAYS,) rays with an edge.
        inliers: (RAYS,) rays whose edge belongs to the ellipse.
        inside: (RAYS,) rays whose contour point lies in the frame.
    """

    ellipse: Ellipse
    move: float
    size_variance: float
    levels: Levels
    offsets: np.ndarray
    found: np.ndarray
    inliers: np.ndarray
    inside: np.ndarray


def refine_edge(
    patch: Patch, ellipse: Ellipse, inliers: np.ndarray, levels: Levels
) -> Refined | NoSpot:
    """Ellipse of the half-maximum contour, from one that is off by less than the edge's width.

    Each ray's shift against the mean profile is the offset of its edge; the ellipse follows the
    offsets, and its size follows the half level of the mean profile.

    Args:
        patch: signal round the spot.
        ellipse: to start from.
        inliers: rays that make the mean profile.
        levels: of the spot.

    Returns:
        The refined ellipse, or why there is none.
    """
    semi_minor = ellipse.axes()[1]
    reach = min(max(3 * levels.width, 2.5 / semi_minor), 0.6)
    samples = 2 * min(max(int(reach * semi_minor / _SAMPLING), 5), 16) + 1
    from_edge = np.linspace(-reach, reach, samples)
    profiles = patch.unwrapped(ellipse, 1 + from_edge)
    if patch.holds(ellipse.scaled(1 + reach)):
        inside = whole = np.ones(len(profiles), bool)
    else:
        inside = ~np.isnan(profiles[:, samples // 2])
        whole = ~np.isnan(profiles[:, 0] + profiles[:, -1])
        profiles = np.nan_to_num(profiles, nan=0.0)
        inliers = inliers & whole
    number = np.count_nonzero(inliers)
    if number < 8:
        return NoSpot(Reason.NONE_FOUND)
    mean = inliers.astype(np.float32) @ profiles / np.float32(number)
    slope = _derivative(mean, from_edge[1] - from_edge[0])
    residual = profiles - mean
    offsets, gain, rough = _shifts(residual, mean, slope, from_edge, inliers)
    found = whole & (gain > 0.5) & (gain < 2) & (np.abs(offsets) < reach)
    typical = np.partition(rough[inliers], number // 2)[number // 2]
    smooth = rough < 9 * max(float(typical), 1e-5 * levels.amplitude**2)
    fitted = robust_step(
        DESIGN,
        offsets,
        _eroded(found & smooth),
        inliers,
        tolerance=0.05 / semi_minor,
        limit=FURTHEST,
    )
    if fitted is None or np.abs(fitted[0]).max() > 0.5:
        return NoSpot(Reason.NONE_FOUND)
    step, inliers = fitted
    variance = 0.0
    half: float | None
    if mean[0] > READABLE * patch.ceiling:
        hidden = hidden_edge(patch, ellipse, inliers, levels, reach)
        if hidden is None:
            return NoSpot(Reason.SATURATED)
        levels, half, variance = hidden
    else:
        levels = _sharpened(levels, from_edge, mean, float(-slope.min()))
        half = _half_crossing(from_edge, mean, levels)
        if half is None:
            return NoSpot(Reason.NONE_FOUND)
    # All of the contour moves with the half level: by sqrt(pi / 2) widths for the relative unit.
    variance += math.pi / 2 * levels.width**2 * levels.dome_variance
    return Refined(
        ellipse=ellipse.stepped(step).scaled(1 + half),
        move=max(float(np.abs(step).max()), abs(half)),
        size_variance=variance,
        levels=levels,
        offsets=offsets - DESIGN @ step,
        found=found,
        inliers=inliers,
        inside=inside,
    )


def _derivative(values: np.ndarray, spacing: float) -> np.ndarray:
    slope = np.empty_like(values)
    slope[1:-1] = (values[2:] - values[:-2]) / (2 * spacing)
    slope[0] = (values[1] - values[0]) / spacing
    slope[-1] = (values[-1] - values[-2]) / spacing
    return slope


def _shifts(
    residual: np.ndarray,
    mean: np.ndarray,
    slope: np.ndarray,
    from_edge: np.ndarray,
    inliers: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outward shift of each ray's profile against the mean, its gain, and the variance left.

    A ray differs from the mean by its shift (times minus the slope), by the wall's reflectance (a
    gain and a gradient along the ray) and by its stretch (an edge as wide in px all round is not as
    wide in radii). The latter three are random with the variances that the rays show beyond the
    noise, and the shift is estimated by generalised least squares (Aitken 1935): its signature
    counts as far as the others, in the strength in which they occur, do not imitate it.
    """
    basis = np.stack([mean, from_edge * mean, from_edge * slope, -slope], axis=1).astype(float)
    gram = basis.T @ basis
    gram.flat[::5] += 1e-12 * gram.trace() + 1e-30
    triangle = np.linalg.cholesky(gram)
    orthonormal = basis @ cv2.invert(triangle)[1].T
    parts = residual @ orthonormal.astype(np.float32)
    squares = parts * parts
    rough = np.einsum("ij,ij->i", residual, residual) - squares.sum(axis=1)
    rough = np.maximum(rough, 0) / max(residual.shape[1] - 4, 1)
    weight = inliers / np.count_nonzero(inliers)
    noise = float(weight @ rough)
    total = weight @ squares
    signature = triangle[3]
    filtered = signature * np.minimum(noise / np.maximum(total, 1e-12), 1)
    filtered[3] = signature[3]
    gain = 1 + parts[:, 0] / triangle[0, 0]
    # A brighter ray's shift shows as much more strongly.
    offsets = parts @ (filtered / (filtered @ signature)) / np.maximum(gain, 0.5)
    return offsets, gain, rough


def _eroded(mask: np.ndarray) -> np.ndarray:
    """Rays with both neighbours in the mask: a shaft's rim spoils the rays beside it."""
    wide = np.concatenate([mask[-1:], mask, mask[:1]])
    return wide[:-2] & mask & wide[2:]


def _sharpened(levels: Levels, from_edge: np.ndarray, mean: np.ndarray, steepest: float) -> Levels:
    """The levels with what the mean profile shows better: the edge's width and its plateau."""
    width = levels.amplitude / (math.sqrt(2 * math.pi) * max(steepest, 1e-12))
    inner = int(np.searchsorted(from_edge, -_PLATEAU * width))
    if inner == 0:
        return replace(levels, width=width)
    plateau = float(mean[:inner].mean())
    if not plateau > levels.background:
        return levels
    share = float(levels.share_of_peak(1 + from_edge[:inner]).mean())
    return replace(levels, width=width, peak=plateau / share)


def _half_crossing(from_edge: np.ndarray, mean: np.ndarray, levels: Levels) -> float | None:
    """Offset at which a cubic through the mean profile's middle falls to the half level."""
    level = levels.half
    heights = mean.tolist()
    falls = [k for k in range(len(heights) - 1) if heights[k] >= level > heights[k + 1]]
    if not falls:
        return None
    k = min(falls, key=lambda k: abs(k - len(heights) // 2))
    spacing = float(from_edge[1] - from_edge[0])
    share = (heights[k] - level) / (heights[k] - heights[k + 1])
    middle = float(from_edge[k]) + spacing * share
    span = max(1.8 * levels.width, 2.6 * spacing)
    first, last = np.searchsorted(from_edge, (middle - span, middle + span))
    x = (from_edge[first:last] - middle) / span
    # A weight that ends smoothly: no sample joins or leaves with a jump of the result.
    weight = 1 - x * x
    powers = np.stack([weight, x * weight, x * x * weight, x * x * x * weight], axis=1)
    rise = (mean[first:last] - level) * weight
    _, cubic = cv2.solve(powers, rise[:, None], flags=cv2.DECOMP_QR)
    c0, c1, c2, c3 = cubic[:, 0].tolist()
    root = 0.0
    for _ in range(4):
        falling = c1 + root * (2 * c2 + 3 * root * c3)
        if not falling < 0:
            return None
        root -= (c0 + root * (c1 + root * (c2 + root * c3))) / falling
    return middle + root * span
