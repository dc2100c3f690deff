"""Peak, background and edge width of a spot, from its profiles."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from eyespot.estimator.detector.coarse import Coarse
from eyespot.estimator.detector.ellipse_rays import DESIGN, AffineEllipse, Patch
from eyespot.estimator.detector.tuning import FEWEST_RAYS, RAYS, HalfLevel, Sharp, WideView

RADII = np.linspace(WideView.INNERMOST, WideView.OUTERMOST, WideView.SAMPLES)
"""Radii of the wide view, in units of the ellipse."""
RADIUS_STEP = float(RADII[1] - RADII[0])
"""Distance between two of them."""

_EVEN_POWERS = RADII[:, None] ** np.array([0, 2, 4])
_NEAR_EDGE = np.abs(RADII[1:-1] - 1) < HalfLevel.NEAR_EDGE
_SURROUNDINGS = np.array(HalfLevel.SURROUNDINGS)
_DIRECTIONS = DESIGN[::2, :2].T


@dataclass(frozen=True)
class Levels:
    """The quantities that determine a spot's half level.

    Attributes:
        peak: signal of the spot's brightest part, without noise and texture.
        dome: signal over the peak's, a polynomial in the squared radius.
        variance: of the peak, relative, due to texture.
        hidden: variance of the peak, relative, if the light's top may be uneven: texture hides it.
        background_radius: where it was taken, units of the radius.
        scatter: standard deviation there of what noise leaves after averaging, such as texture;
            infinite if it is out of view.
        width: of the edge in units of the radius (see `Spot.edge_width_px`).
        half_radius: where the mean profile falls to the half level, units of the radius.
    """

    peak: float
    dome: tuple[float, float, float]
    variance: float
    background: float
    background_radius: float
    scatter: float
    width: float
    half_radius: float
    hidden: float = 0.0

    @property
    def amplitude(self) -> float:
        """Peak above background."""
        return self.peak - self.background

    @property
    def half(self) -> float:
        """The level of the contour."""
        return (self.peak + self.background) / 2

    @property
    def sees_background(self) -> bool:
        """Whether the background was taken beyond the spot's light."""
        return self.background_radius > HalfLevel.FAR_ENOUGH * dark_radius(self.width)

    @property
    def tail(self) -> float:
        """A bell's light that may remain where the background was taken, over its amplitude."""
        if self.width < HalfLevel.TAILED or self.sees_background:
            return 0.0
        way = (self.background_radius - 1) / (HalfLevel.TAIL_END - 1)
        return 0.5 * (2 * HalfLevel.TAIL_LEFT) ** way

    def before(self, background: float, radius: float, scatter: float) -> "Levels | None":
        """The levels with a background taken there, less half of a bell's light that may remain.

        None if the background is as bright as the peak, as in `levels_of`: there is no half level,
        and edge widths, whose logarithms and roots are taken, would not be positive.
        """
        if not self.peak > background:
            return None
        seen = replace(self, background_radius=radius, scatter=scatter)
        return replace(seen, background=background - seen.tail / 2 * (self.peak - background))

    def in_units_of(self, radius: float) -> "Levels":
        """The same levels in units of an ellipse that is so many times as large."""
        c0, c1, c2 = self.dome
        return replace(
            self,
            dome=(c0, c1 * radius**2, c2 * radius**4),
            background_radius=self.background_radius / radius,
            width=self.width / radius,
            half_radius=self.half_radius / radius,
        )

    def share_of_peak(self, radii: np.ndarray) -> np.ndarray:
        """Signal over the peak's inside the edge, at radii inside it."""
        c0, c1, c2 = self.dome
        square = radii * radii
        return c0 + square * (c1 + square * c2)


def levels_of(
    profiles: np.ndarray, coarse: Coarse, ellipse: AffineEllipse, bright: float, around: float
) -> Levels | None:
    """Levels of a spot, with a peak above the background and a positive width.

    Args:
        profiles: (n, len(RADII)) of the rays whose edge belongs to the spot; 0 outside the frame.
        bright, around: typical levels in the spot and beside it.

    Returns:
        None if the profiles do not fall, or if they are the halo of something brighter.
    """
    mean = profiles.sum(axis=0) / len(profiles)
    steepest = float((mean[:-2] - mean[2:])[_NEAR_EDGE].max()) / (2 * RADIUS_STEP)
    height = bright - around
    width = height / (math.sqrt(2 * math.pi) * steepest) if steepest > 0 else math.inf
    if not 0 < width <= HalfLevel.WIDEST:
        return None  # in another channel, what was bright may be dark
    taken = background_of(coarse, ellipse, width)
    background, radius, scatter = taken or (around, 1.0, math.inf)
    dark, glaring = (bright + around) / 2, 2 * bright
    if 2 * np.count_nonzero(profiles[:, :16] > glaring) > profiles[:, :16].size:
        return None  # the halo of something brighter
    peak, dome, variance, hidden = _top(profiles, width, dark, glaring)
    if not peak > background:
        return None
    half_radius = outermost_radius(mean, (peak + background) / 2, RADII)
    found = Levels(peak, dome, variance, background, radius, scatter, width, half_radius, hidden)
    return found.before(background, radius, scatter)


def outermost_radius(profile: np.ndarray, level: float, radii: np.ndarray) -> float:
    """Where a profile at even radii falls to a level for the last time, or the nearest end."""
    above = np.flatnonzero(profile >= level)
    last, share = int(above[-1]) if above.size else 0, 0.0
    if above.size and last + 1 < len(radii):
        share = (profile[last] - level) / (profile[last] - profile[last + 1])
    return float(radii[last] + share * (radii[1] - radii[0]))


