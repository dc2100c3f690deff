"""From frame to frame: where to look, and what may be believed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from .frames import Window, checked_frame
from .levels import dark_radius
from .literal import LiteralSettings, measure_literal
from .regions import Region, regions_in
from .spot import NoSpot, Reason, Spot
from .subpixel import SubpixelSettings

_RIVAL = 0.5  # area of a second spot, relative to the first's, that makes the choice ambiguous


@dataclass(frozen=True, kw_only=True)
class TrackState:
    """What a frame hands to the next: where the spot is looked for, and what it was like.

    Attributes:
        at_px: (x, y) where to look; None searches the whole frame.
        spot: last spot, None before the first and after a loss.
    """

    at_px: tuple[float, float] | None = None
    spot: Spot | None = None


def measure(
    frame: np.ndarray, state: TrackState, settings: LiteralSettings | SubpixelSettings
) -> tuple[Spot | NoSpot, TrackState]:
    """Measure the spot of one frame.

    Literal mode looks in the patch round the last ellipse (or the click) and nowhere else. The
    sub-pixel mode looks round the last position, then in the whole frame. A spot that it finds
    further off or of another size than the settings allow is `ambiguous` in that frame and
    accepted in the next one if it is still there.

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
    if state.at_px is not None:
        near = _near(frame, state.at_px, state.spot, settings)
        if near:
            return near, _following(near, settings)
    result = _searched(frame, settings)
    if isinstance(result, NoSpot):
        return result, TrackState()
    found = _following(result, settings)
    if state.spot is not None and not _continues(result, state.spot, settings):
        return NoSpot(Reason.AMBIGUOUS), replace(found, spot=None)
    return result, found


def _following(spot: Spot, settings: SubpixelSettings) -> TrackState:
    at = spot.x_px, spot.y_px
    return TrackState(at_px=settings.camera.distorted(*at) if settings.camera else at, spot=spot)


def _near(
    frame: np.ndarray,
    at: tuple[float, float],
    last: Spot | None,
    settings: SubpixelSettings,
) -> Spot | None:
    """The spot that continues the last one, or the brightest near the start point."""
    half = float(settings.search_half_width_px)
    if last is not None:
        # The background is where a bell's tails end, round wherever it moved to.
        reach = last.semi_major_px * dark_radius(last.edge_width_px / last.semi_minor_px)
        reach += settings.max_jump_px
        half = max(half, reach)
    for region in regions_in(frame, Window.around(*at, half, half, frame), settings):
        if isinstance(region, Region):
            spot = region.measured()
            if spot and (last is None or _continues(spot, last, settings)):
                return spot
    return None


def _continues(spot: Spot, last: Spot, settings: SubpixelSettings) -> bool:
    growth = spot.semi_minor_px / last.semi_minor_px
    jump = math.hypot(spot.x_px - last.x_px, spot.y_px - last.y_px)
    return jump <= settings.max_jump_px and 1 / settings.max_growth <= growth <= settings.max_growth


def _searched(frame: np.ndarray, settings: SubpixelSettings) -> Spot | NoSpot:
    """The one spot of the whole frame, unless there is another much like it."""
    spots: list[Spot] = []
    failures = [NoSpot(Reason.NONE_FOUND)]
    for region in regions_in(frame, Window.whole(frame), settings):
        if isinstance(region, NoSpot):
            failures.append(region)
        elif not any(_is_rest_of(region, spot) for spot in spots):
            result = region.measured()
            if isinstance(result, NoSpot):
                failures.append(result)
            else:
                spots.append(result)
    if not spots:
        return max(failures, key=_told)
    spots.sort(key=_area, reverse=True)
    if len(spots) > 1 and _area(spots[1]) > _RIVAL * _area(spots[0]):
        return NoSpot(Reason.AMBIGUOUS)
    return spots[0]


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
