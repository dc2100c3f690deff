"""The least error with which a spot's size can be known on a wall of unknown texture.

Cramer-Rao bound of the semi-minor axis for the discs of `own_frames` on its wall with a spectrum
of 1/f and vessels, as `stated_errors` measures them. Gain, ambient light and the edge's width are
not known; the logarithm of the reflectance is a Gaussian process whose covariance is that of the
drawn walls. No estimator without more knowledge has a smaller error on average, unless the walls'
vessels, which are not Gaussian, help it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from benchmarks.bench import show, table
from benchmarks.bench.estimator import own_frames
from benchmarks.bench.estimator.own_frames import Ellipse

_SIDE_PX = 3  # of a cell
_BAND_PX = 20.0  # from the contour, within which cells count; more make little difference
_WALLS = 60  # from which the covariance is taken
_SPOTS, _SPOTS_FULL = 8, 40
_STEPS = {"x": 0.1, "y": 0.1, "semi_major": 0.1, "semi_minor": 0.1, "angle": 0.002}
_WIDTH_STEP_PX = 0.05
_ROUNDED = 1 / 12  # variance of a pixel value's rounding


class _Case(NamedTuple):
    """A kind of frame of `stated_errors`."""

    name: str
    blur_px: float
    seen: float = 1.0  # share of the spot's area, the rest of which says nothing


_CASES = (
    _Case("disc, 1/f", 2.0),
    _Case("disc blurred by 4 px, 1/f", 4.0),
    _Case("disc of which two thirds are seen, 1/f", 2.0, 2 / 3),
)


def run(*, full: bool) -> None:
    """Print the bounds (`full`: of 40 spots a row instead of 8)."""
    rng = np.random.default_rng(20261124)
    covariance = _covariance_of_walls(rng)
    number = _SPOTS_FULL if full else _SPOTS
    made = table(
        "Cramer-Rao bound of the semi-minor axis on a textured wall",
        *("frames", "spots", "bound (RMS), px", "median, px"),
        caption=f"standard deviation of a cell's log reflectance {math.sqrt(covariance[0, 0]):.3f}",
    )
    for case in _CASES:
        spots = [own_frames.any_ellipse(rng, 25, 110) for _ in range(number)]
        variances = [_variance(case, spot, covariance, rng) for spot in spots]
        bound, median = math.sqrt(np.mean(variances)), math.sqrt(np.median(variances))
        made.add_row(case.name, f"{number}", f"{bound:.3f}", f"{median:.3f}")
    show(made)


def _cells(pixels: np.ndarray) -> np.ndarray:
    """Means over cells."""
    rows, columns = (size // _SIDE_PX for size in pixels.shape)
    whole = pixels[: rows * _SIDE_PX, : columns * _SIDE_PX]
    return whole.reshape(rows, _SIDE_PX, columns, _SIDE_PX).mean(axis=(1, 3))


def _covariance_of_walls(rng: np.random.Generator) -> np.ndarray:
    """Mean covariance of cells' log reflectance, by how many cells they are below and beside."""
    total = np.zeros((1, 1))
    for _ in range(_WALLS):
        wall = _cells(np.log(own_frames.textured_wall(rng)))
        wall = wall - wall.mean()
        size = tuple(2 * side for side in wall.shape)
        power = np.abs(np.fft.fft2(wall, s=size)) ** 2
        pairs = np.fft.ifft2(np.abs(np.fft.fft2(np.ones_like(wall), s=size)) ** 2).real
        total = total + np.fft.ifft2(power).real / np.maximum(pairs, 1.0) / _WALLS
    return total


def _variance(
    case: _Case, spot: Ellipse, covariance: np.ndarray, rng: np.random.Generator
) -> float:
    """Bound of the semi-minor axis's variance for one spot, px²."""

    def light(at: Ellipse, blur_px: float) -> np.ndarray:
        seen = own_frames.disc(blur_px)(*own_frames.places_of(at))
        return _cells(own_frames.STEP * seen + own_frames.AMBIENT)

    here = light(spot, case.blur_px)
    counted = np.abs(_cells(own_frames.places_of(spot)[1])) < _BAND_PX
    if case.seen < 1.0:
        counted &= _cells(own_frames.shadow_over_a_third(rng, spot)) > 0.99
    slopes = [
        (
            light(_with(spot, name, step), case.blur_px)
            - light(_with(spot, name, -step), case.blur_px)
        )
        / (2 * step)
        for name, step in _STEPS.items()
    ]
    wider, narrower = (light(spot, case.blur_px + way) for way in (_WIDTH_STEP_PX, -_WIDTH_STEP_PX))
    slopes += [(wider - narrower) / (2 * _WIDTH_STEP_PX), here, np.full(here.shape, 1.0)]
    design = np.stack([slope[counted] / here[counted] for slope in slopes], axis=1)
    rows, columns = np.nonzero(counted)
    apart = np.abs(np.subtract.outer(rows, rows)), np.abs(np.subtract.outer(columns, columns))
    channels = 3  # whose noise is independent
    noise = (own_frames.NOISE**2 + _ROUNDED) / channels / _SIDE_PX**2 / here[counted] ** 2
    factor = cho_factor(covariance[apart] + np.diag(noise))
    bound = np.linalg.inv(design.T @ cho_solve(factor, design))
    return float(bound[3, 3])


def _with(spot: Ellipse, name: str, change: float) -> Ellipse:
    return replace(spot, **{name: getattr(spot, name) + change})
