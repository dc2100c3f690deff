"""Vector irradiance of a lens against closed forms, conservation laws and photons."""

from itertools import pairwise, product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from eyespot import optics
from eyespot.optics.lens_table import LensField, transmitted_power
from tests.support.drawn.made_up import a_lens
from tests.support.light.lens_quadrature import irradiance, transmittance
from tests.support.light.photons import Drop, photons

AIR, VITREOUS, GLUE = 1.0, 1.336, 1.49
DOME, FLAT = optics.load_lens("dome"), optics.load_lens("paper-candidate")


def field(lens, medium, radius, distance):
    v = optics.vector_irradiance(lens, medium_index=medium, radius=radius, distance=distance)
    return np.asarray(v[0]), np.asarray(v[1])


def nodes(first, last, count):
    x, weight = np.polynomial.legendre.leggauss(count)
    return first + (last - first) * (x + 1) / 2, weight * (last - first) / 2


def random_lens(rng):
    """A lens from a flat end to half a ball, with or without a rim, as people make them."""
    aperture = rng.uniform(0.2, 0.35)
    core = rng.uniform(0.15, min(0.3, aperture))
    sag, rim = rng.uniform(0.001, aperture), rng.uniform(0.0, 0.4)
    return optics.glue_lens(
        core_radius=core,
        aperture_radius=aperture,
        sag=sag,
        glue_length=sag + rim,
        glue_index=rng.uniform(1.45, 1.55),
        numerical_aperture=rng.uniform(0.05, 0.3),
    )


def test_a_lambertian_disc_on_its_axis():
    # Nearly all of the half-space filled, no cap: E = π L a²/(a² + d²) with L = 1/(π a² π sin²).
    a, sine = 0.25, 0.9999
    disc = a_lens(glue_length=0.0, sag=0.0, numerical_aperture=sine * GLUE)
    d = np.array([0.01, 0.1, 0.25, 1.0, 5.0, 24.0])
    lateral, axial = field(disc, GLUE, np.zeros(6), d)
    radiance = 1 / (np.pi * a**2 * np.pi * sine**2)
    within = a / np.hypot(a, d) < sine  # nearer, the cone bounds the light
    expected = np.pi * radiance * np.where(within, a**2 / (a**2 + d**2), sine**2)
    # The quadrature is made for a cone of some ten degrees; a view of 88° costs it 6e-5.
    np.testing.assert_allclose(axial, expected, rtol=1e-4)
    np.testing.assert_allclose(lateral / axial, 0.0, atol=1e-4)


@pytest.mark.parametrize("medium", [AIR, VITREOUS])
def test_near_the_flat_end_the_cone_alone_counts(medium):
    # Inside the overlap of disc and cone: E = 2π L ∫ T sin cos dθ over the cone in the medium.
    def fresnel(sine):
        return transmittance(sine * medium / GLUE, GLUE, medium)

    limit = 0.10 / medium
    integral, _ = quad(lambda q: 2 * q * fresnel(q), 0, limit, epsabs=1e-15)
    expected = integral * (medium / GLUE) ** 2 / (np.pi * 0.25**2 * (0.10 / GLUE) ** 2)
    radius = np.array([0.0, 0.05, 0.1, 0.15, 0.2])
    for distance in (1e-4, 0.01, 0.3):
        _, axial = field(FLAT, medium, radius, distance)
        np.testing.assert_allclose(axial, np.full(5, expected), rtol=1e-5)


def bare_disc(a, sine, rho, s):
    """V_s of a disc of uniform radiance within a cone, by its own one-dimensional integral."""
    reach = s * sine / np.sqrt(1 - sine**2)

    def ring(u):  # ring of radius u about the wall point's foot: s²/(s² + u²)² times its lit arc
        cos = np.clip((u**2 + rho**2 - a**2) / (2 * u * max(rho, 1e-300)), -1, 1)
        return u * s**2 / (s**2 + u**2) ** 2 * 2 * np.arccos(cos)

    ends = sorted({0.0, min(abs(a - rho), reach), min(a + rho, reach)})
    parts = (quad(ring, *pair, epsabs=1e-13, limit=200)[0] for pair in pairwise(ends))
    return sum(parts) / (np.pi * a**2 * np.pi * sine**2)


