"""Spot or not: every reason to reject what was measured, in one place.

`sighting_in` has a region measured and judges it by itself, `continues` judges a spot beside the
last frame's, and `one_of` the spots of a whole frame beside each other.
"""

import math
from typing import NamedTuple

import numpy as np

from eyespot.estimator.detector.edges import EdgeFit
from eyespot.estimator.detector.ellipse_rays import (
    AffineEllipse,
    contour_points,
    covariance_of_axes,
    ring_variances,
    shares_of_contour,
)
from eyespot.estimator.detector.measuring import (
    MeasuredRegion,
    is_coarse,
    measured_in,
    significance_of,
    small_spot_in,
    undistorted,
)
from eyespot.estimator.detector.pixel_fit import SmallSpot
from eyespot.estimator.detector.settings import SubpixelSettings
from eyespot.estimator.detector.spot_contour import Region
from eyespot.estimator.detector.tuning import (
    RAYS,
    FieldStop,
    HalfLevel,
    Refine,
    Saturated,
    Sharp,
    Small,
    Verdict,
)
from eyespot.formats.spot import NoSpot, OwnHalf, Reason, Spot


class Sighting(NamedTuple):
    """A spot, and what shows where to look for it in the next frame.

    Attributes:
        ellipse: its contour in the frame as it is.
        half: light on the contour.
        channel: 0, 1, 2 or GREY.
        like_field: whether a camera's round field would look like it.
    """

    spot: Spot
    ellipse: AffineEllipse
    half: float
    channel: int
    like_field: bool = False

    @property
    def place(self) -> tuple[AffineEllipse, float, float, int]:
        """Contour, light on it, width of its edge in radii, and channel."""
        width = self.spot.edge_width_px / math.sqrt(self.area_px / math.pi)
        return self.ellipse, self.half, width, self.channel

    @property
    def area_px(self) -> float:
        """Of the spot's ellipse."""
        return math.pi * self.spot.semi_major_px * self.spot.semi_minor_px


def sighting_in(region: Region) -> Sighting | NoSpot:
    """The spot that a region shows, or why it shows none: measure, then judge."""
    if region.is_small:
        small = small_spot_in(region)
        return small if isinstance(small, NoSpot) else _judged_small(region, small)
    significance = significance_of(region) if region.faint else 0.0
    measured = measured_in(region)
    found = measured if isinstance(measured, NoSpot) else _judged(region, measured)
    if not found and region.faint and found.reason is not Reason.TOO_FAINT:
        # Texture may have made it: its outline is rough, or it has none.
        significant = 2 * significance > Verdict.FAINTEST
        return NoSpot(Reason.TOO_FAINT, significance) if significant else _NOTHING
    if isinstance(found, NoSpot) and found.reason is Reason.NONE_FOUND:
        return NoSpot(Reason.OCCLUDED) if region.fills_its_ellipse() < Verdict.FILLED else found
    return found


