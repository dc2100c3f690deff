"""The table of a lens's light: as good as it promises, and the radii from it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from eyespot import optics
from eyespot.optics.lens_table import LensField
from eyespot.scenes.world.world import lens_light
from tests.support.drawn.made_up import a_lens
from tests.support.light.photons import Drop, counted_light
from tests.support.light.profiles import light_of

AIR, VITREOUS = 1.0, 1.336
CONTACT, SLOPE = 0.25, 0.1


@functools.cache
def table_of(lens, medium):
    """The table from the cache on disk, where other tests' scenes leave it."""
    return lens_light(lens, medium).table


FLAT, DOME = "paper-candidate", "dome"


@pytest.mark.parametrize(
    ("lens", "medium"),
    [
        (FLAT, AIR),
        (DOME, AIR),
        pytest.param(FLAT, VITREOUS, marks=pytest.mark.slow),
        pytest.param(DOME, VITREOUS, marks=pytest.mark.slow),
    ],
)
def test_a_table_is_that_of_photons(lens, medium):
    """Both components and the flux through planes, against a tracer that shares no code."""
    table = table_of(lens, medium)
    rings, planes, nearest, farthest = 40, 5, 0.3, 6.0
    light = counted_light(
        Drop.of(optics.load_lens(lens)),
        float(table.medium_index),
        nearest=nearest,
        farthest=farthest,
        contact=CONTACT,
        slope=0.8 * float(table.slope),
        count=1 << 22,
        planes=planes,
        rings=rings,
    )
    parts = (np.arange(rings)[:, None] + (np.arange(16) + 0.5) / 16) / rings
    for k, distance in enumerate(np.geomspace(nearest, farthest, planes)):
        radius = parts * light.reach(distance)
        found = np.stack(table(radius=radius, distance=np.full_like(radius, distance)))
        found = np.sum(found * radius, axis=-1) / radius.sum(axis=-1) * light.reach(distance) ** 2
        counted = light.rings[:, k]
        off = (found - counted) / counted[1].max()
        area = 2 * np.arange(rings) + 1
        # Of the 1,600 equal areas of all rings, the innermost have one to seven: two seeds of the
        # photons differ by up to 4e-3 there, and by 1e-3 in other rings.
        assert np.abs(off[:, 4:]).max() < 3e-3
        assert np.abs(off[:, :4]).max() < 1e-2
        # Over tens of rings they differ by up to 1e-4, over all by 2e-5.
        tens = (off * area).reshape(2, 4, 10).sum(axis=2) / area.reshape(4, 10).sum(axis=1)
        assert np.abs(tens).max() < 4e-4
        assert abs(np.sum((found[1] - counted[1]) * area)) < 1e-4 * np.sum(counted[1] * area)


def test_no_light_behind_the_tip_and_inverse_square_beyond_the_last_row():
    flat = table_of(FLAT, AIR)
    assert float(flat(radius=0.0, distance=-0.1)[1]) == 0.0
    far = np.array([24.0, 48.0, 96.0])
    e = np.asarray(flat.envelope(far))
    axial = np.asarray(flat(radius=0.3 * e, distance=far)[1])
    np.testing.assert_allclose(axial * e**2, axial[0] * e[0] ** 2, rtol=1e-12)


@pytest.mark.slow
def test_look_ups_near_a_focus_are_right_for_a_camera():
    """Means over a pixel's width of rings: the edge of the core's image moves from row to row."""
    cap = {"aperture_radius": 0.2738, "sag": 0.0171, "glue_length": 0.0171}
    lens = a_lens(core_radius=0.2498, numerical_aperture=0.1733, **cap)
    table, exact = optics.irradiance_table(lens, medium_index=AIR), LensField(lens, AIR)
    pixel, parts = 0.0134, 16
    for distance in (3.9, 4.2, 4.5, 5.2):
        rings = int(exact.envelope(distance) / pixel)
        radius = (np.arange(rings * parts) + 0.5).reshape(rings, parts) * pixel / parts
        at = {"radius": radius, "distance": np.full_like(radius, distance)}
        found, true = (np.sum(light(**at)[1] * radius, axis=1) for light in (table, exact))
        area = radius.sum(axis=1)
        # A pixel's noise is 1.6 % of a well exposed peak; a ring of a thousand averages to 5e-4.
        assert np.abs((found - true) / area).max() < 1e-3 * (true / area).max()


@pytest.fixture(scope="module")
def tent():
    """Light that falls linearly from the axis to the envelope: V_s e² = 1 - rho/e."""
    return light_of(1.0 - jnp.linspace(0.0, 1.0, 65), contact=CONTACT, slope=SLOPE)


def test_radii_of_a_tent_are_where_it_says(tent):
    d = np.array([0.02, 0.5, 6.0])
    e = CONTACT + SLOPE * d
    np.testing.assert_allclose(optics.half_maximum_radius(tent, distance=d), 0.5 * e, rtol=1e-12)
    # V = (1 - R/e)/e² = level.
    level = 1.1
    expected = np.maximum(e * (1 - level * e**2), 0.0)
    found = optics.isophote_radius(tent, distance=d, level=level)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert float(optics.isophote_radius(tent, distance=6.0, level=10.0)) == 0.0


