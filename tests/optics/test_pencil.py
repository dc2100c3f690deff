"""The pencils of a microscope's pupil against exact lines of sight and Gaussian optics."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eyespot import optics
from eyespot.optics import viewing

pytestmark = pytest.mark.usefixtures("fast_compilation")

SCALE = 0.0067
PINHOLE_MM = 200.0
APERTURE = 0.02


PATHS = [("flat", "phakic"), ("wide-field-90", "aphakic")]


def seen_through(lens, *, focus, form):
    """A path, its camera, its pencils and the depth in focus."""
    eye = viewing.load_eye("navarro", wavelength_nm=555.0)
    lens = viewing.load_viewing_lens(lens)
    path = viewing.viewing_path(eye, lens, form=form, pinhole_distance=PINHOLE_MM)
    camera, pencils, depth = pencils_of(path, focus)
    return path, camera, pencils, float(depth)


def pencils_of(path, focus):
    """The camera behind a path, its pencils and the depth in focus."""
    camera = viewing.path_camera(path, scale=SCALE)
    depth = viewing.focal_depth(path, focus=focus)
    return camera, viewing.pencils(path, camera, depth=depth), depth


@pytest.mark.parametrize("lens, form", PATHS)
def test_lines_through_a_place_of_the_pupil_are_those_of_a_pinhole_there(lens, form):
    path, camera, pencils, depth = seen_through(lens, focus=1.0, form=form)
    retina = optics.Ellipsoid(path.retina_semi_axes)
    # Beside the axis, along the meridian and in between.
    aim = jnp.array([[0.0, 0.0], [0.8, 0.0], [1.2, -0.6], [0.0, 1.5]])
    flipped = jnp.array([1.0, -1.0])  # v grows towards -Y
    pixels = camera.principal_point + aim * camera.px_per_aim * flipped

    # A line through the plane in focus and a place of the pupil: a pinhole there.
    def beside(slope):
        return viewing.side_camera(path, aside=-(depth + PINHOLE_MM) * slope, scale=SCALE)

    @jax.jit
    def missed(slope, side):
        point, direction = pencils.ray(pixels, slope)
        at = side.principal_point + (aim - depth * slope) * side.px_per_aim * flipped
        ends = [retina.intersect(*ray).point for ray in ((point, direction), side.ray(at))]
        return jnp.linalg.norm(ends[0] - ends[1], axis=-1)

    slope = APERTURE * jnp.array([0.8, 0.6])
    whole, half = (missed(part, beside(part)) for part in (slope, slope / 2))
    # 1.5 % of the blur of a millimetre out of focus, 0.02 mm.
    assert whole.max() < 3e-4
    # To first order: half the slope leaves a quarter of the error, on the axis an eighth. Terms of
    # both orders may cancel.
    assert np.all(half < 0.7 * whole)


@pytest.mark.parametrize("focus", [0.0, 2.0])
@pytest.mark.parametrize("lens, form", PATHS)
def test_heights_times_angles_are_invariant_between_object_and_image(focus, lens, form):
    """Lagrange and Helmholtz: n u y is the same in front of the path and in the eye."""
    path, camera, pencils, depth = seen_through(lens, focus=focus, form=form)
    small = 1e-6
    pixel = camera.principal_point + jnp.array([small, 0.0]) * camera.px_per_aim
    focal_plane = focus + float(camera.pole_height)

    def at_focus(ray):
        point, direction = ray
        along = (focal_plane - point[2]) / direction[2]
        return point + along * direction, direction[:2] / -direction[2]

    centre, slope = at_focus(camera.ray(pixel))
    other, steeper = at_focus(pencils.ray(pixel, jnp.array([small, 0.0])))
    # In focus all lines of a pixel meet.
    np.testing.assert_allclose(other[:2], centre[:2], atol=1e-6 * small)
    height_in_air = small * (1 + depth / PINHOLE_MM)
    inside = float(path.medium_index) * (steeper[0] - slope[0]) * centre[0]
    assert float(inside) == pytest.approx(small * height_in_air, rel=1e-6)


def test_the_lens_s_gradient_is_traced_too():
    eye = viewing.load_eye("liou-brennan")
    # One layer of the lens alone, as the gradient takes long to compile.
    front, back = eye.lens[:2]
    back = viewing.Refracting(back.surface, viewing.Medium(eye.vitreous_index))
    path = viewing.ViewingPath(
        (front, back), jnp.array(1 / PINHOLE_MM), eye.axial_length, eye.retina_semi_axes
    )
    camera, pencils, _ = pencils_of(path, 0.0)
    ray = pencils.ray(camera.principal_point, jnp.array([APERTURE, 0.0]))
    # In focus on the pole.
    np.testing.assert_allclose(ray[0][:2], 0.0, atol=1e-9)


@pytest.mark.slow
def test_pencils_can_be_differentiated_by_the_eye():
    eye = viewing.load_eye("navarro", wavelength_nm=555.0)

    path = viewing.viewing_path(eye, form="aphakic")

    def spread(length):
        longer = eqx.tree_at(lambda p: p.pole_depth, path, length)
        camera, pencils, _ = pencils_of(longer, 1.0)
        point, _ = pencils.ray(camera.principal_point, jnp.array([APERTURE, 0.0]))
        return point[0]

    step = 1e-4
    lengths = eye.axial_length + step * jnp.array([-1.0, 0.0, 1.0])
    both = jax.jit(jax.vmap(lambda length: jax.jvp(spread, (length,), (jnp.ones(()),))))
    (before, _, after), (_, slope, _) = both(lengths)
    # Central differences err by the step squared.
    assert float(slope) == pytest.approx(float(after - before) / (2 * step), rel=1e-5)
