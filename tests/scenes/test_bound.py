"""The Cramér-Rao bound of an ellipse: closed forms, quadrature, and fits that reach it."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from eyespot import scenes
from eyespot.scenes.description.scene_keys import CameraSettings, SceneError
from eyespot.scenes.sensor import light_information
from eyespot.scenes.stacks.bound import Affine, ellipse_information, ellipse_motion
from eyespot.scenes.world.world import World

SHAPE = (96, 110)
CENTRE = (52.3, 46.8)


def places(factor: int, shape: tuple[int, int] = SHAPE) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (px) of the places of a grid with `factor` x `factor` places a pixel."""
    v, u = ((np.arange(size * factor) + 0.5) / factor - 0.5 for size in shape)
    return np.meshgrid(u, v)


def sigmas(information: np.ndarray, ellipse: Affine) -> np.ndarray:
    """Least standard deviations of x, y, a and b, px."""
    scale = np.array([1, 1, ellipse.semi_major, ellipse.semi_minor, 1.0])
    return (scale * np.sqrt(np.diag(np.linalg.inv(information))))[:4]


def bell(x: float, y: float, a: float, b: float, angle: float, *, factor: int) -> np.ndarray:
    """A Gaussian spot of height 1 with the standard deviations a and b, pixel by pixel."""
    u, v = places(factor)
    along = (u - x) * math.cos(angle) + (v - y) * math.sin(angle)
    across = -(u - x) * math.sin(angle) + (v - y) * math.cos(angle)
    return np.exp(-0.5 * ((along / a) ** 2 + (across / b) ** 2))


def test_a_gaussian_spot_with_even_noise_has_the_bound_of_its_integrals():
    ellipse = Affine(*CENTRE, 9.0, 7.0, 0.4)
    noise = 0.02
    light = bell(*ellipse, factor=2)[..., None]
    even = np.full((*SHAPE, 1), 1 / noise**2)
    found = ellipse_information(
        light, np.ones_like(light), even, ellipse=ellipse, corner=(0, 0), factor=2
    )
    # Of g = exp(-s^2/2a^2 - t^2/2b^2) the integrals over the plane are, with A = pi a b:
    # g_s^2 -> A/(2a^2); of the stretches s g_s = -(s/a)^2 g: 3A/4; mixed with t g_t: A/4;
    # with the brightness g: A and -A/2. The ambient light lies in SHAPE, where its integrals
    # with g, 2A, and with the stretches, -2A, are compared with SHAPE's area.
    a, b = ellipse.semi_major, ellipse.semi_minor
    area, plane = math.pi * a * b, float(np.prod(SHAPE))
    shapes = area * np.array([[0.75, 0.25], [0.25, 0.75]])
    # d/dg11 of the light is +(s/a)^2 g.
    mixed = np.array([[area / 2, 2 * area], [area / 2, 2 * area]])
    others = np.array([[area, 2 * area], [2 * area, plane]])
    stretches = (shapes - mixed @ np.linalg.solve(others, mixed.T)) / noise**2
    stretch = np.sqrt(np.diag(np.linalg.inv(stretches)))
    in_axes = noise * np.sqrt(2 / area) * np.array([a, b])
    cosine, sine = math.cos(ellipse.angle), math.sin(ellipse.angle)
    centre = np.hypot(in_axes[0] * np.array([cosine, sine]), in_axes[1] * np.array([sine, cosine]))
    # Pixels average over 1 px and differences over 1 px, of a spot with sigma 7: both blur the
    # squared derivative by about 1/(4 * 7^2) = 0.5 %.
    assert sigmas(found, ellipse) == pytest.approx(
        [*centre, a * stretch[0], b * stretch[1]], rel=0.01
    )


