"""From frame to frame: where the spot is looked for, and which of the spots found is it.

A frame's way: bright regions (`contour.regions_in`), each one's contour, motion, reflection and
distortion (`measuring.measured_in`), the verdict on it (`verdict.sighting_in`), and the choice of
one (`verdict.one_of`). Nothing is measured after the verdict.

`outlines_of` says where the spot may be in a frame in which none was measured.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from eyespot.estimator.detector.coarse import is_of_lattice
from eyespot.estimator.detector.edges import EdgeFit
from eyespot.estimator.detector.ellipse_rays import AffineEllipse
from eyespot.estimator.detector.levels import dark_radius
from eyespot.estimator.detector.literal import LiteralSettings, measure_literal
from eyespot.estimator.detector.measuring import rim_on
from eyespot.estimator.detector.settings import SubpixelSettings
from eyespot.estimator.detector.spot_contour import (
    Region,
    contour_of,
    region_at,
    regions_in,
    small_regions_in,
)
from eyespot.estimator.detector.tuning import Faint, Refine, Small, Verdict
from eyespot.estimator.detector.verdict import (
    Sighting,
    continues,
    is_part_of,
    is_rival,
    one_of,
    sighting_in,
)
from eyespot.estimator.frame_window import Window, checked_frame, without_repeats
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import NoSpot, Outline, Reason, Spot


@dataclass(frozen=True, kw_only=True)
class TrackState:
    """What one frame passes on to the next: where to look for the spot, and what it was like.

    Attributes:
        at_px: (x, y) where to look; None searches the whole frame.
        spot: the last spot; None before the first and after a loss.
        sighting: the contour that is looked for first: the last spot's, or after a jump that of the
            new spot. Without it the same spot is found, but later.
        rescaled: standard deviation of the size, relative, since it is measured in another channel
            than before. Bells differ in size from colour to colour.
    """

    at_px: tuple[float, float] | None = None
    spot: Spot | None = None
    sighting: Sighting | None = None
    rescaled: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a place that is none."""
        if self.at_px is not None and not all(map(math.isfinite, self.at_px)):
            raise InputError(
                f"TrackState(at_px=...) must be finite, x and y in px; got {self.at_px}."
                " Give None to search the whole frame."
            )


def measure(
    frame: np.ndarray, state: TrackState, settings: LiteralSettings | SubpixelSettings
) -> tuple[Spot | NoSpot, TrackState]:
    """Measure the spot of one frame.

    Literal mode looks in the patch round the last ellipse (or the click) and nowhere else. The
    sub-pixel mode looks for the last contour, then round the last position, then in the whole
    frame. A spot further away or of another size than the settings allow is `ambiguous` in that
    frame, and accepted in the next one if it is still there.

    Args:
        frame: grey (H, W) or RGB (H, W, 3); uint8, uint16, float32 or float64.
        state: of the frame before; `TrackState()` at the start.
        settings: whose type selects the mode.

    Returns:
        The spot, or why there is none; and the state for the next frame.

    Raises:
        InputError: the frame is not an image, see `checked_frame`.
    """
    frame = checked_frame(frame)
    if isinstance(settings, LiteralSettings):
        result = measure_literal(frame, state.at_px, settings)
        if isinstance(result, Spot):
            state = TrackState(at_px=(result.x_px, result.y_px), spot=result)
        return result, state
    frame = without_repeats(frame)
    found = (
        _at_last_contour(frame, state.sighting, settings)
        or _near(frame, state, settings)
        or _anywhere(frame, state, settings)
    )
    if isinstance(found, NoSpot):
        return found, TrackState()
    spot, rescaled = found.spot, state.rescaled
    if state.spot is not None and state.sighting is not None and _is_broad(state.spot):
        if found.channel != state.sighting.channel:
            # How much of the change of size is that of the channel, one frame does not show.
            growth = spot.semi_minor_px / state.spot.semi_minor_px - 1
            rescaled = math.hypot(rescaled, growth)
    if rescaled:
        axes = np.array([0, 0, spot.semi_major_px, spot.semi_minor_px, 0])
        covariance = spot.covariance + rescaled**2 * np.outer(axes, axes)
        spot = replace(spot, covariance=covariance)
    at = (spot.x_px, spot.y_px)
    at = settings.camera.distorted(*at) if settings.camera else at
    if state.spot is not None and not continues(spot, state.spot, settings):
        return NoSpot(Reason.AMBIGUOUS), TrackState(at_px=at, sighting=found, rescaled=rescaled)
    return spot, TrackState(at_px=at, spot=spot, sighting=found, rescaled=rescaled)


