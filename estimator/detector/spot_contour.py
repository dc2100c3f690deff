"""Bright regions that may be the spot, and the half-maximum contour of each.

Regions are looked for anywhere in a window, or at the last contour. `edges` fits a contour to a
patch of light. Here the light is chosen: the wall's texture is taken out of a broad flank, and a
background that the window does not show is taken from the whole frame. Both are known only after a
fit, so such a contour is fitted again.

Texture is estimated from its colours. Blood and pigment absorb some colours more than others, while
light from one source falls off alike in all. A product of powers of the channels, with exponents
that sum to one, leaves such light unchanged. Of these products, the one that varies least over
short distances shows least of the wall: the beamformer of Capon (1969) on the logarithms. Texture
that is equally dark in every colour remains.

A contour is rejected if dark places inside cannot be explained by anything that reaches in from
outside. A shaft or a shadow in front of a spot begins outside the spot: from every point of it, a
straight way through the dark leads out. A letter or a ring is dark behind a bright stroke.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from eyespot.estimator.detector.coarse import (
    Bright,
    Coarse,
    bright_points,
    bright_regions,
    channel_for,
)
from eyespot.estimator.detector.edges import EdgeFit, fit_edge
from eyespot.estimator.detector.ellipse_rays import AffineEllipse, Patch
from eyespot.estimator.detector.levels import dark_radius
from eyespot.estimator.detector.settings import SubpixelSettings
from eyespot.estimator.detector.tuning import (
    RAYS,
    Capture,
    Channel,
    Hollow,
    Refine,
    Saturated,
    Search,
    Sharp,
    Small,
    Texture,
)
from eyespot.estimator.frame_window import Window
from eyespot.formats.camera_sheet import GREY
from eyespot.formats.spot import NoSpot, Reason


@dataclass(frozen=True, eq=False)
class Region:
    """A bright region of a frame that may be a spot.

    Attributes:
        coarse: the window in which it was found, in the channel in which it is to be measured.
        channel, clips, saturated: see `channel_for`.
        faint: whether it is no brighter than a wall's texture may make it.
    """

    frame: np.ndarray
    settings: SubpixelSettings
    full_scale: float
    coarse: Coarse
    channel: int
    clips: tuple[float, ...]
    saturated: tuple[float, ...]
    bright: Bright
    faint: bool

    @property
    def area_px(self) -> float:
        """Number of the frame's pixels in the region."""
        return float(np.count_nonzero(self.bright.mask)) * self.coarse.stride**2

    @property
    def ellipse(self) -> AffineEllipse:
        """The ellipse round the region, good to a few px."""
        return self.bright.ellipses[0]

    @property
    def is_small(self) -> bool:
        """Whether the pixel grid hides too much of profiles along rays."""
        return self.ellipse.axes[1] < Small.LARGEST_PX

    def fills_its_ellipse(self) -> float:
        """Fraction of the ellipse round the region that the region takes up."""
        semi_major, semi_minor, _ = self.ellipse.axes
        return self.area_px / (math.pi * semi_major * semi_minor)


def regions_in(
    frame: np.ndarray, window: Window, settings: SubpixelSettings, channel: int | None = None
) -> Iterator[Region | NoSpot]:
    """Bright regions of a window, brightest first, and the reasons why others are no spots.

    The window is where the spot's body may lie; its edge is followed beyond.

    Args:
        channel: in which they are to be measured; None chooses the best one for each.
    """
    stride = Search.STRIDE
    window = window.on_grid(stride)
    if min(window.of(frame, stride).shape[:2]) < 5:  # the 3x3 median needs neighbours
        return
    grey = coarse_of(frame, window, GREY, settings, stride)
    smallest = Search.SMALLEST_AREA * math.pi * Small.LARGEST_PX**2
    for bright in bright_regions(grey, min_contrast=settings.min_contrast, min_area=smallest):
        if bright is None:
            yield NoSpot(Reason.TOO_SMALL)
        else:
            yield _region(frame, window, grey, bright, settings, channel)


def small_regions_in(
    frame: np.ndarray, window: Window, settings: SubpixelSettings, channel: int | None = None
) -> Iterator[Region]:
    """As `regions_in`, of those that are too small for profiles along rays."""
    if min(window.of(frame).shape[:2]) < 5:
        return
    grey = coarse_of(frame, window, GREY, settings, 1)
    smallest = Search.SMALLEST_AREA * math.pi * settings.min_semi_minor_px**2
    for bright in bright_points(grey, min_area=smallest):
        yield _region(frame, window, grey, bright, settings, channel)


