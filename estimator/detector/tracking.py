"""From frame to frame: where to look, and what may be believed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from estimator.detector.levels import dark_radius
from estimator.detector.literal import LiteralSettings, measure_literal
from estimator.detector.regions import Region, Sighting, region_of, regions_in
from estimator.detector.settings import SubpixelSettings
from estimator.image import NoSpot, Reason, Spot, Window, checked_frame

_RIVAL = 0.5  # area of a second spot, relative to the first's, that makes the choice ambiguous
_LESS_SEEN = 0.1  # of its contour, from which a search may see more of the spot


@dataclass(frozen=True, kw_only=True)
class TrackState:
    """What a frame hands to the next: where the spot is looked for, and what it was like.

    Attributes:
        at_px: (x, y) where to look; None searches the whole frame.
        spot: last spot, None before the first and after a loss.
        sighting: what is looked for first: the last spot's contour, or after a leap that of what is
            to be seen again. Without it the same is found, but later.
    """

    at_px: tuple[float, float] | None = None
    spot: Spot | None = None
    sighting: Sighting | None = None


def measure(
    frame: np.ndarray, state: TrackState, settings: LiteralSettings | SubpixelSettings
) -> tuple[Spot | NoSpot, TrackState]:
    """Measure the spot of one frame.

    Literal mode looks in the patch round the last ellipse (or the click) and nowhere else. The
    sub-pixel mode looks for the last contour, then round the last position, then in the whole
    frame. A spot that it finds further off or of another size than the settings allow is
    `ambiguous` in that frame and accepted in the next one if it is still there.

    Args:
        frame: grey (H, W) or RGB (H, W, 3); uint8, uint16, float32 or float64.
        state: of the frame before; `TrackState()` at the start.
        settings: whose type selects the mode.

    Returns:
        The spot, or why there is none; and the state for the next frame.

    Raises:
        ValueError: the frame is not an image, see `frames.checked_frame`.
    """
    frame = checked_frame(frame)
    if isinstance(settings, LiteralSettings):
        result = measure_literal(frame, state.at_px, settings)
        if isinstance(result, Spot):
            state = TrackState(at_px=(result.x_px, result.y_px), spot=result)
        return result, state
    return _measure_subpixel(frame, state, settings)


def track(
    frames: Iterable[np.ndarray],
    settings: LiteralSettings | SubpixelSettings,
    start: tuple[float, float] | None = None,
) -> Iterator[Spot | NoSpot]:
    """Measure the frames of a sequence, one result a frame.

    Args:
        frames: as `measure` takes them.
        settings: whose type selects the mode.
        start: (x, y) of the spot in the first frame, px; None finds it.
    """
    state = TrackState(at_px=start)
    for frame in frames:
        result, state = measure(frame, state, settings)
        yield result


def _measure_subpixel(
    frame: np.ndarray, state: TrackState, settings: SubpixelSettings
) -> tuple[Spot | NoSpot, TrackState]:
    near = _again(frame, state.sighting, settings) or _near(frame, state, settings)
    if near:
        return near.spot, _following(near, settings)
    result = _searched(frame, settings)
    if isinstance(result, NoSpot):
        return result, TrackState()
    found = _following(result, settings)
    if state.spot is not None and not _continues(result.spot, state.spot, settings):
        return NoSpot(Reason.AMBIGUOUS), replace(found, spot=None)
    return result.spot, found


def _following(sighting: Sighting, settings: SubpixelSettings) -> TrackState:
    spot = sighting.spot
    at = spot.x_px, spot.y_px
    at = settings.camera.distorted(*at) if settings.camera else at
    return TrackState(at_px=at, spot=spot, sighting=sighting)


def _again(frame: np.ndarray, last: Sighting | None, settings: SubpixelSettings) -> Sighting | None:
    """What was seen last, if it hardly changed; the rest is left to a search."""
    region = region_of(last, frame, settings) if last else None
    now = region.measured() if region else None
    if not (last and now and _continues(now.spot, last.spot, settings)):
        return None
    return now if now.spot.coverage > last.spot.coverage - _LESS_SEEN else None


def _near(frame: np.ndarray, state: TrackState, settings: SubpixelSettings) -> Sighting | None:
    """The spot that continues the last one, or the brightest near the start point."""
    if state.at_px is None:
        return None
    half, last = float(settings.search_half_width_px), state.spot
    if last is not None:
        # The background is where a bell's tails end, round wherever it moved to.
        reach = last.semi_major_px * dark_radius(last.edge_width_px / last.semi_minor_px)
        reach += settings.max_jump_px
        half = max(half, reach)
    for region in regions_in(frame, Window.around(*state.at_px, half, half, frame), settings):
        if isinstance(region, Region) and (
            last is None or _in_reach(region, state.at_px, settings)
        ):
            result = region.measured()
            if result and (last is None or _continues(result.spot, last, settings)):
                return result
    return None


def _in_reach(region: Region, at: tuple[float, float], settings: SubpixelSettings) -> bool:
    """Whether a region's spot may lie within a jump: its centre is good to a radius."""
    ellipse = region.readings[0].ellipse
    return math.dist(ellipse.centre.tolist(), at) < settings.max_jump_px + ellipse.axes()[0]


def _continues(spot: Spot, last: Spot, settings: SubpixelSettings) -> bool:
    growth = spot.semi_minor_px / last.semi_minor_px
    jump = math.hypot(spot.x_px - last.x_px, spot.y_px - last.y_px)
    return jump <= settings.max_jump_px and 1 / settings.max_growth <= growth <= settings.max_growth


def _searched(frame: np.ndarray, settings: SubpixelSettings) -> Sighting | NoSpot:
    """The one spot of the whole frame, unless there is another much like it."""
    seen: list[Sighting] = []
    failures = [NoSpot(Reason.NONE_FOUND)]
    for region in regions_in(frame, Window.whole(frame), settings):
        if isinstance(region, NoSpot):
            failures.append(region)
        elif not any(_is_rest_of(region, sighting.spot) for sighting in seen):
            result = region.measured()
            if isinstance(result, NoSpot):
                failures.append(result)
            else:
                seen.append(result)
    if not seen:
        return max(failures, key=_told)
    seen.sort(key=lambda sighting: _area(sighting.spot), reverse=True)
    if len(seen) > 1 and _area(seen[1].spot) > _RIVAL * _area(seen[0].spot):
        return NoSpot(Reason.AMBIGUOUS)
    return seen[0]


_TOLD = (
    Reason.NONE_FOUND,
    Reason.TOO_SMALL,
    Reason.TOO_LARGE,
    Reason.CLIPPED,
    Reason.OCCLUDED,
    Reason.SATURATED,
    Reason.AMBIGUOUS,
)


def _told(failure: NoSpot) -> int:
    """How much a failure tells: how near to a spot it came."""
    return _TOLD.index(failure.reason)


def _area(spot: Spot) -> float:
    return math.pi * spot.semi_major_px * spot.semi_minor_px


def _is_rest_of(region: Region, spot: Spot) -> bool:
    """Whether a region is too small for a rival, or the halo or a severed part of a spot."""
    x, y = region.readings[0].ellipse.centre.tolist()
    near = math.hypot(x - spot.x_px, y - spot.y_px) < 1.5 * spot.semi_major_px
    return near or region.area_px < _RIVAL / 2 * _area(spot)
