"""Fits an ellipse to the half-maximum contour in a patch of light, from its profiles along rays.

The fit is refined step by step, by `refine_sharp` or `refine_broad`. On a broad flank, a bell or a
plateau that falls off slowly, removing the wall's reflectance from each ray would also remove the
slope of the light across the spot, which moves the half level by more than texture does. So all
rays share one level, and texture averages out round the contour.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from eyespot.estimator.detector.band import Band, Refined, refine_sharp
from eyespot.estimator.detector.coarse import Coarse
from eyespot.estimator.detector.ellipse_rays import (
    DESIGN,
    AffineEllipse,
    Patch,
    octaves_middle,
    red_share,
    ring_variance,
    robust_step,
)
from eyespot.estimator.detector.levels import (
    RADII,
    RADIUS_STEP,
    Levels,
    background_of,
    levels_of,
    slope_of_surroundings,
)
from eyespot.estimator.detector.saturated_flank import hidden_bell
from eyespot.estimator.detector.tuning import RAYS, Broad, Capture, ErrorGrowth, Refine, Saturated
from eyespot.formats.spot import NoSpot, OwnHalf, Reason


def refine_broad(
    patch: Patch, ellipse: AffineEllipse, inliers: np.ndarray, levels: Levels
) -> Refined | NoSpot:
    """As `refine_sharp`, from an ellipse that is off by less than the flank's width."""
    levels, slope, unsure, raised = _with_sloping_top(levels, patch, ellipse, inliers)
    half, half_variance = None, 0.0
    if levels.peak > Saturated.READABLE * patch.ceiling:
        hidden = hidden_bell(patch, ellipse, inliers, levels)
        if hidden is None:
            return NoSpot(Reason.SATURATED)
        levels, half, half_variance = hidden
    reach = min(Broad.FLANK * levels.width, Broad.WIDEST)
    band = Band.along(patch, ellipse, inliers, reach)
    if band is None:
        return NoSpot(Reason.NONE_FOUND)
    offsets, _, weights = band.shifts([band.from_edge * band.slope], past_texture=False)
    gain = band.gain
    found = band.lit & (np.abs(offsets) < reach)
    fitted = robust_step(
        DESIGN,
        offsets,
        found,
        band.inliers,
        tolerance=Broad.FORGIVEN * levels.width,
        limit=max(levels.width, Refine.FURTHEST),
    )
    if half is None:
        half = band.half_crossing(levels.half, reach)
    if fitted is None or half is None or np.abs(fitted[0]).max() > Refine.LARGEST_STEP:
        return NoSpot(Reason.NONE_FOUND)
    levels = replace(levels, width=band.width(levels), hidden=0.0)
    if half_variance == 0:
        # The wall under the top differs from the wall under the contour by texture of the longest
        # waves, which the contour shows only as far as they are not the light's own slope.
        light = np.where(found, gain - 1, 0.0)
        share, steepness = red_share(light, Broad.TOP_WAVES)
        # A beam that is no ellipse bends its contour more than texture does, and is as uneven.
        errors = np.where(fitted[1], offsets - DESIGN @ fitted[0], 0.0)
        share = min(share, red_share(errors, Refine.LONG_WAVES_BROAD)[0])
        growth = Broad.TOP_OVER_CONTOUR * octaves_middle(Broad.TOP_WAVES) ** steepness
        texture = share * growth * ring_variance(light, Broad.TOP_WAVES) / RAYS
        variance = levels.variance + texture + Broad.PEAK_ERROR**2
        levels = replace(levels, variance=variance)
    shaded = np.zeros(RAYS, bool)  # a shadow's rim looks like a broad flank
    # Where the light slopes, brighter rays cross the common level farther out, and the level is
    # half of a higher peak.
    semi_major, semi_minor, _ = ellipse.axes()
    per_slope = float(((1 + band.from_edge) * (band.mean - levels.background)) @ weights)
    right, down = (-per_slope * ellipse.shape @ slope).tolist()
    unsure += float(slope @ slope) * Broad.OWN_HALF_ERROR**2
    return band.refined(
        levels,
        offsets,
        found,
        fitted,
        half=half,
        half_variance=half_variance,
        shaded=shaded,
        own_half=OwnHalf(
            right,
            down,
            growth=1 + math.sqrt(math.pi / 2) * levels.width * raised,
            more_variance_px2=per_slope**2 * unsure / 2 * semi_major * semi_minor,
        ),
    )


