"""A blur on the cells of a lattice has the variance, the kurtosis and the shape that it says."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import k1
from scipy.stats import norm

from estimator.pixels.beam import BeamLight, blurred, blurred_with_growth
from estimator.pixels.cells import COUNT, STILL, CellLight, CellWindow
from estimator.pixels.frame_model import FrameModel, FrameState, TextureVariances
from optics.wall_light.cone import UniformCone
from optics.wall_light.pose_light import Steps
from tests.made_up import a_microscope

MIDDLE = COUNT // 2
SCALE, CENTRE = 0.0067, np.full(2, 100.0)  # mm/px, px


def _grid(values):
    return values.reshape(COUNT, COUNT)


@pytest.mark.parametrize("kurtosis", [-1.0, -0.4, 0.0, 0.5, 2.0])
@pytest.mark.parametrize("variance", [0.5, 2.0])
def test_a_point_keeps_its_light_and_gets_variance_and_kurtosis(variance, kurtosis):
    point = np.zeros((COUNT, COUNT))
    point[MIDDLE, MIDDLE] = 1.0
    spread = _grid(blurred(point.ravel(), variance, kurtosis))
    away = np.arange(COUNT) - MIDDLE
    assert spread.sum() == pytest.approx(1.0, abs=1e-12)
    along = spread.sum(axis=0)
    np.testing.assert_allclose(along, spread.sum(axis=1), atol=1e-12)
    found = along @ away**2
    # The lattice ends 12 cells away. There an exponential of variance 2 (L = 0.8) is down to
    # exp(-15), and what is missing of the fourth moment is below 12^4 times 15 L of that: 0.1 %.
    # A narrow blur passes some of the shortest wave, whose ends at the lattice's edge have a
    # share exp(-0.5 * 0.5 * pi^2) / COUNT^2 = 1e-4 of the light, up to 12 cells away.
    slack = 1e-3 + 1e-4 * 12**2 * (variance < 1)
    assert found == pytest.approx(variance, rel=slack)
    if variance > 1:
        assert along @ away**4 / found**2 - 3.0 == pytest.approx(kurtosis, abs=0.02)


def _disc(x, variance):
    radius = 2.0 * np.sqrt(variance)
    x = np.clip(x / radius, -1.0, 1.0)
    return 0.5 + (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) / np.pi


def _exponential(x, variance):
    length = np.sqrt(variance / 3.0)

    def line(y):
        return y * k1(y / length) / (np.pi * length**2) if y > 0 else 1.0 / (np.pi * length)

    half, _ = quad(line, 0.0, abs(x))
    return 0.5 + np.sign(x) * half


def _gaussian(x, variance):
    return norm.cdf(x / np.sqrt(variance))


@pytest.mark.parametrize(
    ("share", "kurtosis", "passes"),
    [
        # What each blur passes of the shortest wave of the lattice and of shorter ones.
        (_gaussian, 0.0, lambda variance: np.exp(-0.5 * variance * np.pi**2)),
        (_disc, -1.0, lambda variance: 2.0 * 0.8 / (2 * np.pi * np.sqrt(variance)) ** 1.5),
        (_exponential, 2.0, lambda variance: (1.0 + variance * np.pi**2 / 3.0) ** -1.5),
    ],
)
@pytest.mark.parametrize("variance", [0.25, 1.0, 2.0])
def test_an_edge_is_that_of_the_blur(share, kurtosis, passes, variance):
    edge = np.zeros((COUNT, COUNT))
    edge[:, MIDDLE:] = 1.0
    seen = _grid(blurred(edge.ravel(), variance, kurtosis))[MIDDLE]
    exact = [
        quad(lambda x: share(x, variance), k, k + 1)[0] for k in range(-MIDDLE, COUNT - MIDDLE)
    ]
    # The mean over cells of an edge has at most 2 / w^2 of a wave of number w. What lies beyond the
    # shortest wave of the lattice, w = pi, is missing, and what it has instead is as much at most:
    # 2/pi times the integral of 2 / w^2 from pi on, times what the blur passes there. Among the
    # longer waves an edge between two cells is (w/2)^2 / sin(w/2)^2 too strong, 1 + w^2/12: as if
    # the variance were 1/6 less. Half of that times a Gaussian's steepest slope, 0.242 / variance;
    # the next order, w^4 / 240, adds less than a tenth.
    slack = 4.0 / np.pi**2 * passes(variance) + 1.1 * 0.242 / (12.0 * variance)
    assert np.abs(np.subtract(seen, exact)).max() < slack


@pytest.mark.parametrize("kurtosis", [-0.5, 0.7])
def test_the_growth_is_the_derivative(kurtosis):
    values = np.random.default_rng(3).uniform(size=COUNT**2)
    step = 1e-4
    found = blurred_with_growth(values, 0.7, kurtosis)
    np.testing.assert_allclose(found.value, blurred(values, 0.7, kurtosis), atol=1e-12)
    by_variance = blurred(values, 0.7 + step, kurtosis) - blurred(values, 0.7 - step, kurtosis)
    # The growth with the variance is a forward difference of the same step: its rest is half a
    # second derivative of it, and those are below (pi^2)^2 / 4 = 24.
    np.testing.assert_allclose(found.by_variance, by_variance / (2 * step), atol=24 * step)
    by_kurtosis = blurred(values, 0.7, kurtosis + step) - blurred(values, 0.7, kurtosis - step)
    np.testing.assert_allclose(found.by_kurtosis, by_kurtosis / (2 * step), atol=1e-9)


def _cone_beam(sharp):
    """A cone's light on a round wall, and a pose with a spot about the image's middle."""
    microscope = a_microscope(
        width_px=200,
        height_px=200,
        scale_mm_px=SCALE,
        principal_point_px=tuple(CENTRE),
        pinhole_height_mm=math.inf,
    )
    source = UniformCone.of(math.atan(1 / 20), -5.117)
    beam = BeamLight(source, microscope, np.zeros((2, 0)), sharp=sharp)
    tip, axis = np.array([-0.28, -0.18, -8.5]), np.array([0.1, 0.05, -math.sqrt(1 - 0.0125)])
    pose = beam.pose(tip, axis)
    assert pose is not None
    return beam, pose


def test_a_beam_that_lights_nothing_of_the_window_suits_no_frame():
    beam, pose = _cone_beam(sharp=True)
    image, usable = np.full((1000, 200), 0.1), np.ones((1000, 200), bool)
    frame = FrameState(
        CellLight(image, usable, np.zeros_like), pose, 0.0, 0.0, None, ambient_prior=(-4.0, 3.0)
    )
    # The spot is some 50 px wide and near the centre; the second window is 500 px below it.
    for below, lit in ((0.0, True), (500.0, False)):
        window = CellWindow.around(CENTRE + np.array([0.0, below]), 60.0)
        model = FrameModel(beam, window, TextureVariances.usual())
        assert (model.scanned(frame, np.zeros(0)) is not None) == lit


@pytest.mark.parametrize("blur_px2", [0.1, 0.2499, 0.2501, 0.5])
def test_the_growth_with_a_narrow_blur_is_the_derivative(blur_px2):
    # A fit that is told another growth than the light has goes to and fro about its minimum.
    beam, pose = _cone_beam(sharp=True)
    window, step = CellWindow.around(CENTRE, 104.0), 1e-3
    below, here, above = (
        beam.irradiance(window, STILL, pose, np.zeros(0), blur_px2=blur_px2 + by)
        for by in (-step, 0.0, step)
    )
    growth = (above.value - below.value) / (2.0 * step)
    # Above 0.25 px^2 the derivative is a difference over a fifth of the blur, along which the
    # growth of an edge, as 1/sqrt, changes by a tenth.
    assert np.linalg.norm(here.bend - growth) < 0.15 * np.linalg.norm(growth)


@pytest.mark.parametrize("sharp", [True, False])
def test_light_that_is_steep_within_a_cell_is_blurred_where_it_is_steep(sharp):
    radius = 2.0  # px, of the disc that a focus 0.5 mm off makes at NA 0.05
    beam, pose = _cone_beam(sharp)
    window = CellWindow.around(CENTRE, 104.0)
    lattice = beam.lattice(window, STILL)
    none = np.zeros(0)
    seen = beam.irradiance(window, STILL, pose, none, blur_px2=radius**2 / 4).value
    # The disc, by 200 places of equal light.
    number = np.arange(200) + 0.5
    far, turn = radius * np.sqrt(number / 200), number * math.pi * (3.0 - math.sqrt(5.0))
    aside = SCALE * np.stack([far * np.cos(turn), far * np.sin(turn), 0.0 * far], axis=-1)
    disc = Steps(tips=aside, axes=np.zeros((200, 3)), shares=np.full(200, 1 / 200))
    exact = beam.irradiance_alone(lattice, pose, none, disc)
    still = beam.irradiance_alone(lattice, pose, none)
    # Four places are a square instead of a disc: that leaves 0.15 of what the blur does. Spread
    # from cell to cell as heat, the light is wrong by 0.84 of it.
    assert np.abs(seen - exact).max() < 0.25 * np.abs(still - exact).max()
