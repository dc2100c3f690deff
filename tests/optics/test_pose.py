"""Five-parameter pose from one contour: round trips, bounds, the mirror, what is not observable."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eyespot import optics

pytestmark = pytest.mark.usefixtures("fast_compilation")

WALL = optics.Sphere(11.5)
CONE: dict[str, Any] = {"half_angle": float(np.arctan(1 / 20)), "apex_offset": -5.117}
SIGMA_PX = 0.05
SIGMAS = jnp.diag(jnp.array([0.01, 0.01, 0.01, 0.01, 0.001]) ** 2)
# With it as without one; but it is compiled with those that know something. A number of NumPy is
# traced, while one of Python would be compiled in.
NO_PRIOR = optics.DirectionPrior(jnp.array([0.0, 0.0, -1.0]), np.float64(np.inf))


GEOMETRIES = {
    "c": st.floats(0.0, 6.0),
    "d": st.floats(0.5, 6.0),
    "incidence": st.floats(5.0, 35.0),
    "azimuth": st.floats(0.0, 6.28),
    "height": st.sampled_from([11.5, 200.0, float("inf")]),
}


@jax.jit
def beam(*, incidence_deg: float, c: float = 3.0, d: float = 4.0, azimuth: float = 1.0):
    return optics.beam_at_spot(
        WALL,
        eccentricity=c,
        azimuth=0.5,
        distance=d,
        incidence=jnp.radians(incidence_deg),
        incidence_azimuth=azimuth,
        **CONE,
    )


# One program each, instead of one for each operation.
spot_contour = jax.jit(optics.spot_contour, static_argnames="points")
spot_ellipse = jax.jit(optics.spot_ellipse)
ellipse_of_contour = jax.jit(optics.ellipse_of_contour)


def eye(height: float, scale: float = 0.0065) -> optics.Microscope:
    return optics.microscope(scale=scale, pinhole_height=height, eye_radius=11.5)


def estimate(contour, height, prior=NO_PRIOR) -> optics.PoseEstimate:
    return optics.pose_from_contour(
        contour, WALL, eye(height), sigma_px=SIGMA_PX, prior=prior, **CONE
    )


def from_ellipse(ellipse, height, covariance=SIGMAS, prior=NO_PRIOR) -> optics.PoseEstimate:
    return optics.pose_from_ellipse(
        ellipse, WALL, eye(height), covariance=covariance, prior=prior, **CONE
    )


@given(**GEOMETRIES)
@settings(max_examples=150)
def test_pose_inverts_the_contour(c, d, incidence, azimuth, height):
    true = beam(incidence_deg=incidence, c=c, d=d, azimuth=azimuth)
    found = estimate(spot_contour(true, WALL, eye(height)), height).best
    np.testing.assert_allclose(found.tip, true.tip, atol=1e-8)
    np.testing.assert_allclose(found.axis, true.axis, atol=1e-8)
    np.testing.assert_allclose(found.distance, d, atol=1e-8)


@given(**GEOMETRIES)
@settings(max_examples=100)
def test_pose_inverts_the_ellipse_of_the_contour(c, d, incidence, azimuth, height):
    true = beam(incidence_deg=incidence, c=c, d=d, azimuth=azimuth)
    found = from_ellipse(
        spot_ellipse(true, WALL, eye(height)),
        height,
        # Five numbers for five parameters: the mirror fits as well, so that a prior must choose.
        prior=optics.DirectionPrior(true.axis, np.radians(5.0)),
    )
    # 32 points leave 1e-7 px; at 5 degrees a micrometre of the tip is 1e-2 px, so 1e-5 of it.
    np.testing.assert_allclose(found.best.tip, true.tip, atol=1e-7)
    np.testing.assert_allclose(found.best.distance, d, atol=1e-8)


def test_pose_from_an_ellipse_is_as_good_as_from_the_contour_that_it_was_fitted_to():
    true = beam(incidence_deg=20.0)
    clean = np.asarray(spot_contour(true, WALL, eye(200.0)))
    noise = SIGMA_PX * np.random.default_rng(0).standard_normal((2000, *clean.shape))
    ellipses = ellipse_of_contour(jnp.asarray(clean + noise))
    spread = np.cov(
        np.column_stack(
            [ellipses.centre, ellipses.semi_major, ellipses.semi_minor, ellipses.angle]
        ).T
    )
    # So wide that it chooses between the mirror solutions and tells nothing else.
    prior = optics.DirectionPrior(true.axis, np.radians(5.0))
    ellipse = spot_ellipse(true, WALL, eye(200.0))
    promised = from_ellipse(ellipse, 200.0, covariance=jnp.asarray(spread), prior=prior).best
    bound = estimate(jnp.asarray(clean), 200.0, prior=prior).best
    # The algebraic fit of a near-circle has the bound's variance but for a percent; 2000 draws
    # give standard deviations to 1.6 %.
    np.testing.assert_allclose(
        np.sqrt(np.diag(promised.covariance)), np.sqrt(np.diag(bound.covariance)), rtol=0.07
    )
    np.testing.assert_allclose(promised.distance_error, bound.distance_error, rtol=0.07)


def test_a_perfect_circle_has_a_pose():
    square = spot_ellipse(beam(incidence_deg=0.0, c=0.0), WALL, eye(200.0))
    circle = square._replace(semi_major=square.semi_minor)
    found = from_ellipse(circle, 200.0)
    np.testing.assert_allclose(found.best.distance, 4.0, atol=1e-4)


@pytest.mark.parametrize(("incidence", "tip_um"), [(10.0, (5.0, 7.0)), (30.0, (1.5, 2.5))])
def test_covariance_is_the_known_bound(incidence, tip_um):
    # Bounds from an independent computation at z_F = r, 6.5 um/px, d 3 to 6 mm, 0.05 px.
    found = estimate(spot_contour(beam(incidence_deg=incidence), WALL, eye(11.5)), 11.5).best
    error = 1e3 * float(jnp.sqrt(jnp.trace(found.covariance[:3, :3])))
    assert tip_um[0] < error < tip_um[1]
    assert 0.5 < 1e3 * float(found.distance_error) < 1.5


def test_covariance_is_the_spread_over_noise():
    true = beam(incidence_deg=20.0)
    clean = np.asarray(spot_contour(true, WALL, eye(200.0)))
    rng = np.random.default_rng(0)
    normal = clean - clean.mean(axis=0)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tips, distances = [], []
    for _ in range(200):
        noisy = clean + SIGMA_PX * rng.standard_normal((len(clean), 1)) * normal
        found = estimate(
            jnp.asarray(noisy), 200.0, prior=optics.DirectionPrior(true.axis, np.radians(5.0))
        ).best
        tips.append(np.asarray(found.tip))
        distances.append(float(found.distance))
    promised = estimate(jnp.asarray(clean), 200.0).best
    # Standard deviations from 200 draws are known to 5 %; three of those. The noise is put along
    # the radius, not the normal: at most 2 % between them here.
    np.testing.assert_allclose(
        np.std(tips, axis=0), np.sqrt(np.diag(promised.covariance)[:3]), rtol=0.17
    )
    np.testing.assert_allclose(np.std(distances), promised.distance_error, rtol=0.17)


def test_the_mirror_fits_almost_as_well_and_has_the_same_distance_but_another_tip():
    true = beam(incidence_deg=10.0)
    contour = spot_contour(true, WALL, eye(11.5))
    found = estimate(contour, 11.5)
    # Root mean square distance from the contour, px.
    assert SIGMA_PX * np.sqrt(found.mirror.cost / len(contour)) < 0.005
    assert abs(float(found.mirror.distance) - 4.0) < 0.01
    # Leaning the other way by 10 degrees at 4 mm: 2 * 4 * sin(10 deg) = 1.4 mm.
    assert 1.0 < float(jnp.linalg.norm(found.mirror.tip - true.tip)) < 2.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_prior_chooses_between_the_solution_and_its_mirror(side):
    true = beam(incidence_deg=6.0)
    contour = spot_contour(true, WALL, eye(200.0))
    free = estimate(contour, 200.0)
    wanted = free.best if side > 0 else free.mirror
    led = estimate(contour, 200.0, prior=optics.DirectionPrior(wanted.axis, np.radians(2.0))).best
    assert float(jnp.dot(led.axis, wanted.axis)) > np.cos(np.radians(0.5))


def test_square_incidence_is_not_observable_but_its_distance_is():
    found = estimate(spot_contour(beam(incidence_deg=0.0), WALL, eye(11.5)), 11.5)
    assert not bool(found.observable)
    np.testing.assert_allclose(found.best.distance, 4.0, atol=1e-4)
    assert float(found.best.distance_error) < 0.002


@pytest.mark.parametrize("height", [11.5, 200.0])
def test_tip_with_known_axis_is_found_from_half_of_a_contour(height):
    true = beam(incidence_deg=25.0)
    half = spot_contour(true, WALL, eye(height), points=256)[:128]
    known = optics.DirectionPrior(true.axis, np.float64(1e-7))  # 1e-6 mm at the tip
    found = estimate(half, height, prior=known)
    np.testing.assert_allclose(found.best.tip, true.tip, atol=1e-7)


def test_pose_on_a_tilted_plane():
    plane = optics.pole_plane(eye_radius=11.5, tilt=0.2, tilt_azimuth=0.4)
    true = optics.beam_at_spot(
        plane, eccentricity=2.0, distance=3.0, incidence=0.4, incidence_azimuth=2.0, **CONE
    )
    contour = spot_contour(true, plane, eye(200.0))
    found = optics.pose_from_contour(contour, plane, eye(200.0), sigma_px=SIGMA_PX, **CONE)
    # On a plane the mirror is exact: either of the two.
    tips = (found.best.tip, found.mirror.tip)
    assert min(float(jnp.linalg.norm(tip - true.tip)) for tip in tips) < 1e-7
    np.testing.assert_allclose(found.best.distance, 3.0, atol=1e-8)


def test_a_tightly_held_axis_does_not_collapse_the_cone_onto_the_wall():
    # A cone whose apex touches the wall has a contour of no size, which agrees with any ellipse.
    true = beam(incidence_deg=20.0)
    ellipse = spot_ellipse(true, WALL, eye(11.5))
    # Measured 1 % too large along its major axis: no cone of this axis has that ellipse.
    measured = ellipse._replace(semi_major=1.01 * ellipse.semi_major)
    prior = optics.DirectionPrior(true.axis, np.float64(1e-6))
    found = from_ellipse(measured, 11.5, prior=prior)
    # Distance follows the size of the spot: between none and 1 % of the 9 mm to the apex.
    assert 3.95 < float(found.best.distance) < 4.1
