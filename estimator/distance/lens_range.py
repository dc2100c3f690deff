"""Distance behind a glue lens, from the size, shape and brightness of the spot.

Behind a lens one radius may belong to two distances. The profile differs between them (a plateau
near the lens, a bell further away). So the distance is the likeliest one, given the half-maximum
radius, the radii at a quarter and at three quarters of the peak relative to it, and, at known
exposure, the peak's brightness.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eyespot.estimator.detector.shape import LEVELS, Shape
from eyespot.estimator.distance.range import Range
from eyespot.formats.calibration import LENS_PARAMETERS, Calibration

if TYPE_CHECKING:
    from eyespot import optics

_RADIUS_ERROR = 0.003  # relative: projection to first order, interpolation between incidences
_SHAPE_ERROR = 0.02  # relative, of a ratio of axes: tilt 0.01, fine texture and blur
_BRIGHTNESS_ERROR = 0.1  # relative: the wall's reflectance differs from place to place
_DECIDING_DIFFERENCE = 9.0  # difference of -2 log likelihood: three standard deviations
_OTHER_BEAM_CHI2 = 25.0
"""Chi squared of the best distance above which only the size counts: a spot that is five standard
deviations off in shape is not of this lens alone."""

_GRID_STEP_MM = 0.001  # between the distances that are compared
_DISTANCES = np.linspace(0.05, 8.0, 160)
_INCIDENCES = np.radians([0.0, 15.0, 30.0, 45.0])
_RADII = np.linspace(0.0, 1.0, 192)  # in units of the light's reach
_HALF_TURN = np.linspace(0.0, np.pi, 19)  # about the axis, from the side to which the beam leans
_SENSITIVITY_DISTANCES = np.linspace(0.05, 8.0, 32)


@dataclass(frozen=True, kw_only=True, eq=False)
class LensCurve:
    """The spot of a lens on a wall, by distance and incidence.

    Attributes:
        distances: d, (n,), mm, growing.
        incidences: (m,), rad, growing from 0.
        radii: (n, m, 3), semi-minor axes of the isophotes at `LEVELS` of the peak, mm.
        peak: (n, m), irradiance, 1/mm2 per unit power in the core.
        relative_error: (n,), standard error of the half-maximum radius from the calibration.
        tip_radius: of the lens's rim, which touches the wall first, mm.
    """

    distances: np.ndarray
    incidences: np.ndarray
    radii: np.ndarray
    peak: np.ndarray
    relative_error: np.ndarray
    tip_radius: float

    def at(self, incidence: float) -> tuple[np.ndarray, np.ndarray]:
        """`radii` and `peak` at an incidence; to first order both fall with its square."""
        square, known = incidence**2, self.incidences**2
        j = int(np.clip(np.searchsorted(known, square) - 1, 0, len(known) - 2))
        share = (square - known[j]) / (known[j + 1] - known[j])
        blend = np.array([1 - share, share])
        return (
            np.einsum("njl,j->nl", self.radii[:, j : j + 2], blend),
            self.peak[:, j : j + 2] @ blend,
        )


def distance_from_lens(
    curve: LensCurve,
    *,
    radius_mm: float,
    relative_sigma: float,
    incidence: float,
    shape: Shape | None,
    peak_irradiance: tuple[float, float] | None,
) -> Range:
    """Distance of greatest likelihood.

    Args:
        radius_mm: semi-minor axis of the half-maximum contour on the wall; NaN is nowhere.
        incidence: of the beam, rad.
        peak_irradiance: of the peak, 1/mm2 per unit power, and its relative standard deviation;
            None if unknown.

    Returns:
        The distance, NaN if no distance in the curve's range has such a spot. If there are others
        that cannot be excluded, sigma includes them.
    """
    radii, peak = curve.at(incidence)
    # Nearer, the tilted tip's rim would be inside the wall.
    possible = curve.distances[curve.distances >= curve.tip_radius * np.tan(incidence)]
    nowhere = Range(distance_mm=math.nan, sigma_mm=math.nan)
    if possible.size == 0:
        return nowhere
    grid = np.arange(possible[0], possible[-1], _GRID_STEP_MM)

    def over_grid(values: np.ndarray) -> np.ndarray:
        return np.interp(grid, curve.distances, values)

    variance = relative_sigma**2 + _RADIUS_ERROR**2 + over_grid(curve.relative_error) ** 2
    by_size = np.log(over_grid(radii[:, 1]) / radius_mm) ** 2 / variance
    if not by_size.min() < _DECIDING_DIFFERENCE:
        return nowhere
    cost = by_size
    if shape is not None:
        # Tilt shifts the isophotes against each other, but not the median over the rays.
        square, _ = curve.at(0.0)
        # What moves the contour, such as texture, moves the other isophotes as much.
        shape_variance = _SHAPE_ERROR**2 + relative_sigma**2
        for column, ratio in zip((0, 2), shape.ratios, strict=True):
            expected = over_grid(square[:, column] / square[:, 1])
            cost = cost + (expected - ratio) ** 2 / shape_variance
    if peak_irradiance is not None:
        value, relative = peak_irradiance
        cost = cost + np.log(over_grid(peak) / value) ** 2 / (relative**2 + _BRIGHTNESS_ERROR**2)
    # A profile that fits no distance (a shaft in front, too dark a wall) is ignored.
    cost = cost if cost.min() < _OTHER_BEAM_CHI2 else by_size
    best = int(np.argmin(cost))
    excess = cost - cost[best]
    # Each interval of distances that cannot be excluded counts as one answer.
    possible = np.ma.clump_masked(np.ma.masked_less(excess, _DECIDING_DIFFERENCE))
    others = tuple(
        float(grid[part][np.argmin(excess[part])])
        for part in possible
        if not part.start <= best < part.stop
    )
    distance = float(grid[best])
    if 0 < best < len(grid) - 1:  # the vertex of the parabola through the least value
        before, least, after = cost[best - 1 : best + 2]
        distance += float(0.5 * _GRID_STEP_MM * (before - after) / (before - 2 * least + after))
    weight = np.exp(-0.5 * excess)
    spread = weight @ (grid - distance) ** 2 / weight.sum()
    return Range(distance_mm=distance, sigma_mm=float(np.sqrt(spread)), others_mm=others)


def lens_curve(calibration: Calibration, *, wall_curvature: float) -> LensCurve:
    """The spots of a calibrated lens. Loads JAX; traces it once, for some 30 s, and keeps that.

    Args:
        wall_curvature: 1/r of the eyeball, 1/mm; 0 of a plane.

    Raises:
        InputError: no lens has these parameters; the text says which one is wrong.
    """
    from eyespot import optics
    from eyespot.formats.kept_arrays import kept_arrays

    values = calibration.values
    lens = optics.glue_lens(**{name: values[name] for name in LENS_PARAMETERS if name in values})
    kept = kept_arrays(
        "lens_curve",
        ("radii", "peak", "relative_error"),
        lambda: _traced(calibration, lens, wall_curvature),
        inputs=(
            list(values.items()),
            calibration.covariance.tolist(),
            calibration.medium.index,
            wall_curvature,
        ),
        code=(*optics.LIGHT_CODE, Path(__file__)),
    )
    return LensCurve(
        distances=_DISTANCES,
        incidences=_INCIDENCES,
        tip_radius=values["aperture_radius"],
        **kept,
    )


def _traced(
    calibration: Calibration, lens: "optics.GlueLens", wall_curvature: float
) -> dict[str, np.ndarray]:
    """What a `LensCurve` has of a lens's light."""
    from eyespot import optics

    table = optics.irradiance_table(lens, medium_index=calibration.medium.index)
    light, points = zip(
        *(_wall_light(table, wall_curvature, distance) for distance in _DISTANCES), strict=True
    )
    contours: Any = np.stack([_isophotes(*of_one) for of_one in zip(light, points, strict=True)])
    return {
        "radii": np.asarray(optics.ellipse_of_contour(contours).semi_minor),
        "peak": np.max(light, axis=(2, 3)),
        "relative_error": _relative_error(calibration),
    }


