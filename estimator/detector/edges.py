"""The half-maximum contour of a bright region, from its profiles unwrapped about an ellipse."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from estimator.detector.band import FURTHEST, LONG_WAVES, Refined
from estimator.detector.broad import BROAD, refine_broad
from estimator.detector.coarse import Candidate, Coarse
from estimator.detector.ellipse import Ellipse, robust_step
from estimator.detector.levels import RADII, RADIUS_STEP, Levels, background_of, levels_of
from estimator.detector.sharp import refine_sharp
from estimator.detector.unwrap import DESIGN, Patch, ring_variance
from estimator.image import NoSpot, Reason

REACH = 1.75
"""Furthest radius at which a fit looks for the edge, in units of the candidate's ellipse."""

_LOOSE = 0.2  # largest error, in radii, of an edge that a capture counts
_CAPTURES = 3
_NEAR_HALF = 0.1  # difference of the half level's radius from the captured one that may stay
_EVERY = 2  # rays that the capture takes: one of so many
_SETTLED = 0.1  # move, in units of the edge's width, after which a refinement is not repeated ...
_SETTLED_BROAD = 0.005  # ... in radii, for a broad flank ...
_EXCHANGED = 6  # ... if no more rays than these came or went
_REFINEMENTS = 3
_MIDDLE_ALONE = 2.7  # noise of the half level's place over that of all of the flank, in variance
_NEARNESS = (1 / (0.1 + np.abs(RADII[:-1] + RADIUS_STEP / 2 - 1))).astype(np.float32)


@dataclass(frozen=True, eq=False)
class EdgeFit:
    """An ellipse fitted to a contour, and how well.

    Attributes:
        ellipse: px.
        step_covariance: 5x5, of the parameters of `Ellipse.stepped`.
        levels: peak, background, edge width.
        offsets: (RAYS,) radial distance of each ray's edge from the ellipse, units of the radius.
        found: (RAYS,) rays with an edge.
        inliers: (RAYS,) rays whose edge belongs to the ellipse.
        inside: (RAYS,) rays whose contour point lies in the frame.
        scatter: standard deviation of the inliers' offsets, units of the radius.
    """

    ellipse: Ellipse
    step_covariance: np.ndarray
    levels: Levels
    offsets: np.ndarray
    found: np.ndarray
    inliers: np.ndarray
    inside: np.ndarray
    scatter: float


def fit_edge(patch: Patch, coarse: Coarse, candidate: Candidate) -> EdgeFit | NoSpot:
    """Ellipse of the half-maximum contour near a candidate.

    1. Capture: on each ray the crossing of the candidate's half level nearest to its ellipse;
       a robust fit through the crossings.
    2. Levels: peak, background and edge width of the inlying rays.
    3. Refinement, up to three times: the shift of each ray's profile against the mean profile is
       the offset of its edge. The ellipse follows the offsets by least squares, and its size
       follows the half level of the mean profile (`sharp.py`, `broad.py`).

    Returns:
        The fit, or why the rays do not show one ellipse.
    """
    located = _located(patch, coarse, candidate)
    for _ in range(_CAPTURES - 1):
        if located is None or abs(located[2].half_radius - 1) < _NEAR_HALF:
            break
        # A bell's typical level is far below its peak: again, from its half level.
        ellipse, _, levels = located
        candidate = replace(
            candidate,
            ellipse=ellipse.scaled(levels.half_radius),
            peak=levels.peak,
            background=levels.background,
        )
        located = _located(patch, coarse, candidate)
    if located is None:
        return NoSpot(Reason.NONE_FOUND)
    return _refined(patch, coarse, *located)


def _located(
    patch: Patch, coarse: Coarse, candidate: Candidate
) -> tuple[Ellipse, np.ndarray, Levels] | None:
    captured = _capture(patch, candidate)
    if captured is None:
        return None
    ellipse, step, inliers, profiles = captured
    levels = levels_of(profiles[inliers], coarse, ellipse, candidate)
    if levels is None:
        return None
    grown = 1 + float(step[2] + step[3]) / 2
    return ellipse.stepped(step), np.repeat(inliers, _EVERY), levels.in_units_of(grown)


def _refined(
    patch: Patch, coarse: Coarse, ellipse: Ellipse, inliers: np.ndarray, levels: Levels
) -> EdgeFit | NoSpot:
    refined = _refined_once(patch, ellipse, inliers, levels)
    for _ in range(_REFINEMENTS - 1):
        if isinstance(refined, NoSpot) or _settled(refined, inliers, levels):
            break
        inliers, levels = refined.inliers, _with_background_in_view(refined, coarse)
        refined = _refined_once(patch, refined.ellipse, inliers, levels)
    return refined if isinstance(refined, NoSpot) else _finished(refined)


def _refined_once(
    patch: Patch, ellipse: Ellipse, inliers: np.ndarray, levels: Levels
) -> Refined | NoSpot:
    refine = refine_broad if levels.width > BROAD else refine_sharp
    return refine(patch, ellipse, inliers, levels)


