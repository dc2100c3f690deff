"""A small spot's half-maximum ellipse, fitted to its pixels.

A spot of a few pixels has no profiles along rays: the pixel grid hides them. On a wall that is even
across it, it is a smooth image with ten parameters: an ellipse, the steepness of its edge, the
height of its light, and a plane under it. They are fitted by least squares (Levenberg 1944).

One family of profiles covers sharp discs, blurred discs and bells: a disc that a Gaussian blurs.
Without blur it is a disc, and of a disc much smaller than the blur a Gaussian is left. Beams that
fall more steeply at their centre have exp(-t^p) with p below 2. The slope at the half maximum
orders them all, so that one number selects the profile. Pixels integrate the light over their area.

What a real beam has beyond that family, such as a halo, rings or a dark middle, repeats all round:
it is seen in the mean of the residuals on rings, and moves the half level (`_own_profile`).

The wall's texture multiplies the light. What the residuals contain beyond the camera's noise and
the rings is taken for texture of long waves, a random field with an exponential covariance, and its
share of the parameters' covariance is added (the sandwich of White 1980).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.special import i1e

from eyespot.estimator.detector.ellipse_rays import AffineEllipse
from eyespot.estimator.detector.levels import garrote, left_doubt, outermost_radius
from eyespot.estimator.detector.tuning import Broad, Small
from eyespot.estimator.information import Information
from eyespot.formats.spot import OwnHalf


@dataclass(frozen=True, eq=False)
class SmallSpot:
    """A spot as its pixels show it; levels in units of the light.

    Attributes:
        ellipse: of the half maximum.
        step_covariance: (5, 5), of the parameters of `AffineEllipse.stepped`.
        steepness: fall of the light at the half maximum, peaks per radius.
        amplitude: peak above background.
        background: under the spot's centre.
        noise: standard deviation of a pixel.
        texture: standard deviation of what multiplies the light and is no spot's.
        own_half: see `Spot.own_half`.
    """

    ellipse: AffineEllipse
    step_covariance: np.ndarray
    steepness: float
    amplitude: float
    background: float
    noise: float
    texture: float
    own_half: OwnHalf

    @property
    def edge_width(self) -> float:
        """Edge width in units of the radius (see `Spot.edge_width_px`)."""
        return 1 / (math.sqrt(2 * math.pi) * self.steepness)


class _Model(NamedTuple):
    """Parameters of a fit; the plane's origin is the centre of the patch, lengths in px."""

    ellipse: AffineEllipse
    steepness: float

    def stepped(self, step: np.ndarray) -> "_Model":
        grown = self.steepness * math.exp(min(max(float(step[5]), -0.5), 0.5))
        low, high = math.exp(_LOG_STEEPNESS[0]), math.exp(_LOG_STEEPNESS[-1])
        ellipse = self.ellipse.stepped(np.clip(step[:5], -0.3, 0.3)).upright()
        return _Model(ellipse, min(max(grown, low), high))

    def linearised(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The light of peak 1 on pixels, and its derivatives by `stepped`, (7, n)."""
        away = np.linalg.solve(self.ellipse.shape, np.stack([u, v]) - self.ellipse.centre[:, None])
        edge = np.abs(np.hypot(*away) - 1) * self.ellipse.axes[1] < Small.SHARP_EDGE_PX
        rows = np.empty((7, u.size))
        for part, points in ((edge, _FINE_QUADRATURE), (~edge, _QUADRATURE)):
            rows[:, part] = self._integrated(u[part], v[part], points)
        return rows

    def _integrated(self, u: np.ndarray, v: np.ndarray, points: np.ndarray) -> np.ndarray:
        """The rows of `linearised` by a quadrature of so many points within a pixel."""
        (a, b), (c, d) = np.linalg.inv(self.ellipse.shape).tolist()
        x, y = u[None] + points[:, :1], v[None] + points[:, 1:]
        x, y = x - self.ellipse.centre[0], y - self.ellipse.centre[1]
        cos, sin = a * x + b * y, c * x + d * y
        t = np.hypot(cos, sin) + 1e-9
        cos, sin = cos / t, sin / t
        # A camera's blur has one width all round: an edge is steeper, per radius, on the longer
        # ones. A bell's flank is as wide as its radius.
        radius = math.sqrt(abs(np.linalg.det(self.ellipse.shape)))
        per_px = np.hypot(cos * a + sin * c, cos * b + sin * d)
        table = _profiles()
        power = float(np.interp(math.log(self.steepness), _LOG_STEEPNESS, table.powers))
        scale = self.steepness * (per_px * radius) ** -power
        z = (t - 1) * scale
        light, slope, by_steepness = _profile(table.profiles, self.steepness, z)
        by_radius = -slope * scale
        rows = [light]
        rows += [by_radius * cos, by_radius * sin]
        rows += [by_radius * t * cos * cos, by_radius * t * sin * sin]
        rows += [by_radius * t * 2 * cos * sin, by_steepness + slope * z]
        return np.stack([row.mean(axis=0) for row in rows])


def fit_to_pixels(
    light: np.ndarray, x0: float, y0: float, start: AffineEllipse
) -> SmallSpot | None:
    """Fit a spot to the light of a patch.

    The loop is its own, since a step moves the ellipse by an affine map and levels are fitted anew.

    Args:
        light: (h, w), linear in the irradiance; NaN where there is nothing to be fitted.
        x0, y0: column and row of the frame of its first pixel.
        start: an ellipse that is off by less than half of its radius.

    Returns:
        None if the fit does not converge, or the pixels do not determine it.
    """
    height, width = light.shape
    seen = np.isfinite(light)
    rows_seen, columns_seen = np.nonzero(seen)
    values = light[seen].astype(float)
    if len(values) < 2 * Small.PARAMETERS:
        return None
    u, v = columns_seen + float(x0), rows_seen + float(y0)
    side = max(height, width) / 2
    plane = np.stack([np.ones(len(u)), (u - u.mean()) / side, (v - v.mean()) / side])
    model, damping, settled = _Model(start.upright(), 1.0), 1e-3, False
    rows, levels, left = _levelled(model, u, v, plane, values)
    for _ in range(60):
        columns = np.concatenate([levels[0] * rows[1:], rows[:1], plane])
        step = Information(columns @ columns.T).solved(columns @ left, damping)
        trial = model.stepped(step)
        axes = trial.ellipse.axes
        if not (axes[1] > 0.5 and axes[0] < 2 * side):
            return None
        # An edge that only pixels blur has the steepest profile there is, however far a step goes.
        steps = np.append(step[:5], math.log(trial.steepness / model.steepness))
        trial_rows, trial_levels, trial_left = _levelled(trial, u, v, plane, values)
        if trial_left @ trial_left <= left @ left:
            settled = bool(np.abs(steps).max() < 1e-3)
            model, rows, levels, left = trial, trial_rows, trial_levels, trial_left
            damping = max(damping / 8, 1e-9)
        else:
            settled = bool(np.abs(steps).max() < 1e-6)
            damping *= 8
        if settled:
            break
    if not (settled and levels[0] > 0):
        return None
    columns = np.concatenate([levels[0] * rows[1:], rows[:1], plane])
    errors = _errors(model, np.stack([u, v]), float(levels[0]), columns, left, values - left)
    if errors is None or not errors.half_radius > 0:  # a ring may be dark from its middle on
        return None
    # Both axes grow alike with the half level.
    covariance = errors.covariance[:5, :5]
    covariance[2:4, 2:4] += errors.size_variance
    return SmallSpot(
        ellipse=model.ellipse.scaled(errors.half_radius),
        step_covariance=covariance,
        steepness=model.steepness,
        amplitude=errors.peak,
        background=float(levels[1:] @ _plane_at(model.ellipse.centre, u, v, side)),
        noise=errors.noise,
        texture=errors.texture,
        own_half=errors.own_half,
    )


def _plane_at(centre: np.ndarray, u: np.ndarray, v: np.ndarray, side: float) -> np.ndarray:
    return np.array([1.0, (centre[0] - u.mean()) / side, (centre[1] - v.mean()) / side])


def _levelled(
    model: _Model, u: np.ndarray, v: np.ndarray, plane: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The model's rows, the best height and plane, and what is left of the values."""
    rows = model.linearised(u, v)
    columns = np.concatenate([rows[:1], plane])
    levels = np.linalg.lstsq(columns @ columns.T, columns @ values, rcond=None)[0]
    return rows, levels, values - levels @ columns


class _Errors(NamedTuple):
    """What the residuals of a fit show, and the profile with what the family lacks.

    Attributes:
        covariance: of the fit's parameters.
        noise, texture: see `SmallSpot`.
        half_radius: of the spot's own profile, over that of the fit.
        size_variance: of that ratio.
        peak: of the spot's own profile above background.
        own_half: see `Spot.own_half`.
    """

    covariance: np.ndarray
    noise: float
    texture: float
    half_radius: float
    size_variance: float
    peak: float
    own_half: OwnHalf


def _errors(
    model: _Model,
    at: np.ndarray,
    amplitude: float,
    columns: np.ndarray,
    left: np.ndarray,
    fitted: np.ndarray,
) -> _Errors | None:
    """Covariance of the parameters, noise, texture, and the spot's own profile.

    Variances of noise and texture are estimated from cells of pixels by restricted maximum
    likelihood (Patterson and Thompson 1971): what the fit has taken of either is accounted for.
    Their mean over the likelihood is taken, because a few dozen cells leave their ratio open.

    The spot's own profile differs from the family's by a broken line in the radius. Each of its
    components counts only as far as it exceeds noise and texture.

    Args:
        at: columns and rows of the frame, (2, n).
    """
    size = np.sqrt((columns * columns).sum(axis=1))
    if not size.min() > 0:
        return None
    scaled = columns / size[:, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    if not values[0] > 1e-9:
        return None
    inverse = (vectors / values) @ vectors.T
    side = max(int(np.ptp(at, axis=1).max() + 1) / Small.CELLS, 1.0)
    across, down = ((at - at.min(axis=1, keepdims=True)) / side).astype(int)
    _, cell = np.unique(down * (across.max() + 1) + across, return_inverse=True)
    number = np.bincount(cell)
    unit = np.linalg.solve(model.ellipse.shape, at - model.ellipse.centre[:, None])
    rings = _rings(np.hypot(*unit))
    means = [np.bincount(cell, row) for row in (*scaled, *rings, left, fitted, *at)] / number
    rows, rings, (rest, lit, x, y) = np.split(means, [len(scaled), len(scaled) + len(rings)])
    root = np.sqrt(number)
    distance = np.sqrt(np.square(x[:, None] - x) + np.square(y[:, None] - y) + side * side / 6)
    field = np.mean([np.exp(-distance / length) for length in Small.TEXTURE_LENGTHS], axis=0)
    field *= np.outer(lit, lit)
    # What rings show beyond the fit.
    design, rings = (rows * root).T, (rings * root).T
    taken = np.linalg.lstsq(design, rings, rcond=None)[0]
    own, strength, mix = np.linalg.svd(rings - design @ taken, full_matrices=False)
    shown = int(np.count_nonzero(strength > Small.SHOWN * strength[0]))
    own, correlated = own[:, :shown], field * np.outer(root, root)
    # In its dim tails a beam's shape differs by more of the light than texture does anywhere.
    share = rows[6] * size[6]
    dark = np.flatnonzero(share < Small.DARK)
    seen = np.append(
        np.flatnonzero(share > Small.BRIGHT), dark[:: len(dark) // Small.PARAMETERS**2 + 1]
    )
    fixed = np.hstack([design, rings])[seen]
    if len(fixed) < fixed.shape[1] + Small.PARAMETERS:
        return None
    free = np.linalg.qr(fixed, mode="complete")[0][:, fixed.shape[1] :]
    ratios, axes = np.linalg.eigh(free.T @ correlated[np.ix_(seen, seen)] @ free)
    squares = np.square(axes.T @ (free.T @ (rest * root)[seen]))
    shares = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 49) / max(ratios[-1], 1e-30)])
    spread = 1 + np.maximum(ratios, 0) * shares[:, None]
    noises = (squares / spread).mean(axis=1)
    likelihood = -0.5 * (
        np.log(spread).sum(axis=1) + len(ratios) * np.log(np.maximum(noises, 1e-30))
    )
    weight = np.exp(likelihood - likelihood.max())
    weight /= weight.sum()
    noise, texture = float(weight @ noises), float(weight @ (noises * shares))
    weighted = rows * number
    meat = weighted @ field @ weighted.T
    covariance = noise * inverse + texture * inverse @ meat @ inverse

    found = own.T @ (rest * root)
    variances = noise + texture * (own * (correlated @ own)).sum(axis=0)
    kept = garrote(found**2, Broad.TOP_DOUBT * variances)
    # The mean profile over rays, and what a unit of each component changes in it.
    u, v = model.ellipse.centre[:, None] + model.ellipse.shape @ _ON_RAYS
    light, *slopes = model.linearised(u, v).reshape(7, -1, len(_RADII)).mean(axis=1)
    of_fit = np.stack([*(amplitude * slope for slope in slopes), light]) / size[:7, None]
    change = (mix[:shown] / strength[:shown, None]) @ (_rings(_RADII) - taken[:7].T @ of_fit)
    family, _, _ = _profile(_profiles().profiles, model.steepness, (_RADII - 1) * model.steepness)
    profile = amplitude * family + (kept * found) @ change

    def half_radius(light: np.ndarray) -> float:
        return outermost_radius(light, light.max() / 2, _RADII)

    radius = half_radius(profile)
    moved = [
        half_radius(profile + error * row)
        for error, row in zip(np.sqrt(variances), change, strict=True)
    ]
    moves = np.square(np.array(moved) - radius)
    doubt = kept + kept * (1 - kept) * found**2 / variances

    def variance_of(own: np.ndarray) -> np.ndarray:
        sums = np.array([np.bincount(cell, row) for row in own])
        return noise + texture * ((sums @ field) * sums).sum(axis=1)

    sloping = amplitude * columns[6] * unit
    taken = sloping @ scaled.T @ inverse
    own_half = _own_half(
        model.ellipse, sloping - taken @ scaled, taken[:, :4] / size[:4], left, variance_of
    )
    return _Errors(
        covariance / np.outer(size, size),
        math.sqrt(noise),
        math.sqrt(texture),
        radius,
        float(doubt @ moves),
        float(profile.max()),
        own_half,
    )


