"""What the mode pixels is made of: light on cells, its blur, the wall's texture and its motion."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import k1
from scipy.stats import norm

from eyespot import optics
from eyespot.estimator.pixels.beam_on_cells import BeamLight, blurred, blurred_with_growth
from eyespot.estimator.pixels.frame_cells import COUNT, STILL, CellLight, CellWindow, rolled
from eyespot.estimator.pixels.frame_fit import registered
from eyespot.estimator.pixels.frame_model import (
    OWN,
    FrameModel,
    FrameState,
    Linear,
    RobotPose,
    motion_between,
)
from eyespot.estimator.pixels.frame_pixels import _most_even
from eyespot.estimator.pixels.texture import LENGTHS_MM, TextureVariances, texture_of
from eyespot.estimator.pixels.tracker import _like
from eyespot.formats.spot import Outline
from eyespot.optics.wall_light.cells import square_lattice
from eyespot.optics.wall_light.cone import UniformCone
from eyespot.optics.wall_light.pose_light import (
    BeamFrame,
    Steps,
    beam_at_wall,
    irradiance_and_slopes,
)
from tests.support.drawn.made_up import a_microscope

HALF_ANGLE, APEX, SCALE = math.atan(1 / 20), -5.117, 0.0067
CONE = UniformCone.of(HALF_ANGLE, APEX)
CAMERA = optics.microscope(
    scale=SCALE, pinhole_height=11.5, eye_radius=11.5, principal_point=(100.0, 100.0)
)


def unit(*vector):
    return np.array(vector) / np.linalg.norm(vector)


TIP, AXIS = np.array([0.05, -0.1, -9.0]), np.array([0.1, 0.05, -math.sqrt(1 - 0.0125)])


def beam_frame(tip=TIP, axis=AXIS, distance=2.45):
    return BeamFrame(
        np.asarray(tip),
        np.asarray(axis),
        np.asarray(distance),
        np.array([1.0, 0.0, 0.0]),
        np.array([0.0, 1.0, 0.0]),
        *(np.asarray(v) for v in optics.perpendicular_frame(np.asarray(axis))),
    )


def light_on_cells(frame, steps=None):
    """Irradiance of the cells, and its derivatives."""
    corner, right = np.full(2, -30.5), np.array([10.0, 0.0])
    lattice = square_lattice(CAMERA, optics.Sphere(11.5), corner=corner, right=right, count=COUNT)
    light = irradiance_and_slopes(
        lattice, CONE, frame, own=np.zeros(2), spread=np.eye(2), steps=steps
    )
    return tuple(map(np.asarray, light))


def test_the_light_of_a_beam_that_moves_has_the_derivatives_of_its_whole_way():
    frame = beam_frame()
    ways = np.linspace(-0.1, 0.1, 4)  # three cells
    aways = ways[:, None] * np.array([1.0, 0.5, 0.0])
    turns = 0.02 * ways[:, None] * np.array([0.0, 1.0, 0.0])
    steps = Steps(tips=aways, axes=turns, shares=np.full(4, 1 / 4))
    value, slopes = light_on_cells(frame, steps)
    step = 1e-5

    def seen(aside):
        """One place after the other, each as a beam at rest."""
        places = TIP + aside * frame.right + aways
        return np.mean(
            [
                light_on_cells(beam_frame(place, unit(*(AXIS + turn))))[0]
                for place, turn in zip(places, turns, strict=True)
            ],
            axis=0,
        )

    np.testing.assert_allclose(value, seen(0.0), rtol=1e-12, atol=1e-12)
    differences = (seen(step) - seen(-step)) / (2 * step)
    # Where an edge crosses a corner of a cell within the step, the derivative jumps.
    scale = np.abs(slopes[0]).max()
    np.testing.assert_allclose(differences, slopes[0], atol=5e-3 * scale)
    # A beam at rest has all of its edge in one place, and there the steepest light.
    assert scale < 0.6 * np.abs(light_on_cells(frame)[1][0]).max()


def test_the_mixture_of_channels_cancels_what_they_share():
    rng = np.random.default_rng(5)
    vessel = rng.standard_normal(500)
    contrast = np.array([0.05, 0.20, 0.15])
    residuals = contrast[:, None] * vessel + 0.003 * rng.standard_normal((3, 500))
    parts = _most_even(residuals)
    assert parts.sum() == pytest.approx(1.0)
    assert np.std(parts @ residuals) < 0.5 * np.std(residuals[0])


def test_cells_with_an_unusable_pixel_and_cells_outside_of_the_image_are_left_out():
    usable = np.ones((200, 200), bool)
    usable[57, 83] = False
    cells = CellLight(np.full((200, 200), 0.25), usable, np.zeros_like)
    light, kept, _ = (
        part.reshape(COUNT, COUNT) for part in cells.means(CellWindow(left=40, top=30, side=7))
    )
    assert not kept[(57 - 30) // 7, (83 - 40) // 7]
    assert not kept[-1].any()  # 30 + 26 * 7 = 212 px
    assert np.count_nonzero(~kept[:24, :22]) == 1
    np.testing.assert_allclose(light[:24, :22], 0.25)


def test_a_window_stays_as_long_as_it_serves_and_moves_ahead_by_whole_cells():
    window = CellWindow.around(np.array([300.0, 200.0]), 70.0)
    for way in (3.0, -3.0):
        places = [np.array([300.0 + way * k, 200.0]) for k in range(60)]
        now, changes = window, 0
        for before, place in itertools.pairwise(places):
            then = now.following(place, 70.0, place - before)
            changes += then != now
            assert then.side == now.side
            assert (then.left - now.left) % now.side == 0
            now = then
            # All that must be seen of a spot lies within: a reach of 70 px less a fifth.
            assert np.abs(place - now.middle_px).max() + 0.8 * 70.0 < 13 * now.side
        assert 1 <= changes < 20
    assert window.following(np.array([300.0, 200.0]), 100.0, np.zeros(2)).side > window.side


def test_the_model_of_a_moved_window_is_that_of_the_same_cells():
    values = np.arange(2.0 * COUNT**2).reshape(2, -1)
    moved = rolled(values, 3, -2).reshape(2, COUNT, COUNT)
    old = values.reshape(2, COUNT, COUNT)
    # Cell (row, column) of the new window is (row - 2, column + 3) of the old one.
    np.testing.assert_array_equal(moved[:, 2:, :-3], old[:, :-2, 3:])
    assert not moved[:, :2].any()
    assert not moved[:, :, -3:].any()
    for way in ((COUNT, 0), (-40, 3), (2, 31)):  # farther than its side
        assert not rolled(np.ones(COUNT**2), *way).any()


MIDDLE = COUNT // 2


@pytest.mark.parametrize("kurtosis", [-1.0, -0.4, 0.0, 0.5, 2.0])
@pytest.mark.parametrize("variance", [0.5, 2.0])
def test_a_point_keeps_its_light_and_gets_variance_and_kurtosis(variance, kurtosis):
    point = np.zeros((COUNT, COUNT))
    point[MIDDLE, MIDDLE] = 1.0
    spread = blurred(point.ravel(), variance, kurtosis).reshape(COUNT, COUNT)
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


def disc_share(x, variance):
    x = np.clip(x / (2.0 * np.sqrt(variance)), -1.0, 1.0)
    return 0.5 + (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) / np.pi


def exponential_share(x, variance):
    length = np.sqrt(variance / 3.0)

    def line(y):
        return y * k1(y / length) / (np.pi * length**2) if y > 0 else 1.0 / (np.pi * length)

    return 0.5 + np.sign(x) * quad(line, 0.0, abs(x))[0]


BLURS = {
    # Light beyond a line, kurtosis, and what passes of the lattice's shortest wave.
    "Gaussian": (
        lambda x, variance: norm.cdf(x / np.sqrt(variance)),
        0.0,
        lambda variance: np.exp(-0.5 * variance * np.pi**2),
    ),
    "disc": (disc_share, -1.0, lambda variance: 1.6 / (2 * np.pi * np.sqrt(variance)) ** 1.5),
    "exponential": (exponential_share, 2.0, lambda variance: (1 + variance * np.pi**2 / 3) ** -1.5),
}


@pytest.mark.parametrize("blur", BLURS)
@pytest.mark.parametrize("variance", [0.25, 1.0, 2.0])
def test_an_edge_is_that_of_the_blur(blur, variance):
    share, kurtosis, passes = BLURS[blur]
    edge = np.zeros((COUNT, COUNT))
    edge[:, MIDDLE:] = 1.0
    seen = blurred(edge.ravel(), variance, kurtosis).reshape(COUNT, COUNT)[MIDDLE]
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
def test_the_growth_of_a_blur_is_its_derivative(kurtosis):
    values = np.random.default_rng(3).uniform(size=COUNT**2)
    step = 1e-4
    value, grown_by_variance, grown_by_kurtosis = blurred_with_growth(values, 0.7, kurtosis)
    np.testing.assert_allclose(value, blurred(values, 0.7, kurtosis), atol=1e-12)
    by_variance = blurred(values, 0.7 + step, kurtosis) - blurred(values, 0.7 - step, kurtosis)
    # The growth with the variance is a forward difference of the same step: its rest is half a
    # second derivative of it, and those are below (pi^2)^2 / 4 = 24.
    np.testing.assert_allclose(grown_by_variance, by_variance / (2 * step), atol=24 * step)
    by_kurtosis = blurred(values, 0.7, kurtosis + step) - blurred(values, 0.7, kurtosis - step)
    np.testing.assert_allclose(grown_by_kurtosis, by_kurtosis / (2 * step), atol=1e-9)


CENTRE, NONE = np.full(2, 100.0), np.zeros(0)


def cone_beam(*, sharp):
    """A cone's light on a round wall, and a pose with a spot about the image's middle."""
    microscope = a_microscope(
        width_px=200,
        height_px=200,
        scale_mm_px=SCALE,
        principal_point_px=tuple(CENTRE),
        pinhole_height_mm=math.inf,
    )
    beam = BeamLight(CONE, microscope, np.zeros((2, 0)), sharp=sharp)
    return beam, beam_at_wall(beam.wall, np.array([-0.28, -0.18, -8.5]), AXIS)


def test_a_beam_that_lights_nothing_of_the_window_suits_no_frame():
    beam, pose = cone_beam(sharp=True)
    image, usable = np.full((1000, 200), 0.1), np.ones((1000, 200), bool)
    cells = CellLight(image, usable, np.zeros_like)
    frame = FrameState(cells, pose, 0.0, 0.0, None, ambient_prior=(-4.0, 3.0))
    # The spot is some 50 px wide and near the centre; the second window is 500 px below it.
    for below, lit in ((0.0, True), (500.0, False)):
        window = CellWindow.around(CENTRE + np.array([0.0, below]), 60.0)
        model = FrameModel(beam, window, TextureVariances.usual())
        (found,) = model.scanned([frame], NONE)
        assert (found is not None) == lit


@pytest.mark.parametrize("blur_px2", [0.1, 0.2499, 0.2501, 0.5])
def test_the_growth_with_a_narrow_blur_is_the_derivative(blur_px2):
    # A fit that is told another growth than the light has goes to and fro about its minimum.
    beam, pose = cone_beam(sharp=True)
    window, step = CellWindow.around(CENTRE, 104.0), 1e-3
    below, here, above = (
        beam.irradiance(window, STILL, pose, NONE, blur_px2=blur_px2 + by)
        for by in (-step, 0.0, step)
    )
    growth = (above.value - below.value) / (2.0 * step)
    # Above 0.25 px^2 the derivative is a difference over a fifth of the blur, along which the
    # growth of an edge, as 1/sqrt, changes by a tenth.
    assert np.linalg.norm(here.bend - growth) < 0.15 * np.linalg.norm(growth)


@pytest.mark.parametrize("sharp", [True, False])
def test_light_that_is_steep_within_a_cell_is_blurred_where_it_is_steep(sharp):
    radius = 2.0  # px, of the disc that a focus 0.5 mm off makes at NA 0.05
    beam, pose = cone_beam(sharp=sharp)
    window = CellWindow.around(CENTRE, 104.0)
    lattice = beam.lattice(window, STILL)
    seen = beam.irradiance(window, STILL, pose, NONE, blur_px2=radius**2 / 4).value
    # The disc, by 200 places of equal light.
    number = np.arange(200) + 0.5
    far, turn = radius * np.sqrt(number / 200), number * math.pi * (3.0 - math.sqrt(5.0))
    aside = SCALE * np.stack([far * np.cos(turn), far * np.sin(turn), 0.0 * far], axis=-1)
    disc = Steps(tips=aside, axes=np.zeros((200, 3)), shares=np.full(200, 1 / 200))
    exact = beam.irradiance_alone(lattice, pose, NONE, disc)
    still = beam.irradiance_alone(lattice, pose, NONE)
    # Four places are a square instead of a disc: that leaves 0.15 of what the blur does. Spread
    # from cell to cell as heat, the light is wrong by 0.84 of it.
    assert np.abs(seen - exact).max() < 0.25 * np.abs(still - exact).max()


def test_the_only_bright_region_may_be_a_spot_that_has_grown_threefold():
    # Behind a dome in vitreous a spot grew by that within 0.75 mm; its fitted light decides.
    def outline(size, x=300.0):
        return Outline(x, 240.0, size, size, 0.0, measured=False)

    last, grown, other = outline(20.0), outline(40.0), outline(35.0, x=450.0)
    assert _like(last, [grown]) == grown
    # Of several, only one of about the last size can be told.
    assert _like(last, [grown, other]) == last
    assert _like(last, [grown, outline(21.0)]) == outline(21.0)
    assert _like(last, []) == last


def test_a_shift_of_the_wall_is_found_although_the_light_has_changed():
    rng = np.random.default_rng(4)
    # A smooth random field on a lattice that is wider than the map.
    place, field = np.arange(2 * COUNT), np.zeros((2 * COUNT, 2 * COUNT))
    for _ in range(60):
        kx, ky = rng.normal(0, 0.35, 2)
        field += np.sin(kx * place[None, :] + ky * place[:, None] + rng.uniform(0, 2 * np.pi))
    field *= 0.1 / field.std()
    at, right, down = COUNT // 2, 3, -2
    known = field[at : at + COUNT, at : at + COUNT].ravel()
    now = field[at - down : at - down + COUNT, at - right : at - right + COUNT].ravel()
    slopes = np.zeros((OWN, COUNT**2))
    along = np.linspace(-1, 1, COUNT)
    slopes[0], slopes[1] = np.tile(along, COUNT), np.repeat(along, COUNT)
    slopes[2] = 1.0
    noise = 0.005
    line = Linear(
        residual=now + 0.3 * slopes[0] - 0.2 * slopes[2] + noise * rng.normal(size=COUNT**2),
        slopes=slopes,
        shared=np.zeros((0, COUNT**2)),
        weight=np.full(COUNT**2, noise**-2),
    )
    window = CellWindow(left=100, top=80, side=6)
    found = registered(line, known, np.full(COUNT**2, noise**2), window)
    assert found is not None
    moved = found.image_px(window.middle_px) - window.middle_px
    # 0.05 cells: noise of 5 % of the contrast on 500 cells would leave 0.005, splines some more.
    np.testing.assert_allclose(moved / window.side, [right, down], atol=0.05)
    assert abs(found.turn) < 0.005


def test_a_robot_that_moves_as_the_beam_says_nothing_new_and_slopes_are_differences():
    pose_0 = beam_frame([0.0, 0.0, -9.0], unit(0.1, 0.0, -1), 2.0)
    pose = beam_frame([0.3, 0.0, -8.5], unit(0.2, 0.1, -1), 2.0)
    # The robot is elsewhere, but has moved alike.
    home = np.array([5.0, 3.0, -2.0])
    robot_0, robot = (RobotPose(one.tip + home, one.axis, 0.005) for one in (pose_0, pose))
    motion = motion_between((pose_0, robot_0), (pose, robot))
    assert motion is not None
    np.testing.assert_allclose(motion.rest, 0.0, atol=1e-12)
    assert motion_between((pose_0, None), (pose, robot)) is None

    def moved(one, change):
        tip, axis = one.moved(change)
        return one._replace(tip=tip, axis=axis, distance=one.distance + change[2])

    step = 1e-6
    for k, change in enumerate(step * np.eye(5)):
        later = motion_between((pose_0, robot_0), (moved(pose, change), robot))
        first = motion_between((moved(pose_0, change), robot_0), (pose, robot))
        assert later is not None and first is not None
        # Of second order in the step.
        np.testing.assert_allclose(-later.rest / step, motion.slopes[:, k], atol=1e-4)
        np.testing.assert_allclose(-first.rest / step, motion.first_slopes[:, k], atol=1e-4)


SIDE_MM = 0.06


def drawn_walls(texture, count, rng, number):
    """Walls of count x count cells with this texture."""
    root = np.linalg.cholesky(texture.covariance(count, SIDE_MM) + 1e-12 * np.eye(count**2))
    for _ in range(number):
        yield root @ rng.standard_normal(count**2)


def found_in_even_light(wall, rng, *, noise):
    """The texture that is found in a wall, if the fit knows nothing but the gain."""
    residual, weight = wall + noise * rng.standard_normal(wall.size), np.full(wall.size, noise**-2)
    count = math.isqrt(wall.size)
    return texture_of(residual, weight, np.ones((1, wall.size)), count=count, side_mm=SIDE_MM)


def test_the_texture_of_a_drawn_wall_is_found():
    rng = np.random.default_rng(3)
    true = TextureVariances(np.array([0.05, 0.10, 0.001]) ** 2)
    found = [
        np.sum(found_in_even_light(wall, rng, noise=0.005).variances[:2])
        for wall in drawn_walls(true, 20, rng, 6)
    ]
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
    (wall,) = drawn_walls(true, 20, rng, 1)
    found = found_in_even_light(wall, rng, noise=noise)
    # Of 400 cells the noise's variance is known to sqrt(2 / 400), which a texture may hide in: a
    # quarter of the noise. The longest part, as long as the window, may be twice too large.
    hidden = noise**2 / 14
    assert found.variance < 4 * (true.variance + hidden)
    assert np.sum(found.variances[:2]) > np.sum(true.variances[:2]) / 2
