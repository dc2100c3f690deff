"""From frame to frame: where to look, and what may be believed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from .frames import Window, checked_frame
from .literal import LiteralSettings, measure_literal
from .spot import NoSpot, Reason, Spot
from .subpixel import SubpixelSettings, spots_in

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
        if result:
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
        near = _near(frame, state, settings)
        if near:
            return near, TrackState(at_px=(near.x_px, near.y_px), spot=near)
    result = _searched(frame, settings)
    if not result:
        return result, TrackState()
    found = TrackState(at_px=(result.x_px, result.y_px), spot=result)
    if state.spot is not None and not _continues(result, state.spot, settings):
        return NoSpot(Reason.AMBIGUOUS), replace(found, spot=None)
    return result, found


def _near(frame: np.ndarray, state: TrackState, settings: SubpixelSettings) -> Spot | None:
    """The spot that continues the last one, or the one nearest to the start point."""
    x, y = state.at_px
    half = settings.search_half_width_px
    if state.spot is not None:
        # The background of a bell is seen only several edge widths away.
        half = max(half, state.spot.semi_major_px + 5 * state.spot.edge_width_px)
    window = Window.around(x, y, half, half, frame)
    for spot in spots_in(frame, window, settings):
        if spot and (state.spot is None or _continues(spot, state.spot, settings)):
            return spot
    return None


def _continues(spot: Spot, last: Spot, settings: SubpixelSettings) -> bool:
    growth = spot.semi_minor_px / last.semi_minor_px
    jump = math.hypot(spot.x_px - last.x_px, spot.y_px - last.y_px)
    return jump <= settings.max_jump_px and 1 / settings.max_growth <= growth <= settings.max_growth


def _searched(frame: np.ndarray, settings: SubpixelSettings) -> Spot | NoSpot:
    """The one spot of the whole frame; of several, the largest unless another is much like it."""
    spots: list[Spot] = []
    failure = NoSpot(Reason.NONE_FOUND)
    for result in spots_in(frame, Window.whole(frame), settings):
        if not result:
            failure = max(failure, result, key=_told)
        elif not any(_same(result, spot) for spot in spots):
            spots.append(result)
    if not spots:
        return failure
    spots.sort(key=_area, reverse=True)
    if len(spots) > 1 and _area(spots[1]) > _RIVAL * _area(spots[0]):
        return NoSpot(Reason.AMBIGUOUS)
    return spots[0]


_TOLD = (
    Reason.NONE_FOUND,
    Reason.TOO_SMALL,
    Reason.TOO_LARGE,
    Reason.CLIPPED,
    Reason.SATURATED,
    Reason.OCCLUDED,
)


def _told(failure: NoSpot) -> int:
    """How much a failure tells: how near to a spot it came."""
    return _TOLD.index(failure.reason)


def _area(spot: Spot) -> float:
    return spot.semi_major_px * spot.semi_minor_px


def _same(one: Spot, other: Spot) -> bool:
    """Whether one spot is the halo of the other."""
    distance = math.hypot(one.x_px - other.x_px, one.y_px - other.y_px)
    return distance < max(one.semi_major_px, other.semi_major_px)