@pytest.mark.parametrize("factor", [4, 8])
def test_a_sharp_disc_has_the_bound_of_its_edge(factor):
    ellipse = Affine(*CENTRE, 36.0, 36.0, 0.0)
    noise = 0.05
    u, v = places(factor)
    light = (np.hypot(u - CENTRE[0], v - CENTRE[1]) < 36.0).astype(float)[..., None]
    even = np.full((*SHAPE, 1), 1 / noise**2)
    found = ellipse_information(
        light, np.ones_like(light), even, ellipse=ellipse, corner=(0, 0), factor=factor
    )
    # Quadrature along the edge: a pixel's light changes by the edge's length in it times its
    # displacement, here from 200,000 short pieces.
    turn = np.linspace(0, 2 * math.pi, 200_001)[:-1]
    x, y = 36.0 * np.cos(turn), 36.0 * np.sin(turn)
    column, row = (np.rint(c + p).astype(int) for c, p in zip(CENTRE, (x, y), strict=True))
    length = 36.0 * 2 * math.pi / turn.size
    nx, ny = np.cos(turn), np.sin(turn)
    moved = (nx, ny, x * nx, y * ny, y * nx + x * ny)
    pixels = row * SHAPE[1] + column
    rows = [np.bincount(pixels, own * length, minlength=math.prod(SHAPE)) for own in moved]
    inside = light.reshape(SHAPE[0], factor, SHAPE[1], factor).mean(axis=(1, 3)).ravel()
    derivatives = np.array([*rows, inside, np.ones(math.prod(SHAPE))]) / noise
    whole = derivatives @ derivatives.T
    own = whole[:5, :5] - whole[:5, 5:] @ np.linalg.solve(whole[5:, 5:], whole[5:, :5])
    # The edge between places is a staircase, whose differences scatter round those of the curve.
    # Their squares add information in proportion to 1/factor, so the bound errs to the low side:
    # by 6 % with 4 places and 3 % with 8.
    ratio = sigmas(found, ellipse) / sigmas(own, ellipse)
    assert np.all((1 - 0.3 / factor < ratio) & (ratio < 1.01))


def test_texture_that_is_known_does_not_hide_the_spot():
    ellipse = Affine(*CENTRE, 9.0, 7.0, 0.4)
    light = bell(*ellipse, factor=2)[..., None]
    # Reflectance 0.5 and 1.5 in turn, of pixel-wide stripes: the mean of its square is 1.25.
    stripes = np.where(np.arange(SHAPE[1]) % 2, 0.5, 1.5).repeat(2)[None, :, None]
    even = np.full((*SHAPE, 1), 1e4)
    plain, striped = (
        ellipse_information(
            light, wall * np.ones_like(light), even, ellipse=ellipse, corner=(0, 0), factor=2
        )
        for wall in (1.0, stripes)
    )
    assert striped[0, 0] / plain[0, 0] == pytest.approx(1.25, rel=0.01)


def test_a_clipped_number_keeps_the_information_that_remains():
    camera = CameraSettings(full_well_e=1e4, read_noise_e=0.0, black_level_dn=0, bit_depth=16)
    # Far below full scale: all of it, 1/variance with the shot noise of 2,500 electrons. At full
    # scale: half of the numbers are clipped; 1/2 + 1/pi remain. Far above: nothing.
    light = np.array([0.25, 1.0, 1.2]).reshape(3, 1, 1)
    found = light_information(light, exposure=1.0, settings=camera).ravel()
    whole = 1e4**2 / (np.array([2500.0, 10000.0, 12000.0]))
    # Rounding to 16 bits adds 0.002 electrons squared.
    assert found / whole == pytest.approx([1.0, 0.5 + 1 / math.pi, 0.0], abs=1e-5)


def test_a_bayer_filter_leaves_one_colour_a_pixel():
    light = np.full((4, 4, 3), 0.5)
    whole = light_information(light, exposure=1.0, settings=CameraSettings())
    single = light_information(light, exposure=1.0, settings=CameraSettings(bayer="RGGB"))
    assert single.sum(axis=(0, 1)) == pytest.approx(whole[0, 0] * [4, 8, 4])


def test_fits_by_maximum_likelihood_reach_the_bound():
    """Drawn bells with shot and read noise, on a striped wall that the fit knows."""
    ellipse = Affine(*CENTRE, 9.0, 7.0, 0.4)
    camera = CameraSettings(read_noise_e=20.0, bit_depth=12)
    wall = 0.8 + 0.2 * np.sin(0.3 * np.arange(SHAPE[1]))
    truth = np.array([*ellipse, 0.5, 0.1])

    def light(parameters: np.ndarray) -> np.ndarray:
        *shape, direct, ambient = parameters
        return wall * (direct * bell(*shape, factor=1) + ambient)

    mean = light(truth)
    information = light_information(mean[..., None], exposure=1.0, settings=camera)
    fine = (0.5 * bell(*ellipse, factor=2))[..., None]
    reflectance = np.broadcast_to(wall.repeat(2)[None, :, None], fine.shape)
    bound = sigmas(
        ellipse_information(
            fine, reflectance, information, ellipse=ellipse, corner=(0, 0), factor=2
        ),
        ellipse,
    )
    rng = np.random.default_rng(5)
    weight = np.sqrt(information[..., 0])
    count = 100
    fitted = []
    for _ in range(count):
        seen = mean + rng.normal(0, 1, SHAPE) / weight
        fit = least_squares(
            lambda p, seen=seen: ((light(p) - seen) * weight).ravel(), truth, method="lm"
        )
        fitted.append(fit.x[:4])
    scatter = np.std(fitted, axis=0, ddof=4)
    # The standard deviation of 100 values scatters by 1/sqrt(200) = 7 %; 3 of these.
    assert scatter == pytest.approx(bound, rel=0.21)