def _settled(refined: Refined, inliers: np.ndarray, before: Levels) -> bool:
    """Whether another refinement would change nothing that matters."""
    after = refined.levels
    same_kind = (after.width > BROAD) == (before.width > BROAD) and after.width > 0.7 * before.width
    same_rays = np.count_nonzero(refined.inliers != inliers) <= _EXCHANGED
    settled = refined.move < min(_SETTLED * after.width, _SETTLED_BROAD)
    return settled and bool(same_rays) and same_kind and after.sees_background


def _with_background_in_view(refined: Refined, coarse: Coarse) -> Levels:
    """The levels, the background taken anew if the edge is wider than it seemed."""
    levels = refined.levels
    if levels.sees_background:
        return levels
    background, radius = background_of(coarse, refined.ellipse, levels.width) or (
        levels.background,
        levels.background_radius,
    )
    return levels.before(background, radius)


def _capture(
    patch: Patch, candidate: Candidate
) -> tuple[Ellipse, np.ndarray, np.ndarray, np.ndarray] | None:
    """Ellipse, its step to the contour (a few tenths of a px), inlying rays, and their profiles."""
    ellipse, step = candidate.ellipse.upright(), np.zeros(5)
    level = (candidate.peak + candidate.background) / 2
    tolerance = max(1.5 / ellipse.axes()[1], 0.02)
    for _ in range(3):
        ellipse = ellipse.stepped(step)
        profiles = patch.unwrapped(ellipse, RADII, every=_EVERY)
        offsets, found = _crossings(profiles, level)
        near = np.abs(offsets) < FURTHEST
        design = DESIGN[::_EVERY]
        fitted = robust_step(design, offsets, found, near, tolerance=tolerance, limit=_LOOSE)
        if fitted is None or np.abs(fitted[0]).max() > 0.7:
            return None
        step, inliers = fitted
        if np.abs(step).max() < 0.1:
            break
    if not patch.holds(ellipse.scaled(float(RADII[-1]) + 0.1)):
        profiles = np.nan_to_num(profiles, nan=0.0)
    return ellipse, step, inliers, profiles


def _crossings(profiles: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Falling crossing of the level nearest to the radius 1, as an offset from it, by ray."""
    below = profiles < level
    falling = below[:, 1:] > below[:, :-1]
    nearest = np.argmax(falling * _NEARNESS, axis=1)
    ray = np.arange(len(profiles))
    before, after = profiles[ray, nearest], profiles[ray, nearest + 1]
    found = (before >= level) & (after < level)  # a profile that leaves the patch has no edge
    share = np.divide(before - level, before - after, out=np.zeros(len(ray)), where=found)
    return RADII[0] - 1 + RADIUS_STEP * (nearest + share), found


def _finished(refined: Refined) -> EdgeFit:
    levels = refined.levels
    rows = DESIGN[refined.inliers]
    errors = np.where(refined.inliers, refined.offsets, 0.0)
    share = len(rows) / len(DESIGN)
    # Harmonics 0 to 2 are fitted; on a broad flank texture is strongest next to them.
    broad = levels.width > BROAD
    harmonics = slice(3, 7) if broad else LONG_WAVES
    freedom = 2 * (harmonics.stop - harmonics.start)
    # The mean of the squared errors over so uncertain a variance is one. Of a part of a contour the
    # ellipse takes up longer waves than of the whole, and less of them is left to tell.
    variance = ring_variance(errors, harmonics) / share**2 * freedom / (freedom - 2)
    step_covariance = variance * cv2.invert(rows.T @ rows)[1]
    texture = refined.band.texture
    if broad:
        longer = _longer_waves(size=1, centre=1 + 6 * texture, shape=1 + texture)
    else:
        rise = 25 * texture * levels.width
        longer = _longer_waves(size=_MIDDLE_ALONE + 4 * rise, centre=1 + 2 * rise, shape=1 + rise)
    step_covariance = longer @ step_covariance @ longer
    step_covariance[2:4, 2:4] += refined.size_variance
    return EdgeFit(
        ellipse=refined.ellipse,
        step_covariance=step_covariance,
        levels=levels,
        offsets=refined.offsets,
        found=refined.found,
        inliers=refined.inliers,
        inside=refined.band.inside,
        scatter=math.sqrt(float(errors @ errors) / len(rows)),
    )


def _longer_waves(*, size: float, centre: float, shape: float) -> np.ndarray:
    """Errors of a step over those told from the contour's shorter waves, (5, 5), by variances.

    A wall's texture is strongest at long waves, of which wide profiles hold the more. How much the
    variances rise was found on printed retinas, and holds within a factor of two.
    """
    size, centre, shape = math.sqrt(size), math.sqrt(centre), math.sqrt(shape)
    longer = np.diag([centre, centre, (size + shape) / 2, (size + shape) / 2, shape])
    longer[2, 3] = longer[3, 2] = (size - shape) / 2
    return longer
