"""Light spread in the wall: against sums over discs, half planes and the wall itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import iti0k0, k0

from eyespot import optics
from tests.support.light.profiles import light_of, light_on
from tests.support.light.spread_disc import lit_by_disc, radii

pytestmark = pytest.mark.usefixtures("fast_compilation")

K, B, R_EYE = 20.0, -5.117, 11.5
CONE = {"half_angle": float(np.arctan(1 / K)), "apex_offset": B}


def half_radius(disc, length):
    """Radius at which a spread disc has half of its peak."""
    level = 0.5 * lit_by_disc(1e-9, disc, length)
    return brentq(lambda x: lit_by_disc(x, disc, length) - level, 0.2 * disc, 2 * disc)


def beam(d, *, wall, c=0.0, incidence=0.0):
    return optics.beam_at_spot(
        wall, eccentricity=c, distance=d, incidence=incidence, incidence_azimuth=0.4, **CONE
    )


def mean_radius(points):
    return float(jnp.mean(jnp.hypot(points[:, 0], points[:, 1])))


def test_all_the_light_leaves_the_wall_somewhere():
    inside, _ = quad(lambda r: r * np.exp(-r / 0.05) / 0.05**2, 0.0, 0.1)
    assert float(optics.enclosed(jnp.array(0.1), 0.05)) == pytest.approx(inside, abs=1e-12)
    assert float(optics.enclosed(jnp.array(5.0), 0.05)) == pytest.approx(1.0, abs=1e-12)
    offsets, weights = optics.spread_nodes()
    assert weights.sum() == pytest.approx(1.0, abs=1e-14)
    # Moments of a plane exponential: <x^2> = <y^2> = 3 L^2, <x^2 y^2> = 15 L^4.
    x, y = offsets.T
    assert weights @ x**2 == pytest.approx(3.0, rel=1e-12)
    assert weights @ (x * y) ** 2 == pytest.approx(15.0, rel=1e-12)


@pytest.mark.parametrize("x", [-0.1, -0.02, 0.0, 0.05])
def test_a_half_plane_is_the_closed_form(x):
    # Of a cone so far away that its edge is straight; the line spread |x| K1(|x|/L)/(pi L^2) sums
    # up to (t K0(t) + pi/2 - int_0^t K0)/pi.
    length = 0.05
    t = abs(x) / length
    tail = ((t * k0(t) if t else 0.0) + np.pi / 2 - iti0k0(t)[1]) / np.pi
    expected = tail if x > 0 else 1.0 - tail
    far = optics.Beam(
        tip=jnp.array([0.0, 0.0, 1e4]),
        axis=jnp.array([0.0, 0.0, -1.0]),
        half_angle=jnp.arctan(0.01),
        apex_offset=jnp.array(0.0),
    )
    point, outward = jnp.array([100.0 + x, 0.0, 0.0]), jnp.array([0.0, 0.0, -1.0])
    # The edge bends by L^2/2R = 1e-5 mm, 2e-4 of L; 128 directions see the edge's kink to 1e-4.
    found = optics.lit_share(far, point, outward, length)
    assert float(found) == pytest.approx(expected, abs=4e-4)


@pytest.mark.parametrize("length", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("d", [0.5, 2.0, 6.0])
def test_a_square_cones_contours_are_those_of_a_spread_disc(length, d):
    wall = optics.pole_plane(eye_radius=R_EYE)
    edge, half_max = optics.spread_contours(None, beam(d, wall=wall), wall, length)
    disc = (d - B) / K
    # Rings by the midpoint rule: 1e-4 of the light, 1e-4 of L in the radius, and the kinks.
    assert mean_radius(half_max) == pytest.approx(half_radius(disc, length), abs=4e-4 * length)
    at_edge = brentq(lambda x: lit_by_disc(x, disc, length) - 0.5, 0.2 * disc, 2 * disc)
    assert mean_radius(edge) == pytest.approx(at_edge, abs=4e-4 * length)


def test_fifty_micrometres_cost_a_sharp_cone_a_tenth_of_a_millimetre():
    wall = optics.Sphere(R_EYE)
    lost = {}
    for length in (0.05, 0.1):
        for d in (0.5, 2.0, 4.0, 6.0):
            pose = beam(d, wall=wall)
            _, half_max = optics.spread_contours(None, pose, wall, length)
            edge = optics.cone_contour(pose, wall).point
            lost[length, d] = K * (mean_radius(half_max) - mean_radius(edge))
    near = [lost[0.05, d] for d in (0.5, 2.0, 4.0, 6.0)]
    # As an independent sum over a disc has it: -0.15 to -0.09 mm, and -0.30 at most for 0.1 mm.
    assert near == pytest.approx([-0.148, -0.134, -0.110, -0.091], abs=1e-3)
    assert min(lost[0.1, d] for d in (0.5, 2.0, 4.0, 6.0)) == pytest.approx(-0.296, abs=1e-3)


def test_a_tilted_lens_spot_is_spread_as_a_brute_sum_over_the_wall():
    bell = 1.0 / (1.0 + jnp.exp((jnp.linspace(0.0, 1.0, 129) - 0.5) / 0.05))
    table = light_of(bell, contact=0.5, aside=0.2)
    wall, length = optics.pole_plane(eye_radius=R_EYE), 0.05
    pose = beam(2.0, wall=wall, incidence=0.5)
    _, half_max = optics.spread_contours(table, pose, wall, length)
    light = jax.jit(lambda points: light_on(table, pose, points, jnp.array([0.0, 0.0, 1.0])))
    ring, turn = np.meshgrid(radii(length, 400), np.arange(64) * (2 * np.pi / 64))
    aside = np.stack([ring * np.cos(turn), ring * np.sin(turn), 0 * ring], axis=-1).reshape(-1, 3)
    found = np.array([float(jnp.mean(light(p + aside))) for p in half_max[::16]])
    centre = jnp.array([0.0, 0.0, -R_EYE])
    steps = np.linspace(-0.3, 0.3, 11)
    grid = [centre + jnp.array([x, y, 0.0]) for x in steps for y in steps]
    peak = max(float(jnp.mean(light(p + aside))) for p in grid)
    # The grid misses the flat peak by up to 2e-3; the table's cells are 4 um wide.
    assert found == pytest.approx(0.5 * peak, rel=4e-3)


def test_light_spread_beyond_the_spot_has_no_contour():
    wall = optics.pole_plane(eye_radius=R_EYE)
    edge, _ = optics.spread_contours(None, beam(0.5, wall=wall), wall, 1.0)
    assert np.isnan(edge).all()
