"""Ellipses as images of the unit circle, their fit to radial edge offsets, and their profiles.

A `Patch` of light is sampled along the rays of an ellipse, and `capture` fits an ellipse to where
its rays fall to a level. Statistics go round the ring of rays.
"""

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import cv2
import numpy as np

from eyespot.estimator.detector.tuning import (
    FEWEST_RAYS,
    RAYS,
    Capture,
    ErrorGrowth,
    Refine,
    Trimming,
    WideView,
)

RADII = np.linspace(WideView.INNERMOST, WideView.OUTERMOST, WideView.SAMPLES)
"""Radii of the wide view, in units of the ellipse."""
RADIUS_STEP = float(RADII[1] - RADII[0])
"""Distance between two of them."""
_NEARNESS = (1 / (0.1 + np.abs(RADII[:-1] + RADIUS_STEP / 2 - 1))).astype(np.float32)


@dataclass(frozen=True, eq=False)
class AffineEllipse:
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
    ) -> "AffineEllipse":
        """The ellipse of a centre (px), semi-axes (px) and an angle from +x towards +y (rad)."""
        c, s = math.cos(angle), math.sin(angle)
        shape = np.array([[c * semi_major, -s * semi_minor], [s * semi_major, c * semi_minor]])
        return cls(np.array([x, y], float), shape)

    @cached_property
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

    def upright(self) -> "AffineEllipse":
        """The same ellipse with a symmetric shape matrix.

        Of all shape matrices of an ellipse it is unique, so the rays meet the same pixels however
        the ellipse was reached.
        """
        (p, q), (r, s) = self.shape.tolist()
        area = abs(p * s - q * r)
        square = np.array(
            [[p * p + q * q + area, p * r + q * s], [p * r + q * s, r * r + s * s + area]]
        )
        return AffineEllipse(self.centre, square / math.sqrt(square[0, 0] + square[1, 1]))

    def scaled(self, factor: float) -> "AffineEllipse":
        """The concentric ellipse with all lengths times `factor`."""
        return AffineEllipse(self.centre, self.shape * factor)

    def stepped(self, step: np.ndarray, scale: float = 1.0) -> "AffineEllipse":
        """The ellipse whose edge lies `DESIGN @ step` further out, in units of the radius.

        Args:
            scale: factor on all lengths after the step.
        """
        u, v, p, q, r = step.tolist()
        grown = np.array([[1 + p, r], [r, 1 + q]])
        shape = self.shape @ grown * scale
        return AffineEllipse(self.centre + self.shape @ np.array([u, v]), shape)

    def half_extent(self) -> tuple[float, float]:
        """Half width and half height of the bounding box, px."""
        (p, q), (r, s) = self.shape.tolist()
        return math.hypot(p, q), math.hypot(r, s)


