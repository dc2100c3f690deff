"""A band of profiles along a contour, and the refinement of the contour by it.

The band gives the mean profile, and each ray's shift against it. Where the edge is sharp, the
wall's reflectance is removed from each ray as a gain and a gradient, so that the ray's edge is
where its own light is half. On a broad flank, a bell or a plateau that falls off slowly, this would
also remove the slope of the light across the spot, which moves the half level by more than texture
does. So there all rays share one level, and texture averages out round the contour.
"""

import math
from dataclasses import dataclass, replace
from functools import cache, cached_property

import cv2
import numpy as np

from eyespot.estimator.detector.coarse import Coarse
from eyespot.estimator.detector.ellipse_rays import (
    DESIGN,
    AffineEllipse,
    Patch,
    red_share,
    ring_variances,
    robust_step,
)
from eyespot.estimator.detector.levels import (
    Levels,
    background_of,
    garrote,
    left_doubt,
    sloping_top,
    top_counts,
)
from eyespot.estimator.detector.saturated_flank import hidden_bell, hidden_edge
from eyespot.estimator.detector.tuning import FEWEST_RAYS, RAYS, Broad, Refine, Saturated, Sharp
from eyespot.formats.spot import EVEN_LIGHT, NoSpot, OwnHalf, Reason

_CUBIC = np.arange(4)
_WAVES = DESIGN.astype(np.float32)
_SOLVABLE = np.float32(1e-3) * np.eye(5, dtype=np.float32)  # an arc too short for an ellipse


@dataclass(frozen=True, eq=False)
class Refined:
    """An ellipse after a refinement.

    Attributes:
        move: how far the contour moved at most, radii.
        size_variance: of the contour's common offset, in addition to the scatter of the offsets.
        centre_variance: of either coordinate of the centre, radii^2, also in addition.
        offsets: (RAYS,) radial distance of each ray's edge from the ellipse, radii.
        found: (RAYS,) rays with an edge.
        inliers: (RAYS,) rays whose edge belongs to the ellipse.
        shaded: (RAYS,) rays in a shadow in which they still show an edge.
    """

    ellipse: AffineEllipse
    move: float
    size_variance: float
    centre_variance: float
    levels: Levels
    offsets: np.ndarray
    found: np.ndarray
    inliers: np.ndarray
    shaded: np.ndarray
    own_half: OwnHalf
    band: "Band"

    @property
    def bright(self) -> np.ndarray:
        """Inliers outside the shadow, of which a mean profile may be made, (RAYS,)."""
        return self.inliers & ~self.shaded