def test_an_index_matched_lens_is_no_lens():
    # The dome in a medium of its own index is a bare disc, the core's face, 0.12 mm further away.
    radius = np.array([0.01, 0.12, 0.24, 0.26, 0.3, 0.5, 0.8])
    distance = np.array([0.02, 0.1, 0.7, 0.5, 1.5, 3.0, 10.0])
    _, axial = field(DOME, GLUE, radius, distance)
    sine = 0.2 / GLUE
    expected = [bare_disc(0.25, sine, r, s + 0.12) for r, s in zip(radius, distance, strict=True)]
    peak = 1 / (np.pi * 0.25**2)
    # The corner between core and cone costs the quadrature 1e-5 of the peak.
    np.testing.assert_allclose(axial, expected, atol=2e-5 * peak)


@pytest.mark.parametrize("medium", [AIR, VITREOUS])
@pytest.mark.parametrize("name", ["dome", "paper-candidate"])
def test_every_plane_receives_the_transmitted_power(name, medium):
    lens = optics.load_lens(name)
    light = LensField(lens, medium)
    power = float(transmitted_power(lens, medium_index=medium))
    for distance in (0.05, 0.3, 1.0, 24.0):
        # The light of the dome in air reaches far out; most of it is near the axis.
        radius, weight = nodes(0.0, float(light.envelope(distance)) ** 0.5, 500)
        _, axial = light(radius=radius**2, distance=distance)
        flux = np.sum(2 * np.pi * radius**2 * np.asarray(axial) * 2 * radius * weight)
        # 500 nodes across caustics, whose edges are steep: 1e-4.
        assert flux == pytest.approx(power, rel=1e-4)


@pytest.mark.parametrize(
    ("core", "aperture", "sag", "rim", "na", "medium", "distance"),
    [
        (0.15, 0.27, 0.24, 0.0, 0.23, AIR, 3.0),  # 1.6 % of the light is off the meridian's rings
        (0.175, 0.227, 0.17, 0.32, 0.06, VITREOUS, 3.0),
        (0.25, 0.30, 0.07, 0.04, 0.15, AIR, 3.0),
        (0.211, 0.324, 0.178, 0.011, 0.185, AIR, 0.1),  # short arcs beside long ones
    ],
)
def test_a_core_narrower_than_the_cap_sends_light_where_brute_force_says(
    core, aperture, sag, rim, na, medium, distance
):
    cap = {"aperture_radius": aperture, "sag": sag, "glue_length": sag + rim}
    lens = a_lens(core_radius=core, numerical_aperture=na, **cap)
    reach = float(LensField(lens, medium).envelope(distance))
    radius = reach * np.linspace(0.05, 0.95, 12) ** 2
    expected = [irradiance(lens, medium, r, distance, steps=600) for r in radius]
    _, axial = field(lens, medium, radius, distance)
    # The referee's own error is some 2e-4 of the peak, by comparison with 900 steps.
    np.testing.assert_allclose(axial, expected, rtol=0, atol=1e-3 * max(expected))


@pytest.mark.parametrize("medium", [AIR, VITREOUS])
def test_the_field_has_no_sources(medium):
    # What enters a cylinder about the axis through its ends leaves through its side.
    radius, top, bottom = 0.15, 0.8, 1.3
    rho, weight = nodes(0.0, radius, 200)
    through = [
        np.sum(2 * np.pi * rho * weight * field(DOME, medium, rho, s)[1]) for s in (top, bottom)
    ]
    s, weight = nodes(top, bottom, 200)
    lateral, _ = field(DOME, medium, radius, s)
    leaves = np.sum(2 * np.pi * radius * weight * lateral)
    assert abs(leaves) > 0.05  # the beam narrows or widens here: the balance is not trivial
    assert through[0] - through[1] == pytest.approx(leaves, abs=2e-5)


