"""Spot or not: every reason to reject what was fitted, in one place.

`sighting_in` judges a region by itself, `continues` a spot beside the last frame's, and `one_of`
the spots of a whole frame beside each other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimator.detector.contour import contour_of, patch_round
from estimator.detector.edges import EdgeFit
from estimator.detector.ellipse import covariance_of_axes, refitted
from estimator.detector.levels import background_of
from estimator.detector.motion_blur import at_mid_exposure
from estimator.detector.reflection import spot_on
from estimator.detector.regions import Region
from estimator.detector.settings import SubpixelSettings
from estimator.detector.tuning import Motion, Refine, Verdict
from estimator.detector.unwrap import contour_points, shares_of_contour
from estimator.image import NoSpot, Reason, Spot


class Sighting(NamedTuple):
    """A spot and the contour from which it was measured.

    Attributes:
        spot: what was measured.
        fit: half-maximum contour.
        channel: in which it was measured: 0, 1, 2 or `image.GREY`.
    """

    spot: Spot
    fit: EdgeFit
    channel: int

    @property
    def area_px(self) -> float:
        """Of the spot's ellipse."""
        return math.pi * self.spot.semi_major_px * self.spot.semi_minor_px


def sighting_in(region: Region) -> Sighting | NoSpot:
    """The spot that a region shows, or why it shows none."""
    found = _judged(region)
    if not found and region.faint and found.reason is not Reason.TOO_FAINT:
        return _faint(region)
    if isinstance(found, NoSpot) and found.reason is Reason.NONE_FOUND:
        return NoSpot(Reason.OCCLUDED) if region.fills_its_ellipse() < Verdict.FILLED else found
    return found


def _faint(region: Region) -> NoSpot:
    """Why a region that texture may make shows no spot: its outline is rough, or it has none."""
    around = background_of(region.coarse, region.ellipse, Refine.BROAD)
    if around is None or region.fills_its_ellipse() < Verdict.FILLED:
        return _NOTHING
    background, _, scatter = around
    significance = (region.candidates[0].peak - background) / scatter
    return (
        NoSpot(Reason.TOO_FAINT, significance) if 2 * significance > Verdict.FAINTEST else _NOTHING
    )


def _judged(region: Region) -> Sighting | NoSpot:
    contour = contour_of(region)
    if isinstance(contour, NoSpot):
        return contour
    fit = contour
    if fit.levels.width > Motion.SMEARED and not _is_coarse(fit):
        fit = at_mid_exposure(patch_round(region, fit.ellipse, fit.levels.width), fit)
    spot = _spot_of(fit, region.settings, region.saturated[region.channel])
    if isinstance(spot, NoSpot):
        return spot
    if _rim_on(region, fit) is not None:
        return NoSpot(Reason.AMBIGUOUS)
    return Sighting(spot, contour, region.channel)


def spot_on_reflection(region: Region) -> EdgeFit | None:
    """The spot that a region's light shows, where that is a wet wall's reflection of a lamp."""
    contour = contour_of(region)
    return _rim_on(region, contour) if isinstance(contour, EdgeFit) else None


def _rim_on(region: Region, fit: EdgeFit) -> EdgeFit | None:
    if fit.levels.width < Refine.BROAD:
        return None
    return spot_on(patch_round(region, fit.ellipse), fit, region.settings.min_semi_minor_px)


def continues(spot: Spot, last: Spot, settings: SubpixelSettings) -> bool:
    """Whether a spot may be the last frame's: neither too far away nor too different in size."""
    growth = spot.semi_minor_px / last.semi_minor_px
    jump = math.hypot(spot.x_px - last.x_px, spot.y_px - last.y_px)
    return jump <= settings.max_jump_px and 1 / settings.max_growth <= growth <= settings.max_growth


def one_of(seen: list[Sighting], failures: list[NoSpot]) -> Sighting | NoSpot:
    """The largest sighting, unless another is much like it; without one, the best reason.

    Args:
        seen: all sightings in a frame.
        failures: why other regions are no spots.
    """
    if not seen:
        return max(failures, key=lambda f: _NEARNESS.index(f.reason), default=_NOTHING)
    first, *others = sorted(seen, key=lambda sighting: sighting.area_px, reverse=True)
    if others and others[0].area_px > Verdict.RIVAL * first.area_px:
        return NoSpot(Reason.AMBIGUOUS)
    return first


