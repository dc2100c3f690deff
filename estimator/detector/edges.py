"""Fits an ellipse to the half-maximum contour in a patch of light, from its profiles along rays."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from eyespot.estimator.detector.band import Refined, refine
from eyespot.estimator.detector.coarse import Coarse
from eyespot.estimator.detector.ellipse_rays import (
    DESIGN,
    AffineEllipse,
    Patch,
    capture,
    red_share,
    ring_variances,
)
from eyespot.estimator.detector.levels import Levels, levels_of, slope_of_surroundings
from eyespot.estimator.detector.tuning import Broad, Capture, ErrorGrowth, Refine, Saturated
from eyespot.formats.spot import NoSpot, Reason


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
       follows the half level of the mean profile (`refine`).
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
    refined = refine(patch, coarse, *located)
    return refined if isinstance(refined, NoSpot) else _finished(refined, patch, coarse)


def _located(
    patch: Patch, coarse: Coarse, near: AffineEllipse, peak: float, background: float
) -> tuple[AffineEllipse, np.ndarray, Levels] | None:
    """Capture and levels: an ellipse, its inlying rays, and what they show."""
    captured = capture(patch, near, (peak + background) / 2)
    if captured is None:
        return None
    profiles = np.nan_to_num(captured.profiles, copy=False, nan=0.0)
    levels = levels_of(profiles[captured.inliers], coarse, captured.along, peak, background)
    if levels is None:
        return None
    inliers = np.repeat(captured.inliers, Capture.EVERY)
    return captured.ellipse, inliers, levels.in_units_of(captured.growth)


def _finished(refined: Refined, patch: Patch, coarse: Coarse) -> EdgeFit:
    levels = refined.levels
    rows = DESIGN[refined.inliers]
    errors = np.where(refined.inliers, refined.offsets, 0.0)
    share = len(rows) / len(DESIGN)
    # Harmonics 0 to 2 are fitted; on a broad flank texture is strongest next to them.
    broad = levels.width > Refine.BROAD
    harmonics = Refine.LONG_WAVES_BROAD if broad else Refine.LONG_WAVES
    variance = _variance(errors, harmonics, share)
    of_rays = cv2.invert(rows.T @ rows)[1]
    step_covariance = variance * of_rays
    texture = refined.band.texture
    size_variance, centre_variance = refined.size_variance, refined.centre_variance
    blurred = 0.0
    if broad:
        _, share, grown = red_share(errors, harmonics, 1.0, 2.0)
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
        # A blur moves an edge by its square times the relative slope of the wall's light across it.
        # That is as large as the slope along it: for the second and third wave, at least twice the
        # wave itself.
        light = np.where(refined.bright, refined.band.gain - 1, 0.0)
        blurred = levels.width**4 * 2**2 * _variance(light, slice(2, 4), share)
        # A clipped plateau may be a dome: its half level is higher than the rim tells.
        size_variance += math.pi / 2 * (levels.width * Saturated.DOME) ** 2 * patch.clipped
    step_covariance = longer @ step_covariance @ longer + blurred * of_rays
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


def _variance(values: np.ndarray, harmonics: slice, share: float) -> float:
    """Variance per ray, at some harmonics, of values that a share of the rays has; 0 on the others.

    It is raised so that the mean of squared errors over so uncertain a variance is one.
    """
    freedom = 2 * (harmonics.stop - harmonics.start)
    (scattered,) = ring_variances(values, harmonics)
    return scattered / share * freedom / (freedom - 2)


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
