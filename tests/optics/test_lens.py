"""The glue lens itself: its shape and presets, rays through its cap, the power that leaves it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w
from scipy.integrate import quad

from eyespot import optics
from eyespot.optics.irradiance_edges import RingRays
from eyespot.optics.lens_table import (
    MISSED_APERTURE,
    TOTAL_INTERNAL_REFLECTION,
    TRANSMITTED,
    emitted_rays,
    transmitted_power,
)
from eyespot.optics.refraction import fresnel_transmittance, refracted_cosine
from tests.support.drawn.made_up import DOME, a_lens
from tests.support.light.lens_quadrature import transmittance

pytestmark = pytest.mark.usefixtures("fast_compilation")

AIR, VITREOUS, GLUE = 1.0, 1.336, 1.49


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"sag": 0.4}, r"sag=\.\.\.\) must lie in \[0, aperture_radius\]; got sag=0.4 mm"),
        ({"sag": -0.1}, "Lower sag or raise"),
        ({"glue_length": 0.1}, "glue_length=0.1 mm, sag=0.12 mm. Raise glue_length"),
        ({"aperture_radius": 0.2}, "at least the core's radius"),
        ({"numerical_aperture": 1.5}, r"must lie in \(0, glue_index\)"),
        ({"core_radius": 0.0}, "core_radius=...\\) must lie in"),
        ({"glue_index": 15.0}, "glue_index"),
        ({"launch_radius": 0.0}, "Leave it out for a uniform core"),
    ],
)
def test_impossible_lenses_are_refused_with_the_rule_and_the_way_out(change, rule):
    with pytest.raises(ValueError, match=rule):
        a_lens(**change)


def test_presets_are_found_by_name_and_by_path(tmp_path):
    assert set(optics.lens_names()) >= {"dome", "paper-candidate"}
    assert float(optics.load_lens("paper-candidate").sag) == 0.0
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps({"schema": 1, "lens": DOME | {"launch_radius": 0.05}}))
    assert optics.load_lens(path).launch_radius == 0.05


def test_an_unknown_lens_is_answered_with_the_presets():
    with pytest.raises(ValueError, match=r"Presets: dome, .*paper-candidate"):
        optics.load_lens("no-such-lens")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("schema = 2\n[lens]\n", "schema is 2; .* Install a newer eyespot"),
        ("schema = 1\n[lens]\nsag = 0.1\nradius = 1.0\n", "wrong: radius, missing: core_radius"),
        ("schema = 1\n[lens]\nsag = true\n", "wrong: sag"),
        ("schema = [", "wrong.toml.*not a TOML file"),
    ],
)
def test_a_wrong_lens_file_is_refused_with_its_fault(tmp_path, text, reason):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=reason):
        optics.load_lens(path)


def test_the_cap_is_a_sphere_through_vertex_and_rim():
    radius_of_curvature = (0.25**2 + 0.12**2) / (2 * 0.12)
    rho = np.linspace(0.0, 0.25, 7)
    depth = np.asarray(a_lens().sagitta(rho))
    distance = np.hypot(rho, radius_of_curvature - depth)
    np.testing.assert_allclose(distance, radius_of_curvature, rtol=1e-14)
    assert depth[-1] == pytest.approx(0.12, rel=1e-14)


def test_the_flat_end_is_exact_and_has_a_slope():
    flat = a_lens(sag=0.0)
    assert np.all(np.asarray(flat.sagitta(np.linspace(0.0, 0.25, 5))) == 0.0)
    # Depth is rho² h / a² to first order in h.
    slope = jax.grad(lambda sag: a_lens(sag=sag).sagitta(0.1))(0.0)
    assert float(slope) == pytest.approx(0.1**2 / 0.25**2, rel=1e-12)


def test_fresnel_at_normal_incidence_and_at_brewsters_angle():
    def at(angle, n1, n2):
        cos = np.cos(angle)
        return float(
            fresnel_transmittance(
                cos_incident=cos,
                cos_transmitted=refracted_cosine(cos_incident=cos, index_ratio=n1 / n2),
                index_incident=n1,
                index_transmitted=n2,
            )
        )

    assert at(0.0, GLUE, AIR) == pytest.approx(1 - ((GLUE - 1) / (GLUE + 1)) ** 2, rel=1e-14)
    # At Brewster's angle nothing of p is reflected, and r_s = -cos 2θ_B there.
    brewster = np.arctan(VITREOUS / GLUE)
    expected = 1 - np.cos(2 * brewster) ** 2 / 2
    assert at(brewster, GLUE, VITREOUS) == pytest.approx(expected, rel=1e-14)
    assert at(0.9, GLUE, AIR) == 0.0


def test_emitted_rays_obey_snell_on_the_cap():
    rng = np.random.default_rng(1)
    points, directions = rng.uniform(-0.12, 0.12, (400, 2)), rng.uniform(-0.1, 0.1, (400, 2))
    rays = emitted_rays(a_lens(), medium_index=VITREOUS, points=points, directions=directions)
    assert np.all(np.asarray(rays.status) == TRANSMITTED)
    point, out = np.asarray(rays.point), np.asarray(rays.direction)
    inside = np.column_stack([directions, np.sqrt(1 - np.sum(directions**2, axis=1))])
    centre = np.array([0.0, 0.0, -(0.25**2 + 0.12**2) / 0.24])
    normal = (point - centre) / np.linalg.norm(point - centre, axis=1, keepdims=True)
    # n sin θ is kept along the surface, and the path to the cap is straight.
    np.testing.assert_allclose(
        GLUE * np.cross(inside, normal), VITREOUS * np.cross(out, normal), atol=1e-14
    )
    path = point - np.column_stack([points, np.full(400, -0.12)])
    np.testing.assert_allclose(np.cross(path, inside), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1.0, rtol=1e-14)
    sine = np.linalg.norm(np.cross(inside, normal), axis=1)
    np.testing.assert_allclose(rays.transmittance, transmittance(sine, GLUE, VITREOUS), rtol=1e-13)


def test_rays_beyond_the_critical_angle_and_beside_the_cap_say_so():
    radius_of_curvature = (0.25**2 + 0.12**2) / 0.24
    critical = radius_of_curvature / GLUE  # height at which an axial ray meets it, in air
    heights = np.array([0.999 * critical, 1.001 * critical])
    axial = np.zeros((2, 2))
    rays = emitted_rays(
        a_lens(), medium_index=AIR, points=np.column_stack([heights, np.zeros(2)]), directions=axial
    )
    assert list(rays.status) == [TRANSMITTED, TOTAL_INTERNAL_REFLECTION]
    assert float(rays.transmittance[1]) == 0.0
    beside = emitted_rays(
        a_lens(glue_length=2.0),
        medium_index=AIR,
        points=np.array([[0.2, 0.0]]),
        directions=np.array([[0.1, 0.0]]),
    )
    assert list(beside.status) == [MISSED_APERTURE]


@pytest.mark.parametrize("medium", [AIR, VITREOUS])
def test_axial_rays_meet_at_the_paraxial_focus(medium):
    dome = a_lens()
    height = 1e-4
    rays = emitted_rays(
        dome, medium_index=medium, points=np.array([[height, 0.0]]), directions=np.zeros((1, 2))
    )
    point, out = np.asarray(rays.point)[0], np.asarray(rays.direction)[0]
    crossing = point[2] - point[0] * out[2] / out[0]
    radius_of_curvature = (0.25**2 + 0.12**2) / 0.24
    focus = medium * radius_of_curvature / (GLUE - medium)
    # Spherical aberration is of the order h²/R: 1e-8/0.3 mm, times a few.
    assert crossing == pytest.approx(focus, abs=1e-6)
    assert float(dome.focal_length(medium_index=medium)) == pytest.approx(focus, rel=1e-12)


def test_a_ray_traced_forwards_is_found_again_backwards():
    rng = np.random.default_rng(2)
    # Tangential starts as well as radial ones; along x after turning the wall point there.
    points, directions = rng.uniform(-0.1, 0.1, (50, 2)), rng.uniform(-0.09, 0.09, (50, 2))
    rays = emitted_rays(a_lens(), medium_index=AIR, points=points, directions=directions)
    point, out = np.asarray(rays.point), np.asarray(rays.direction)
    wall = point + 0.7 * out
    radius, cap_radius = np.hypot(wall[:, 0], wall[:, 1]), np.hypot(point[:, 0], point[:, 1])
    turn = np.arctan2(wall[:, 1], wall[:, 0]) - np.arctan2(point[:, 1], point[:, 0])
    rays = RingRays(a_lens(), *map(jnp.asarray, (AIR, radius, wall[:, 2])))
    back = rays.trace(cap_radius, np.sin(turn / 2) ** 2)
    sine_limit, core = 0.2 / GLUE, 0.25
    # cone and face are squared ratios less 1: rounding of order 1e-15 over the ratio of distances.
    np.testing.assert_allclose(
        back.cone, np.sum(directions**2, axis=1) / sine_limit**2 - 1, atol=1e-12
    )
    np.testing.assert_allclose(back.face, np.sum(points**2, axis=1) / core**2 - 1, atol=1e-12)


@pytest.mark.parametrize("medium", [AIR, VITREOUS])
def test_power_of_the_flat_end_is_the_fresnel_integral(medium):
    flat = a_lens(sag=0.0, glue_length=0.0, numerical_aperture=0.5)
    limit = 0.5 / GLUE
    expected, _ = quad(lambda q: 2 * q * transmittance(q, GLUE, medium), 0, limit, epsabs=1e-14)
    # Gauss-Legendre of a smooth function: exact to rounding.
    power = float(transmitted_power(flat, medium_index=medium))
    assert power == pytest.approx(expected / limit**2, rel=1e-12)


@pytest.mark.parametrize("medium", [AIR, VITREOUS])
def test_power_of_a_collimated_dome_is_the_fresnel_integral_over_its_cap(medium):
    radius_of_curvature = (0.25**2 + 0.12**2) / 0.24
    edge = min(0.25, radius_of_curvature * medium / GLUE)  # the critical height, in air

    def ring(turn):  # height = edge sin(turn), since T falls like a root at the critical height
        height = edge * np.sin(turn)
        passes = transmittance(height / radius_of_curvature, GLUE, medium)
        return 2 * height * passes * edge * np.cos(turn)

    expected, _ = quad(ring, 0, np.pi / 2, epsabs=1e-13, epsrel=1e-12)
    power = float(transmitted_power(a_lens(numerical_aperture=1e-4), medium_index=medium))
    # The cone of 1e-4 changes the power by its square: 1e-8.
    assert power == pytest.approx(expected / 0.25**2, abs=1e-6)


def test_an_index_matched_cap_loses_nothing():
    assert float(transmitted_power(a_lens(), medium_index=GLUE)) == pytest.approx(1.0, abs=1e-12)


def test_a_long_drop_loses_what_meets_its_side():
    # Collimated light of a core as wide as the drop reaches the cap; a wide cone does not: from a
    # point at height p, rays within the cone leave through the rim's disc. Index-matched, so no
    # Fresnel loss; the referee counts straight rays in NumPy.
    length, cone = 1.5, 0.3
    drop = a_lens(glue_length=length, sag=0.0, numerical_aperture=cone)
    power = float(transmitted_power(drop, medium_index=GLUE))
    rng = np.random.default_rng(3)
    count = 400_000
    height = 0.25 * np.sqrt(rng.uniform(size=count))
    sine = cone / GLUE * np.sqrt(rng.uniform(size=count))
    turn = rng.uniform(0, 2 * np.pi, count)
    reach = length * sine / np.sqrt(1 - sine**2)
    passed = np.hypot(height + reach * np.cos(turn), reach * np.sin(turn)) < 0.25
    sigma = np.sqrt(passed.mean() * (1 - passed.mean()) / count)
    assert abs(power - passed.mean()) < 4 * sigma


def test_a_gaussian_launch_carries_unit_power_and_underfills_the_cone():
    # A narrow Gaussian launch sees the flat end at normal incidence: T there, to the square of its
    # width; so its radiance integrates to one.
    narrow = a_lens(sag=0.0, launch_radius=0.05, launch_aperture=0.002)
    normal = 1 - ((GLUE - AIR) / (GLUE + AIR)) ** 2
    assert float(transmitted_power(narrow, medium_index=AIR)) == pytest.approx(normal, abs=1e-6)


def test_power_has_the_derivatives_of_its_differences():
    def power(sag, index, medium):
        return transmitted_power(a_lens(sag=sag, glue_index=index), medium_index=medium)

    at = (0.11, 1.49, 1.0)
    slopes = jax.jacfwd(power, argnums=(0, 1, 2))(*at)
    for which, slope in enumerate(slopes):
        step = np.zeros(3)
        step[which] = 1e-5
        difference = (power(*(at + step)) - power(*(at - step))) / 2e-5
        # Both carry the error of the quadrature where total reflection leaves the core: 2e-5.
        assert float(slope) == pytest.approx(float(difference), rel=5e-5)
