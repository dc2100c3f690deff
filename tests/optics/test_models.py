"""The models against the exact geometry and against figures found by another program."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eyespot import optics

pytestmark = pytest.mark.usefixtures("fast_compilation")

R_EYE, SCALE, K, B = 11.5, 0.0067, 20.0, -5.117
CONE = {"half_angle": float(np.arctan(1 / K)), "apex_offset": B}
KNOWN = {"scale": SCALE, "k": K, "b": B, "eye_radius": R_EYE}


def exact(height, *, d, c):
    """e1' of the exact contour, px."""
    eye = optics.microscope(scale=SCALE, pinhole_height=height, eye_radius=R_EYE)
    return exact_semi_minor(optics.Sphere(R_EYE), eye, distance=d, eccentricity=c, **CONE)


# One program each, instead of one for each operation.
exact_semi_minor = jax.jit(optics.exact_semi_minor)


# Errors of small_plane at c = 3 mm, mm, from an independent computation (three decimals given).
ROWS = {
    11.5: {0.5: -0.098, 2.0: -0.124, 4.0: -0.157, 6.0: -0.190},
    100.0: {0.5: -0.325, 2.0: -0.412, 4.0: -0.528, 6.0: -0.643},
}


@pytest.mark.parametrize(
    ("height", "d", "error"), [(h, d, e) for h, r in ROWS.items() for d, e in r.items()]
)
def test_small_plane_is_off_by_the_known_rows(height, d, error):
    axis = exact(height, d=d, c=3.0)
    estimate = optics.small_plane_distance(semi_minor_px=axis, eccentricity=3.0, **KNOWN)
    # Half a unit of the third decimal, and a hair for 0.18960 printed as 0.190.
    assert float(estimate) - d == pytest.approx(error, abs=5.1e-4)


# From the lowest pinhole a spot is seen under the steepest angle: 6.0 um at c = 5 mm.
LIMITS = {0.0: 0.0061} | dict.fromkeys((5.0, 11.5, 30.0, 100.0, float("inf")), 0.005)


@pytest.mark.parametrize(("height", "limit"), LIMITS.items())
@pytest.mark.parametrize("c", [0.0, 2.5, 5.0])
def test_corrected_is_within_some_micrometres_for_spots_to_0_4_mm(height, limit, c):
    d = 2.885  # R = 0.400 mm
    estimate = optics.closed_form_distance(
        "corrected",
        semi_minor_px=exact(height, d=d, c=c),
        eccentricity=c,
        inverse_working_distance=1.0 / (height + R_EYE),
        **KNOWN,
    )
    assert abs(float(estimate) - d) < limit


@pytest.mark.parametrize("c", [0.0, 3.0, 7.0])
def test_stereographic_is_exact_from_the_sphere(c):
    for d in (0.5, 6.0):
        axis = exact(R_EYE, d=d, c=c)
        estimate = optics.closed_form_distance(
            "stereographic",
            semi_minor_px=axis,
            eccentricity=c,
            inverse_working_distance=1 / (2 * R_EYE),
            **KNOWN,
        )
        # Rounding of e1' (1e-13 relative) times k delta e1' of 11 mm.
        np.testing.assert_allclose(estimate, d, atol=1e-10)


def test_small_plane_is_right_to_first_order_for_a_pinhole_at_the_centre():
    for c in (1.0, 3.0):
        axis = exact(0.0, d=6.0, c=c)
        estimate = optics.small_plane_distance(semi_minor_px=axis, eccentricity=c, **KNOWN)
        assert abs(float(estimate) - 6.0) < 0.014


@pytest.mark.parametrize("model", optics.CLOSED_FORMS)
def test_a_closed_form_is_the_same_in_numpy_and_in_jax(model):
    given = KNOWN | {"inverse_working_distance": 0.01}
    size, c = np.linspace(20.0, 90.0, 8), np.linspace(0.0, 7.0, 8)
    plain = optics.closed_form_distance(model, semi_minor_px=size, eccentricity=c, **given)
    traced = jax.jit(
        lambda size, c: optics.closed_form_distance(
            model, semi_minor_px=size, eccentricity=c, **given
        )
    )(size, c)
    assert isinstance(plain, np.ndarray)
    # Rounding of a few operations on numbers of some 20 mm.
    np.testing.assert_allclose(traced, plain, atol=1e-13)