def _judged(region: Region, measured: MeasuredRegion) -> Sighting | NoSpot:
    fit, settings = measured.fit, region.settings
    levels = fit.levels
    semi_major, semi_minor, _ = fit.ellipse.axes
    ellipse = measured.ellipse or fit.ellipse
    of_steps = fit.step_covariance.copy()
    if settings.uneven_top:
        of_steps[2:4, 2:4] += math.pi / 2 * levels.width**2 * levels.hidden
    covariance = covariance_of_axes(ellipse, of_steps)
    coverage, belonging, in_frame = shares_of_contour(
        fit.ellipse, fit.seen, fit.inliers, fit.band.inside
    )
    partial = coverage <= Verdict.WHOLE
    coherent = fit.scatter < Verdict.ROUGHEST * (1 + levels.width / Refine.BROAD)
    # An outline of no ellipse, such as a polygon's or a word's.
    rough = is_coarse(fit) or fit.steeper > Verdict.STEEPER or _has_corners(fit)
    low = levels.amplitude < settings.min_contrast * levels.background
    # An optic disc is as bright, but its edge is soft and nowhere the same.
    discoid = levels.amplitude < 2 * settings.min_contrast * levels.background
    discoid &= levels.width > Verdict.SOFT and is_coarse(fit, Verdict.SOFT_COARSEST)
    significance = levels.amplitude / levels.scatter
    vague = covariance[3, 3] > (Verdict.VAGUEST * ellipse.axes[1]) ** 2
    # A camera's field stop is a lit disc, too. Beside so large a spot the frame has no room for the
    # rings of its background but the outermost, so that it could not be measured anyway.
    half_width, half_height = fit.ellipse.half_extent()
    rows, columns = region.frame.shape[:2]
    outermost = 2 * (1 + HalfLevel.RINGS[-2]) * max(half_width / columns, half_height / rows)
    # Beyond a bell's flank another light begins, such as a beam's second lobe.
    beside = fit.band.whole & (fit.band.profiles[:, -1] > levels.half)
    (another,) = shares_of_contour(fit.ellipse, beside)
    lobed = levels.width > Refine.BROAD and another > 1 - Verdict.WHOLE
    # Dots whose outermost ones lie on an ellipse leave most of it dark.
    patchy = region.area_px < Verdict.LIT * coverage * math.pi * semi_major * semi_minor
    covered, smallest = settings.min_coverage, settings.min_semi_minor_px
    for rejected, reason in (
        (not coherent or patchy or belonging < Verdict.SHORTEST_ARC, Reason.NONE_FOUND),
        (semi_major > settings.max_axis_ratio * semi_minor, Reason.NONE_FOUND),
        (semi_minor < smallest, Reason.TOO_SMALL),
        (semi_major > settings.max_semi_major_px, Reason.TOO_LARGE),
        (outermost > 1, Reason.TOO_LARGE),
        (lobed, Reason.AMBIGUOUS),
        (coverage < covered, Reason.CLIPPED if in_frame < covered else Reason.OCCLUDED),
        (rough, Reason.OCCLUDED if partial else Reason.NONE_FOUND),
        (measured.ellipse is None, Reason.NONE_FOUND),
        (discoid or (low and significance < Verdict.FAINTEST), Reason.TOO_FAINT),
        (vague and partial and levels.width < Refine.BROAD, Reason.OCCLUDED),
        (measured.rim is not None, Reason.AMBIGUOUS),
    ):
        if rejected:
            return NoSpot(reason, significance if reason is Reason.TOO_FAINT else math.nan)
    spot = _spot(
        ellipse,
        covariance=covariance,
        edge_width=levels.width,
        coverage=coverage,
        inlier_fraction=float(np.count_nonzero(fit.inliers) / max(fit.found.sum(), 1)),
        saturated=region.saturated[region.channel],
        own_half=fit.own_half,
    )
    contour = measured.contour
    like_field = _is_like_field(contour, region)
    return Sighting(spot, contour.ellipse, contour.levels.half, region.channel, like_field)


def _has_corners(fit: EdgeFit) -> bool:
    """Whether one wave stands out round the contour, as of a polygon."""
    offsets = np.where(fit.found, np.clip(fit.offsets, -Refine.FURTHEST, Refine.FURTHEST), 0.0)
    waves = Verdict.CORNERS
    every = slice(3, 2 * waves.stop - 2)  # of an outline that is no ellipse, with overtones
    alone = (slice(k, k + 1) for k in range(waves.start, waves.stop))
    mean, *corners = ring_variances(offsets, every, *alone)
    strongest, all_waves = max(corners), (every.stop - every.start) * mean
    clean = 2 / RAYS * strongest < (Refine.CLEAN * fit.levels.width) ** 2
    return not clean and strongest > Verdict.CORNERED * all_waves


def _is_like_field(fit: EdgeFit, region: Region) -> bool:
    """Whether a lit disc is round and sharp, about the frame's middle, and dark all round.

    A fundus camera's field is such a disc. It shows a wall, so the light in it is uneven; the
    stray light round it is not.
    """
    semi_major, semi_minor, _ = fit.ellipse.axes
    frame = region.frame.shape
    middle = (frame[1] - 1) / 2, (frame[0] - 1) / 2
    levels, uneven = fit.levels, float(np.std(fit.band.gain[fit.bright]))
    plain = levels.scatter < FieldStop.PLAIN * uneven * levels.background
    # Rounding to a level of the search hides so faint a texture.
    hidden = levels.scatter < 1.02 * HalfLevel.ROUNDING * region.coarse.unit
    darkest = FieldStop.PLAINEST if plain else FieldStop.DIM if hidden else FieldStop.DARK
    return (
        semi_minor > FieldStop.SMALLEST * min(frame[:2])
        and semi_major < FieldStop.ROUND * semi_minor
        and math.dist(fit.ellipse.centre.tolist(), middle) < semi_minor / 2
        and levels.width < Refine.BROAD
        and levels.background < darkest * levels.peak
        and uneven > FieldStop.UNEVEN
    )