def _own_half(
    ellipse: AffineEllipse,
    sloping: np.ndarray,
    taken: np.ndarray,
    left: np.ndarray,
    variance_of: Callable[[np.ndarray], np.ndarray],
) -> OwnHalf:
    """How the ellipse changes if the light may slope, as far as noise and texture do not slope so.

    Args:
        sloping: (2, n), what the fit leaves of slopes of the light by 1 per radius.
        taken: (2, 4), what it takes of them for another centre and other axes.
        left: (n,), what the fit leaves of the light.
        variance_of: of the components of what is left along directions, (2, n), each of length 1.
    """
    mix, strength, own = np.linalg.svd(sloping, full_matrices=False)
    found, variances = own @ left, variance_of(own)
    kept = garrote(found**2, Broad.TOP_DOUBT * variances)
    unsure = left_doubt(found**2, kept, variances)
    # A Gaussian's slope is a shift, of which nothing is left.
    by_slope = -(mix / np.maximum(strength, np.finfo(float).eps)).T @ taken
    moved_by = (kept * found) @ by_slope
    right, down = (ellipse.shape @ moved_by[:2]).tolist()
    variance = float(unsure @ np.square(by_slope[:, :2]).mean(axis=1))
    return OwnHalf(
        right,
        down,
        growth=1 + float(moved_by[2:].mean()),
        more_variance_px2=variance * float(abs(np.linalg.det(ellipse.shape))),
    )