def _region(
    frame: np.ndarray,
    window: Window,
    grey: Coarse,
    bright: Bright,
    settings: SubpixelSettings,
    channel: int | None,
) -> Region:
    """A bright region of a grey window, in the channel in which it is to be measured."""
    full_scale, stride = settings.response.full_scale_of(frame), grey.stride
    mask = bright.mask.view(np.uint8)
    best, clips, full = channel_for(frame, window, stride, mask, full_scale)
    channel = best if channel is None else channel
    coarse, faint = grey, bright.is_below(settings.min_contrast)
    if channel != GREY:
        coarse = coarse_of(frame, window, channel, settings, stride)
        bright = bright.relevelled(coarse)
    return Region(frame, settings, full_scale, coarse, channel, clips, full, bright, faint)


def region_at(
    ellipse: AffineEllipse,
    half: float,
    width: float,
    channel: int,
    frame: np.ndarray,
    settings: SubpixelSettings,
) -> Region | None:
    """The region that exceeds the last spot's half level near its contour.

    None where there is nothing like it, where another channel than the last one shows it better
    now, and for a broad edge, whose background is too far away for a search nearby.

    Args:
        ellipse, half, width: of the last spot; its edge's width in radii.
    """
    small = ellipse.axes[1] < Small.LARGEST_PX
    if width > Refine.BROAD and not small:
        return None
    stride = 1 if small else Search.STRIDE
    reach = dark_radius(width) + Search.AROUND
    x, y = ellipse.centre.tolist()
    window = Window.around(x, y, *ellipse.scaled(reach).half_extent(), frame).on_grid(stride)
    coarse = coarse_of(frame, window, channel, settings, stride)
    mask = (coarse.levels > half / coarse.unit).view(np.uint8)
    moments = cv2.moments(mask, binaryImage=True)
    semi_major, semi_minor, _ = ellipse.axes
    filled = moments["m00"] * stride**2 / (math.pi * semi_major * semi_minor)
    if abs(filled - 1) > Search.LIKE_LAST:
        return None
    full_scale = settings.response.full_scale_of(frame)
    best_channel, clips, full = channel_for(frame, window, stride, mask, full_scale)
    if best_channel != channel:
        return None
    if abs(filled - 1) < Search.UNHIDDEN:
        centroid = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        ellipse = AffineEllipse((window.x0, window.y0) + stride * centroid, ellipse.shape)
    bright = Bright([ellipse], 0.0, 0.0, mask.view(bool)).relevelled(coarse)
    faint = bright.is_below(settings.min_contrast)
    return Region(frame, settings, full_scale, coarse, channel, clips, full, bright, faint)


def coarse_of(
    frame: np.ndarray, window: Window, channel: int, settings: SubpixelSettings, stride: int
) -> Coarse:
    """The light of a window in one channel, of every `stride`-th pixel, in 8 bits."""
    response = settings.response
    values = window.of(frame, stride)
    light = response.channel(values, channel, response.full_scale_of(frame))
    return Coarse.of_signal(light, stride=stride, x0=window.x0, y0=window.y0)


def without_texture(patch: Patch, colours: np.ndarray, ellipse: AffineEllipse) -> Patch:
    """The patch divided by the texture that its colours show.

    Args:
        patch: light of the channel or the grey mean to be measured in, at full resolution.
        colours: (h, w, 3) float32 light of the same pixels, nowhere saturated.
    """
    light = patch.signal
    height, width = light.shape
    cell = max(ellipse.axes[1] / Texture.CELLS, 1.0)
    cells = max(round(width / cell), 1), max(round(height / cell), 1)
    channels = cv2.resize(np.dstack([colours, light]), cells, interpolation=cv2.INTER_AREA)
    channels = np.maximum(channels.reshape(-1, 4), 0)
    bright = channels[:, 3:]
    # The same fraction of each channel, so that light that falls off alike in all still does.
    lift = Texture.LIFT * (channels * bright).sum(axis=0) / max(bright.sum(), 1e-30) + 1e-30
    logarithms = cv2.log(channels + lift)
    # Twice, because the logarithm of a bell is curved, and the bell's colour differs from that of
    # the other light.
    short = logarithms.reshape(*cells[::-1], 4)
    for _ in range(2):
        short = short - cv2.GaussianBlur(short, (0, 0), Texture.SHORT_WAVES)
    short = bright * short.reshape(-1, 4)[:, :3]
    varying = short.T @ short
    varying.flat[::4] += 1e-6 * varying.trace() + 1e-30
    exponents = np.linalg.solve(varying, np.ones(3))
    texture = logarithms[:, 3] - logarithms[:, :3] @ (exponents / exponents.sum())
    # Variation with the radius is the light's: without the means of rings about the centre.
    x = (np.arange(cells[0]) + 0.5) * (width / cells[0]) - 0.5 + patch.x0 - ellipse.centre[0]
    y = (np.arange(cells[1]) + 0.5) * (height / cells[1]) - 0.5 + patch.y0 - ellipse.centre[1]
    (a, b), (c, d) = np.linalg.inv(ellipse.shape).tolist()
    radius = np.hypot(a * x + b * y[:, None], c * x + d * y[:, None])
    ring = np.rint(radius * Texture.CELLS).astype(int).ravel()
    both = np.stack([logarithms[:, 3], logarithms[:, 3] - texture], axis=1)
    sums = np.stack([np.bincount(ring, column) for column in both.T], axis=1)
    rings = (sums / np.maximum(np.bincount(ring), 1)[:, None])[ring]
    before, after = np.square(bright * (both - rings)).sum(axis=0)
    if after > Texture.BY_CHANCE * before:  # wide patches of another pigment
        return patch
    on_rings = rings[:, :1] - rings[:, 1:]
    along_rings = texture[:, None] - on_rings
    across_rings = on_rings - float((bright * on_rings).sum() / max(bright.sum(), 1e-30))
    if np.square(bright * across_rings).sum() > np.square(bright * along_rings).sum():
        return patch  # the colours do not fall off alike
    texture = cv2.exp((texture - np.median(texture)).astype(np.float32)).reshape(cells[::-1])
    texture = cv2.resize(texture, (width, height), interpolation=cv2.INTER_LINEAR)
    return replace(patch, signal=(light + lift[3]) / texture - lift[3])


