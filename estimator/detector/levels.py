"""Peak, background and edge width of a spot, from its profiles."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import NormalDist
from typing import Any, NamedTuple

import cv2
import numpy as np

from eyespot.estimator.detector.coarse import Coarse
from eyespot.estimator.detector.ellipse_rays import (
    DESIGN,
    RADII,
    RADIUS_STEP,
    AffineEllipse,
    Patch,
    ring_variances,
)
from eyespot.estimator.detector.tuning import FEWEST_RAYS, RAYS, Broad, HalfLevel, Sharp

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

    @cached_property
    def amplitude(self) -> float:
        """Peak above background."""
        return self.peak - self.background

    @cached_property
    def half(self) -> float:
        """The level of the contour."""
        return (self.peak + self.background) / 2

    @cached_property
    def sees_background(self) -> bool:
        """Whether the background was taken beyond the spot's light."""
        return self.background_radius > HalfLevel.FAR_ENOUGH * dark_radius(self.width)

    @cached_property
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

    def width_of(self, slope: np.ndarray) -> float:
        """Edge width, units of the radius, of a profile with these slopes by the radius."""
        steepest = max(-float(slope.min()), 1e-12 * self.amplitude)
        return self.amplitude / (math.sqrt(2 * math.pi) * steepest)

    def sharpened(
        self,
        from_edge: np.ndarray,
        mean: np.ndarray,
        fall: np.ndarray,
        slope: np.ndarray,
        doubt: float,
    ) -> "Levels":
        """The levels with the edge's width, the plateau and its slope as a mean profile shows them.

        Args:
            from_edge: (n,) radius offsets of its samples.
            mean, fall: (n,) the profile, and its derivative.
            slope: (2,) of the plateau, over its mean per radius; `doubt` is its variance.
        """
        width = self.width_of(fall)
        inner = int(np.count_nonzero(from_edge < -Sharp.PLATEAU * width))
        if inner == 0 or not width > 0:
            return replace(self, width=width)
        radii = 1 + from_edge[:inner]
        # The fraction of a plateau that a Gaussian blur leaves at radii inside the half level's.
        rim = float(self.share_of_peak(np.ones(1))[0]) * self.peak - self.background
        height, normal = min(max(rim / self.amplitude, 0.51), 1.0), NormalDist()
        middle = normal.inv_cdf(0.5 / height)
        left = np.array([normal.cdf(middle + (1 - r) / (width * height)) for r in radii.tolist()])
        light = float(mean[:inner].sum()) - self.background * float((1 - left).sum())
        peak = light / float(self.share_of_peak(radii) @ left)
        if not peak > self.background:
            return self
        rise = math.hypot(*slope) * max(1 - Sharp.BRIGHTEST_INSIDE * width, 0.0)
        peak += rise * (peak - self.background)
        return replace(self, width=width, peak=peak, variance=self.variance + doubt)

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
    radius = dark_radius(width)
    for _ in range(6):  # down to a quarter of the distance
        rings = coarse.patch.unwrapped(ellipse, radius + np.array(HalfLevel.RINGS), every=2)
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
    signal = coarse.patch.unwrapped(ellipse, _SURROUNDINGS, every=2)
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


def garrote(square: Any, doubt: Any) -> Any:
    """Share of a feature of the light that counts: none if its square is below its doubt.

    The garrote of Breiman (1995). Numbers or arrays.
    """
    return np.maximum(1 - doubt / np.maximum(square, 1e-30), 0.0)


def left_doubt(square: Any, kept: Any, variance: Any) -> Any:
    """Mean square error of a feature of which a share is kept: the rest, and what hides it."""
    return variance + (1 - kept) ** 2 * square


class SlopingTop(NamedTuple):
    """The levels with the peak of a top that slopes, and the slope.

    Attributes:
        slope: of the light across the spot over its height, per radius, (2,).
        unsure: variance of either component, by what texture may hide.
        raised: share of the height by which the slope raises the peak.
    """

    levels: Levels
    slope: np.ndarray
    unsure: float = 0.0
    raised: float = 0.0


def sloping_top(
    levels: Levels, patch: Patch, ellipse: AffineEllipse, inliers: np.ndarray
) -> SlopingTop:
    """The levels of a broad flank, with the peak that its top shows.

    A beam that meets the wall obliquely is brighter on the near side, and a focused beam has a
    cusp: the peak is the maximum of a polynomial in the radius plus a slope across. Texture has
    cusps and slopes too. So they raise the peak above a parabola's only as far as they exceed what
    the rest of the rays' spectrum explains.
    """
    top = min(max(1 - Broad.SHOULDER * levels.width, 0.35), 0.9)  # of a bell; inside the edge
    radii = RADII[: max(int(np.searchsorted(RADII, top)), 8)]
    inner = np.nan_to_num(patch.unwrapped(ellipse, radii), nan=0.0)
    seen = (inner > levels.half) & (inner < 2 * levels.peak) & inliers[:, None]
    if np.count_nonzero(seen) < 10 * Broad.POWERS:
        return SlopingTop(levels, np.zeros(2))
    area = seen * radii
    across = DESIGN[:, :2]
    slopes = across[:, :1] * radii, across[:, 1:] * radii
    rings = [np.broadcast_to(radii**k, inner.shape) for k in range(Broad.POWERS)]
    basis = np.stack([column[seen] for column in (*rings, *slopes)], axis=1)
    weighted = basis * area[seen][:, None]
    gram = weighted.T @ basis
    gram.flat[:: len(gram) + 1] += 1e-6
    pull = weighted.T @ inner[seen].astype(float)[:, None]
    _, solution = cv2.solve(gram, pull)
    powers = np.vander(radii, Broad.POWERS, increasing=True)
    profile = powers @ solution[: Broad.POWERS, 0]
    tilt = solution[Broad.POWERS :, 0]
    left = np.where(seen, inner - profile - (across @ tilt)[:, None] * radii, 0.0)
    lever = float((area * radii).sum() / RAYS)
    (uneven,) = ring_variances((left * area).sum(axis=1) / lever, slice(2, 6))
    pull_variance = uneven / RAYS
    _, parabola = cv2.solve(gram[np.ix_([0, 2], [0, 2])], pull[[0, 2]])
    simple = float(parabola[0, 0])
    steepest = math.hypot(*tilt)
    highest = int(np.argmax(profile + steepest * radii))
    rise = float(profile[highest] + steepest * radii[highest]) - simple
    doubt = Broad.TOP_DOUBT * pull_variance
    kept = float(garrote(rise**2, doubt))
    peak = simple + kept * rise
    height = peak - levels.background
    if not height > 0:
        return SlopingTop(levels, np.zeros(2))
    sure = float(garrote(steepest**2, doubt))
    # Where nothing counts, the light may slope as much as it seems to, and as texture may hide.
    unsure = left_doubt(steepest**2, sure, pull_variance)
    return SlopingTop(
        replace(
            levels, peak=peak, dome=(1.0, 0.0, 0.0), variance=pull_variance / peak**2, hidden=0.0
        ),
        slope=sure * tilt / height,
        unsure=unsure / height**2,
        raised=kept * steepest * float(radii[highest]) / height,
    )
