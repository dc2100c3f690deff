"""Camera, beam, walls and the exact contour against closed forms."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eyespot import optics
from eyespot.formats.inputs import InputError

pytestmark = pytest.mark.usefixtures("fast_compilation")

R_EYE = 11.5
SCALE = 0.0067
HALF_ANGLE = float(np.arctan(1 / 20))
APEX = -5.117
BEHIND = -28.4  # kappa = -0.059/mm, a phakic eye behind a flat contact lens
HEIGHTS = (0.0, 5.0, 11.5, 30.0, 100.0, 200.0, float("inf"), BEHIND)


def camera(height: float, **kwargs) -> optics.Microscope:
    return optics.microscope(scale=SCALE, pinhole_height=height, eye_radius=R_EYE, **kwargs)


# Python's floats under the same names, so that one compilation serves all tests.
SQUARE = {"incidence": 0.0, "incidence_azimuth": 0.0, "half_angle": HALF_ANGLE, "apex_offset": APEX}
"""A cone of light square to the wall."""


@pytest.mark.parametrize("height", HEIGHTS)
def test_scale_at_the_pole_is_delta(height):
    step = camera(height).project(jnp.array([[0.0, 0.0, -R_EYE], [1.0, 0.0, -R_EYE]]))
    # One division: rounding only.
    np.testing.assert_allclose(step[1, 0] - step[0, 0], 1.0 / SCALE, rtol=1e-14)


def test_projection_agrees_with_the_pinhole_formula_of_the_frame():
    u0, v0, z_f = 320.0, 240.0, 40.0
    points = np.random.default_rng(0).uniform(-8, 8, (100, 3))
    f = (z_f + R_EYE) / SCALE
    expected = np.stack(
        [
            u0 + f * points[:, 0] / (z_f - points[:, 2]),
            v0 - f * points[:, 1] / (z_f - points[:, 2]),
        ],
        axis=1,
    )
    got = camera(z_f, principal_point=(u0, v0)).project(jnp.asarray(points))
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_telecentric_is_the_limit_of_a_high_pinhole():
    points = jnp.asarray(np.random.default_rng(1).uniform(-8, 8, (50, 3)))
    far, telecentric = (camera(h).project(points) for h in (1e9, float("inf")))
    # X/delta * (Z + r)/z_F: at most 8/0.0067 * 20/1e9 = 2.4e-5 px.
    np.testing.assert_allclose(far, telecentric, atol=3e-5)


@pytest.mark.parametrize("height", HEIGHTS)
def test_ray_of_a_pixel_passes_the_point_that_it_images(height):
    points = jnp.asarray(np.random.default_rng(2).uniform([-5, -5, -11], [5, 5, -3], (50, 3)))
    eye = camera(height, principal_point=(100.0, -50.0), distortion=(-0.05, 0.01, 1e-3, -2e-3, 0.0))
    origin, direction = eye.ray(eye.project(points))
    off = jnp.linalg.norm(jnp.cross(points - origin, direction), axis=-1)
    # Undistortion converges to 1e-12 px; times delta and a length of order one.
    assert float(off.max()) < 1e-9


def test_camera_matrix_and_distortion_are_those_of_opencv():
    cv2 = pytest.importorskip("cv2")
    distortion = (-0.12, 0.03, 2e-3, -1e-3, 0.01)
    z_f = 60.0
    eye = camera(z_f, principal_point=(310.0, 250.0), distortion=distortion)
    points = np.random.default_rng(3).uniform([-6, -6, -11.5], [6, 6, -8], (40, 3))
    # OpenCV's camera looks along +z with y down: turn the frame by half a turn about x.
    rotation, _ = cv2.Rodrigues(np.array([np.pi, 0.0, 0.0]))
    expected, _ = cv2.projectPoints(
        points,
        cv2.Rodrigues(rotation)[0],
        np.array([0.0, 0.0, z_f]),
        np.asarray(eye.camera_matrix()),
        np.array(distortion),
    )
    # Rodrigues' half turn carries 1e-9; times f of 10,000 px.
    np.testing.assert_allclose(eye.project(jnp.asarray(points)), expected[:, 0], atol=1e-4)


@pytest.mark.parametrize("height", [-R_EYE, -float("inf"), float("nan")])
def test_a_pinhole_on_the_retina_is_refused_with_the_way_out(height):
    with pytest.raises(InputError, match=r"eye_radius=11\.5 mm.* Move the pinhole"):
        camera(height)


@pytest.mark.parametrize(
    "wall", [optics.Sphere(R_EYE), optics.pole_plane(eye_radius=R_EYE, tilt=0.2)]
)
def test_beam_at_spot_meets_the_wall_there_at_that_distance_and_incidence(wall):
    tilted = SQUARE | {"azimuth": 0.7, "incidence": 0.5, "incidence_azimuth": 1.1}
    beam = optics.beam_at_spot(wall, eccentricity=3.0, distance=4.0, **tilted)
    spot = beam.spot(wall)
    np.testing.assert_allclose(spot.distance, 4.0, rtol=1e-13)
    np.testing.assert_allclose(jnp.hypot(*spot.point[:2]), 3.0, rtol=1e-13)
    np.testing.assert_allclose(-jnp.dot(spot.normal, beam.axis), np.cos(0.5), rtol=1e-13)
    assert int(spot.status) == optics.HIT


def test_rays_that_miss_or_point_away_say_so_and_stay_finite():
    origin = jnp.array([[0.0, 0.0, 30.0], [0.0, 0.0, 30.0], [0.0, 0.0, 0.0]])
    direction = jnp.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    for wall in (optics.Sphere(R_EYE), optics.pole_plane(eye_radius=R_EYE)):
        status = wall.intersect(origin, direction).status
        assert status.tolist() == [optics.MISS, optics.BEHIND, optics.HIT]
        gradient = jax.grad(lambda o, w=wall: jnp.sum(w.intersect(o, direction).point))(origin)
        assert bool(jnp.isfinite(gradient).all())


@pytest.mark.parametrize("incidence", [0.0, 0.3, 0.8])
def test_contact_is_where_the_rim_first_touches(incidence):
    rim = 0.25
    angles = np.linspace(0, 2 * np.pi, 20001)
    for wall in (optics.Sphere(R_EYE), optics.pole_plane(eye_radius=R_EYE)):
        d = optics.contact_distance(wall, incidence=incidence, rim_radius=rim)
        beam = optics.beam_at_spot(
            wall, eccentricity=4.0, distance=d, **SQUARE | {"incidence": incidence}
        )
        first, second = optics.perpendicular_frame(beam.axis)
        points = beam.tip + rim * (
            np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
        )
        gap = jax.vmap(wall.nearest_distance)(points)
        # The sampled rim misses its deepest point by rim*(pi/20000)^2/2 = 3e-9 mm.
        assert abs(float(gap.min())) < 1e-8


def test_cone_on_a_tilted_plane_is_the_closed_form_ellipse():
    # Semi-axes of a cone's section (e.g. Dandelin): with h the apex distance along the axis,
    # t = tan(alpha), s = tan(tilt): along the tilt a = h t /(cos(tilt)(1 - t^2 s^2)) and
    # across b = h t / sqrt(1 - t^2 s^2).
    tilt, d = 0.6, 3.0
    plane = optics.pole_plane(eye_radius=R_EYE, tilt=tilt)
    beam = optics.Beam(
        tip=jnp.array([0.0, 0.0, -R_EYE + d]),
        axis=jnp.array([0.0, 0.0, -1.0]),
        half_angle=0.2,
        apex_offset=-1.0,
    )
    edge = jax.jit(optics.cone_contour)(beam, plane).point
    along = jnp.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    flat = jnp.stack([edge @ along, edge[:, 1]], axis=-1)
    ellipse = jax.jit(optics.ellipse_of_contour)(flat)
    h, t, s = d + 1.0, np.tan(0.2), np.tan(tilt)
    np.testing.assert_allclose(
        ellipse.semi_major, h * t / (np.cos(tilt) * (1 - t * t * s * s)), rtol=1e-10
    )
    np.testing.assert_allclose(ellipse.semi_minor, h * t / np.sqrt(1 - t * t * s * s), rtol=1e-10)


@pytest.mark.parametrize("height", HEIGHTS)
def test_square_spot_images_as_the_closed_form_conic(height):
    kappa = 1.0 / (height + R_EYE)
    for c, d in itertools.product((0.0, 2.0, 5.0, 7.0), (0.5, 6.0)):
        got = forward_axis(camera(height), d, SQUARE | {"eccentricity": c})
        radius = optics.square_spot_radius(distance=d, k=20.0, b=APEX, eye_radius=R_EYE)
        # Semi-axes of the image of a lit circle, mm, as docs/theory/models.md derives them.
        sin_phi, above = c / R_EYE, np.sqrt(R_EYE**2 - radius**2)
        cos_phi = np.sqrt(1 - sin_phi**2)
        a, b = 1 - kappa * (R_EYE - above * cos_phi), kappa * radius * sin_phi
        meridional = (radius * cos_phi * a + above * sin_phi * b) / (a**2 - b**2)
        axes = meridional, radius / np.sqrt(a**2 - b**2)
        np.testing.assert_allclose(got, min(axes) / SCALE, rtol=1e-9, err_msg=f"c {c}, d {d}")


def test_square_spot_images_as_a_circle_from_the_sphere():
    wall, eye = optics.Sphere(R_EYE), camera(R_EYE)
    beam = optics.beam_at_spot(wall, eccentricity=6.0, distance=5.0, **SQUARE)
    contour = jax.jit(optics.spot_contour)(beam, wall, eye)
    ellipse = jax.jit(optics.ellipse_of_contour)(contour)
    radii = jnp.linalg.norm(contour - ellipse.centre, axis=-1)
    # f = 3433 px; the projection cancels nothing, so 1e-9 px is rounding with a wide margin.
    assert float(jnp.ptp(radii)) < 1e-9
    # f sin(beta) / (cos(phi) + cos(beta)) with f = 2r/delta, of which c is that of O.
    radius = optics.square_spot_radius(distance=5.0, k=20.0, b=APEX, eye_radius=R_EYE)
    cos_phi, cos_beta = (np.sqrt(1 - (x / R_EYE) ** 2) for x in (6.0, radius))
    stereographic = 2 * radius / SCALE / (cos_phi + cos_beta)
    np.testing.assert_allclose(radii, stereographic, rtol=1e-11)


def test_ellipse_of_an_ellipse_is_itself_whatever_the_spacing_of_its_points():
    rng = np.random.default_rng(5)
    low, high = [-900, -900, 60, 20, -1.5, 0.0], [900, 900, 150, 59, 1.5, 6.0]
    x, y, major, minor, angle, turn = jnp.asarray(rng.uniform(low, high, (50, 6))).T
    truth = optics.Ellipse(jnp.stack([x, y], axis=-1), major, minor, angle)

    def fitted(ellipse, turn):
        angles = jnp.arange(64) * 2 * jnp.pi / 64
        uneven = angles + 0.3 * jnp.sin(angles + turn)
        return optics.ellipse_of_contour(optics.ellipse_points(ellipse, uneven))

    for got, true in zip(jax.jit(jax.vmap(fitted))(truth, turn), truth, strict=True):
        np.testing.assert_allclose(got, true, rtol=1e-9, atol=1e-9)


def test_number_of_contour_points_does_not_move_the_ellipse():
    wall, eye = optics.Sphere(R_EYE), camera(200.0)
    wide = {"incidence": 0.6, "incidence_azimuth": 1.0, "half_angle": 0.14, "apex_offset": -1.0}
    beam = optics.beam_at_spot(wall, eccentricity=5.0, distance=6.0, **wide)
    spot_ellipse = jax.jit(optics.spot_ellipse, static_argnames="points")
    coarse, fine = (spot_ellipse(beam, wall, eye, points=n) for n in (128, 1024))
    # dt is taken from chords, whose error falls with n^2; it weighs residuals of 1e-3 of an axis.
    np.testing.assert_allclose(coarse.semi_minor, fine.semi_minor, rtol=2e-7)


WALL = optics.Sphere(R_EYE)


exact_distance = jax.jit(optics.exact_distance)


@jax.jit
def forward_axis(eye, d, beam):
    return optics.exact_semi_minor(WALL, eye, distance=d, **beam)


GEOMETRIES = {
    "c": st.floats(0.0, 6.0),
    "d": st.floats(0.3, 6.0),
    "incidence": st.floats(0.0, 0.6),
    "azimuth": st.floats(0.0, 6.28),
    "height": st.sampled_from(HEIGHTS),
}


@given(**GEOMETRIES)
@settings(max_examples=60)
def test_exact_distance_inverts_the_exact_contour(c, d, incidence, azimuth, height):
    eye = camera(height)
    beam = SQUARE | {"eccentricity": c, "incidence": incidence, "incidence_azimuth": azimuth}
    found = exact_distance(WALL, eye, semi_minor_px=forward_axis(eye, d, beam), **beam)
    np.testing.assert_allclose(found, d, atol=1e-8)
