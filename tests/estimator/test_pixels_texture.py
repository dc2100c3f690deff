"""The mode pixels: what it learns of a wall's texture from one frame, and from several."""

import math

import numpy as np
import pytest
from scipy.linalg import cho_factor

from estimator.pixels.cells import COUNT, SHADES
from estimator.pixels.frame_model import LENGTHS_MM, Linear, TextureVariances, texture_of
from estimator.pixels.solver import PoseSolution

_SIDE_MM = 0.06


def _root(texture, count):
    """A matrix that turns independent numbers of variance 1 into a wall of count x count cells."""
    return np.linalg.cholesky(texture.covariance(count, _SIDE_MM) + 1e-12 * np.eye(count**2))


def _found_in_even_light(root, rng, *, noise):
    """The texture that is found in a drawn wall, if the fit knows nothing but the gain."""
    n = len(root)
    residual = root @ rng.standard_normal(n) + noise * rng.standard_normal(n)
    weight = np.full(n, noise**-2.0)
    return texture_of(residual, weight, np.ones((1, n)), count=math.isqrt(n), side_mm=_SIDE_MM)


def test_the_texture_of_a_drawn_wall_is_found():
    rng = np.random.default_rng(3)
    true = TextureVariances(np.array([0.05, 0.10, 0.001]) ** 2)
    root = _root(true, 20)
    found = [np.sum(_found_in_even_light(root, rng, noise=0.005).variances[:2]) for _ in range(6)]
    # 400 cells and lengths of 1.3 and 5 cells have some 60 independent parts: 18 % a wall. The
    # third length takes what it cannot be told from.
    assert np.mean(found) == pytest.approx(np.sum(true.variances[:2]), rel=0.35)
    assert len(LENGTHS_MM) == 3


@pytest.mark.parametrize(("part", "power"), [(0, 1), (1, 2), (2, 2)])
def test_grain_is_rough_and_what_is_larger_is_smooth(part, power):
    texture, near = TextureVariances(np.eye(3)[part]), 1e-3 * LENGTHS_MM[part]
    # Near 0, 2 (1 - exp(-x)) is 2 x, and 2 (1 - (1 + y) exp(-y)), y = sqrt(3) x, is 3 x^2; the next
    # terms are 5e-4 and 1.2e-3 of these.
    slope = 2.0 if power == 1 else 3.0
    expected = slope * (near / LENGTHS_MM[part]) ** power
    assert texture.variogram(near) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("contrast", [0.0, 0.001, 0.01, 0.1])
def test_the_texture_is_as_large_as_the_wall_s_whether_it_is_even_or_not(contrast):
    rng = np.random.default_rng(11)
    noise = 0.002
    true = TextureVariances(np.square(contrast * np.array([0.5, 0.7, 0.5])))
    found = _found_in_even_light(_root(true, 20), rng, noise=noise)
    # Of 400 cells the noise's variance is known to sqrt(2 / 400), which a texture may hide in: a
    # quarter of the noise. The longest part, as long as the window, may be twice too large.
    hidden = noise**2 / 14
    assert found.variance < 4 * (true.variance + hidden)
    assert np.sum(found.variances[:2]) > np.sum(true.variances[:2]) / 2


def _seen(wall, rng, *, middle):
    """A wall in a bell of light that the fit knows nothing of but the bell's kind."""
    place = COUNT * _SIDE_MM / 2 * SHADES[:2] - np.array(middle)[:, None]
    x, y = place / 0.4
    square = x**2 + y**2
    light = np.exp(-square) + 0.02
    noise = 0.003 / np.sqrt(light)
    # Gain, ambient light, and a bell that moves, widens, tilts and stretches.
    changes = [1, x, y, square, x**2 - y**2, x * y, x * square, y * square]
    bell = (light - 0.02) / light
    slopes = np.stack([bell * change for change in changes] + [1.0 / light])
    residual = wall + noise * rng.standard_normal(wall.size)
    return Linear(residual, slopes, np.zeros((0, wall.size)), noise**-2.0)


def test_frames_in_different_light_show_a_texture_that_one_frame_hides_in_its_light():
    rng = np.random.default_rng(8)
    true = TextureVariances(np.array([0.02, 0.06, 0.08]) ** 2)
    root = _root(true, COUNT)
    one: list[float] = []
    both: list[float] = []
    for _ in range(5):
        wall = root @ rng.standard_normal(COUNT**2)
        frames = [_seen(wall, rng, middle=middle) for middle in ((0, 0), (0.3, 0.2))]
        for found, lines in ((one, frames[:1]), (both, frames)):
            total = PoseSolution(
                [], lines, np.zeros(0), np.eye(1), 0.0, wall, cho_factor(np.eye(1)), True
            )
            texture = texture_of(*total.together, count=COUNT, side_mm=_SIDE_MM)
            found.append(abs(np.log(texture.variances[-1] / true.variances[-1])))
    # Of the longest part a window shows one wave or two, so that one wall may be far off.
    assert np.median(both) < 0.7 * np.median(one)
    assert np.median(both) < np.log(3.0)