_AT = np.linspace(-1, 1, Hollow.SIDE, dtype=np.float32)
_X, _Y = np.meshgrid(_AT, _AT)
_RADIUS = np.hypot(_X, _Y)
_RAY = np.rint(np.arctan2(_Y, _X) * (RAYS / (2 * math.pi))).astype(int) % RAYS
_THICK = np.ones((3, 3), np.uint8)  # along a thinner line, a way strays into the bright
_MIDDLE = (Hollow.SIDE - 1) / 2
_TURNS = [
    cv2.getRotationMatrix2D((_MIDDLE, _MIDDLE), degrees, 1)
    for degrees in range(0, 180, 5)  # between two of them a way of a radius strays by 0.04 radii
]


def hollow_share(
    patch: Patch, ellipse: AffineEllipse, seen: np.ndarray, half: float, width: float
) -> float:
    """Area of dark places behind a visible edge, over the area inside the edge.

    1 for a ring: of an edge that is mostly visible in the frame, a straight shaft hides the light
    behind some, never behind most.

    Args:
        seen: (RAYS,) rays on which its edge is visible.
    """
    inside = _RADIUS < 1 - Sharp.PLATEAU * width
    # On a grid on which the ellipse is the unit circle; NaN outside the patch.
    x0, y0 = ((ellipse.centre - (patch.x0, patch.y0)) / patch.stride).tolist()
    (a, b), (c, d) = (ellipse.shape / patch.stride).astype(np.float32)
    x, y = np.float32(x0) + a * _X + b * _Y, np.float32(y0) + c * _X + d * _Y
    light = cv2.remap(
        patch.signal, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=math.nan
    )
    dark = inside & (light < half)
    area = np.count_nonzero(inside)
    if np.count_nonzero(dark) <= Hollow.SHARE * area:
        return 0.0
    circle = (np.abs(_RADIUS - Hollow.BEHIND) < 2 / Hollow.SIDE) & ~np.isnan(light)
    behind = circle & seen[_RAY]
    ring = np.count_nonzero(dark & behind) > Hollow.RING * np.count_nonzero(behind)
    if ring and 2 * np.count_nonzero(behind) > np.count_nonzero(circle):
        return 1.0
    thick = cv2.morphologyEx(dark.view(np.uint8), cv2.MORPH_OPEN, _THICK).view(bool)
    passable = np.where(inside, dark | np.isnan(light), ~seen[_RAY])
    return np.count_nonzero(thick & ~_reached_from_outside(passable)) / area


def _reached_from_outside(passable: np.ndarray) -> np.ndarray:
    """Pixels from which some straight way through passable pixels leads to the image's border."""
    reached = np.zeros_like(passable)
    for turn in _TURNS:
        turned = cv2.warpAffine(
            passable.view(np.uint8), turn, passable.shape, flags=cv2.INTER_NEAREST, borderValue=1
        )
        ways = np.minimum.accumulate(turned, axis=1)
        ways |= np.minimum.accumulate(turned[:, ::-1], axis=1)[:, ::-1]
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        reached |= cv2.warpAffine(ways, turn, passable.shape, flags=flags).view(bool)
    return reached


def contour_of(region: Region) -> EdgeFit | NoSpot:
    """The region's contour; near several ellipses the one of which most is visible."""
    best: EdgeFit | None = None
    failure = NoSpot(Reason.NONE_FOUND)
    for ellipse in region.bright.ellipses:
        fit = _fitted(region, ellipse)
        if isinstance(fit, NoSpot):
            failure = fit
            continue
        if best is None or np.count_nonzero(fit.inliers) > np.count_nonzero(best.inliers):
            best = fit
        if np.count_nonzero(best.inliers) > region.settings.min_coverage * RAYS:
            break
    return failure if best is None else best


