"""What is measured of a bright region: contour, motion, reflection, lens distortion.

Two kinds of spots are fitted again:

- A spot that moved during the exposure. Its image is the mean of its ellipse over its path: its
  edge is smeared along the path and not across it, and the half-maximum contour is not an ellipse.
  So the ellipse, its path, its acceleration and its edge are fitted to the pixels together.
  Acceleration counts because a spot that speeds up is in the middle of its path later than in the
  middle of the exposure. This takes about 0.1 s, and is done only for spots whose edge is wide in
  one direction and narrow across.
- A spot on a specular reflection. A wet or varnished wall reflects the microscope's light as a wide
  bell, which may be brighter than the spot. A spot with a broad edge is smooth throughout; a
  reflection shows the sharp rim of the spot.
"""

import math
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import NamedTuple

import cv2
import numpy as np

from eyespot.estimator.detector.coarse import Coarse, bright_regions
from eyespot.estimator.detector.edges import EdgeFit, fit_edge
from eyespot.estimator.detector.ellipse_rays import (
    AffineEllipse,
    Patch,
    contour_points,
    normals_of,
    refitted,
    ring_variances,
)
from eyespot.estimator.detector.levels import RADII, RADIUS_STEP, background_of
from eyespot.estimator.detector.pixel_fit import SmallSpot, fit_to_pixels
from eyespot.estimator.detector.spot_contour import Region, contour_of, patch_round
from eyespot.estimator.detector.tuning import (
    RAYS,
    Motion,
    Refine,
    Reflection,
    Saturated,
    Small,
    Verdict,
)
from eyespot.estimator.frame_window import Window
from eyespot.formats.camera_sheet import GREY, LensDistortion
from eyespot.formats.spot import EVEN_LIGHT, NoSpot, Reason

_GRID = np.linspace(-Motion.FLAT, Motion.FLAT, 1601)
_PER_WIDTH = (len(_GRID) - 1) / (2 * Motion.FLAT)
_INSIDE = np.array([NormalDist().cdf(-d) for d in _GRID], np.float32)
_DENSITY = np.exp(-0.5 * _GRID**2, dtype=np.float32) / np.float32(math.sqrt(2 * math.pi))


