"""A blur on the cells of a lattice has the variance it says, and stays light."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from estimator.files import MicroscopeFile
from estimator.pixels.beam import BeamLight
from estimator.pixels.blur import blurred, growth_with_blur
from estimator.pixels.cells import COUNT, Window
from estimator.pixels.wall_motion import STILL
from optics.wall_light import Steps, UniformCone

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


@pytest.mark.parametrize("sharp", [True, False])
def test_light_that_is_steep_within_a_cell_is_blurred_where_it_is_steep(sharp):
    scale, radius = 0.0067, 2.0  # mm/px; px, of the disc that a focus 0.5 mm off makes at NA 0.05
    microscope = MicroscopeFile(
        width_px=200,
        height_px=200,
        camera_matrix=None,
        distortion=np.zeros(0),
        scale_mm_px=scale,
        principal_point_px=(0.0, 0.0),
        pinhole_height_mm=math.inf,
        eye_radius_mm=11.5,
    )
    source = UniformCone.of(math.atan(1 / 20), -5.117)
    beam = BeamLight(source, microscope, np.zeros((2, 0)), sharp=sharp)
    tip, axis = np.array([-0.28, -0.18, -8.5]), np.array([0.1, 0.05, -math.sqrt(1 - 0.0125)])
    pose = beam.pose(tip, axis)
    assert pose is not None
    window = Window.around(np.zeros(2), 104.0)
    lattice = beam.lattice(window, STILL)
    none = np.zeros(0)
    seen = beam.irradiance(lattice, pose, none, window=window, blur_px2=radius**2 / 4).value
    # The disc, by 200 places of equal light.
    number = np.arange(200) + 0.5
    far, turn = radius * np.sqrt(number / 200), number * math.pi * (3.0 - math.sqrt(5.0))
    aside = scale * np.stack([far * np.cos(turn), far * np.sin(turn), 0.0 * far], axis=-1)
    disc = Steps(tips=aside, axes=np.zeros((200, 3)), shares=np.full(200, 1 / 200))
    exact = beam.irradiance_alone(lattice, pose, none, disc)
    still = beam.irradiance_alone(lattice, pose, none)
    # Four places are a square instead of a disc: that leaves 0.15 of what the blur does. Spread
    # from cell to cell as heat, the light is wrong by 0.84 of it.
    assert np.abs(seen - exact).max() < 0.25 * np.abs(still - exact).max()