def _with_sloping_top(
    levels: Levels, patch: Patch, ellipse: AffineEllipse, inliers: np.ndarray
) -> tuple[Levels, np.ndarray, float, float]:
    """The levels with the peak of a top that slopes, and the slope.

    A beam that meets the wall obliquely is brighter on the near side, and a focused beam has a
    cusp: the peak is the maximum of a polynomial in the radius plus a slope across. Texture has
    cusps and slopes too. So they raise the peak above a parabola's only as far as they exceed what
    the rest of the rays' spectrum explains (the garrote of Breiman 1995).

    Returns:
        Also the light's slope across the spot over its height, per radius, (2,); its variance by
        what texture may hide of it; and by what share of the height the slope raises the peak.
    """
    top = min(max(1 - Broad.SHOULDER * levels.width, 0.35), 0.9)  # of a bell; inside the edge
    radii = RADII[: max(int(np.searchsorted(RADII, top)), 8)]
    inner = np.nan_to_num(patch.unwrapped(ellipse, radii), nan=0.0)
    seen = (inner > levels.half) & (inner < 2 * levels.peak) & inliers[:, None]
    level_top = levels, np.zeros(2), 0.0, 0.0
    if np.count_nonzero(seen) < 10 * Broad.POWERS:
        return level_top
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
    pull_variance = ring_variance((left * area).sum(axis=1) / lever, slice(2, 6)) / RAYS
    _, parabola = cv2.solve(gram[np.ix_([0, 2], [0, 2])], pull[[0, 2]])
    simple = float(parabola[0, 0])
    steepest = math.hypot(*tilt)
    highest = int(np.argmax(profile + steepest * radii))
    rise = float(profile[highest] + steepest * radii[highest]) - simple
    doubt = Broad.TOP_DOUBT * pull_variance
    kept = max(0.0, 1 - doubt / rise**2) if rise else 0.0
    peak = simple + kept * rise
    height = peak - levels.background
    if not height > 0:
        return level_top
    sure = max(0.0, 1 - doubt / steepest**2) if steepest else 0.0
    unsure = sure * doubt + (1 - sure) * min(doubt, steepest**2)
    levels = replace(
        levels, peak=peak, dome=(1.0, 0.0, 0.0), variance=pull_variance / peak**2, hidden=0.0
    )
    raised = kept * steepest * float(radii[highest]) / height
    return levels, sure * tilt / height, unsure / height**2, raised


_NEARNESS = (1 / (0.1 + np.abs(RADII[:-1] + RADIUS_STEP / 2 - 1))).astype(np.float32)


@dataclass(frozen=True, eq=False)
class EdgeFit(Refined):
    """The last refinement of an ellipse, and how well it fits the contour.

    Attributes:
        step_covariance: 5x5, of the parameters of `AffineEllipse.stepped`.
        scatter: standard deviation of the inliers' offsets, radii.
        steeper: how much steeper single rays are than their mean (`Band.steeper`), where the edges
            scatter.
    """

    step_covariance: np.ndarray
    scatter: float
    steeper: float

    @property
    def seen(self) -> np.ndarray:
        """Rays that show the ellipse's edge, (RAYS,).

        A ray roughened by texture counts as seen if its edge lies within half an edge width of the
        ellipse.
        """
        on_ellipse = np.abs(self.offsets) < Refine.SAME_EDGE * self.levels.width
        return self.inliers | (self.found & on_ellipse)


def fit_edge(
    patch: Patch, coarse: Coarse, near: AffineEllipse, peak: float, background: float
) -> EdgeFit | NoSpot:
    """Ellipse of the half-maximum contour near the ellipse of a bright region.

    1. Capture: on each ray the crossing of the region's half level nearest to its ellipse;
       a robust fit through the crossings.
    2. Levels: peak, background and edge width of the inlying rays.
    3. Refinement, up to three times: the shift of each ray's profile against the mean profile is
       the offset of its edge. The ellipse follows the offsets by least squares, and its size
       follows the half level of the mean profile (`refine_sharp`, `refine_broad`).
    """
    located = _located(patch, coarse, near, peak, background)
    for _ in range(2):
        if located is None or abs(located[2].half_radius - 1) < Capture.NEAR_ENOUGH:
            break
        # A bell's typical level is far below its peak: start again from its half level.
        ellipse, _, levels = located
        near = ellipse.scaled(levels.half_radius)
        located = _located(patch, coarse, near, levels.peak, levels.background)
    if located is None:
        return NoSpot(Reason.NONE_FOUND)
    ellipse, inliers, levels = located
    for left in (2, 1, 0):
        refine = refine_broad if levels.width > Refine.BROAD else refine_sharp
        found = refine(patch, ellipse, inliers, levels)
        if isinstance(found, NoSpot):
            return found
        refined = found
        if _settled(refined, inliers, levels):
            break
        if left == 0:  # fringes make it swing
            unsettled = refined.size_variance + refined.move**2 / 2
            refined = replace(refined, size_variance=unsettled)
            break
        seen = refined.levels
        now: Levels | None = seen
        if not seen.sees_background:  # the edge is wider than was assumed for it
            around = background_of(coarse, refined.ellipse, seen.width)
            now = seen.before(*(around or (seen.background, seen.background_radius, seen.scatter)))
        if now is None:  # the dip at the edge is the wall's texture
            return NoSpot(Reason.NONE_FOUND)
        ellipse, inliers, levels = refined.ellipse, refined.bright, now
    return _finished(refined, patch, coarse)


def _settled(refined: Refined, inliers: np.ndarray, before: Levels) -> bool:
    """Whether another refinement would hardly change the result."""
    after = refined.levels
    same_kind = (after.width > Refine.BROAD) == (before.width > Refine.BROAD)
    same_kind &= after.width > Refine.SAME_WIDTH * before.width
    same_rays = np.count_nonzero(refined.bright != inliers) <= 6
    settled = refined.move < min(Refine.SETTLED * after.width, Refine.SETTLED_BROAD)
    return settled and bool(same_rays) and same_kind and after.sees_background


