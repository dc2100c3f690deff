"""A blur on the cells of a lattice has the variance it says, and stays light."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from estimator.pixels.blur import blurred, growth_with_blur
from estimator.pixels.cells import COUNT

MIDDLE = COUNT // 2


def _grid(values):
    return values.reshape(COUNT, COUNT)


@pytest.mark.parametrize("variance", [0.05, 0.5, 2.0])
def test_a_point_keeps_its_light_and_gets_the_variance(variance):
    point = np.zeros((COUNT, COUNT))
    point[MIDDLE, MIDDLE] = 1.0
    spread = _grid(blurred(point.ravel(), variance))
    away = np.arange(COUNT) - MIDDLE
    assert spread.min() >= -1e-12
    assert spread.sum() == pytest.approx(1.0, abs=1e-12)
    for along in (spread.sum(axis=0), spread.sum(axis=1)):
        # Beyond nine standard deviations hardly any light has reached the lattice's edge.
        assert along @ away**2 == pytest.approx(variance, abs=1e-9)


@pytest.mark.parametrize("variance", [0.05, 0.25, 1.0])
def test_an_edge_is_nearly_that_of_a_gaussian_blur(variance):
    edge = np.zeros((COUNT, COUNT))
    edge[:, MIDDLE:] = 1.0
    seen = _grid(blurred(edge.ravel(), variance))[MIDDLE]
    exact = [
        quad(lambda x: norm.cdf(x / np.sqrt(variance)), k, k + 1)[0]
        for k in range(-MIDDLE, COUNT - MIDDLE)
    ]
    # At a side between two cells, the light that crosses it is sqrt(variance / (2 pi)) of a cell,
    # and never more. On the lattice less crosses, at least the first order's variance / 2 less what
    # comes back.
    assert np.abs(seen - exact).max() < np.sqrt(variance / (2 * np.pi)) - variance / 4


def test_the_growth_is_the_derivative():
    values = np.random.default_rng(3).uniform(size=COUNT**2)
    step = 1e-4
    difference = (blurred(values, 0.7 + step) - blurred(values, 0.7 - step)) / (2 * step)
    # The rest of central differences is of third order: 1e-8 times a third derivative below 64.
    np.testing.assert_allclose(growth_with_blur(blurred(values, 0.7)), difference, atol=1e-6)