def _judged_small(region: Region, measured: SmallSpot) -> Sighting | NoSpot:
    settings, seen = region.settings, measured.ellipse
    semi_major, semi_minor, _ = seen.axes
    edges = contour_points(seen, np.zeros(RAYS))
    height, width = region.frame.shape[:2]
    in_frame = float(((edges > -0.5) & (edges < (width - 0.5, height - 0.5))).all(axis=1).mean())
    ellipse = undistorted(seen, edges, settings.camera)
    covariance = covariance_of_axes(ellipse or seen, measured.step_covariance)
    radius, amplitude = math.sqrt(semi_major * semi_minor), measured.amplitude
    background = measured.background
    low = amplitude < settings.min_contrast * background
    scatter = math.hypot(measured.texture * background, measured.noise / math.sqrt(semi_minor))
    significance = amplitude / max(scatter, 1e-30)
    clipped = region.saturated[region.channel]
    vague = covariance[3, 3] > (Small.VAGUEST * semi_minor) ** 2
    for rejected, reason in (
        (
            vague,
            Reason.SATURATED if clipped else Reason.NONE_FOUND,
        ),
        (semi_major > settings.max_axis_ratio * semi_minor, Reason.NONE_FOUND),
        (measured.texture > Small.ROUGHEST, Reason.NONE_FOUND),
        (measured.steepness < Saturated.CUSP * math.log(2) / 2, Reason.NONE_FOUND),
        (semi_minor < settings.min_semi_minor_px, Reason.TOO_SMALL),
        (in_frame < settings.min_coverage, Reason.CLIPPED),
        (ellipse is None, Reason.NONE_FOUND),
        (significance < Verdict.FAINTEST and low, Reason.TOO_FAINT),
    ):
        if rejected:
            return NoSpot(reason, significance if reason is Reason.TOO_FAINT else math.nan)
    assert ellipse is not None  # rejected above
    spot = _spot(
        ellipse,
        covariance=covariance,
        # The fit to pixels has their side in its model, profiles along rays have it in their edges.
        edge_width=math.hypot(measured.edge_width, Sharp.PIXEL_EDGE_PX / radius),
        coverage=in_frame,
        inlier_fraction=1.0,
        saturated=clipped,
        own_half=measured.own_half,
    )
    return Sighting(spot, seen, background + amplitude / 2, region.channel)


def _spot(
    ellipse: AffineEllipse,
    *,
    covariance: np.ndarray,
    edge_width: float,
    coverage: float,
    inlier_fraction: float,
    saturated: float,
    own_half: OwnHalf,
) -> Spot:
    """The spot of an ellipse; `edge_width` is over the mean of its semi-axes."""
    semi_major, semi_minor, angle = ellipse.axes
    x, y = ellipse.centre.tolist()
    return Spot(
        x_px=x,
        y_px=y,
        semi_major_px=semi_major,
        semi_minor_px=semi_minor,
        angle_rad=angle,
        covariance=covariance,
        edge_width_px=edge_width * math.sqrt(semi_major * semi_minor),
        coverage=coverage,
        inlier_fraction=inlier_fraction,
        saturated=saturated,
        own_half=own_half,
    )


def continues(spot: Spot, last: Spot, settings: SubpixelSettings) -> bool:
    """Whether a spot may be the last frame's: neither too far away nor too different in size."""
    growth = spot.semi_minor_px / last.semi_minor_px
    jump = math.hypot(spot.x_px - last.x_px, spot.y_px - last.y_px)
    return jump <= settings.max_jump_px and 1 / settings.max_growth <= growth <= settings.max_growth


def one_of(seen: list[Sighting], failures: list[NoSpot]) -> Sighting | NoSpot:
    """The largest sighting, unless another is much like it; without one, the best reason.

    One frame does not tell a camera's field from a spot that looks like it. A spot that is tracked
    or clicked is taken for one.
    """
    if not seen:
        return max(failures, key=lambda f: _NEARNESS.index(f.reason), default=_NOTHING)
    first, *others = sorted(seen, key=lambda sighting: sighting.area_px, reverse=True)
    if others and others[0].area_px > Verdict.RIVAL * first.area_px:
        return NoSpot(Reason.AMBIGUOUS)
    return NoSpot(Reason.FIELD_STOP) if first.like_field else first


def is_part_of(region: Region, sighting: Sighting) -> bool:
    """Whether a region is too small for a rival of a spot, or its halo or a severed part of it.

    Another lobe of the same beam is a rival: it lies beside the spot and is about as bright.
    """
    spot = sighting.spot
    x, y = region.ellipse.centre.tolist()
    distance = math.hypot(x - spot.x_px, y - spot.y_px)
    if region.area_px < Verdict.RIVAL / 2 * sighting.area_px:
        return True
    bright = region.bright.peak > sighting.half and region.channel == sighting.channel
    reach = 1.0 if bright else Verdict.NEAR_SPOT
    return distance < reach * spot.semi_major_px


def is_rival(region: Region, sighting: Sighting) -> bool:
    """Whether a region that could not be measured may be the spot instead: another lamp, say."""
    large = region.area_px > Verdict.RIVAL * sighting.area_px
    return large and not is_part_of(region, sighting)


_NOTHING = NoSpot(Reason.NONE_FOUND)
_NEARNESS = (
    Reason.NONE_FOUND,
    Reason.TOO_SMALL,
    Reason.TOO_LARGE,
    Reason.TOO_FAINT,
    Reason.CLIPPED,
    Reason.OCCLUDED,
    Reason.SATURATED,
    Reason.FIELD_STOP,
    Reason.AMBIGUOUS,
)
"""Reasons by how near to a spot a region came: the last that occurs in a frame is reported."""