@dataclass(frozen=True, eq=False)
class Band:
    """Profiles on either side of an ellipse.

    Attributes:
        from_edge: (n,) radius offsets of the samples, units of the radius.
        profiles: (RAYS, n) signal; 0 on rays that leave the frame.
        whole: (RAYS,) rays that stay in the frame.
        inside: (RAYS,) rays whose contour point lies in the frame.
        inliers: (RAYS,) rays of which the mean profile is made.
        mean, slope: (n,) mean profile, and its derivative.
    """

    ellipse: AffineEllipse
    from_edge: np.ndarray
    profiles: np.ndarray
    whole: np.ndarray
    inside: np.ndarray
    inliers: np.ndarray
    mean: np.ndarray
    slope: np.ndarray

    @classmethod
    def along(
        cls, patch: Patch, ellipse: AffineEllipse, inliers: np.ndarray, reach: float
    ) -> "Band | None":
        """The band that reaches so far (radii, below 1) on either side; None for too few rays."""
        # Samples 0.7 px apart, less than the pixel grid resolves; enough of them for a cubic.
        side = int(reach * ellipse.axes[1] / 0.7)
        side = min(max(side, 5), 16)
        from_edge = np.arange(-side, side + 1) * (reach / side)
        profiles = patch.unwrapped(ellipse, 1 + from_edge)
        inside = ~np.isnan(profiles[:, side])
        whole = ~np.isnan(profiles[:, 0] + profiles[:, -1])
        if not whole.all():
            profiles = np.nan_to_num(profiles, nan=0.0)
            inliers = inliers & whole
        number = np.count_nonzero(inliers)
        if number < FEWEST_RAYS:
            return None
        mean = inliers.astype(np.float32) @ profiles / np.float32(number)
        slope = _differences(len(mean)) @ mean / np.float32(reach / side)
        return cls(ellipse, from_edge, profiles, whole, inside, inliers, mean, slope)

    @cached_property
    def gain(self) -> np.ndarray:
        """Brightness of each ray over the mean profile's, (RAYS,)."""
        return self.profiles @ self.mean / (self.mean @ self.mean)

    @property
    def lit(self) -> np.ndarray:
        """Rays that are neither hidden nor show a glint, (RAYS,)."""
        plain = (self.gain > Refine.DARKEST_GAIN) & (self.gain < 1 / Refine.DARKEST_GAIN)
        return self.whole & plain

    def in_shade(self, stretch: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Light, outward shift and misfit of each ray's profile if it is shaded, (RAYS,).

        A shadow dims the spot's light and not the rest, so that a profile is a share of the mean,
        a constant, and the changes by shift and by `stretch`, (n,), a wider edge. It is so dim that
        noise counts, and is therefore averaged with its neighbours.
        """
        beside = Refine.SHADED_NEIGHBOURS
        around = np.concatenate([self.profiles[-beside:], self.profiles, self.profiles[:beside]])
        smooth = cv2.blur(around, (1, 2 * beside + 1))[beside:-beside]
        basis = np.stack([self.mean, -self.slope, stretch, np.ones_like(self.mean)], axis=1)
        _, parts = cv2.solve(basis.T @ basis, basis.T @ smooth.T)
        light = np.maximum(parts[0], 1e-6)
        left = smooth.T - basis @ parts
        misfit = np.sqrt(np.square(left).mean(axis=0)) / light
        return parts[0], parts[1] / light, misfit

    def steeper(self, rays: np.ndarray) -> float:
        """How much steeper some rays, (RAYS,), are than their mean: 1 if they show the same edge.

        The integral of the squared slope of an edge of one height is inversely proportional to the
        edge's width. Noise and texture add to it, as they do on the plateaus beside the edge. Where
        an ellipse runs across an outline of another shape, the mean of the rays is smeared.
        """
        profiles = self.profiles[rays]
        steps = np.diff(profiles, axis=1)
        across = np.diff(profiles.sum(axis=0) / np.float32(len(profiles)))
        beside = steps.shape[1] // 5  # at either end: the band reaches beyond the edge
        steps *= steps
        rest = steps[:, :beside].sum(axis=1) + steps[:, -beside:].sum(axis=1)
        squares = _row_sums(steps) - float(np.median(rest)) * (steps.shape[1] / (2 * beside))
        return float(np.median(squares)) / max(float(across @ across), 1e-30)

    @property
    def middle(self) -> float:
        """Offset of the edge's middle: the mean of where the profile falls."""
        fall = float(self.slope.sum())
        return float(self.from_edge @ self.slope) / fall if fall < 0 else 0.0

    @property
    def _unevenness(self) -> np.ndarray:
        """Brightness of the inliers over the mean, minus one; 0 of the other rays."""
        return self.inliers * (self.gain - 1)

    @property
    def texture(self) -> float:
        """Part of the variance of the rays' brightness that is the wall's texture, not noise."""
        waves = Refine.LONG_WAVES, Refine.SHORT_WAVES
        long, short = ring_variances(self._unevenness, *waves)
        return max(0.0, 1 - Refine.NOISE_AT_MOST * short / max(long, 1e-30))

    def shifts(
        self, disturbances: list[np.ndarray], *, past_texture: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Outward shift of each ray's profile against the mean, and the variance left, (RAYS,).

        The last array, (n,), are the weights of a profile's samples in its shift.

        A ray differs from the mean by -slope * shift, by disturbances of any strength, by texture
        and by noise. The shift is a weighted sum of the samples that disturbances leave alone: that
        of least squares or, past texture, the one that varies least from ray to ray, which is the
        beamformer of Capon (1969). There, what the wall's texture looks like in this frame decides
        on the weights. The covariance of the samples is drawn towards a diagonal one as far as so
        few rays leave it open (Ledoit and Wolf 2004).

        Args:
            past_texture: whether texture is to move the shifts as little as possible. A wall's
                slope across a ray is a disturbance then, too: few rays differ in it from their
                neighbours, but it moves a whole ellipse.
        """
        residual = self.profiles - self.mean
        basis = np.array([*disturbances, -self.slope], float).T
        gram = basis.T @ basis
        gram.flat[:: len(gram) + 1] += 1e-12 * gram.trace() + 1e-30
        triangle = np.linalg.cholesky(gram)
        orthonormal = (basis @ cv2.invert(triangle)[1].T).astype(np.float32)
        parts = residual @ orthonormal
        left = residual - parts[:, :-1] @ orthonormal[:, :-1].T
        rough = np.maximum(_row_sums(left * left) - parts[:, -1] ** 2, 0)
        rough /= max(residual.shape[1] - len(gram), 1)
        towards = weights = orthonormal[:, -1]
        if past_texture:
            # A wall's texture has no direction, so its long waves slope across a contour as much as
            # they do along it, where the rays' brightness shows them.
            first, second = ring_variances(self._unevenness, slice(1, 2), slice(2, 3))
            slopes = math.sqrt((first + 4 * second) / 2) * self.from_edge * self.mean
            slopes = slopes - orthonormal[:, :-1] @ (orthonormal[:, :-1].T @ slopes)
            # A step of the ellipse goes along with slopes of the light. If it counted as scatter,
            # the weights would cancel it by them.
            rays, waves = left[self.inliers], _WAVES[self.inliers]
            _, fitted = cv2.solve(waves.T @ waves + _SOLVABLE, waves.T @ rays)
            weights = _least_varying(rays - waves @ fitted, towards, slopes)
        weights = weights / np.float32(triangle[-1, -1])
        weights = weights - orthonormal[:, :-1] @ (weights @ orthonormal[:, :-1])
        return residual @ weights, rough, weights

    def half_crossing(self, level: float, span: float) -> float | None:
        """Offset where the mean profile falls to a level, by a cubic over `span` on either side."""
        from_edge, heights = self.from_edge, self.mean.tolist()
        falls = [k for k in range(len(heights) - 1) if heights[k] >= level > heights[k + 1]]
        if not falls:
            return None
        k = min(falls, key=lambda k: abs(k - len(heights) // 2))
        spacing = float(from_edge[1] - from_edge[0])
        share = (heights[k] - level) / (heights[k] - heights[k + 1])
        middle = float(from_edge[k]) + spacing * share
        span = max(span, 2.6 * spacing)  # at least five samples
        first = max(math.ceil((middle - span) / spacing) + len(heights) // 2, 0)
        last = math.floor((middle + span) / spacing) + len(heights) // 2 + 1
        x = ((from_edge[first:last] - middle) / span)[:, None]
        if len(x) < 5:
            return None
        # The weight ends smoothly, so that a sample that enters or leaves moves nothing abruptly.
        weight = 1 - x * x
        rise = (self.mean[first:last, None] - level) * weight
        _, cubic = cv2.solve(x**_CUBIC * weight, rise, flags=cv2.DECOMP_QR)
        c0, c1, c2, c3 = cubic[:, 0].tolist()
        # Undo the blur by interpolation: subtract half its variance, 1/6 px^2 (the mean of t (1-t)
        # over a pixel), times the Laplacian.
        semi_major, semi_minor, _ = self.ellipse.axes
        half_blur = (1 / 6) / (2 * span**2 * semi_major * semi_minor)
        c0 -= half_blur * (2 * c2 + span * c1)
        c1 -= half_blur * (6 * c3 + span * 2 * c2)
        c2 -= half_blur * span * 3 * c3
        root = 0.0
        for _ in range(4):
            falling = c1 + root * (2 * c2 + 3 * root * c3)
            if not falling < 0:
                return None
            root -= (c0 + root * (c1 + root * (c2 + root * c3))) / falling
        edge = middle + root * span
        # Newton's steps may leave the band. Beyond the centre a radius would be negative, and with
        # it every length in units of it.
        return edge if abs(edge) <= float(from_edge[-1]) else None

    def refined(
        self,
        levels: Levels,
        offsets: np.ndarray,
        found: np.ndarray,
        fitted: tuple[np.ndarray, np.ndarray],
        *,
        half: float,
        half_variance: float,
        shaded: np.ndarray,
        own_half: OwnHalf = EVEN_LIGHT,
        centre_variance: float = 0.0,
    ) -> Refined:
        """The ellipse moved by a fitted step (see `robust_step`) and to the half level's offset.

        The whole contour moves with the half level, by sqrt(pi / 2) widths for a relative change
        of 1, so the variance of peak and background adds to the variance of the size.
        """
        step, inliers = fitted
        level_variance = math.pi / 2 * levels.width**2 * (levels.variance + levels.tail**2 / 4)
        growth = (1 + half) * (1 + float(step[2] + step[3]) / 2)
        return Refined(
            ellipse=self.ellipse.stepped(step, 1 + half),
            move=max(float(np.abs(step).max()), abs(half)),
            size_variance=half_variance + level_variance,
            centre_variance=centre_variance,
            levels=levels.in_units_of(growth),
            offsets=offsets - DESIGN @ step,
            found=found,
            inliers=inliers,
            shaded=shaded,
            own_half=own_half,
            band=self,
        )


def _least_varying(rays: np.ndarray, towards: np.ndarray, extra: np.ndarray) -> np.ndarray:
    """Weights whose sum over a ray varies least, of those with weights @ towards = 1, (n,).

    Rays also contain the profile `extra`, (n,), with a random factor of variance one.
    """
    # In units of the rays' own size: fourth powers of very bright or dim light are no numbers.
    size = float(np.abs(rays).max())
    if not size > 0:
        return towards
    rays, extra = rays / np.float32(size), extra / size
    covariance = (rays.T @ rays / np.float32(len(rays))).astype(float)
    typical = covariance.trace() / len(towards)
    square = float(np.vdot(covariance, covariance))
    squares = _row_sums(rays * rays)
    error = float(squares @ squares) / len(rays) ** 2 - square / len(rays)
    spread = square - len(towards) * typical**2
    kept = 1 - min(max(error, 0.0) / max(spread, 1e-30), 1.0)
    covariance *= kept
    covariance += np.outer(extra, extra)
    covariance.flat[:: len(towards) + 1] += (1 - kept + 1e-6) * typical + 1e-30
    along = towards.astype(float)
    solved, weights = cv2.solve(covariance, along[:, None], flags=cv2.DECOMP_CHOLESKY)
    weights = weights[:, 0] if solved else along
    return (weights / (weights @ towards)).astype(np.float32)


def _row_sums(values: np.ndarray) -> np.ndarray:
    """Three times as fast as `sum(axis=1)` at this size."""
    return values @ np.ones(values.shape[1], values.dtype)


@cache
def _differences(number: int) -> np.ndarray:
    """Compact differences of fourth order (Lele 1992), as a matrix for samples at unit spacing.

    A sharp edge is three samples wide. Central differences would make it 20 % less steep, and
    shifts and their errors 20 % larger.
    """
    implicit = np.eye(number) + (np.eye(number, k=1) + np.eye(number, k=-1)) / 4
    explicit = 0.75 * (np.eye(number, k=1) - np.eye(number, k=-1))
    for end, inner in ((0, 1), (-1, -2)):
        implicit[end] = explicit[end] = 0
        implicit[end, end] = 1
        explicit[end, [end, inner]] = (-1, 1) if end == 0 else (1, -1)
    return np.linalg.solve(implicit, explicit).astype(np.float32)


_SLOPES = np.column_stack([np.ones(RAYS), DESIGN[:, :2]])
_NEIGHBOURS = np.ones((1, 2 * Sharp.SPOILED_RAYS + 1), np.uint8)


def refine(
    patch: Patch, coarse: Coarse, ellipse: AffineEllipse, inliers: np.ndarray, levels: Levels
) -> Refined | NoSpot:
    """Refine a contour up to three times, until it and its levels hardly change."""
    for left in (2, 1, 0):
        once = _refine_broad if levels.width > Refine.BROAD else _refine_sharp
        found = once(patch, ellipse, inliers, levels)
        if isinstance(found, NoSpot) or _settled(found, inliers, levels):
            return found
        refined = found
        seen = refined.levels
        now: Levels | None = seen
        if left and not seen.sees_background:  # the edge is wider than was assumed for it
            around = background_of(coarse, refined.ellipse, seen.width)
            now = seen.before(*(around or (seen.background, seen.background_radius, seen.scatter)))
        if now is None:  # the dip at the edge is the wall's texture
            return NoSpot(Reason.NONE_FOUND)
        ellipse, inliers, levels = refined.ellipse, refined.bright, now
    unsettled = refined.size_variance + refined.move**2 / 2  # fringes make it swing
    return replace(refined, size_variance=unsettled)


def _settled(refined: Refined, inliers: np.ndarray, before: Levels) -> bool:
    """Whether another refinement would hardly change the result."""
    after = refined.levels
    same_kind = (after.width > Refine.BROAD) == (before.width > Refine.BROAD)
    same_kind &= after.width > Refine.SAME_WIDTH * before.width
    same_rays = np.count_nonzero(refined.bright != inliers) <= 6
    settled = refined.move < min(Refine.SETTLED * after.width, Refine.SETTLED_BROAD)
    return settled and bool(same_rays) and same_kind and after.sees_background


def _refine_sharp(
    patch: Patch, ellipse: AffineEllipse, inliers: np.ndarray, levels: Levels
) -> Refined | NoSpot:
    """Ellipse of the half-maximum contour, from one that is off by less than the edge's width.

    The inliers' rays make the mean profile.
    """
    reach = max(Sharp.REACH * levels.width, Sharp.REACH_PX / ellipse.axes[1])
    if reach >= 1:  # the pixel grid hides the whole ellipse
        return NoSpot(Reason.TOO_SMALL)
    band = Band.along(patch, ellipse, inliers, reach)
    if band is None:
        return NoSpot(Reason.NONE_FOUND)
    full = band.profiles[band.inliers, 0] > Saturated.READABLE * patch.ceiling
    saturated = bool(2 * np.count_nonzero(full) > full.size)
    # Stretched about the edge itself: otherwise a ray with a narrower edge would seem shifted.
    middle = 0.0 if saturated else band.middle
    stretch = (band.from_edge - middle) * band.slope
    shifts, rough, weights = band.shifts([stretch, band.mean], past_texture=True)
    gain = band.gain
    # A shift changes a brighter ray by more.
    offsets = shifts / np.maximum(gain, Refine.DARKEST_GAIN)
    found = band.lit & (np.abs(offsets) < reach)
    plain = rough[found]
    if not plain.size:
        return NoSpot(Reason.NONE_FOUND)
    typical = float(np.partition(plain, plain.size // 2)[plain.size // 2])
    smooth = rough < Sharp.ROUGH * max(typical, 1e-5 * levels.amplitude**2)
    shaded = np.zeros(RAYS, bool)
    if not saturated and bool((band.whole & (gain <= Refine.DARKEST_GAIN)).any()):
        light, shaded_shifts, misfit = band.in_shade(stretch)
        shaded = _eroded(
            band.whole
            & (gain <= Refine.DARKEST_GAIN)
            & (light > Sharp.DEEPEST_SHADE)
            & (misfit < Sharp.SHADED_MISFIT * levels.amplitude)
            & (np.abs(shaded_shifts) < reach)
        )
        offsets = np.where(shaded, shaded_shifts, offsets)
    fitted = robust_step(
        DESIGN,
        offsets,
        _eroded(found & smooth) | shaded,
        band.inliers,
        tolerance=Sharp.FORGIVEN * levels.width,
        limit=Refine.FURTHEST,
    )
    if fitted is None or np.abs(fitted[0]).max() > Refine.LARGEST_STEP:
        return NoSpot(Reason.NONE_FOUND)
    if saturated:
        hidden = hidden_edge(patch, ellipse, fitted[1], levels, reach)
        if hidden is None:
            return NoSpot(Reason.SATURATED)
        levels, half, half_variance = hidden
        return band.refined(
            levels, offsets, found, fitted, half=half, half_variance=half_variance, shaded=shaded
        )
    slope, variance, sure = _slope(band, found)
    square = float(slope @ slope)
    hidden_square = min(variance, square)
    # A slope moves a sharp edge so little that a wrong estimate of it would do more harm.
    counts = top_counts(levels.width)
    kept = counts * sure
    doubt = kept * variance + kept * (1 - kept) * square
    levels = levels.sharpened(band.from_edge, band.mean, band.slope, kept * slope, doubt)
    inside = max(1 - Sharp.BRIGHTEST_INSIDE * levels.width, 0.0)
    levels = replace(levels, hidden=levels.hidden + inside**2 * (counts - kept) * hidden_square)
    crossing = band.half_crossing(levels.half, Sharp.MIDDLE * levels.width)
    if crossing is None or not levels.width > 0:
        return NoSpot(Reason.NONE_FOUND)
    # A ray's shift is where its own light is half. Half of the common peak lies further out on the
    # brighter rays.
    step, rays = fitted
    per_slope = math.sqrt(math.pi / 2) * levels.width
    aside = per_slope * kept * slope
    step[:2] += aside
    offsets = offsets + DESIGN[:, :2] @ aside
    # The wall's reflectance brightens background and spot, a slope of the light the spot alone, and
    # the more the farther out: that shifts a profile, too.
    by_slope = (1 + band.from_edge) * (band.mean - levels.background)
    misled = float(by_slope @ weights) * float(band.mean @ band.mean) / float(by_slope @ band.mean)
    right, down = (-ellipse.shape @ (aside + misled * sure * slope)).tolist()
    semi_major, semi_minor, _ = ellipse.axes
    # The half of each side's own light contains neither the slope that counts for the half of the
    # peak nor that slope's variance.
    centre_variance = per_slope**2 * doubt / 2
    unsure = left_doubt(square, sure, Sharp.HIDDEN_SLOPE * variance)
    own_variance = misled**2 * unsure / 2 * semi_major * semi_minor
    return band.refined(
        levels,
        offsets,
        found | shaded,
        (step, rays),
        half=crossing,
        half_variance=(Sharp.SIZE_PX / semi_minor) ** 2,
        centre_variance=centre_variance,
        shaded=shaded,
        own_half=OwnHalf(
            right,
            down,
            growth=1 + inside * float(np.linalg.norm(aside)),
            more_variance_px2=own_variance - centre_variance * semi_minor**2,
            less_growth_variance=2 * centre_variance,
        ),
    )


def _eroded(mask: np.ndarray) -> np.ndarray:
    """Rays whose neighbours are all in the mask: the rim of a shaft disturbs the rays beside it."""
    beside = Sharp.SPOILED_RAYS
    wide = np.concatenate([mask[-beside:], mask, mask[:beside]]).view(np.uint8)
    return cv2.erode(wide[None], _NEIGHBOURS)[0, beside:-beside].view(bool)


def _slope(band: Band, found: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Slope of the light across the plateau, over its mean per radius, (2,), and its variance.

    The last number is the part of it that texture does not explain.

    A beam that meets the wall obliquely is brighter on the near side. Texture is uneven, too, so
    the slope counts only as far as it exceeds what shorter waves explain.
    """
    waves = np.where(found[:, None], _SLOPES, 0.0)
    _, fitted = cv2.solve(waves.T @ waves, waves.T @ band.gain[:, None].astype(float))
    slope = fitted[1:, 0] / fitted[0, 0]
    square = float(slope @ slope)
    rest = np.where(found, band.gain, 0.0) - waves @ fitted[:, 0]
    (scatter,) = ring_variances(rest, slice(2, 7))
    variance = Sharp.SLOPE_DOUBT * 2 * scatter / RAYS
    return slope, variance, float(garrote(square, variance))


def _refine_broad(
    patch: Patch, ellipse: AffineEllipse, inliers: np.ndarray, levels: Levels
) -> Refined | NoSpot:
    """As `_refine_sharp`, from an ellipse that is off by less than the flank's width."""
    top = sloping_top(levels, patch, ellipse, inliers)
    levels = top.levels
    half, half_variance = None, 0.0
    if levels.peak > Saturated.READABLE * patch.ceiling:
        hidden = hidden_bell(patch, ellipse, inliers, levels)
        if hidden is None:
            return NoSpot(Reason.SATURATED)
        levels, half, half_variance = hidden
    reach = min(Broad.FLANK * levels.width, Broad.WIDEST)
    band = Band.along(patch, ellipse, inliers, reach)
    if band is None:
        return NoSpot(Reason.NONE_FOUND)
    offsets, _, weights = band.shifts([band.from_edge * band.slope], past_texture=False)
    gain = band.gain
    found = band.lit & (np.abs(offsets) < reach)
    fitted = robust_step(
        DESIGN,
        offsets,
        found,
        band.inliers,
        tolerance=Broad.FORGIVEN * levels.width,
        limit=max(levels.width, Refine.FURTHEST),
    )
    if half is None:
        half = band.half_crossing(levels.half, reach)
    if fitted is None or half is None or np.abs(fitted[0]).max() > Refine.LARGEST_STEP:
        return NoSpot(Reason.NONE_FOUND)
    levels = replace(levels, width=levels.width_of(band.slope), hidden=0.0)
    if half_variance == 0:
        # The wall under the top differs from the wall under the contour by texture of the longest
        # waves, which the contour shows only as far as they are not the light's own slope.
        light = np.where(found, gain - 1, 0.0)
        uneven, share, (growth,) = red_share(light, Broad.TOP_WAVES, 1.0)
        # A beam that is no ellipse bends its contour more than texture does, and is as uneven.
        errors = np.where(fitted[1], offsets - DESIGN @ fitted[0], 0.0)
        share = min(share, red_share(errors, Refine.LONG_WAVES_BROAD)[1])
        texture = share * (Broad.TOP_OVER_CONTOUR * growth) * uneven / RAYS
        variance = levels.variance + texture + Broad.PEAK_ERROR**2
        levels = replace(levels, variance=variance)
    # Where the light slopes, brighter rays cross the common level farther out, and the level is
    # half of a higher peak.
    per_slope = float(((1 + band.from_edge) * (band.mean - levels.background)) @ weights)
    right, down = (-per_slope * ellipse.shape @ top.slope).tolist()
    unsure = top.unsure + float(top.slope @ top.slope) * Broad.OWN_HALF_ERROR**2
    semi_major, semi_minor, _ = ellipse.axes
    return band.refined(
        levels,
        offsets,
        found,
        fitted,
        half=half,
        half_variance=half_variance,
        shaded=np.zeros(RAYS, bool),  # a shadow's rim looks like a broad flank
        own_half=OwnHalf(
            right,
            down,
            growth=1 + math.sqrt(math.pi / 2) * levels.width * top.raised,
            more_variance_px2=per_slope**2 * unsure / 2 * semi_major * semi_minor,
        ),
    )