def track(
    frames: Iterable[np.ndarray],
    settings: LiteralSettings | SubpixelSettings,
    start: tuple[float, float] | None = None,
) -> Iterator[Spot | NoSpot]:
    """Measure the frames of a sequence, one result a frame.

    Args:
        start: (x, y) of the spot in the first frame, px; None finds it.
    """
    state = TrackState(at_px=start)
    for frame in frames:
        result, state = measure(frame, state, settings)
        yield result


def _at_last_contour(
    frame: np.ndarray, last: Sighting | None, settings: SubpixelSettings
) -> Sighting | None:
    """The last sighting if it has hardly changed; all else needs a search."""
    region = region_at(*last.place, frame, settings) if last else None
    now = sighting_in(region) if region else None
    if not (last and now and continues(now.spot, last.spot, settings)):
        return None
    return now if now.spot.coverage > last.spot.coverage - Verdict.LESS_SEEN else None


def _is_broad(spot: Spot) -> bool:
    """Whether its edge is a bell's flank, which has another size in every colour."""
    size = math.sqrt(spot.semi_major_px * spot.semi_minor_px)
    return spot.edge_width_px > Refine.BROAD * size


def _near(frame: np.ndarray, state: TrackState, settings: SubpixelSettings) -> Sighting | None:
    """The spot that continues the last one, or the one at the start point, or near it."""
    if state.at_px is None:
        return None
    half, last = float(settings.search_half_width_px), state.spot
    if last is not None:
        # The background begins where a bell's tails end, round wherever the spot moved.
        reach = last.semi_major_px * dark_radius(last.edge_width_px / last.semi_minor_px)
        reach += settings.max_jump_px
        half = max(half, reach)
    window = Window.around(*state.at_px, half, half, frame)
    searches: list[tuple[Callable[..., Iterator[Region | NoSpot]], int | None]]
    searches = [(regions_in, None), (small_regions_in, None)]
    if last is not None:
        if last.semi_minor_px < Small.LARGEST_PX:
            searches.reverse()
        if state.sighting is not None and _is_broad(last):
            search = searches[0][0]
            searches.insert(0, (search, state.sighting.channel))
    near: Sighting | None = None
    for region in itertools.chain.from_iterable(
        search(frame, window, settings, channel) for search, channel in searches
    ):
        if isinstance(region, NoSpot) or region.faint:  # a window may show the spot alone
            continue
        # A region's centre is good to a radius.
        jump = math.dist(region.ellipse.centre.tolist(), state.at_px)
        if last is not None and jump >= settings.max_jump_px + region.ellipse.axes[0]:
            continue
        sighting = sighting_in(region)
        if not sighting:
            continue
        if last is None and jump >= region.ellipse.axes[0]:
            near = near or (None if region.is_small else sighting)
        elif last is None or continues(sighting.spot, last, settings):
            return sighting
    return near


