"""The ellipsoidal retina: a sphere's case, its own equation, and NumPy's search for the foot."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from eyespot import optics

pytestmark = pytest.mark.usefixtures("fast_compilation")

AXES = np.array([11.4, 11.1, 10.1])  # about those of Atchison's emmetropic eye
TURNED = optics.Ellipsoid(AXES, shift=(0.4, -0.3), tilt=0.15, tilt_azimuth=0.8)


def rays(count):
    rng = np.random.default_rng(3)
    origin = rng.uniform(-3, 3, (count, 3))
    direction = rng.normal(size=(count, 3))
    return jnp.asarray(origin), jnp.asarray(
        direction / np.linalg.norm(direction, axis=1, keepdims=True)
    )


def test_with_equal_semi_axes_it_is_the_sphere():
    sphere, ellipsoid = optics.Sphere(11.5), optics.Ellipsoid(np.full(3, 11.5), tilt=0.3)
    ours, theirs = (wall.intersect(*rays(50)) for wall in (ellipsoid, sphere))
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)
    frames = [w.frame_at(eccentricity=3.0, azimuth=0.7) for w in (ellipsoid, sphere)]
    for a, b in zip(*frames, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)
    point = jnp.array([1.0, -2.0, -6.0])
    nearest = [float(w.nearest_distance(point)) for w in (ellipsoid, sphere)]
    assert nearest[0] == pytest.approx(nearest[1], abs=1e-12)


def own(points):
    """Points in the ellipsoid's own frame, with its tilt made by two plain rotations."""
    c, s = np.cos(0.8), np.sin(0.8)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    c, s = np.cos(0.15), np.sin(0.15)
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    turn = about_z @ about_y @ about_z.T
    return (np.asarray(points) - np.asarray(TURNED.centre)) @ turn


def test_rays_end_on_the_ellipsoid_and_normals_point_inwards():
    origin, direction = rays(50)
    hit = TURNED.intersect(origin, direction)
    assert np.all(np.asarray(hit.status) == optics.HIT)
    on_it = np.sum((own(hit.point) / AXES) ** 2, axis=1)
    np.testing.assert_allclose(on_it, 1.0, atol=1e-12)
    # The gradient of the implicit equation points outwards.
    gradient = own(hit.point) / np.square(AXES)
    normal = own(np.asarray(hit.normal) + np.asarray(TURNED.centre))
    np.testing.assert_allclose(
        normal, -gradient / np.linalg.norm(gradient, axis=1, keepdims=True), atol=1e-12
    )


def test_the_axis_meets_it_at_the_pole():
    down = jnp.array([0.0, 0.0, -1.0])
    pole = TURNED.intersect(jnp.zeros(3), down).point
    np.testing.assert_allclose(pole, [0.0, 0.0, -AXES[2]], atol=1e-12)


def test_the_frame_is_that_of_the_local_tangent():
    """Along the meridional tangent only c grows; along the azimuthal one neither height nor c
    of the tangent plane leaves the wall to first order."""
    frame = TURNED.frame_at(eccentricity=3.0, azimuth=0.7)
    assert float(jnp.hypot(*frame.origin[:2])) == pytest.approx(3.0, abs=1e-12)

    def wall_point(c):
        return TURNED.frame_at(eccentricity=c, azimuth=0.7).origin

    along = jax.jvp(wall_point, (3.0,), (1.0,))[1]
    np.testing.assert_allclose(along / jnp.linalg.norm(along), frame.meridional, atol=1e-9)
    axes = np.stack([frame.outward, frame.meridional, frame.azimuthal])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("point", [(1.0, -2.0, -6.0), (0.0, 0.0, -9.0), (4.0, 3.0, 1.0)])
def test_the_nearest_wall_point_is_what_a_search_finds(point):
    def away(angles):
        polar, azimuth = angles
        unit = np.array(
            [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
        )
        return np.linalg.norm(unit * AXES - own(point))

    starts = [(p, a) for p in (0.5, 1.5, 2.5, 3.0) for a in (0.0, 2.0, 4.0)]
    found = min(minimize(away, start, tol=1e-12).fun for start in starts)
    # The search's own precision: the square root of rounding, times the length.
    assert float(TURNED.nearest_distance(jnp.array(point))) == pytest.approx(found, abs=1e-6)