@pytest.mark.parametrize("seed", range(10))
def test_photons_of_random_lenses_land_where_the_field_says(seed):
    rng = np.random.default_rng(seed)
    lens, medium = random_lens(rng), (AIR, VITREOUS)[seed % 2]
    count, distance = 400_000, (0.1, 0.4, 2.0)[seed % 3]
    x, y, slope_x, slope_y, weight, _ = photons(Drop.of(lens), medium, rng.random((4, count)))
    rho = np.hypot(x + distance * slope_x, y + distance * slope_y)
    edges = np.append(0.0, np.quantile(rho, [0.1, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99]))
    for first, last in pairwise(edges):
        r, area = nodes(first, last, 64)
        expected = np.sum(2 * np.pi * r * area * field(lens, medium, r, distance)[1])
        found = np.where((rho >= first) & (rho < last), weight, 0.0)
        mean = found.sum() / count
        sigma = np.sqrt((np.sum(found**2) / count - mean**2) / count)
        # 70 comparisons: 4.5 sigma is passed by chance once in 2000 runs. The 64 nodes of a ring
        # that a caustic crosses are good to 1e-3 of it.
        assert abs(mean - expected) < 4.5 * sigma + 1e-3 * expected


@pytest.mark.slow
def test_a_gaussian_launch_is_gaussian_far_away():
    # Index-matched, a core of a point's size: E ∝ exp(-2 (n sin θ / w)²) cos⁴ θ on a plane.
    width = 0.15
    flat = {"glue_length": 0.0, "sag": 0.0}
    lens = a_lens(core_radius=1e-3, numerical_aperture=0.5, launch_aperture=width, **flat)
    distance = 100.0
    angle = np.array([0.0, 0.05, 0.1, 0.2])
    _, axial = field(lens, GLUE, distance * np.tan(angle), distance)
    expected = np.exp(-2 * (GLUE * np.sin(angle) / width) ** 2) * np.cos(angle) ** 4
    # The core's size over the distance, squared, is 1e-10.
    np.testing.assert_allclose(axial / axial[0], expected, rtol=1e-6)


def test_there_is_no_light_outside_the_shadow_and_nowhere_a_nan():
    radius = np.array([0.0, 0.1, 0.25, 0.5, 1.0, 5.0])
    # In the glue's own index the two cosines of a ray from behind the cap cancel: 0/0 but for
    # rounding.
    for lens, medium in product((FLAT, DOME), (AIR, GLUE)):
        for distance in (1e-5, 1e-3, 0.1, 24.0):
            lateral, axial = field(lens, medium, radius, distance)
            assert np.all(np.isfinite(lateral)) and np.all(axial >= 0.0)
    tangent = 0.10 / np.sqrt(1 - 0.10**2)
    _, axial = field(FLAT, AIR, 0.25 + 2.0 * tangent + np.array([-1e-3, 1e-3]), 2.0)
    assert axial[0] > 0.0 and axial[1] == 0.0


def light(vector):
    core, length, aperture, sag, index, cone = vector[:6]
    lens = optics.GlueLens(core, length, aperture, sag, index, cone, None, None)
    v = optics.vector_irradiance(lens, medium_index=vector[6], radius=vector[7], distance=vector[8])
    return jnp.stack(v)


SLOPE = jax.jit(lambda vector, along: jax.jvp(light, (vector,), (along,))[1])


@pytest.mark.slow  # half a minute to compile
@pytest.mark.parametrize(
    ("core", "sag", "length", "medium"),
    [
        (0.2, 0.12, 0.2, AIR),
        (0.2, 0.12, 0.2, VITREOUS),
        (0.2, 0.0, 0.05, AIR),
        (0.22, 0.2, 0.21, VITREOUS),
    ],
)
def test_derivatives_in_every_parameter_are_those_of_differences(core, sag, length, medium):
    # Core, length, aperture, sag, glue index, NA, medium index, and the wall point.
    values = np.array([core, length, 0.25, sag, GLUE, 0.2, medium, 0.28, 1.2])
    slope = np.stack([SLOPE(jnp.array(values), along) for along in np.eye(len(values))], axis=1)
    steepest = np.abs(slope).max()
    for which in range(len(values)):
        step = np.zeros(len(values))
        step[which] = 2e-6
        ahead, behind = light(jnp.array(values + step)), light(jnp.array(values - step))
        difference = (np.asarray(ahead) - np.asarray(behind)) / 4e-6
        # Differences of differences: slopes change by their own size over 1 mm or faster, so
        # (2e-6)² times some 1e4 is left of them. Wider steps reach breaks that come and go.
        np.testing.assert_allclose(slope[:, which], difference, atol=1e-5 * steepest)