def _anywhere(
    frame: np.ndarray, state: TrackState, settings: SubpixelSettings
) -> Sighting | NoSpot:
    """The one spot of the whole frame; a small one only if there is none that is much larger."""
    seen: list[Sighting] = []
    failures: list[NoSpot] = []
    unmeasured: list[Region] = []
    lattice = False
    for region in regions_in(frame, Window.whole(frame), settings):
        if isinstance(region, NoSpot):
            failures.append(region)
        elif region.bright.lobed and not region.faint:
            return NoSpot(Reason.AMBIGUOUS)
        elif not any(is_part_of(region, sighting) for sighting in seen):
            sighting = sighting_in(region)
            if not isinstance(sighting, NoSpot):
                seen.append(sighting)
                lattice |= is_of_lattice(region.coarse, sighting.ellipse, sighting.half)
                continue
            failures.append(sighting)
            if sighting.reason in (Reason.SATURATED, Reason.CLIPPED):
                unmeasured.append(region)
    found = one_of(seen, failures)
    if found and (lattice or any(is_rival(region, found) for region in unmeasured)):
        return NoSpot(Reason.AMBIGUOUS)
    if found:
        # Another spot may be as large as this one and yet too small for that search.
        small = Verdict.RIVAL * found.area_px < math.pi * Small.LARGEST_PX**2
        if not small or all(one.reason is not Reason.TOO_SMALL for one in failures):
            return found
    elif found.reason not in (Reason.NONE_FOUND, Reason.TOO_SMALL):
        return found
    for region in small_regions_in(frame, Window.whole(frame), settings):
        if any(is_part_of(region, sighting) for sighting in seen):
            continue
        sighting = sighting_in(region)
        semi_major, middle = region.ellipse.axes[0], region.ellipse.centre.tolist()
        chosen = state.at_px is not None and math.dist(middle, state.at_px) < semi_major
        if isinstance(sighting, NoSpot):
            failures.append(sighting)
        elif region.bright.lobed and not chosen:
            failures.append(NoSpot(Reason.AMBIGUOUS))
        else:
            seen.append(sighting)
    return one_of(seen, failures)


def outlines_of(
    frame: np.ndarray, result: Spot | NoSpot, settings: SubpixelSettings
) -> list[Outline]:
    """The outline of the spot, even if it is faint or seen in part, or those of whatever is bright.

    Args:
        frame: as `measure` takes it; result and settings are those of its measurement.
    """
    if isinstance(result, Spot):
        return [result.outline]
    frame = checked_frame(frame)
    settings = replace(
        settings,
        min_contrast=min(settings.min_contrast, Faint.CONTRAST),
        min_coverage=min(settings.min_coverage, Verdict.SHORTEST_ARC),
    )
    if result.reason in (Reason.NONE_FOUND, Reason.OCCLUDED, Reason.CLIPPED):
        fainter, _ = measure(frame, TrackState(), settings)
        if isinstance(fainter, Spot):
            return [fainter.outline]
    regions = [
        one for one in regions_in(frame, Window.whole(frame), settings) if isinstance(one, Region)
    ]
    found = []
    if result.reason in (Reason.AMBIGUOUS, Reason.OCCLUDED):
        # Spots on a wet wall's reflections of a lamp.
        for region in regions:
            contour = contour_of(region)
            fit = rim_on(region, contour) if isinstance(contour, EdgeFit) else None
            if fit is not None:
                outline = _outline(fit.ellipse)
                size = math.sqrt(outline.semi_major_px * outline.semi_minor_px)
                found.append(outline._replace(edge_width_px=fit.levels.width * size))
    if found:
        return found
    # The bright regions that fill their ellipses, which are good to a few px.
    outlines = [_outline(one.ellipse) for one in regions if one.fills_its_ellipse() > Faint.FILLED]
    return [
        outline._replace(measured=result.reason is Reason.SATURATED)
        for outline in outlines
        if outline.semi_minor_px > settings.min_semi_minor_px
        and outline.semi_major_px < settings.max_semi_major_px
    ]


def _outline(ellipse: AffineEllipse) -> Outline:
    x, y = ellipse.centre.tolist()
    return Outline(x, y, *ellipse.axes)