def offset_design(cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Matrix from the five parameters of `AffineEllipse.stepped` to radial edge offsets, (n, 5).

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

    Trimming starts from the start mask. If it keeps less than `Trimming.MOST` of the edges, it
    starts again from each quarter of the ring: what hides a part of a spot spares some of them. Of
    these fits, the one with the most edges near it is taken.

    Args:
        offsets: (n,) radial offsets of the edges.
        seen: (n,) whether there is an edge.
        start: (n,) edges that are assumed to belong.
        tolerance: error of an offset that always belongs, in units of the radius.
        limit: error from which none does.

    Returns:
        The step and the mask of the offsets that belong; None with fewer than 8 of them.
    """

    def trimmed(inliers: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        for _ in range(8):
            number = int(np.count_nonzero(inliers))
            if number < FEWEST_RAYS:
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

    plain = trimmed(start & seen)
    if plain is not None and np.count_nonzero(plain[1]) > Trimming.MOST * np.count_nonzero(seen):
        return plain
    right, below = design[:, 0] > 0, design[:, 1] > 0
    quarters = (right & below, right & ~below, ~right & below, ~right & ~below)
    others = [trimmed(quarter & seen) for quarter in quarters]
    fits = [plain, *(fit for fit in others if fit and np.abs(fit[0]).max() < Refine.LARGEST_STEP)]

    def near(fit: tuple[np.ndarray, np.ndarray]) -> int:
        return int(np.sum(seen & (np.abs(offsets - design @ fit[0]) < 2 * tolerance)))

    return max(filter(None, fits), key=near, default=None)


def refitted(ellipse: AffineEllipse, points: np.ndarray) -> AffineEllipse:
    """The ellipse nearest to points (n, 2) that lie near a given one."""
    for _ in range(3):
        cos, sin = np.linalg.solve(ellipse.shape, (points - ellipse.centre).T)
        radius = np.hypot(cos, sin)
        design = offset_design(cos / radius, sin / radius)
        ellipse = ellipse.stepped(np.linalg.lstsq(design, radius - 1, rcond=None)[0])
    return ellipse


def covariance_of_axes(ellipse: AffineEllipse, step_covariance: np.ndarray) -> np.ndarray:
    """Covariance of (x, y, semi_major, semi_minor, angle) from that of a step.

    Args:
        step_covariance: 5x5 covariance of the parameters of `AffineEllipse.stepped`.
    """
    a, b, angle = ellipse.axes
    # The shape whose columns are the semi-major and the semi-minor axis.
    canonical = AffineEllipse.from_axes(0.0, 0.0, a, b, angle).shape
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


_ANGLES = 2 * np.pi * np.arange(RAYS) / RAYS
_COS, _SIN = np.cos(_ANGLES), np.sin(_ANGLES)
_ACROSS = np.stack([_COS, _SIN])
_ALONG = np.stack([-_SIN, _COS])

DESIGN = offset_design(_COS, _SIN)
"""Radial offsets of the rays' edges by the parameters of `AffineEllipse.stepped`, (RAYS, 5)."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Signal of a rectangle of a frame, maybe subsampled.

    Attributes:
        signal: (h, w) float32.
        x0, y0, stride: column and row of the frame under the first pixel, and px per pixel.
        ceiling: signal at which pixels are clipped; infinite if none is.
        clipped: fraction of the spot's pixels that are.
    """

    signal: np.ndarray
    x0: float
    y0: float
    stride: float = 1.0
    ceiling: float = math.inf
    clipped: float = 0.0

    def unwrapped(self, ellipse: AffineEllipse, radii: np.ndarray, every: int = 1) -> np.ndarray:
        """Bilinear samples on the ellipse's rays, (RAYS / every, radii); NaN outside the patch.

        Args:
            radii: in units of the ellipse, 1 on its contour.
        """
        centre = (ellipse.centre - (self.x0, self.y0)) / self.stride
        rays = (ellipse.shape / self.stride) @ _ACROSS[:, ::every]
        x, y = centre.astype(np.float32)[:, None, None] + np.multiply.outer(
            rays.astype(np.float32), radii.astype(np.float32)
        )
        return cv2.remap(
            self.signal,
            x,
            y,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=math.nan,
        )

    def on_circle(self, ellipse: AffineEllipse) -> tuple[np.ndarray, np.ndarray]:
        """Places of all pixels, (h, w) each, where the ellipse is the unit circle; of stride 1."""
        height, width = self.signal.shape
        u = np.arange(width, dtype=np.float32) + np.float32(self.x0 - ellipse.centre[0])
        v = np.arange(height, dtype=np.float32) + np.float32(self.y0 - ellipse.centre[1])
        (a, b), (c, d) = np.linalg.inv(ellipse.shape).astype(np.float32)
        return a * u + b * v[:, None], c * u + d * v[:, None]


class Captured(NamedTuple):
    """An ellipse that follows a level of a patch, and the profiles that show it.

    Attributes:
        along: the ellipse of the profiles, a few tenths of a px from this one.
        growth: this one's size over that.
        inliers: rays whose edge belongs to the ellipse, every `Capture.EVERY`-th of `RAYS`.
        profiles: signal at `RADII` on these rays; NaN outside the patch.
        scatter: standard deviation of the inliers' edges about the ellipse, radii.
    """

    ellipse: AffineEllipse
    along: AffineEllipse
    growth: float
    inliers: np.ndarray
    profiles: np.ndarray
    scatter: float


def capture(patch: Patch, near: AffineEllipse, level: float) -> Captured | None:
    """The ellipse through the crossings of a level that are nearest to a given ellipse, if any."""
    following = near.upright()
    design = DESIGN[:: Capture.EVERY]
    tolerance = max(Capture.TOLERANCE_PX / following.axes[1], Capture.TOLERANCE)
    for _ in range(3):
        along = following
        profiles = patch.unwrapped(along, RADII, every=Capture.EVERY)
        offsets, found = _crossings(profiles, level)
        beside = np.abs(offsets) < Refine.FURTHEST
        fitted = robust_step(
            design, offsets, found, beside, tolerance=tolerance, limit=Capture.FURTHEST
        )
        if fitted is None or np.abs(fitted[0]).max() > Capture.LARGEST_STEP:
            return None
        step, inliers = fitted
        following = along.stepped(step)
        if np.abs(step).max() < Capture.NEAR_ENOUGH:
            break
    errors = (offsets - design @ step)[inliers]
    growth = 1 + float(step[2] + step[3]) / 2
    scatter = math.sqrt(float(errors @ errors) / errors.size)
    return Captured(following, along, growth, inliers, profiles, scatter)


def _crossings(profiles: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Falling crossing of the level nearest to the radius 1, as an offset from it, by ray."""
    below = profiles < level
    falling = below[:, 1:] > below[:, :-1]
    nearest = np.argmax(falling * _NEARNESS, axis=1)
    ray = np.arange(len(profiles))
    before, after = profiles[ray, nearest], profiles[ray, nearest + 1]
    # A profile that leaves the patch is NaN and has no edge.
    found = (before >= level) & (after < level)
    share = np.divide(before - level, before - after, out=np.zeros(len(ray)), where=found)
    return RADII[0] - 1 + RADIUS_STEP * (nearest + share), found


def contour_points(ellipse: AffineEllipse, offsets: np.ndarray) -> np.ndarray:
    """Image points (RAYS, 2) at radial offsets from the ellipse, px."""
    return ellipse.centre + ((1 + offsets) * (ellipse.shape @ _ACROSS)).T


def normals_of(ellipse: AffineEllipse) -> tuple[np.ndarray, np.ndarray]:
    """Outward unit normals on the rays, (2, RAYS), and radii per px along them, (RAYS,)."""
    gradients = np.linalg.inv(ellipse.shape).T @ _ACROSS
    per_px = np.hypot(*gradients)
    return gradients / per_px, per_px


def shares_of_contour(ellipse: AffineEllipse, *masks: np.ndarray) -> list[float]:
    """Fraction of the contour's length that belongs to the rays in each mask."""
    steps = np.hypot(*(ellipse.shape @ _ALONG))
    length = float(steps.sum())
    return [float(steps @ mask) / length for mask in masks]


def ring_variances(values: np.ndarray, *harmonics: slice) -> list[float]:
    """Variance per ray of values round the ring, at the wavelengths of each range of harmonics.

    Neighbouring rays share pixels and texture, so their plain scatter underestimates the error of a
    mean over the ring; the spectrum at long wavelengths does not.
    """
    parts = [values @ _waves(waves.start, waves.stop) for waves in harmonics]
    return [float(part @ part) * 2 / part.size for part in parts]


def red_share(values: np.ndarray, long: slice, *waves: float) -> tuple[float, float, list[float]]:
    """How far the long waves of values round the ring are a wall's texture, and how it grows.

    The variance of texture rises with a power of the wavelength, of fringes and noise it does not.
    What rises more steeply than texture is the shape of a beam that is no ellipse.

    Args:
        values: (RAYS,).
        waves: harmonics for which the growth is wanted.

    Returns:
        The variance of the long waves; the share of texture in it; and the texture's variance at
        each harmonic over that. So few waves leave the power open by half a power, as much as walls
        differ, so it is the mean of the frame's and the walls'.
    """
    longer, shorter = ring_variances(values, long, Refine.NEXT_WAVES_BROAD)
    ratio = math.log(_octaves_middle(Refine.NEXT_WAVES_BROAD) / _octaves_middle(long))
    seen = math.log(max(longer, 1e-30) / max(shorter, 1e-30)) / ratio
    share = math.exp(min(0.0, ErrorGrowth.STEEPEST - seen) * ratio)
    steepness = (min(max(seen, 0.0), ErrorGrowth.STEEPEST) + ErrorGrowth.STEEPNESS) / 2
    return longer, share, [(_octaves_middle(long) / wave) ** steepness for wave in waves]


def _octaves_middle(harmonics: slice) -> float:
    """Geometric mean of the harmonics."""
    return float(np.exp(np.log(np.arange(harmonics.start, harmonics.stop)).mean()))


@cache
def _waves(first: int, end: int) -> np.ndarray:
    """Cosines and sines of harmonics round the ring, (RAYS, 2 (end - first))."""
    phases = np.multiply.outer(_ANGLES, np.arange(first, end))
    return np.concatenate([np.cos(phases), np.sin(phases)], axis=1) / math.sqrt(RAYS)