def background_of(
    coarse: Coarse, ellipse: AffineEllipse, width: float
) -> tuple[float, float, float] | None:
    """Signal on rings outside an edge of that width: its median, where they begin, its scatter.

    If the window does not contain the rings, nearer ones are used; None if it contains none.
    """
    levels = Patch(coarse.levels.astype(np.float32), coarse.x0, coarse.y0, coarse.stride)
    radius = dark_radius(width)
    for _ in range(6):  # down to a quarter of the distance
        rings = levels.unwrapped(ellipse, radius + np.array(HalfLevel.RINGS), every=2)
        ring, around = rings.ravel(), rings.mean(axis=1)
        ring, around = ring[~np.isnan(ring)], around[~np.isnan(around)]
        if ring.size > RAYS // 2:
            # Means over an area like that of an edge: noise averages out, texture does not.
            scatter = math.inf
            if around.size > RAYS // 8:
                means = np.sort(np.convolve(around, np.full(5, 1 / 5), "valid"))
                low, high = means[int(0.16 * means.size)], means[int(0.84 * means.size)]
                scatter = max(float(high - low) / 2, HalfLevel.ROUNDING) * coarse.unit
            middle = float(np.partition(ring, ring.size // 2)[ring.size // 2])
            return middle * coarse.unit, radius, scatter
        radius = 1 + 0.75 * (radius - 1)
    return None


def slope_of_surroundings(
    coarse: Coarse, ellipse: AffineEllipse, levels: Levels
) -> np.ndarray | None:
    """Slope of the signal round a spot over its mean there, per radius of the ellipse, (2,).

    None if too little of the surroundings is in view, or if they are so dark that they show noise
    and the spot's tails instead of the wall.
    """
    view = Patch(coarse.levels.astype(np.float32), coarse.x0, coarse.y0, coarse.stride)
    signal = view.unwrapped(ellipse, _SURROUNDINGS, every=2)
    rows = np.column_stack(
        [np.ones(signal.size), *(np.multiply.outer(c, _SURROUNDINGS).ravel() for c in _DIRECTIONS)]
    )
    signal = signal.ravel()
    seen = ~np.isnan(signal)
    if np.count_nonzero(seen) < signal.size // 4:
        return None
    seen &= np.nan_to_num(signal) < 2 * np.median(signal[seen])  # no glints
    rows, signal = rows[seen], signal[seen, None].astype(float)
    _, fitted = cv2.solve(rows.T @ rows, rows.T @ signal)
    mean = float(fitted[0, 0])
    if mean * coarse.unit < HalfLevel.LIT_SURROUNDINGS * levels.amplitude:
        return None
    slope: np.ndarray = fitted[1:, 0] / mean
    return slope


def dark_radius(width: float) -> float:
    """Radius at which a spot's light has ended, from the width of its edge in radii."""
    near = 1 + HalfLevel.BACKGROUND * width
    # The tails of a lens's bell reach further than a Gaussian's of the same flank.
    return near if width < HalfLevel.TAILED else max(near, HalfLevel.TAIL_END)


def top_counts(width: float) -> float:
    """How far the shape of a top counts: it hardly moves a sharp edge."""
    return min(max(width / Sharp.SLOPE_SHOWS - 1, 0.0), 1.0)


def _top(
    profiles: np.ndarray, width: float, dark: float, glaring: float
) -> tuple[float, tuple[float, float, float], float, float]:
    """Peak, the dome under it, and the variances `variance` and `hidden` (see `Levels`).

    An even polynomial is fitted to the means of rings, over samples that are neither dark (a shaft)
    nor glaring. A wall's texture looks like a dome too, so the dome counts only as far as it
    exceeds what the scatter of the rays explains (the garrote of Breiman 1995).
    """
    outermost = min(max(1 - 3 * width, 0.5), 0.9)
    rings = slice(0, max(int((outermost - RADII[0]) / RADIUS_STEP) + 1, 8), 2)
    radii, basis = RADII[rings], _EVEN_POWERS[rings]
    inner = profiles[:, rings]
    seen = (inner > dark) & (inner < glaring)
    number = seen.sum(axis=0)
    means = (inner * seen).sum(axis=0) / np.maximum(number, 1)
    weighted = basis * (radii * number)[:, None]
    gram = weighted.T @ basis
    gram.flat[::4] += 1e-6
    _, coefficients = cv2.solve(gram, weighted.T @ means[:, None])
    curve = basis @ coefficients
    top, plateau = float(curve.max()), float(curve[-1, 0])
    height = top / plateau - 1 if plateau > dark / 2 else 0.0
    whole = inner[seen.all(axis=1)]
    if len(whole) < FEWEST_RAYS or not height > 0:
        return plateau, (1.0, 0.0, 0.0), 0.0, 0.0
    sums = whole.sum(axis=1)
    sums -= sums.sum() / len(sums)
    variance = float(sums @ sums) / len(sums) / (plateau * len(radii)) ** 2
    kept = max(0.0, 1 - (HalfLevel.DOME_DOUBT * variance / height**2) ** 2)
    c0, c1, c2 = (coefficients[:, 0] / top).tolist()
    dome = (1 - kept + kept * c0, kept * c1, kept * c2)
    # The variance of a dome that exists with probability `kept`.
    doubt = kept * variance + kept * (1 - kept) * height**2
    hidden = top_counts(width) * (1 - kept) * min(variance, height**2)
    return plateau / (1 - kept + kept * plateau / top), dome, doubt, hidden