SCENE = (
    'source.kind="cone"',
    "motion.frames=3",
    "camera.bit_depth=12",
    "motion.travel_mm=3",
    'exposures.kinds=["metered"]',
    "exposures.sensitivity_mm2_sr_mj=2000",
    "microscope.width_px=320",
    "microscope.height_px=240",
)


def test_the_ellipse_moves_with_the_tip_as_geometry_says():
    world = World(
        scenes.load_scene(
            None,
            [*SCENE, "spot.incidence_deg=0", "spot.eccentricity_mm=0", "instrument.visible=false"],
        )
    )
    ellipses, by_tip, approach = ellipse_motion(world)
    # A beam square to the wall on the axis: a step of 1 mm aside moves the spot by 1/delta and
    # does not change its size; a step away changes d by 1 mm and R by 1/k.
    scale = world.scene.microscope.scale_mm_px
    jacobian = by_tip[1]
    assert abs(jacobian[0, 0]) == pytest.approx(1 / scale, rel=0.02)
    assert approach[1] == pytest.approx([0, 0, 1], abs=1e-6)
    grown = jacobian[2:4, 2] * ellipses[1].semi_minor * scale
    assert grown == pytest.approx(np.full(2, 1 / world.scene.source.cone_k), rel=0.02)


def test_a_restless_view_moves_the_ellipses_but_not_their_derivatives():
    (still, by_tip, _), (drifting, by_drifting_tip, _) = (
        ellipse_motion(World(scenes.load_scene(None, [*SCENE, *unrest])))
        for unrest in ((), ("unrest.drift_mm_s=[0.005, 0.0]",))
    )
    assert abs(drifting[2].x - still[2].x) > 1
    # Differences of ellipses that are rounded after a shift.
    np.testing.assert_allclose(by_drifting_tip, by_tip, atol=1e-6)


@pytest.fixture(scope="module")
def bounded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bound")
    return {
        exposure: scenes.render_stack(
            scenes.load_scene(
                None, [*SCENE, "exposures.bound=true", f"camera.full_well_e={exposure}"]
            ),
            Path(folder / f"{exposure}"),
        ).labels
        for exposure in (5000, 20000)
    }


def test_rendered_images_have_a_bound_that_falls_with_the_light(bounded):
    for few, many in zip(bounded[5000][1:], bounded[20000][1:], strict=True):
        assert 0 < many.bound_semi_minor_px < few.bound_semi_minor_px < 0.01
        # Four times the electrons: half of the standard deviation by shot noise alone, a quarter
        # by read noise alone.
        ratio = few.bound_semi_minor_px / many.bound_semi_minor_px
        assert 2.0 < ratio < 4.0
        assert few.bound_d_mm > 0


def test_a_sharp_spot_has_about_the_bound_of_a_uniform_disc(bounded):
    """The rendered frame against the edge's quadrature, from the labels and the light alone."""
    row = bounded[20000][2]
    a, b = row.half_max_semi_major_px, row.half_max_semi_minor_px
    # Light m falls from its level to the ambient light within the pixels of the edge, which on
    # average over the position of the edge have the information 1/variance of every level between.
    # The exact levels of the textured wall vary by a factor of two, and so does the information.
    levels = np.linspace(0.02, 0.7, 200) * 20000
    per_pixel = np.mean((0.7 * 20000) ** 2 / (levels + 10.0**2)) * 2  # colours: one and two halves
    radius = math.sqrt(1 / (2 * math.pi * math.sqrt(a * b) * per_pixel))
    assert radius * math.sqrt(3) / 3 < row.bound_semi_minor_px < radius * math.sqrt(3) * 3


@pytest.mark.parametrize(
    "change",
    ['phantom.indirect="traced"', 'phantom.spread="own"', "microscope.numerical_aperture=0.03"],
)
def test_light_with_random_numbers_has_no_bound(change, tmp_path):
    scene = scenes.load_scene(None, [*SCENE, "exposures.bound=true", change])
    with pytest.raises(SceneError, match=r"exposures\.bound needs light without random numbers"):
        scenes.render_stack(scene, tmp_path / "stack")
