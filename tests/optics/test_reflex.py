"""Reflexes at the surfaces of viewing paths against mirror formulas and matrices."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from eyespot.optics import viewing

pytestmark = pytest.mark.usefixtures("fast_compilation")

DISTANCE_MM = 200.0


def path_to(lens=None, *, distance=DISTANCE_MM):
    return viewing.viewing_path(
        viewing.load_eye("navarro", wavelength_nm=555.0),
        None if lens is None else viewing.load_viewing_lens(lens),
        pinhole_distance=distance,
    )


def test_off_the_axis_a_sphere_reflects_by_the_law_of_reflection():
    # The same path with a sphere as the cornea's front.
    path = eqx.tree_at(lambda p: p.elements[0].surface.asphericity, path_to(), jnp.zeros(()))
    radius = 1 / float(path.elements[0].surface.curvature)
    aim = 2.0
    pinhole, towards = np.array([0.0, DISTANCE_MM]), np.array([aim, 0.0])
    ray = (towards - pinhole) / np.linalg.norm(towards - pinhole)
    # Height counts upwards from the vertex, so the centre lies below it.
    from_centre = pinhole - np.array([0.0, -radius])
    b = ray @ from_centre
    point = from_centre + (-b - np.sqrt(b * b - from_centre @ from_centre + radius**2)) * ray
    normal = point / radius
    out = ray - 2 * (ray @ normal) * normal
    at = point + np.array([0.0, -radius])
    expected = at[0] + out[0] / out[1] * (DISTANCE_MM - at[1])
    found = viewing.reflexes(path)[0].place(jnp.array([aim, 0.0]))
    # A series of 28 terms.
    np.testing.assert_allclose(np.asarray(found), [expected, 0.0], rtol=1e-8)


def matrix_image(path, number):
    """Place to which a paraxial line returns, per mm of aim, by matrices of height and slope."""
    surfaces = [e for e in path.elements if isinstance(e, viewing.Refracting)]
    depths = [float(e.surface.depth) for e in surfaces]
    curvatures = [float(e.surface.curvature) for e in surfaces]
    indices = [1.0, *(float(e.medium.index) for e in surfaces)]

    def move(length):
        return np.array([[1.0, length], [0.0, 1.0]])

    def refract(k, *, back):
        front, behind = indices[k], indices[k + 1]
        curvature = -curvatures[k] if back else curvatures[k]
        if back:
            front, behind = behind, front
        return np.array([[1.0, 0.0], [-(behind - front) / behind * curvature, front / behind]])

    ray = np.array([1.0 + depths[0] / DISTANCE_MM, 1.0 / DISTANCE_MM])
    for k in range(number):
        ray = move(depths[k + 1] - depths[k]) @ refract(k, back=False) @ ray
    # Seen upside down, a mirror that is convex from above adds 2/R to the slope.
    ray = ray + np.array([0.0, 2.0 * curvatures[number] * ray[0]])
    for k in reversed(range(number)):
        ray = refract(k, back=True) @ move(depths[k + 1] - depths[k]) @ ray
    return (move(DISTANCE_MM + depths[0]) @ ray)[0]


@pytest.mark.parametrize("lens", [None, "flat"])
def test_all_images_lie_where_gaussian_optics_puts_them(lens):
    path = path_to(lens)
    found = viewing.reflexes(path)
    assert len(found) == (4 if lens is None else 5)
    for number, reflex in enumerate(found):
        small = 1e-4
        place = float(reflex.place(jnp.array([small, 0.0]))[0]) / small
        assert place == pytest.approx(matrix_image(path, number), rel=1e-6)


def test_on_the_axis_fresnel_says_how_bright():
    path = path_to("flat")
    indices = [1.0, *(float(e.medium.index) for e in path.elements if hasattr(e, "medium"))]
    left = 1.0
    for reflex, front, behind in zip(
        viewing.reflexes(path), indices[:-1], indices[1:], strict=True
    ):
        reflected = ((front - behind) / (front + behind)) ** 2
        assert float(reflex.part(jnp.zeros(2))) == pytest.approx(
            left * reflected, rel=1e-8
        )  # of the series
        left *= (1 - reflected) ** 2


def test_a_gradient_lens_bends_light_on_its_way_back_as_on_its_way_there():
    medium = viewing.load_eye("liou-brennan").lens[0].medium
    back = medium.reversed(1.59)
    places = np.linspace(0.0, 1.59, 5)

    def indices(medium, depths):
        points = jnp.stack([jnp.full(5, 0.7), jnp.zeros(5), jnp.asarray(depths)], axis=-1)
        return np.asarray(medium.index_at(points, front=0.0))

    np.testing.assert_allclose(indices(back, 1.59 - places), indices(medium, places), rtol=1e-14)


def test_a_distant_pinhole_is_refused():
    with pytest.raises(ValueError, match=r"needs a pinhole at a finite height; got .* inf\. Give"):
        viewing.reflexes(path_to(distance=float("inf")))