@dataclass(frozen=True, eq=False)
class _Moving:
    """An evenly lit ellipse with a Gaussian-blurred edge that moves along a path; lengths in px.

    At the time t, from -1/2 to 1/2, its centre is at ellipse.centre + path * t + bend * t**2.
    """

    ellipse: AffineEllipse
    path: np.ndarray
    bend: np.ndarray
    width: float
    amplitude: float
    background: float

    def stepped(self, step: np.ndarray) -> "_Moving":
        """Changed by five parameters of the ellipse, path, bend, and three logarithms."""
        growth = np.exp(np.clip(step[9:], -0.5, 0.5)).tolist()
        longest = 0.25 * self.ellipse.axes[1]
        return _Moving(
            self.ellipse.stepped(np.clip(step[:5], -0.2, 0.2)),
            self.path + np.clip(step[5:7], -longest, longest),
            self.bend + np.clip(step[7:9], -longest, longest),
            self.width * growth[0],
            self.amplitude * growth[1],
            self.background * growth[2],
        )

    def linearised(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signal at pixels, and the relative derivatives by the parameters of `stepped`, (12, …).

        The mean over the path is a sum over places closer together than the edge is wide.
        """
        number = 3 + math.ceil(1.2 * math.hypot(*self.path) / self.width)
        (a, b), (c, d) = np.linalg.inv(self.ellipse.shape).astype(np.float32)
        lit = np.zeros(np.broadcast(u, v).shape, np.float32)
        derivatives = np.zeros((Motion.PARAMETERS, *lit.shape), np.float32)
        for at in ((np.arange(number) + 0.5) / number - 0.5).tolist():
            x, y = (self.ellipse.centre + at * self.path + at * at * self.bend).tolist()
            cos, sin = a * (u - x) + b * (v - y), c * (u - x) + d * (v - y)
            radius = np.hypot(cos, sin) + np.float32(1e-6)
            cos, sin = cos / radius, sin / radius
            normal_x, normal_y = cos * a + sin * c, cos * b + sin * d
            per_px = np.hypot(normal_x, normal_y)
            distance = (radius - 1) / (per_px * np.float32(self.width))
            inside = np.clip((distance + Motion.FLAT) * _PER_WIDTH, 0, len(_GRID) - 1).astype(int)
            lit += _INSIDE[inside]
            density = _DENSITY[inside] / np.float32(self.width)
            by_radius = density / per_px
            for row, column in enumerate((cos, sin, cos * cos, sin * sin, 2 * cos * sin)):
                derivatives[row] += by_radius * column
            for row, power in ((5, at), (7, at * at)):
                derivatives[row] += by_radius * normal_x * power
                derivatives[row + 1] += by_radius * normal_y * power
            derivatives[9] += density * distance * np.float32(self.width)
        share = np.float32(self.amplitude / number)
        derivatives *= share
        signal = lit * share
        derivatives[10] = signal
        derivatives[11] = self.background
        signal = signal + np.float32(self.background)
        return signal, derivatives / signal


def at_mid_exposure(patch: Patch, fit: EdgeFit) -> EdgeFit:
    """The fit with the ellipse in the middle of the path if the spot moved, else the fit unchanged.

    Weighted least squares by Gauss-Newton steps on the ratio of signal and model, both without
    their local mean, because a wall's texture is strongest at long waves (`Motion.LONG_WAVES`). The
    covariance is White's (1980), from blocks of pixels that share texture.
    """
    path = _path(patch, fit)
    if path is None:
        return fit
    levels = fit.levels
    # Where neither rest nor motion explains the edge, no ray is known to show it. For example,
    # tools hide the ends of the path: then no size is determined.
    neither = replace(fit, inliers=np.zeros_like(fit.inliers))
    shrink = max(round(max(patch.signal.shape) / 100), 1)  # 0.1 s
    height, width = (length // shrink for length in patch.signal.shape)
    whole = patch.signal[: height * shrink, : width * shrink]
    signal = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    u = patch.x0 + shrink * (np.arange(width, dtype=np.float32) + 0.5) - 0.5
    v = patch.y0 + shrink * (np.arange(height, dtype=np.float32)[:, None] + 0.5) - 0.5
    background = max(levels.background, 0.01 * levels.peak)
    moving = _Moving(fit.ellipse, path, np.zeros(2), float(shrink), levels.amplitude, background)
    for _ in range(12):
        model, derivatives = moving.linearised(u, v)
        residual = _passed(signal / model - 1)
        columns = np.stack([_passed(row) for row in derivatives], axis=-1)
        typical = 1.48 * float(np.median(np.abs(residual))) + 1e-9
        weight = 1 / (1 + (residual / (Motion.OUTLYING * typical)) ** 2)
        pull = columns * (weight * residual)[..., None]
        flat = columns.reshape(-1, Motion.PARAMETERS)
        gram = (flat.T * weight.ravel()).astype(float) @ flat
        gram.flat[:: Motion.PARAMETERS + 1] *= 1 + 1e-6
        step = np.linalg.lstsq(gram, pull.sum(axis=(0, 1)).astype(float), rcond=None)[0]
        moving = moving.stepped(step)
        semi_major, semi_minor, _ = moving.ellipse.axes
        sane = shrink / 4 < moving.width < semi_minor and semi_major < 2 * fit.ellipse.axes[0]
        if not (sane and math.hypot(*moving.path) < 4 * semi_minor):
            return neither
        if np.abs(step[:5]).max() < 2e-4:  # 0.01 px at a radius of 60 px
            break
    else:
        return neither
    covariance = _covariance(gram, pull, columns * np.sqrt(weight)[..., None])
    # A residual that grows loses weight, so a step changes the pull by less than the weights say
    # (Huber 1981, section 6.3).
    bending = weight * (2 * weight - 1)
    bent = (flat.T * bending.ravel()).astype(float) @ flat
    share = np.trace(np.linalg.solve(gram, bent)) / Motion.PARAMETERS
    covariance /= max(share, 0.25) ** 2  # 0.85 for normal errors
    path = moving.path
    # Variance of the path's length, times its square.
    doubt = path @ covariance[5:7, 5:7] @ path
    if (path @ path) ** 2 <= Motion.SURE**2 * doubt or _rests(signal, model, fit, u, v):
        return fit
    return replace(
        fit,
        ellipse=moving.ellipse,
        step_covariance=covariance[:5, :5],
        levels=replace(
            levels,
            peak=moving.background + moving.amplitude,
            background=moving.background,
            width=moving.width / math.sqrt(semi_major * semi_minor),
        ),
        offsets=np.where(fit.found, 0.0, fit.offsets),
        inliers=fit.found,
        own_half=EVEN_LIGHT,
        scatter=0.0,
        steeper=1.0,
    )


def _path(patch: Patch, fit: EdgeFit) -> np.ndarray | None:
    """Rough path of a spot whose edge is wide in one direction and narrow across; else None."""
    profiles = np.nan_to_num(patch.unwrapped(fit.ellipse, RADII), nan=0.0)
    normals, per_px = normals_of(fit.ellipse)
    # The integral of the squared slope is step^2 / length where an edge is smeared evenly.
    steepness = (np.diff(profiles, axis=1) ** 2).sum(axis=1) * (per_px / RADIUS_STEP)
    seen = fit.found & (steepness > 0)
    lengths = fit.levels.amplitude**2 / steepness[seen]
    cos, sin = normals[:, seen]
    double = np.stack([np.ones_like(cos), cos * cos - sin * sin, 2 * cos * sin], axis=1)
    _, along, across = np.linalg.lstsq(double, np.log(lengths * per_px[seen]), rcond=None)[0]
    if math.hypot(along, across) < Motion.UNEVEN:
        return None
    heading = math.atan2(across, along) / 2
    towards = np.array([math.cos(heading), math.sin(heading)])
    along_path = np.abs(towards @ normals[:, seen])
    beside, ahead = lengths[along_path < Motion.BESIDE], lengths[along_path > Motion.ALONG]
    # The edge of a sharp spot stays sharp beside its path. A bell, whose width texture or a slanted
    # beam makes uneven too, is broad all round.
    if not (beside.size and ahead.size) or np.median(beside) > Motion.SHARP * fit.ellipse.axes[1]:
        return None
    return min(float(np.median(ahead)), fit.ellipse.axes[1]) * towards


def _rests(
    signal: np.ndarray, moving: np.ndarray, fit: EdgeFit, u: np.ndarray, v: np.ndarray
) -> bool:
    """Whether a spot at rest, of any profile, explains the light better than a moving one does.

    Fringes make a bell's edge uneven, too.
    """
    inverse, (x, y) = np.linalg.inv(fit.ellipse.shape), fit.ellipse.centre
    cos, sin = (row[0] * (u - x) + row[1] * (v - y) for row in inverse)
    radius = np.hypot(cos, sin)
    near = radius < RADII[-1]
    ring = np.rint(radius[near] / RADIUS_STEP).astype(int)
    light = signal[near]
    profile = np.bincount(ring, light) / np.maximum(np.bincount(ring), 1)
    # The levels of the moving spot were fitted without long waves, so they are fitted again.
    levels = np.column_stack([moving[near], np.ones(light.size)])
    _, left, *_ = np.linalg.lstsq(levels, light, rcond=None)
    return bool(np.square(light - profile[ring]).sum() < left.sum())


def _passed(values: np.ndarray) -> np.ndarray:
    return values - cv2.GaussianBlur(values, (0, 0), Motion.LONG_WAVES)


def _covariance(gram: np.ndarray, pull: np.ndarray, weighted: np.ndarray) -> np.ndarray:
    """Covariance of the parameters, from the scatter of what blocks of pixels pull.

    The fit follows the blocks, so what they still pull is too little. It is raised by what the fit
    has taken from each: the bias-reduced estimate of Bell and McCaffrey (2002).

    Args:
        gram: (p, p) normal matrix.
        pull: (h, w, p) each pixel's part of the gradient.
        weighted: (h, w, p) derivatives, times the roots of the pixels' weights.
    """

    def blocks(values: np.ndarray) -> np.ndarray:
        """Values (h, w, p) of pixels by block, (blocks, pixels, p)."""
        side = round(4 * Motion.LONG_WAVES)
        down, across = (length // side for length in values.shape[:2])
        parts = values[: down * side, : across * side].reshape(down, side, across, side, -1)
        return parts.swapaxes(1, 2).reshape(down * across, side * side, -1)

    values, vectors = np.linalg.eigh(gram)
    root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    rows = blocks(weighted)
    shares = root.T @ np.matmul(rows.transpose(0, 2, 1), rows).astype(float) @ root
    taken, axes = np.linalg.eigh(shares)
    left = np.sqrt(np.maximum(1 - taken, 0.01))  # a block alone may determine a parameter
    scores = blocks(pull).sum(axis=1).astype(float) @ root
    along = np.einsum("bij,bi->bj", axes, scores) / left
    raised = np.einsum("bij,bj->bi", axes, along)
    return root @ (raised.T @ raised) @ root.T


def rim_on(region: Region, fit: EdgeFit) -> EdgeFit | None:
    """The spot with a sharp rim that a region's light shows; None if it shows none.

    The light is then a wet wall's reflection of a lamp.
    """
    if fit.levels.width < Refine.BROAD:
        return None
    patch, smallest_px = patch_round(region, fit.ellipse), region.settings.min_semi_minor_px
    half_width, half_height = fit.ellipse.half_extent()
    x, y = (fit.ellipse.centre - (patch.x0, patch.y0)).tolist()
    left, top = max(int(x - half_width), 0), max(int(y - half_height), 0)
    light = patch.signal[top : int(y + half_height) + 1, left : int(x + half_width) + 1]
    stride = max(light.shape) // 64 + 1
    height, width = (length // stride for length in light.shape)
    if min(height, width) < 2 * Reflection.POWERS:
        return None
    light = light[: height * stride, : width * stride]
    small = cv2.resize(light, (width, height), interpolation=cv2.INTER_AREA)
    # Orthonormal polynomials on as many points, in columns.
    down, across = (
        np.linalg.qr(np.vander(np.linspace(-1, 1, number), Reflection.POWERS))[0].astype(np.float32)
        for number in (height, width)
    )
    surface = down @ (down.T @ small @ across) @ across.T
    x0, y0 = int(patch.x0) + left, int(patch.y0) + top
    coarse = Coarse.of_signal(small - surface, stride=stride, x0=x0, y0=y0)
    above = light - cv2.resize(surface, light.shape[::-1], interpolation=cv2.INTER_LINEAR)
    standing_out = Patch(above, x0, y0)
    rims: list[EdgeFit] = []
    # Without its surface, a bell leaves rings.
    smallest = Reflection.SMALLEST * light.size
    regions = bright_regions(coarse, min_contrast=0, min_area=smallest, solid=False)
    for bright in filter(None, regions):
        for ellipse in bright.ellipses:
            rim = fit_edge(standing_out, coarse, ellipse, bright.peak, bright.background)
            if (
                isinstance(rim, EdgeFit)
                and rim.levels.width < Reflection.SHARPEST
                and rim.scatter < Reflection.SMOOTHEST
                and rim.inliers.mean() > Reflection.SEEN
                and rim.ellipse.axes[1] > smallest_px  # smaller blobs are noise
            ):
                rims.append(rim)
    return max(rims, key=lambda rim: float(rim.inliers.mean()), default=None)


def small_spot_in(region: Region) -> SmallSpot | NoSpot:
    """The spot that is fitted to the pixels of a small region; clipped pixels are left out."""
    frame, start = region.frame, region.ellipse
    half_width, half_height = start.scaled(Small.REACH).half_extent()
    x, y = start.centre.tolist()
    window = Window.around(x, y, half_width + 3, half_height + 3, frame)
    values = window.of(frame)
    light = region.settings.response.channel(values, region.channel, region.full_scale)
    planes = np.atleast_3d(values)
    used = slice(None) if region.channel == GREY else slice(region.channel, region.channel + 1)
    clips = np.array(region.clips)[used] * (1 - 1e-6)
    clipped = np.array((planes[:, :, used] >= clips).any(axis=2), np.uint8)
    # A pixel is more likely to be left out if its noise is bright: so its neighbours are, too.
    left_out = cv2.dilate(clipped, np.ones((3, 3))).view(bool)
    seen = np.where(left_out, np.nan, light)
    spot = fit_to_pixels(seen, window.x0, window.y0, start)
    contour = Patch(light.astype(np.float32), window.x0, window.y0)
    if spot is not None and (foreign := _beside(seen, contour, spot)).any():
        spot = fit_to_pixels(np.where(foreign, np.nan, seen), window.x0, window.y0, spot.ellipse)
    if spot is None:
        return NoSpot(Reason.NONE_FOUND)
    half = spot.background + spot.amplitude / 2
    rings = np.nan_to_num(contour.unwrapped(spot.ellipse, np.array(Small.RINGS)) - half).T
    along, heights = rings[-1], rings.mean(axis=1) + spot.amplitude / 2
    corners = max(ring_variances(along, *(slice(k, k + 1) for k in range(3, Verdict.CORNERS.stop))))
    cornered = 2 / RAYS * corners > (Small.CORNERED * spot.amplitude) ** 2
    hollow = heights[0] < 0.5 * heights[1:-1].max()
    if cornered or hollow or spot.ellipse.axes[1] > Small.OPENING_PX / 2:
        return NoSpot(Reason.NONE_FOUND)
    area = math.pi * abs(np.linalg.det(spot.ellipse.shape))
    hidden = np.count_nonzero(left_out) > Saturated.MOST_HIDDEN * area
    # A flat top at the limit is clipped as a whole, though noise or JPEG leave some pixels below.
    ceiling = region.settings.response.ceiling(region.channel, region.clips, region.full_scale)
    top = spot.background + spot.amplitude
    flat = spot.edge_width < Refine.BROAD and top > ceiling - Small.AT_LIMIT * spot.noise
    return NoSpot(Reason.SATURATED) if hidden or (clipped.any() and flat) else spot


def _beside(light: np.ndarray, patch: Patch, spot: SmallSpot) -> np.ndarray:
    """Pixels beside a small spot that show something else, such as a ghost or a tool, (h, w).

    A beam's own foot is as bright all round. So pixels count that stand out from the median of
    their ring by more than noise and texture do.
    """
    radius = np.hypot(*patch.on_circle(spot.ellipse))
    per_px = 1 / spot.ellipse.axes[1]
    outside = (radius > 1 + Small.FOOT * max(spot.edge_width, per_px)) & np.isfinite(light)
    rest = np.zeros_like(light)
    ring = (radius / max(per_px, Small.RING / 2)).astype(int)
    for number in np.unique(ring[outside]):
        own = outside & (ring == number)
        rest[own] = light[own] - np.median(light[own])
    scatter = 1.4826 * float(np.median(np.abs(rest[outside]))) if outside.any() else 0.0
    far = np.abs(rest) > max(Small.STANDS_OUT * scatter, Small.FOREIGN * spot.amplitude)
    square = np.ones((3, 3), np.uint8)
    lasting = cv2.morphologyEx(far.astype(np.uint8), cv2.MORPH_OPEN, square)
    return cv2.dilate(lasting, square, iterations=2).view(bool) & outside


class MeasuredRegion(NamedTuple):
    """What was measured of a bright region with a contour.

    Attributes:
        contour: half-maximum contour in the frame as it is.
        fit: the same, in the middle of the exposure if the spot moved.
        rim: of a spot on the region's light, where that is a wet wall's reflection of a lamp.
        ellipse: of the fit, without the lens's distortion; None if the lens cannot have made it.
    """

    contour: EdgeFit
    fit: EdgeFit
    rim: EdgeFit | None
    ellipse: AffineEllipse | None


def measured_in(region: Region) -> MeasuredRegion | NoSpot:
    """Contour, motion, reflection and distortion; or why the region has no contour."""
    contour = contour_of(region)
    if isinstance(contour, NoSpot):
        return contour
    fit = contour
    if fit.levels.width > Motion.SMEARED and not is_coarse(fit):
        fit = at_mid_exposure(patch_round(region, fit.ellipse, fit.levels.width), fit)
    rim = rim_on(region, fit)
    edges = contour_points(fit.ellipse, fit.offsets)[fit.inliers]
    return MeasuredRegion(
        contour, fit, rim, undistorted(fit.ellipse, edges, region.settings.camera)
    )


def is_coarse(fit: EdgeFit, coarsest: float = Verdict.COARSEST) -> bool:
    """Whether the edges scatter about the ellipse by more than texture and motion explain.

    Either moves an edge by less than the edge is wide.
    """
    width = math.hypot(fit.levels.width, 1 / fit.ellipse.axes[1])  # drawn edges: a whole pixel
    return fit.scatter > coarsest * width


def undistorted(
    ellipse: AffineEllipse, edges: np.ndarray, camera: LensDistortion | None
) -> AffineEllipse | None:
    """An ellipse without the lens's distortion, from points (n, 2) of its edge.

    None if the lens cannot have made it.
    """
    if camera is None:
        return ellipse
    if not (edges.size and camera.can_undistort(edges)):
        return None
    straight = refitted(ellipse, camera.undistorted(edges))
    # Its edge may be undistorted where its inside cannot be.
    moved = math.dist(camera.distorted(*straight.centre), ellipse.centre)
    return straight if moved <= ellipse.axes[0] else None


def significance_of(region: Region) -> float:
    """Light of a faint region over the scatter round it; 0 if something hides a part of it."""
    around = background_of(region.coarse, region.ellipse, Refine.BROAD)
    if around is None or region.fills_its_ellipse() < Verdict.FILLED:
        return 0.0
    background, _, scatter = around
    return (region.bright.peak - background) / scatter
