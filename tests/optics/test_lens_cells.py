"""A lens's light as the fit to pixels has it: its table, its samples, its mean over a pixel."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

from eyespot import optics
from eyespot.optics.wall_light.cells import lattice_irradiance, square_lattice
from eyespot.optics.wall_light.lens_flux import (
    TABLE_ERROR,
    Grid,
    LensSamples,
    _Field,
    _first_order,
    lens_samples,
)
from tests.support.drawn.made_up import a_lens_table


def test_table_is_exact_for_cubic_fields():
    grid = Grid(1.0, 0.5, 0.5, 8.0)
    y, x = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 7), indexing="ij")

    def field(x, y):
        return 1 + x - 2 * x**3 + y * x**2 + 3 * y**3

    table = a_lens_table(field(x, y), grid)
    rng = np.random.default_rng(0)
    s = jnp.asarray(rng.uniform(0.5, 8.0, 50))
    envelope = 1.0 + 0.5 * s
    share = jnp.asarray(rng.uniform(0.0, 1.5, 50))
    found = jax.jit(lambda rho, s: table(radius=rho, distance=s))(share * envelope, s)
    # A disc larger than the envelope has no more light, so its mean falls with its area.
    inside, larger = jnp.minimum(share, 1.0), jnp.maximum(share, 1.0)
    expected = field(inside, jnp.log(s / 0.5) / jnp.log(16.0)) / (envelope * larger) ** 2
    np.testing.assert_allclose(found, expected, rtol=1e-10)


@pytest.mark.slow
def test_samples_from_those_of_a_near_lens_are_as_good_as_new_ones():
    # In vitreous this drop makes a sharp image of its core, whose edge moves with the lens.
    values = {"core_radius": 0.25, "aperture_radius": 0.30, "rim_height": 0.04, "sag": 0.07}
    values |= {"glue_index": 1.49, "numerical_aperture": 0.15}
    free, index = ("sag", "numerical_aperture"), optics.MEDIA["vitreous"]
    settings: dict[str, Any] = {"nearest": 0.3, "farthest": 6.0, "reach": 1.05, "halvings": 3}
    settings |= {"medium_index": index, "finest": 0.0}
    near = lens_samples(values, free, **settings)
    moved = values | {"sag": 0.07014, "numerical_aperture": 0.1497}
    found = lens_samples(moved, free, **settings, near=near)
    # The same grid, all of it by quadrature; its slopes are not looked at.
    _, *shape = found.values.shape
    light = _Field(moved, (), index, near.grid)(np.ones(shape, bool), np.zeros((1, *shape)))
    exact = np.concatenate([light, found.values[1:]])
    peak = exact[0].max(axis=1, keepdims=True)
    before, off = (np.abs(own.values[0] - exact[0]) / peak for own in (near, found))
    assert np.quantile(before, 0.99) > TABLE_ERROR
    # A sample between those that were checked may err by more, by a few times the accepted error.
    assert np.quantile(off, 0.998) < TABLE_ERROR
    assert off.max() < 4 * TABLE_ERROR
    ours, theirs = (own.table().values[0] for own in (found, found._replace(values=exact)))
    error = np.abs(np.asarray(ours - theirs)) / np.asarray(theirs).max(axis=1, keepdims=True)
    assert error.max() < TABLE_ERROR / 4  # the mean over a disc errs much less than a sample


def test_a_lens_with_a_level_rim_may_be_near_another_one():
    # What is 0 in one lens has no relative change; the step at half of the radius may have moved.
    light = np.where(np.arange(41) < 20, 1.0, 0.1) * np.ones((9, 1))
    near = LensSamples(np.stack([light, 0 * light]), np.ones(2), np.array([0.0]), Grid(1, 1, 1, 2))
    for rim, changed in ((0.0, False), (1e-6, False), (0.01, True)):
        _, moved = _first_order(near, np.array([rim]), 2)
        assert moved[:, 18:22].all() == moved.any() == changed


def test_light_of_a_lens_is_the_mean_over_a_pixel():
    # Light that flows along the lines rho/e(s), with an edge as wide as a pixel.
    def light(x):
        return stats.norm.sf(x, 0.3, 0.01)

    x = np.linspace(0.0, 1.0, 1601)
    within = integrate.cumulative_trapezoid(2 * x * light(x), x, initial=0.0)
    mean = np.append(1.0, within[1:] / x[1:] ** 2)
    table = a_lens_table(np.tile(mean, (9, 1)), Grid(1.0, 0.5, 1.0, 4.0))
    eye = optics.microscope(scale=0.02, pinhole_height=11.5, eye_radius=11.5)
    surface = optics.Sphere(jnp.asarray(11.5))
    tip, axis = jnp.array([0.0, 0.0, -9.5]), jnp.array([0.0, 0.0, -1.0])
    v, u = np.mgrid[0:40, 0:40]
    pixels = np.stack([u.ravel(), v.ravel()], axis=-1).astype(float)

    n = 8
    shifts = np.stack(np.meshgrid(*2 * [(np.arange(n) + 0.5) / n - 0.5]), axis=-1).reshape(-1, 1, 2)
    parts = surface.intersect(*eye.ray(jnp.asarray((pixels + shifts).reshape(-1, 2))))
    corner, right = np.array([-0.5, -0.5]), np.array([1.0, 0.0])
    lattice = square_lattice(eye, surface, corner=corner, right=right, count=40)
    found = np.asarray(jax.jit(lattice_irradiance)(lattice, table, tip=tip, axis=axis)).ravel()
    offset, normal = np.asarray(parts.point - tip), np.asarray(parts.normal)
    envelope = 1.0 - 0.5 * offset[:, 2]
    aside = offset[:, :2] / envelope[:, None]
    axial = light(np.linalg.norm(aside, axis=1)) / envelope**2
    onto = axial * (normal[:, 2] - 0.5 * np.sum(aside * normal[:, :2], axis=1))
    expected = onto.reshape(n * n, -1).mean(axis=0)
    assert expected.min() < 0.01 * expected.max()
    # The mean of 8 x 8 points errs by up to (1/8)^2/24 of the second difference, 0.25 of the step.
    np.testing.assert_allclose(found, expected, atol=3e-4 * expected.max())