def _located(
    patch: Patch, coarse: Coarse, near: AffineEllipse, peak: float, background: float
) -> tuple[AffineEllipse, np.ndarray, Levels] | None:
    """Capture and levels: an ellipse, its inlying rays, and what they show."""
    ellipse, step = near.upright(), np.zeros(5)
    level = (peak + background) / 2
    tolerance = max(Capture.TOLERANCE_PX / ellipse.axes()[1], Capture.TOLERANCE)
    for _ in range(3):
        ellipse = ellipse.stepped(step)
        profiles = patch.unwrapped(ellipse, RADII, every=Capture.EVERY)
        offsets, found = _crossings(profiles, level)
        beside = np.abs(offsets) < Refine.FURTHEST
        design = DESIGN[:: Capture.EVERY]
        fitted = robust_step(
            design, offsets, found, beside, tolerance=tolerance, limit=Capture.FURTHEST
        )
        if fitted is None or np.abs(fitted[0]).max() > Capture.LARGEST_STEP:
            return None
        step, inliers = fitted
        if np.abs(step).max() < Capture.NEAR_ENOUGH:
            break
    profiles = np.nan_to_num(profiles, copy=False, nan=0.0)
    # The profiles' ellipse is a few tenths of a px from the contour's.
    levels = levels_of(profiles[inliers], coarse, ellipse, peak, background)
    if levels is None:
        return None
    grown = 1 + float(step[2] + step[3]) / 2
    return ellipse.stepped(step), np.repeat(inliers, Capture.EVERY), levels.in_units_of(grown)


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


def _finished(refined: Refined, patch: Patch, coarse: Coarse) -> EdgeFit:
    levels = refined.levels
    rows = DESIGN[refined.inliers]
    errors = np.where(refined.inliers, refined.offsets, 0.0)
    share = len(rows) / len(DESIGN)
    # Harmonics 0 to 2 are fitted; on a broad flank texture is strongest next to them.
    broad = levels.width > Refine.BROAD
    harmonics = Refine.LONG_WAVES_BROAD if broad else Refine.LONG_WAVES
    freedom = 2 * (harmonics.stop - harmonics.start)
    # The factor freedom / (freedom - 2) makes the mean of squared errors over so uncertain a
    # variance one. Rays without an edge add nothing to it: hence the share.
    variance = ring_variance(errors, harmonics) / share * freedom / (freedom - 2)
    step_covariance = variance * cv2.invert(rows.T @ rows)[1]
    texture = refined.band.texture
    size_variance, centre_variance = refined.size_variance, refined.centre_variance
    if broad:
        share, steepness = red_share(errors, harmonics)
        grown = [(octaves_middle(harmonics) / wave) ** steepness for wave in (1.0, 2.0)]
        first, second = (1 + share * texture * (g - 1) for g in grown)
        longer = _longer_waves(size=first, centre=first, shape=second)
        # A bell on a sloping wall looks like one that has moved, and the contour does not show
        # that. What slopes far beyond the spot slopes under it, too.
        slope = slope_of_surroundings(coarse, refined.ellipse, levels)
        shift = 0.0 if slope is None else math.pi / 2 * levels.width**2 * float(slope @ slope)
        centre_variance = Broad.SLOPE_OVER_SURROUNDINGS * shift
    else:
        rise = ErrorGrowth.RISE * texture * levels.width
        longer = _longer_waves(
            size=Refine.MIDDLE_ALONE + ErrorGrowth.SIZE * rise,
            centre=1 + ErrorGrowth.CENTRE * rise,
            shape=1 + ErrorGrowth.SHAPE * rise,
        )
        # A clipped plateau may be a dome: its half level is higher than the rim tells.
        size_variance += math.pi / 2 * (levels.width * Saturated.DOME) ** 2 * patch.clipped
    step_covariance = longer @ step_covariance @ longer
    step_covariance[2:4, 2:4] += size_variance
    step_covariance[[0, 1], [0, 1]] += centre_variance
    scatter = math.sqrt(float(errors @ errors) / len(rows))
    clean = broad or scatter < Refine.CLEAN * levels.width
    return EdgeFit(
        **vars(refined),
        step_covariance=step_covariance,
        scatter=scatter,
        steeper=1.0 if clean else refined.band.steeper(refined.bright),
    )


def _longer_waves(*, size: float, centre: float, shape: float) -> np.ndarray:
    """Errors of a step over those estimated from the contour's shorter waves, (5, 5).

    A wall's texture is strongest at long waves, and wider profiles contain more of it. The
    arguments are ratios of variances: of the common growth of both axes, of the centre, and of the
    axes' difference and the angle.
    """
    size, centre, shape = math.sqrt(size), math.sqrt(centre), math.sqrt(shape)
    longer = np.diag([centre, centre, (size + shape) / 2, (size + shape) / 2, shape])
    longer[2, 3] = longer[3, 2] = (size - shape) / 2
    return longer