def _rings(radii: np.ndarray) -> np.ndarray:
    """Triangles of height 1 about even radii, of which a broken line is a sum, (n, ...)."""
    return np.maximum(1 - np.abs(radii / Small.RING - np.arange(_NUMBER)[:, None]), 0)


_NUMBER = round(Small.REACH / Small.RING)
_RADII = np.linspace(0.0, Small.REACH, 20 * _NUMBER + 1)
_CIRCLE_16 = np.exp(2j * np.pi * np.arange(16) / 16)
_ON_RAYS = np.stack(
    [part[:, None] * _RADII for part in (_CIRCLE_16.real, _CIRCLE_16.imag)]
).reshape(2, -1)

_HALF = 0.5 / math.sqrt(3)
_QUADRATURE = np.array([(x, y) for x in (-_HALF, _HALF) for y in (-_HALF, _HALF)])
"""Gauss-Legendre points of a pixel, exact to the third power of either coordinate."""
_FINE = (np.arange(4) + 0.5) / 4 - 0.5
_FINE_QUADRATURE = np.array([(x, y) for x in _FINE for y in _FINE])
"""Points of a pixel on an edge that nothing else blurs, where four points err by 0.02 px."""

_BELL = math.log(2)
"""Steepness of a Gaussian."""
_LOG_STEEPNESS = math.log(_BELL) + 0.03 * np.arange(-23, 127)
_Z = np.linspace(-2.0, 4.0, 1201)
"""Distance from the half maximum, in units of the peak over the slope there."""