def test_the_effective_cone_of_a_tent_is_its_own(tent):
    # R = e/2 = (s - b)/k with k = 2/slope, b = -contact/slope.
    cone = optics.effective_cone(tent, from_distance=0.3, to_distance=5.0)
    assert float(cone.k) == pytest.approx(2 / SLOPE, rel=1e-10)
    assert float(cone.b) == pytest.approx(-CONTACT / SLOPE, rel=1e-10)
    assert float(cone.half_angle) == pytest.approx(np.arctan(SLOPE / 2), rel=1e-10)
    assert float(cone.r_squared) == pytest.approx(1.0, abs=1e-10)
    assert optics.ambiguous_distances(tent, from_distance=0.3, to_distance=5.0) == []


def test_the_flat_ends_half_maximum_is_that_of_two_overlapping_discs():
    # Far enough to be paraxial, E is the overlap of the core's disc and the cone's: circles of
    # radius a and d tan θ about the axis and the wall point.
    def overlap(rho, a, c):
        if rho >= a + c:
            return 0.0
        if rho <= abs(a - c):
            return np.pi * min(a, c) ** 2
        first = np.arccos((rho**2 + a**2 - c**2) / (2 * rho * a))
        second = np.arccos((rho**2 + c**2 - a**2) / (2 * rho * c))
        chord = 0.5 * np.sqrt((-rho + a + c) * (rho + a - c) * (rho - a + c) * (rho + a + c))
        return a**2 * first + c**2 * second - chord

    for d in (0.3, 1.0, 2.5, 4.0):
        reach = d * 0.10 / np.sqrt(1 - 0.10**2)
        half = 0.5 * overlap(0.0, 0.25, reach)
        expected = brentq(lambda rho: overlap(rho, 0.25, reach) - half, 1e-6, 2.0)  # noqa: B023
        found = float(optics.half_maximum_radius(table_of(FLAT, AIR), distance=d))
        # cos⁴ of 5.7° is 2 % less than 1 across the cone; half of that on the radius's slope.
        assert found == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize(
    ("medium", "k", "b", "r_squared"),
    [
        (AIR, (4.1, 4.3), (0.2, 0.32), 0.9965),
        pytest.param(VITREOUS, (7.2, 7.7), (-0.45, -0.25), 0.9945, marks=pytest.mark.slow),
    ],
)
def test_the_domes_effective_cones_are_those_traced_elsewhere(medium, k, b, r_squared):
    # k 4.1-4.3, b 0.2...0.3, R² 0.997 in air and k 7.4-7.7, b about -0.4 in vitreous, from a dozen
    # distances between 0.5 and 6 mm; more distances near the vitreous's waist lower k to 7.3.
    cone = optics.effective_cone(table_of(DOME, medium), from_distance=0.5, to_distance=6.0)
    assert k[0] < float(cone.k) < k[1]
    assert b[0] < float(cone.b) < b[1]
    assert float(cone.r_squared) > r_squared


def test_one_radius_at_two_distances_is_called_ambiguous():
    flat = table_of(FLAT, AIR)
    intervals = optics.ambiguous_distances(flat, from_distance=0.1, to_distance=6.0)
    # The radius shrinks from contact to 2.5 mm and passes its contact value again near 2.9 mm.
    assert len(intervals) == 1
    first, last = intervals[0]
    assert first == pytest.approx(0.1, abs=0.01) and 2.6 < last < 3.2
    radii = optics.half_maximum_radius(flat, distance=np.array([0.1, last]))
    # Neighbouring samples are 5 µm of distance apart, at a slope of 0.1: 1 µm.
    assert float(radii[0]) == pytest.approx(float(radii[1]), abs=2e-3)
    assert optics.ambiguous_distances(flat, from_distance=3.5, to_distance=8.0) == []


@pytest.mark.slow
def test_the_dome_has_a_waist_in_vitreous_near_0_7_mm():
    d = np.linspace(0.2, 2.0, 181)
    radius = np.asarray(optics.half_maximum_radius(table_of(DOME, VITREOUS), distance=d))
    assert 0.6 < d[radius.argmin()] < 0.8


@pytest.mark.slow
def test_the_half_maximum_follows_the_lens_with_the_right_slope():
    def radius(sag):
        lens = a_lens(sag=sag, glue_length=0.15)
        return optics.half_maximum_radius(LensField(lens, AIR), distance=3.0)

    slope = float(jax.jacfwd(radius)(0.12))
    step = 1e-3
    difference = (float(radius(0.12 + step)) - float(radius(0.12 - step))) / (2 * step)
    # The profile is joined by straight lines of e/1024, 4 µm: 1e-2 of a slope near 3.
    assert slope == pytest.approx(difference, rel=2e-2)