def is_part_of(region: Region, sighting: Sighting) -> bool:
    """Whether a region is too small for a rival of a spot, or its halo or a severed part of it.

    Another lobe of the same beam is a rival: it lies beside the spot and is about as bright.
    """
    spot = sighting.spot
    x, y = region.ellipse.centre.tolist()
    distance = math.hypot(x - spot.x_px, y - spot.y_px)
    if region.area_px < Verdict.RIVAL / 2 * sighting.area_px:
        return True
    levels = sighting.fit.levels
    bright = region.candidates[0].peak > levels.half and region.channel == sighting.channel
    reach = 1.0 if bright else Verdict.NEAR_SPOT
    return distance < reach * spot.semi_major_px


_NOTHING = NoSpot(Reason.NONE_FOUND)
_NEARNESS = (
    Reason.NONE_FOUND,
    Reason.TOO_SMALL,
    Reason.TOO_LARGE,
    Reason.TOO_FAINT,
    Reason.CLIPPED,
    Reason.OCCLUDED,
    Reason.SATURATED,
    Reason.AMBIGUOUS,
)
"""Reasons by how near to a spot a region came: the last that occurs in a frame is reported."""


def _is_rough(fit: EdgeFit) -> bool:
    """Whether an outline is none of an ellipse, such as a polygon's or a word's.

    Not that of a spot in motion before `at_mid_exposure`: its rays are not equally steep.
    """
    return _is_coarse(fit) or fit.steeper > Verdict.STEEPER


def _is_coarse(fit: EdgeFit) -> bool:
    """Whether the edges scatter about the ellipse by more than texture and motion explain.

    Either moves an edge by less than the edge is wide.
    """
    width = math.hypot(fit.levels.width, Verdict.FINEST_PX / fit.ellipse.axes()[1])
    return fit.scatter > Verdict.COARSEST * width


def _spot_of(fit: EdgeFit, settings: SubpixelSettings, saturated: float) -> Spot | NoSpot:
    semi_major, semi_minor, angle = fit.ellipse.axes()
    levels = fit.levels
    coverage, belonging, in_frame = shares_of_contour(
        fit.ellipse, fit.seen, fit.inliers, fit.inside
    )
    coherent = fit.scatter < Verdict.ROUGHEST * (1 + levels.width / Refine.BROAD)
    if not coherent or belonging < Verdict.SHORTEST_ARC:
        return NoSpot(Reason.NONE_FOUND)
    if semi_major > settings.max_axis_ratio * semi_minor:
        return NoSpot(Reason.NONE_FOUND)
    if semi_minor < settings.min_semi_minor_px:
        return NoSpot(Reason.TOO_SMALL)
    if semi_major > settings.max_semi_major_px:
        return NoSpot(Reason.TOO_LARGE)
    if coverage < settings.min_coverage:
        return NoSpot(Reason.CLIPPED if in_frame < settings.min_coverage else Reason.OCCLUDED)
    if _is_rough(fit):
        return NoSpot(Reason.NONE_FOUND if coverage > Verdict.WHOLE else Reason.OCCLUDED)
    ellipse = fit.ellipse
    if settings.camera is not None:
        edges = contour_points(ellipse, fit.offsets)[fit.inliers]
        if not settings.camera.can_undistort(edges):
            return NoSpot(Reason.NONE_FOUND)
        ellipse = refitted(ellipse, settings.camera.undistorted(edges))
        if math.dist(settings.camera.distorted(*ellipse.centre), fit.ellipse.centre) > semi_major:
            return NoSpot(Reason.NONE_FOUND)  # its edge can be undistorted, but not its inside
        semi_major, semi_minor, angle = ellipse.axes()
    covariance = covariance_of_axes(ellipse, fit.step_covariance)
    significance = levels.amplitude / levels.scatter
    if significance < Verdict.FAINTEST and levels.amplitude < (
        settings.min_contrast * levels.background
    ):
        return NoSpot(Reason.TOO_FAINT, significance)
    vague = covariance[3, 3] > (Verdict.VAGUEST * semi_minor) ** 2
    if vague and coverage < Verdict.WHOLE and levels.width < Refine.BROAD:
        return NoSpot(Reason.OCCLUDED)
    x, y = ellipse.centre.tolist()
    return Spot(
        x_px=x,
        y_px=y,
        semi_major_px=semi_major,
        semi_minor_px=semi_minor,
        angle_rad=angle,
        covariance=covariance,
        edge_width_px=levels.width * math.sqrt(semi_major * semi_minor),
        coverage=coverage,
        inlier_fraction=float(np.count_nonzero(fit.inliers) / max(fit.found.sum(), 1)),
        saturated=saturated,
    )