def patch_round(region: Region, ellipse: AffineEllipse, width: float = 0.0) -> Patch:
    """Light round an ellipse; for a broad edge (`width` in radii) without the wall's texture."""
    frame, response = region.frame, region.settings.response
    half_width, half_height = ellipse.half_extent()
    x, y = ellipse.centre.tolist()
    window = Window.around(x, y, Capture.REACH * half_width, Capture.REACH * half_height, frame)
    values, full_scale = window.of(frame), region.full_scale
    light = response.channel(values, region.channel, full_scale)
    ceiling, clipped = math.inf, region.saturated[region.channel]
    if clipped > 0:
        ceiling = response.ceiling(region.channel, region.clips, full_scale)
    patch = Patch(light, window.x0, window.y0, ceiling=ceiling, clipped=clipped)
    if width > Refine.BROAD and _colours_show_texture(region):
        return _evened(region, patch, ellipse)
    return patch


def _evened(region: Region, patch: Patch, ellipse: AffineEllipse) -> Patch:
    """A region's patch without the texture that its colours show."""
    left, top = int(patch.x0), int(patch.y0)
    height, width = patch.signal.shape
    values = region.frame[top : top + height, left : left + width]
    return without_texture(
        patch, region.settings.response.light(values, region.full_scale), ellipse
    )


def _fitted(region: Region, ellipse: AffineEllipse) -> EdgeFit | NoSpot:
    patch = patch_round(region, ellipse)
    levels = region.bright.peak, region.bright.background
    fit = fit_edge(patch, region.coarse, ellipse, *levels)
    if fit and fit.levels.width > Refine.BROAD and _colours_show_texture(region):
        even = _evened(region, patch, ellipse)
        if again := fit_edge(even, region.coarse, ellipse, *levels):
            patch, fit = even, again
    if fit and not fit.levels.sees_background:
        frame = region.frame
        whole = coarse_of(
            frame, Window.whole(frame), region.channel, region.settings, Search.STRIDE
        )
        fit = fit_edge(patch, whole, ellipse, *levels)
    if fit and fit.levels.width <= Refine.BROAD:
        lit, half, width = fit.seen & ~fit.shaded, fit.levels.half, fit.levels.width
        # The first ellipse may have been a piece's, and its patch too small for the whole.
        reach = np.abs(fit.ellipse.centre - ellipse.centre) + fit.ellipse.half_extent()
        beyond = bool((reach > Capture.REACH * np.array(ellipse.half_extent())).any())
        around = patch_round(region, fit.ellipse) if beyond else patch
        if hollow_share(around, fit.ellipse, lit, half, width) > Hollow.SHARE:
            return NoSpot(Reason.NONE_FOUND)  # as letters are
        # Compressing moves a cut edge by tenths of a px, in each colour, which shows in no misfit.
        cut = max(region.saturated) > Channel.SATURATED
        if cut and _is_compressed(around, fit.ellipse, fit.levels.width):
            return NoSpot(Reason.SATURATED)
    return fit


def _is_compressed(patch: Patch, ellipse: AffineEllipse, width: float) -> bool:
    """Whether pixels beside an edge are rougher than farther out, as in the blocks of a JPEG.

    Second differences along both axes leave noise, and little of walls and flanks.
    """
    rough = patch.signal[1:, 1:] - patch.signal[:-1, 1:] - patch.signal[1:, :-1]
    rough = rough + patch.signal[:-1, :-1]
    cos, sin = Patch(rough, patch.x0 + 0.5, patch.y0 + 0.5).on_circle(ellipse)
    beyond_px = (np.hypot(cos, sin) - 1 - Sharp.REACH * width) * ellipse.axes[1]
    # A glint on the edge is rough, too, but not all round it.
    turn = np.arctan2(sin, cos) / (2 * math.pi)
    sector = np.floor(Saturated.SECTORS * turn).astype(int) % Saturated.SECTORS
    typical = []
    for first, last in Saturated.BLOCKS_PX:
        there = (beyond_px > first) & (beyond_px < last)
        number = np.bincount(sector[there], minlength=Saturated.SECTORS)
        square = np.bincount(sector[there], rough[there] ** 2, minlength=Saturated.SECTORS)
        seen = number > Saturated.FEWEST
        if np.count_nonzero(seen) < Saturated.SECTORS // 2:
            return False
        typical.append(float(np.median(square[seen] / number[seen])))
    near, far = typical
    return near > Saturated.ROUGHER**2 * far


def _colours_show_texture(region: Region) -> bool:
    """Whether no colour of the wall is saturated."""
    return region.frame.ndim == 3 and max(region.saturated) == 0
