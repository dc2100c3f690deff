"""A pinhole beside the axis, against one on the axis, a closed form and its own inverse."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from eyespot import optics
from eyespot.formats.inputs import InputError
from eyespot.optics import viewing

pytestmark = pytest.mark.usefixtures("fast_compilation")

RADIUS, SCALE = 12.0, 0.0134
POINTS = np.array([[0.0, 0.0, -12.0], [1.0, 2.0, -11.0], [-2.0, -2.0, -8.0]])


THICK = viewing.Refracting(viewing.Conic(depth=-25.0, curvature=0.02), viewing.Medium(1.49))


def path_to(lens, **options):
    return viewing.viewing_path(viewing.load_eye("navarro", wavelength_nm=550.0), lens, **options)


def flat_path(**options):
    return path_to(viewing.load_viewing_lens("flat"), **options)


@pytest.mark.parametrize("lens", [viewing.load_viewing_lens("flat"), THICK])
def test_a_side_camera_on_the_axis_is_the_paths_camera(lens):
    path = path_to(lens)
    on_axis = viewing.path_camera(path, scale=SCALE)
    beside = viewing.side_camera(path, aside=(0.0, 0.0), scale=SCALE)
    # The camera's series holds lines of sight to 1e-8 mm, 1e-6 px.
    np.testing.assert_allclose(beside.project(POINTS), on_axis.project(POINTS), atol=1e-6)
    assert np.all(beside.sees(POINTS[:2]))


def test_a_pixel_sees_the_point_that_is_projected_onto_it():
    camera = viewing.side_camera(flat_path(), aside=(9.6, 2.0), scale=SCALE)
    point, direction = camera.ray(camera.project(POINTS))
    along = (POINTS[:, 2:] - point[:, 2:]) / direction[:, 2:]
    # Six of Newton's steps end in rounding.
    np.testing.assert_allclose(point + along * direction, POINTS, atol=1e-12)
    assert np.all(camera.sees(POINTS))
    # Navarro's eye behind a 3 mm lens shows c < 5 mm; the iris hides what lies farther out.
    assert not camera.sees(jnp.array([9.0, 0.0, -7.9]))
    assert camera.transmittance(camera.project(jnp.array([9.0, 0.0, -7.9]))) == 0.0


@pytest.mark.parametrize("aside", [(-10.0, 0.0), (3.0, 7.0)])
def test_without_optics_lines_of_sight_are_straight_lines_from_the_pinhole(aside):
    height = 200.0
    path = viewing.bare_path(eye_radius=RADIUS, pinhole_height=height)
    camera = viewing.side_camera(path, aside=aside, scale=SCALE)
    pinhole = np.array([*aside, height])
    # Where the line from the pinhole through a point crosses the plane of the cornea's vertex.
    share = (height - RADIUS) / (height - POINTS[:, 2:])
    aim = (pinhole + share * (POINTS - pinhole))[:, :2]
    px_per_mm = (height + RADIUS) / (height - RADIUS) / SCALE
    np.testing.assert_allclose(
        camera.project(POINTS), aim * px_per_mm * np.array([1.0, -1.0]), atol=1e-9
    )


def test_a_pair_has_the_scale_of_the_microscope_between_its_halves():
    """A step along X at the pole covers the same number of pixels in all three."""
    path = viewing.bare_path(eye_radius=RADIUS, pinhole_height=200.0)
    pole = np.array([[0.0, 0.0, -RADIUS], [0.01, 0.0, -RADIUS]])
    microscope = optics.microscope(scale=SCALE, pinhole_height=200.0, eye_radius=RADIUS)
    for x in (-10.0, 0.0, 10.0):
        camera = viewing.side_camera(path, aside=(x, 0.0), scale=SCALE)
        step = np.diff(np.asarray(camera.project(pole)), axis=0)
        np.testing.assert_allclose(
            step, np.diff(np.asarray(microscope.project(pole)), axis=0), atol=1e-9
        )


def test_a_window_can_be_centred_on_a_point():
    camera = viewing.side_camera(
        viewing.bare_path(eye_radius=RADIUS, pinhole_height=200.0), aside=(9.0, 0.0), scale=SCALE
    )
    centred = eqx.filter_jit(lambda c: c.centred_on(jnp.asarray(POINTS[1]), width=640, height=480))
    np.testing.assert_allclose(centred(camera).project(POINTS[1]), [319.5, 239.5], atol=1e-9)


def test_a_telecentric_pinhole_cannot_be_beside_the_axis():
    path = flat_path(pinhole_distance=np.inf)
    with pytest.raises(InputError, match="needs a pinhole at a finite height"):
        viewing.side_camera(path, aside=(1.0, 0.0), scale=SCALE)