def _profile(
    table: np.ndarray, steepness: float, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The profile of that steepness, and its derivatives by z and by the steepness' logarithm."""
    place = (math.log(steepness) - _LOG_STEEPNESS[0]) / (_LOG_STEEPNESS[1] - _LOG_STEEPNESS[0])
    row = min(int(place), len(table) - 2)
    share = place - row
    both = (1 - share) * table[row] + share * table[row + 1]
    rise = (table[row + 1] - table[row]) / (_LOG_STEEPNESS[1] - _LOG_STEEPNESS[0])
    at = np.clip((z - _Z[0]) / (_Z[1] - _Z[0]), 0, len(_Z) - 1.001)
    first = at.astype(int)
    share_z = at - first
    step = both[1:] - both[:-1]
    light = both[first] + share_z * step[first]
    slope = np.gradient(both, _Z[1] - _Z[0])
    slope = slope[first] + share_z * (slope[first + 1] - slope[first])
    return light, slope, rise[first] + share_z * (rise[first + 1] - rise[first])


class _Profiles(NamedTuple):
    """Profiles by steepness.

    Attributes:
        profiles: of peak 1 over `_Z`, a row for each of `_LOG_STEEPNESS`.
        powers: with which the steepness of a spot's radii rises with their length.
    """

    profiles: np.ndarray
    powers: np.ndarray


@cache
def _profiles() -> _Profiles:
    """Blurred discs, and beams with a cusp."""
    # The light of a disc whose radius is so many times the blur: its integral over the disc falls
    # with the distance by a Bessel function.
    sizes = np.concatenate([[0.02], np.geomspace(0.3, 80, 400)])
    beside = np.linspace(-8, 8, 2001)  # blurs from the disc's edge, where all of its light falls
    halves, slopes, lights = [], [], []
    for size in sizes.tolist():
        distances = np.maximum(size + beside, 0.0)
        fall = size * np.exp(-0.5 * (distances - size) ** 2) * i1e(size * distances)
        light = 1 - cumulative_trapezoid(fall, distances, initial=0) / -math.expm1(-0.5 * size**2)
        half = float(np.interp(-0.5, -light, distances))
        slope = half * float(np.interp(half, distances, fall)) / -math.expm1(-0.5 * size**2)
        halves.append(half)
        slopes.append(slope)
        lights.append(np.interp((1 + _Z / slope) * half, distances, light, right=0.0))
    steepness = np.log(np.maximum.accumulate(slopes))
    rises = np.gradient(steepness, np.log(halves))
    rows = []
    for wanted in _LOG_STEEPNESS.tolist():
        bell = math.exp(wanted)
        if bell < _BELL * (1 - 1e-9):
            rows.append(np.exp(-_BELL * np.maximum(1 + _Z / bell, 0) ** (2 * bell / _BELL)))
            continue
        k = min(max(int(np.searchsorted(steepness, wanted)), 1), len(sizes) - 1)
        share = (wanted - steepness[k - 1]) / (steepness[k] - steepness[k - 1])
        share = min(max(share, 0.0), 1.0)
        rows.append((1 - share) * lights[k - 1] + share * lights[k])
    powers = np.interp(_LOG_STEEPNESS, steepness, np.clip(np.nan_to_num(rises), 0, 1))
    powers[_LOG_STEEPNESS <= math.log(_BELL)] = 0.0
    return _Profiles(np.array(rows), powers)