def _wall_light(
    table: "optics.IrradianceTable", curvature: float, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance of the wall as `optics.wall_irradiance` has it, but at all incidences at once.

    The wall touches z = 0 at O, the sphere's centre is above it, and the beam leans towards +x. A
    point p of the wall has p_z = curvature |p|^2 / 2, and the outward normal curvature p - (0,0,1).
    Light per unit power on half a turn of rays, (incidences, angles, radii), and the points, mm.
    """

    def vectors(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.stack(np.broadcast_arrays(x, y, z), axis=-1)

    incidence, angle = _INCIDENCES[:, None, None], _HALF_TURN[:, None]
    sine, cosine, none = np.sin(incidence), np.cos(incidence), np.zeros(1)
    axis = vectors(sine, none, -cosine)
    around = vectors(np.cos(angle) * cosine, np.sin(angle), np.cos(angle) * sine)
    down = np.array([0.0, 0.0, -1.0])

    def light_to(reach: float) -> tuple[np.ndarray, np.ndarray]:
        radius = reach * _RADII
        start = radius[:, None] * around - distance * axis
        # Where the ray leaves the wall: a t^2 + 2 b t + c = 0, in the form that needs no a > 0.
        b = 0.5 * (curvature * np.sum(start * axis, axis=-1) + cosine)
        c = 0.5 * curvature * np.sum(start**2, axis=-1) - start[..., 2]
        square = b**2 - 0.5 * curvature * c
        to_wall = -c / (b + np.sqrt(np.maximum(square, 0.0)))
        point = start + to_wall[..., None] * axis
        outward = curvature * point + down
        lateral, axial = map(np.asarray, table(radius=radius, distance=to_wall))
        vector = lateral[..., None] * around + axial[..., None] * axis
        light = np.sum(outward * vector, axis=-1)
        return np.where(square > 0, np.maximum(light, 0.0), 0.0), point

    # On a tilted wall the light's far side is farther than O; wide enough up to 45 degrees. A few
    # rays go far beside the spot, so a second look takes in the isophotes alone.
    reach = float(table.envelope(1.5 * distance + 0.5))
    light, _ = light_to(reach)
    bright = (light > 0.5 * LEVELS[0] * light.max(axis=(1, 2), keepdims=True)).any(axis=(0, 1))
    outermost = np.flatnonzero(bright).max(initial=0) + 1
    return light_to(reach * _RADII[min(outermost, _RADII.size - 1)])


def _isophotes(light: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Isophotes at `LEVELS`, seen square to the wall at O: (incidences, 3, whole turn, 2), mm."""
    contours = []
    for level in LEVELS:
        wanted = level * light.max(axis=(1, 2), keepdims=True)
        above = light[..., :-1] >= wanted
        last = above.shape[-1] - 1 - np.argmax(above[..., ::-1], axis=-1, keepdims=True)
        inner, outer = (np.take_along_axis(light, last + side, axis=-1) for side in (0, 1))
        # Nearer than the tilted tip can come there may be no light at all.
        share = (inner - wanted) / np.where(inner > outer, inner - outer, 1.0)
        start, end = (
            np.take_along_axis(points, last[..., None] + side, axis=-2)[..., 0, :2]
            for side in (0, 1)
        )
        half = start + share * (end - start)
        contours.append(np.concatenate([half, half[:, -2:0:-1] * [1.0, -1.0]], axis=1))
    return np.stack(contours, axis=1)


def _relative_error(calibration: Calibration) -> np.ndarray:
    """Standard error of the half-maximum radius at `_DISTANCES`, from the calibration's."""
    from eyespot import optics

    def log_radius(values: Mapping[str, float]) -> np.ndarray:
        # Unchecked: a step of one standard error may leave what `optics.glue_lens` allows.
        present: Any = {name: None for name in LENS_PARAMETERS}
        present |= {name: np.asarray(values[name]) for name in LENS_PARAMETERS if name in values}
        field = optics.LensField(optics.GlueLens(**present), calibration.medium.index)
        radius = optics.half_maximum_radius(field, distance=_SENSITIVITY_DISTANCES)
        return np.log(np.asarray(radius))

    values = calibration.values
    slopes = np.zeros((len(_SENSITIVITY_DISTANCES), len(values)))
    middle: np.ndarray | None = None
    for column, (name, value) in enumerate(values.items()):
        # Steps of one standard error: the error of the quadrature exceeds the effect of small ones.
        step = calibration.sigma(name)
        if name == "scale":
            slopes[:, column] = -1.0 / value
        elif name in LENS_PARAMETERS and step > 0:
            middle = log_radius(values) if middle is None else middle
            slopes[:, column] = (log_radius({**values, name: value + step}) - middle) / step
    variance = np.einsum("ni,ij,nj->n", slopes, calibration.covariance, slopes)
    return np.sqrt(np.interp(_DISTANCES, _SENSITIVITY_DISTANCES, np.maximum(variance, 0.0)))
