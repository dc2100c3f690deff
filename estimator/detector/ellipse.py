"""Ellipses as images of the unit circle, and their fit to radial edge offsets."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from estimator.detector.tuning import Rays, Refine, Trimming


@dataclass(frozen=True, eq=False)
class Ellipse:
    """The image of the unit circle under n -> centre + shape @ n.

    Unlike axes and angle, the shape matrix changes smoothly when the ellipse becomes a circle.

    Attributes:
        centre: (x, y), px.
        shape: 2x2, px.
    """

    centre: np.ndarray
    shape: np.ndarray

    @classmethod
    def from_axes(
        cls, x: float, y: float, semi_major: float, semi_minor: float, angle: float
    ) -> Ellipse:
        """The ellipse of a centre (px), semi-axes (px) and an angle from +x towards +y (rad)."""
        c, s = math.cos(angle), math.sin(angle)
        shape = np.array([[c * semi_major, -s * semi_minor], [s * semi_major, c * semi_minor]])
        return cls(np.array([x, y], float), shape)

    def axes(self) -> tuple[float, float, float]:
        """Semi-major axis, semi-minor axis (px) and angle in (-pi/2, pi/2] (rad)."""
        (p, q), (r, s) = self.shape.tolist()
        half_sum, half_difference = (
            (p * p + q * q + r * r + s * s) / 2,
            (p * p + q * q - r * r - s * s) / 2,
        )
        cross = p * r + q * s
        spread = math.hypot(half_difference, cross)
        major = math.sqrt(half_sum + spread)
        minor = abs(p * s - q * r) / major
        angle = 0.5 * math.atan2(cross, half_difference)
        return major, minor, math.pi / 2 if angle <= -math.pi / 2 else angle

    def canonical(self) -> Ellipse:
        """The same ellipse with its shape's columns along the semi-major and semi-minor axes."""
        x, y = self.centre.tolist()
        return Ellipse.from_axes(x, y, *self.axes())

    def upright(self) -> Ellipse:
        """The same ellipse with a symmetric shape matrix.

        Of all shape matrices of an ellipse it is unique, so the rays meet the same pixels however
        the ellipse was reached.
        """
        (p, q), (r, s) = self.shape.tolist()
        area = abs(p * s - q * r)
        square = np.array(
            [[p * p + q * q + area, p * r + q * s], [p * r + q * s, r * r + s * s + area]]
        )
        return Ellipse(self.centre, square / math.sqrt(square[0, 0] + square[1, 1]))

    def scaled(self, factor: float) -> Ellipse:
        """The concentric ellipse with all lengths times `factor`."""
        return Ellipse(self.centre, self.shape * factor)

    def stepped(self, step: np.ndarray) -> Ellipse:
        """The ellipse whose edge lies `DESIGN @ step` further out, in units of the radius."""
        u, v, p, q, r = step.tolist()
        grown = np.array([[1 + p, r], [r, 1 + q]])
        return Ellipse(self.centre + self.shape @ np.array([u, v]), self.shape @ grown)

    def half_extent(self) -> tuple[float, float]:
        """Half width and half height of the bounding box, px."""
        (p, q), (r, s) = self.shape.tolist()
        return math.hypot(p, q), math.hypot(r, s)