def test_an_unknown_closed_form_is_refused_by_name():
    zero = dict.fromkeys(("semi_minor_px", "scale", "k", "b", "eccentricity", "eye_radius"), 0.0)
    with pytest.raises(ValueError, match="planar, small_plane, corrected, stereographic"):
        optics.closed_form_distance("exact", **zero, inverse_working_distance=0.0)


@pytest.mark.parametrize("height", [0.0, 11.5, 200.0, float("inf"), -28.4])
def test_the_closed_form_of_a_line_of_sight_meets_the_sphere_where_the_ray_does(height):
    eye = optics.microscope(scale=SCALE, pinhole_height=height, eye_radius=R_EYE)
    right, down = np.array([-700.0, 0.0, 300.0]), np.array([100.0, 0.0, -500.0])
    point = optics.eyeball_point(
        right_px=right,
        down_px=down,
        scale=SCALE,
        eye_radius=R_EYE,
        inverse_working_distance=1.0 / (height + R_EYE),
    )
    principal = np.asarray(eye.principal_point)
    ray = eye.ray(np.stack([right, down], axis=-1) + principal)
    # Rounding: some ten operations on numbers of up to 200 mm.
    np.testing.assert_allclose(point.T, optics.Sphere(R_EYE).intersect(*ray).point, atol=1e-11)


def test_models_agree_at_the_pole_up_to_the_sagitta():
    axis = jnp.linspace(30.0, 90.0, 7)
    planar = optics.planar_distance(semi_minor_px=axis, scale=SCALE, k=K, b=B)
    small = optics.small_plane_distance(semi_minor_px=axis, eccentricity=0.0, **KNOWN)
    sagitta = optics.sagitta(spot_radius=SCALE * axis, eye_radius=R_EYE)
    np.testing.assert_allclose(small - planar, sagitta, rtol=1e-9)
    # Series of r - sqrt(r^2 - R^2) to fourth order; the next term is R^6/16r^5 = 1.5e-8 mm.
    radius = SCALE * np.asarray(axis)
    series = radius**2 / (2 * R_EYE) + radius**4 / (8 * R_EYE**3)
    np.testing.assert_allclose(sagitta, series, atol=2e-8)


def test_planar_and_square_models_invert():
    d = jnp.linspace(0.2, 6.0, 30)
    axis = (d - B) / (SCALE * K)  # the radius of a cone's section, in pixels
    np.testing.assert_allclose(optics.planar_distance(semi_minor_px=axis, scale=SCALE, k=K, b=B), d)
    radius = optics.square_spot_radius(distance=d, k=K, b=B, eye_radius=R_EYE)
    again = optics.sphere_distance(spot_radius=radius, k=K, b=B, eye_radius=R_EYE)
    np.testing.assert_allclose(again, d, atol=1e-12)


def test_the_papers_dropped_angle_is_87_5_degrees_at_the_edge_of_its_view():
    # "the minimum value of S'DE is more than 87.5 degrees" for a view of 10 mm (c = 5) and spots
    # of about 1 mm radius and less (Zhou et al. 2020, below eq. 8).
    angle = optics.paper_angle_s_d_e(eccentricity=5.0, eye_radius=11.5, spot_radius=0.95)
    assert 87.4 < np.degrees(float(angle)) < 87.6


@pytest.mark.parametrize("pupil", [0.0, 3.0])
def test_indirect_light_of_an_eye_keeps_the_energy(pupil):
    # What the wall absorbs and what leaves through the cap of height h is what the source gives;
    # all direct light falls on the wall.
    flux, rho = 2.0, np.array([0.1, 0.6, 0.9])
    indirect = optics.indirect_irradiance(
        flux=flux, reflectance=rho, eye_radius=R_EYE, pupil_radius=pupil
    )
    cap = 2 * np.pi * R_EYE * (R_EYE - np.sqrt(R_EYE**2 - pupil**2))
    wall = 4 * np.pi * R_EYE**2 - cap
    absorbed, lost = (1 - rho) * (flux + indirect * wall), indirect * cap
    np.testing.assert_allclose(absorbed + lost, flux, rtol=1e-14)
