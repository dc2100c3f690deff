"""Bright regions of a subsampled window, and the ellipses of which they may be parts.

A region is measured in one colour channel, `channel_for`, which also says where its values end.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from eyespot.estimator.detector.clipping import clip_level
from eyespot.estimator.detector.ellipse_rays import AffineEllipse, Patch, capture
from eyespot.estimator.detector.tuning import Channel, Reflection, Search, Small, Verdict
from eyespot.estimator.frame_window import Window
from eyespot.formats.camera_sheet import GREY, GREY_WEIGHTS


def channel_for(
    frame: np.ndarray, window: Window, stride: int, mask: np.ndarray, full_scale: float
) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    """The channel with the least noise and texture that is not saturated.

    This is grey, the weighted mean of the colours, unless a channel is clearly brighter in the
    region (its texture is weaker) or saturated.

    Args:
        stride: px of the frame per pixel of the mask.
        mask: (h, w) uint8 of the window, 1 in the region.

    Returns:
        0, 1, 2 or GREY; the value at which each channel is clipped (`clip_level`, or full scale);
        and the fraction of the region's pixels that are, by channel, the last entry the worst
        channel's, so that GREY as an index selects it.
    """
    values = window.of(frame, stride)
    planes = [values] if values.ndim == 2 else cv2.split(values)
    clips, saturated = [], []
    part, bright = _part(frame, window, stride, mask)
    for number, plane in enumerate(planes):
        clip = min(clip_level(part[:, :, number], bright), full_scale)
        _, full = cv2.threshold(plane, clip * (1 - 1e-6), 1, cv2.THRESH_BINARY)
        clips.append(clip)
        saturated.append(cv2.mean(full, mask)[0])
    if len(planes) == 1:
        return GREY, tuple(clips), tuple(saturated)
    peaks = cv2.mean(values, mask)[:3]
    usable = [k for k in range(3) if peaks[k] > Channel.FAINTEST * max(peaks)] or [0, 1, 2]
    # A glint saturates every channel, so only what exceeds the least saturated channel counts.
    least = min(saturated[k] for k in usable)
    unspoilt = [k for k in usable if saturated[k] <= least + Channel.SATURATED]
    brightest = max(unspoilt, key=lambda k: peaks[k])
    grey = sum(weight * peak for weight, peak in zip(GREY_WEIGHTS, peaks, strict=True))
    channel = GREY
    if len(unspoilt) < len(usable) or peaks[brightest] > Channel.BRIGHTER * grey:
        channel = brightest
    return channel, tuple(clips), (*saturated, max(saturated))


def _part(
    frame: np.ndarray, window: Window, stride: int, mask: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The region and round it, (h, w, channels), and which pixels are the region's, (h, w)."""
    x, y, width, height = cv2.boundingRect(mask)
    # The foot of the flank, too.
    left, top = max(x - width // 4, 0), max(y - height // 4, 0)
    grown = mask[top : y + height + height // 4, left : x + width + width // 4]
    # All pixels show a flat top; every stride-th one is enough of a large region.
    every = stride if grown.size * stride**2 > 40_000 else 1  # or it takes over 0.3 ms
    x0, y0 = window.x0 + left * stride, window.y0 + top * stride
    rows, columns = (side * stride for side in grown.shape)
    part = frame[y0 : y0 + rows : every, x0 : x0 + columns : every]
    bright = cv2.resize(grown, part.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    return np.atleast_3d(part), bright.view(bool)


@dataclass(frozen=True, eq=False)
class Coarse:
    """A subsampled window as 8-bit signal.

    Attributes:
        levels: (h, w) uint8.
        unit: signal per level.
        stride, x0, y0: px of the frame per pixel, and its column and row under the first one.
    """

    levels: np.ndarray
    unit: float
    stride: int
    x0: int
    y0: int

    @classmethod
    def of_signal(cls, signal: np.ndarray, *, stride: int, x0: int, y0: int) -> "Coarse":
        """Scale a float signal to 8 bits by its own maximum."""
        unit = float(signal.max()) / 255
        # Squares of a darker signal, and of 1e-6 of it, would be no float32 numbers.
        if not 255 * unit > 1e-12:
            return cls(np.zeros(signal.shape, np.uint8), 1.0, stride, x0, y0)
        _, positive = cv2.threshold(signal, 0, 0, cv2.THRESH_TOZERO)
        levels = cv2.convertScaleAbs(positive, alpha=1 / unit)
        return cls(levels, unit, stride, x0, y0)

    @cached_property
    def patch(self) -> Patch:
        """The levels, to be sampled along rays."""
        return Patch(self.levels.astype(np.float32), self.x0, self.y0, self.stride)


@dataclass(frozen=True, eq=False)
class Bright:
    """A bright region of a window, and its levels.

    Attributes:
        ellipses: of which it may be a part, at least one; good to a few px.
        lobed: whether it is one of several like regions of soft light, as of a beam with lobes.
    """

    ellipses: list[AffineEllipse]
    peak: float
    background: float
    mask: np.ndarray
    lobed: bool = False

    def is_below(self, contrast: float) -> bool:
        """Whether it exceeds the background by less than that times the background."""
        return self.peak - self.background < contrast * self.background

    def relevelled(self, coarse: Coarse) -> "Bright":
        """The same region with its mean levels in another channel."""
        mask = self.mask.view(np.uint8)
        peak, background = cv2.mean(coarse.levels, mask)[0], cv2.mean(coarse.levels, 1 - mask)[0]
        return replace(self, peak=peak * coarse.unit, background=background * coarse.unit)


def bright_regions(
    coarse: Coarse, *, min_contrast: float, min_area: float, solid: bool = True
) -> Iterator[Bright | None]:
    """Bright regions, brightest first.

    A region that is too small for a spot is None. Any other exceeds the half level between the
    bright and the dark part of the window (after a median filter). Its ellipse is fitted to the
    vertices of its convex hull: if something convex hides part of an ellipse, the hull's vertices
    still lie on the ellipse, because a chord without vertices bridges the hidden part. A spot that
    a shaft splits in two has two ellipses: that of all its pieces, and the largest alone. A region
    that was offered is painted over before the next search.

    Args:
        min_contrast: (peak - background) / background that texture does not reach. A region of less
            must exceed the scatter of the dark part.
        solid: whether rings and halos are left out. If not, what follows no ellipse is left out:
            without a bell's surface a wall's texture stands out, too.
    """
    smooth = cv2.medianBlur(coarse.levels, 3)
    for _ in range(Search.REGIONS):
        count = cv2.calcHist([smooth], [0], None, [256], [0, 256]).ravel().astype(int)
        below = np.cumsum(count)
        # Otsu's level divides a histogram best, and small glints hardly move it.
        split = int(cv2.threshold(smooth, 0, 255, cv2.THRESH_OTSU)[0])
        dark, pixels = int(below[split]), int(below[-1])
        low, background, high = np.searchsorted(below, np.array([0.16, 0.5, 0.84]) * dark).tolist()
        peak, top = np.searchsorted(below, dark + np.array([0.5, 0.96]) * (pixels - dark)).tolist()
        least = min(min_contrast * background, Search.SIGNIFICANT * max(high - low, 1) / 2)
        if peak - background < max(least, Search.FAINTEST_STEP):
            return
        if 2 * dark < pixels:
            # The dark part is a shaft in front of a bright wall: the wall is the background.
            smooth = np.maximum(smooth, np.uint8(peak))
            continue
        half = (peak + background) // 2
        mask = (smooth > half).view(np.uint8)
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        areas = [_area(contour) for contour in contours]
        largest = max(range(len(areas)), key=areas.__getitem__)
        painted = [contours[largest]]
        if areas[largest] * coarse.stride**2 < min_area:
            painted = contours
            yield None
        else:
            region = np.zeros_like(mask)
            cv2.drawContours(region, contours, largest, 1, cv2.FILLED)
            inside = (region & mask).view(bool)
            soft = solid and peak - background < Search.PLATEAU * (top - background)
            lobed = soft and _are_lobes(contours, areas, cv2.subtract(smooth, half))
            bright = coarse.levels > half
            # A ring, or the halo of something brighter that was painted over. What hides a part of
            # a spot reaches in from outside; only small glints make holes in it.
            holes, area = region.view(bool) & ~inside, np.count_nonzero(region)
            lit = np.count_nonzero(holes & bright)
            ring = np.count_nonzero(holes) - lit > Search.HOLE * area
            hollow = solid and (ring or lit > Search.GLARE * area)
            least_piece = Search.SMALLEST_PIECE * areas[largest]
            pieces = [c for c, size in zip(contours, areas, strict=True) if size > least_piece]
            together = [np.concatenate(pieces)] if len(pieces) > 1 and not lobed else []
            hulls = [_hull_ellipse(points, coarse) for points in [*together, contours[largest]]]
            ellipses = [ellipse for ellipse in hulls if ellipse is not None and not hollow]
            if not solid:
                ellipses = [one for one in ellipses if _is_followed(one, coarse, half)]
            if ellipses:
                levels = peak * coarse.unit, background * coarse.unit
                yield Bright(ellipses, *levels, inside, lobed)
        smooth = smooth.copy()
        cv2.drawContours(smooth, painted, -1, background, cv2.FILLED)
        cv2.drawContours(smooth, painted, -1, background, 3)


def bright_points(coarse: Coarse, *, min_area: float) -> Iterator[Bright]:
    """Regions that stand out and are narrower than the largest small spot, brightest first.

    They exceed half of the height over what an opening (Serra 1982) leaves of the light. A point is
    `lobed` if as much of the window as its own area is as bright elsewhere.
    """
    smooth = cv2.medianBlur(coarse.levels, 3)
    widest = np.ones((Small.OPENING_PX, Small.OPENING_PX), np.uint8)
    below = cv2.morphologyEx(smooth, cv2.MORPH_OPEN, widest)
    above = smooth - below
    for _ in range(Search.REGIONS):
        _, top, _, place = cv2.minMaxLoc(above)
        if top < Search.FAINTEST_STEP:
            return
        _, labels = cv2.connectedComponents((above > top / 2).view(np.uint8))
        mask = labels == labels[place[::-1]]
        rows, columns = np.nonzero(mask)
        reach = 1 + int(max(np.ptp(rows), np.ptp(columns)))
        around = np.s_[
            max(int(rows.min()) - reach, 0) : int(rows.max()) + reach + 1,
            max(int(columns.min()) - reach, 0) : int(columns.max()) + reach + 1,
        ]
        if len(rows) >= min_area:
            half = float(below[mask].mean()) + top / 2
            elsewhere = int(
                np.count_nonzero(smooth > half) - np.count_nonzero(smooth[around] > half)
            )
            middle = np.array([coarse.x0 + columns.mean(), coarse.y0 + rows.mean()])
            # A uniform ellipse has a quarter of its squared axes as variances.
            spread = np.cov(columns, rows) + np.eye(2) / 12
            values, axes = np.linalg.eigh(spread)
            yield Bright(
                [AffineEllipse(middle, axes * (2 * np.sqrt(values)))],
                (half + top / 2) * coarse.unit,
                (half - top / 2) * coarse.unit,
                mask,
                lobed=elsewhere > Verdict.RIVAL * len(rows),
            )
        above[around] = 0


def _are_lobes(contours: Sequence[np.ndarray], areas: list[float], light: np.ndarray) -> bool:
    """Whether the two largest pieces of light are alike and convex, and each has its own middle.

    The halves of a spot that something dark severs are brightest towards each other.
    """
    order = sorted(range(len(areas)), key=areas.__getitem__)[-2:]
    if len(order) < 2 or areas[order[0]] < Verdict.RIVAL * areas[order[1]]:
        return False
    middles: list[np.ndarray] = []
    brightest: list[np.ndarray] = []
    for piece in order:
        if not _is_convex(contours[piece]):
            return False
        mask = np.zeros_like(light)
        cv2.drawContours(mask, contours, piece, 1, cv2.FILLED)
        for found, image in ((middles, mask), (brightest, mask * light)):
            moments = cv2.moments(image)
            found.append(np.array([moments["m10"], moments["m01"]]) / max(moments["m00"], 1))
    apart, closer = (math.dist(*places) for places in (middles, brightest))
    return apart - closer < Search.TOWARDS * math.sqrt(areas[order[1]])


def is_of_lattice(coarse: Coarse, dot: AffineEllipse, half: float) -> bool:
    """Whether two more pieces of light beside a dot are as bright, large and convex as it."""
    light = (coarse.levels > half / coarse.unit).view(np.uint8)
    semi_axes = dot.axes[0] / coarse.stride, dot.axes[1] / coarse.stride
    area = math.pi * semi_axes[0] * semi_axes[1]
    middle = ((dot.centre - (coarse.x0, coarse.y0)) / coarse.stride).tolist()
    contours, _ = cv2.findContours(light, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    alike = [
        contour
        for contour in contours
        if Verdict.RIVAL * area < _area(contour) < area / Verdict.RIVAL
        and math.dist(cv2.minEnclosingCircle(contour)[0], middle) > semi_axes[0]
        and _is_convex(contour)
    ]
    return len(alike) > 1


def _is_followed(ellipse: AffineEllipse, coarse: Coarse, level: float) -> bool:
    """Whether a level of the window is an ellipse near a given one, as far as it shows edges."""
    captured = capture(coarse.patch, ellipse, level)
    return captured is not None and captured.scatter < Reflection.ROUGHEST


def _area(contour: np.ndarray) -> float:
    """A contour runs through pixel centres; half its length is the area outside them."""
    return cv2.contourArea(contour) + len(contour) / 2 + 1


def _is_convex(contour: np.ndarray) -> bool:
    hull = cv2.contourArea(cv2.convexHull(contour))
    return cv2.contourArea(contour) >= Search.CONVEX * hull


def _hull_ellipse(points: np.ndarray, coarse: Coarse) -> AffineEllipse | None:
    hull = cv2.convexHull(points)[:, 0]
    height, width = coarse.levels.shape
    x, y = hull[:, 0], hull[:, 1]
    hull = hull[(x > 0) & (y > 0) & (x < width - 1) & (y < height - 1)]
    if len(hull) < 5:
        return None
    (u, v), (first, second), degrees = cv2.fitEllipse(hull)
    # cv2's angle is that of the first axis; the rim lies half a pixel outside pixel centres.
    half = first / 2 + 0.5, second / 2 + 0.5
    if not (max(half) < 2 * max(height, width) and math.isfinite(u + v + degrees)):
        return None
    return AffineEllipse.from_axes(
        coarse.x0 + coarse.stride * u,
        coarse.y0 + coarse.stride * v,
        coarse.stride * half[0],
        coarse.stride * half[1],
        math.radians(degrees),
    )