def offset_design(cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Matrix from the five parameters of `Ellipse.stepped` to radial edge offsets, (n, 5).

    With n = (cos, sin), centre step w and symmetric growth G the edge at n moves out by
    w . n + n' G n to first order, in units of the local radius. Its least-squares fit minimises
    the algebraic distance of the conic, uniform in the ellipse's own angle.
    """
    return np.stack([cos, sin, cos * cos, sin * sin, 2 * cos * sin], axis=-1)


def robust_step(
    design: np.ndarray,
    offsets: np.ndarray,
    seen: np.ndarray,
    start: np.ndarray,
    *,
    tolerance: float,
    limit: float,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Least-squares step through the offsets that belong to one ellipse.

    Trimming starts from the start mask. If it keeps less than `Trimming.MOST` of the edges, random
    samples of five offsets (RANSAC, Fischler and Bolles 1981; fixed seed) vote for another start.

    Args:
        design: (n, 5), see `offset_design`.
        offsets: (n,) radial offsets of the edges.
        seen: (n,) whether there is an edge.
        start: (n,) edges that are assumed to belong.
        tolerance: error of an offset that always belongs, in units of the radius.
        limit: error of an offset that never belongs.

    Returns:
        The step and the mask of the offsets that belong; None with fewer than 8 of them.
    """
    plain = _trimmed(design, offsets, seen, start & seen, tolerance, limit)
    if plain is not None and np.count_nonzero(plain[1]) > Trimming.MOST * np.count_nonzero(seen):
        return plain
    candidates = np.flatnonzero(seen)
    if candidates.size < Trimming.POSITIONS:
        return plain
    chosen = candidates[(_SAMPLES * candidates.size) // Trimming.POSITIONS]
    steps = np.linalg.solve(design[chosen] + _JITTER, offsets[chosen][..., None])[..., 0]
    errors = np.abs(design[candidates] @ steps.T - offsets[candidates, None])
    plausible = np.abs(steps).max(axis=1) < Refine.LARGEST_STEP
    votes = (errors < 2 * tolerance).sum(axis=0) * plausible
    best = int(np.argmax(votes))
    elected = np.zeros(seen.size, bool)
    elected[candidates] = errors[:, best] < 2 * tolerance
    voted = _trimmed(design, offsets, seen, elected, tolerance, limit)
    if voted is None or (plain is not None and plain[1].sum() >= voted[1].sum()):
        return plain
    return voted


_SAMPLES = np.stack(
    [np.random.default_rng(k).permutation(Trimming.POSITIONS)[:5] for k in range(Trimming.SAMPLES)]
)
_JITTER = 1e-9 * np.eye(5)


def _trimmed(
    design: np.ndarray,
    offsets: np.ndarray,
    seen: np.ndarray,
    inliers: np.ndarray,
    tolerance: float,
    limit: float,
) -> tuple[np.ndarray, np.ndarray] | None:
    for _ in range(Trimming.STEPS):
        number = int(np.count_nonzero(inliers))
        if number < Rays.FEWEST:
            return None
        weighted = design.T * inliers
        normal = weighted @ design
        normal.flat[::6] += 1e-6  # an arc too short for an ellipse stays solvable
        # Four times as fast as np.linalg.solve at this size.
        _, step = cv2.solve(normal, weighted @ offsets[:, None])
        errors = np.abs(offsets - design @ step[:, 0])
        spread = np.partition(errors[inliers], number // 3)[number // 3] / Trimming.THIRD
        kept = seen & (errors < min(max(Trimming.BELONGS * spread, tolerance), limit))
        if (kept == inliers).all():
            break
        inliers = kept
    return step[:, 0], inliers


def refitted(ellipse: Ellipse, points: np.ndarray) -> Ellipse:
    """The ellipse nearest to points (n, 2) that lie near a given one."""
    for _ in range(3):
        cos, sin = np.linalg.solve(ellipse.shape, (points - ellipse.centre).T)
        radius = np.hypot(cos, sin)
        design = offset_design(cos / radius, sin / radius)
        ellipse = ellipse.stepped(np.linalg.lstsq(design, radius - 1, rcond=None)[0])
    return ellipse


def covariance_of_axes(ellipse: Ellipse, step_covariance: np.ndarray) -> np.ndarray:
    """Covariance of (x, y, semi_major, semi_minor, angle) from that of a step.

    Args:
        ellipse: the one that was stepped.
        step_covariance: 5x5 covariance of the parameters of `Ellipse.stepped`.
    """
    a, b, _ = ellipse.axes()
    canonical = ellipse.canonical().shape
    # n' = V' n labels the same point of the contour with respect to the axes.
    (c, d), (e, f) = (cv2.invert(ellipse.shape)[1] @ canonical).tolist()
    to_axes = np.zeros((5, 5))
    to_axes[:2, :2] = canonical @ np.array([[c, e], [d, f]])
    to_axes[2, 2:] = a * np.array([c * c, e * e, 2 * c * e])
    to_axes[3, 2:] = b * np.array([d * d, f * f, 2 * d * f])
    # A circle has no angle; the floor keeps its variance finite and far above pi.
    turn = 2 * a * b / max(a * a - b * b, 1e-6 * a * a)
    to_axes[4, 2:] = turn * np.array([c * d, e * f, c * f + d * e])
    return to_axes @ step_covariance @ to_axes.T
