"""Every public function of optics under jit, vmap and its derivative."""

import inspect
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eyespot import optics
from tests.support.light.profiles import light_of

pytestmark = pytest.mark.usefixtures("fast_compilation")

R_EYE, SCALE = 11.5, 0.0067
WALL = optics.Sphere(R_EYE)
PLANE = optics.pole_plane(eye_radius=R_EYE, tilt=0.2)
POSE_CONE: dict[str, Any] = {"half_angle": 0.05, "apex_offset": -5.0}
BEAM = {"eccentricity": 3.0, "distance": 4.0, "incidence": 0.4, "azimuth": 0.7}
BEAM |= {"incidence_azimuth": 1.1, **POSE_CONE}
USUAL = {
    **{"semi_minor_px": 60.0, "scale": SCALE, "k": 20.0, "b": -5.0, "half_angle": 0.05},
    **{"eccentricity": 3.0, "eye_radius": R_EYE, "inverse_working_distance": 0.01},
    **{"distance": 3.0, "spot_radius": 0.5, "right_px": 300.0, "down_px": -200.0},
    **{"flux": 1.0, "reflectance": 0.5, "radius": 0.07, "length": 0.05},
}
"""Arguments of closed forms by name."""
# The core is narrower than the cap: where they are equal the power has a kink.
LENS = {"core_radius": 0.2, "glue_length": 0.3, "sag": 0.05, "aperture_radius": 0.25}
LENS |= {"numerical_aperture": 0.12, "glue_index": 1.49}
TENT = light_of(jnp.linspace(1.0, 0.0, 65), contact=0.3)


def flat(tree: object) -> jax.Array:
    leaves = [jnp.ravel(leaf) for leaf in jax.tree.leaves(tree)]
    return jnp.concatenate([leaf for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.floating)])


def of(function: Callable, given: dict | None = None) -> tuple[Callable, list[float]]:
    """A function of the vector of the values given by keyword, or of those in `USUAL`."""
    if given is None:
        given = {
            name: USUAL[name] for name in inspect.signature(function).parameters & USUAL.keys()
        }
    names = list(given)

    return lambda x: function(**dict(zip(names, x, strict=True))), list(given.values())


def camera():
    return optics.microscope(scale=SCALE, pinhole_height=200.0, eye_radius=R_EYE)


def beam(x):
    return optics.beam_at_spot(WALL, **dict(zip(BEAM, x, strict=True)))


def seen(x):
    return optics.spot_contour(beam(x), WALL, camera())


@cache
def clean():
    """The contour of `BEAM`, a constant in what is traced."""
    with jax.ensure_compile_time_eval():
        return np.asarray(seen(AT_BEAM))


def lens(x):
    return optics.glue_lens(**dict(zip(LENS, x, strict=True)))


AT_BEAM, AT_LENS = list(BEAM.values()), list(LENS.values())
MEASURED = optics.Ellipse(jnp.array([3.0, 4.0]), jnp.array(60.0), jnp.array(50.0), jnp.array(0.3))

FORMS = [of(partial(optics.closed_form_distance, model)) for model in optics.CLOSED_FORMS]

QUICK: dict[str, tuple[Callable, list[float]]] = {
    "ellipse_mismatch": (
        lambda x: optics.ellipse_mismatch(
            optics.ellipse_points(
                optics.Ellipse(x[:2], x[2], x[3], x[4]), jnp.linspace(0.0, 6.2, 32)
            ),
            MEASURED,
        ),
        [3.1, 4.1, 60.1, 50.2, 0.29],
    ),
    "mismatch_covariance": (
        lambda x: optics.mismatch_covariance(
            optics.Ellipse(x[:2], x[2], x[3], x[4]), jnp.diag(x[5:])
        ),
        [3.0, 4.0, 60.0, 50.0, 0.3, 1e-4, 1e-4, 1e-4, 1e-4, 1e-6],
    ),
    "microscope": of(
        partial(optics.microscope, eye_radius=R_EYE), {"scale": SCALE, "pinhole_height": 90.0}
    ),
    "refract": (
        lambda x: optics.refract(
            direction=x[:3] / jnp.linalg.norm(x[:3]),
            normal=x[3:6] / jnp.linalg.norm(x[3:6]),
            index_incident=x[6],
            index_transmitted=x[7],
        ),
        [0.3, -0.2, 1.0, 0.1, 0.1, 1.0, 1.0, 1.49],
    ),
    "nearest_point": (
        lambda x: optics.nearest_point((x[:3], x[3:6]), (x[6:9], x[9:])),
        [0.1, -0.2, 0.3, 0.2, 0.1, -1.0, 3.0, 0.5, 0.2, -0.3, 0.05, -1.0],
    ),
    "beam_at_spot": (beam, AT_BEAM),
    "contact_distance": of(
        partial(optics.contact_distance, WALL), {"incidence": 0.4, "rim_radius": 0.25}
    ),
    "perpendicular_frame": (optics.perpendicular_frame, [0.48, 0.6, 0.64]),
    "pole_plane": of(
        partial(optics.pole_plane, eye_radius=R_EYE), {"tilt": 0.2, "tilt_azimuth": 0.4}
    ),
    "cone_contour": (lambda x: optics.cone_contour(beam(x), WALL, points=32), AT_BEAM),
    "spot_contour": (seen, AT_BEAM),
    "ellipse_of_contour": (lambda x: optics.ellipse_of_contour(seen(x)), AT_BEAM),
    "ellipse_points": (
        lambda x: optics.ellipse_points(
            optics.Ellipse(x[:2], x[2], x[3], x[4]), x[4] + jnp.arange(5.0)
        ),
        [3.0, 4.0, 60.0, 50.0, 0.3],
    ),
    "exact_semi_minor": of(partial(optics.exact_semi_minor, WALL, camera()), BEAM),
    "closed_form_distance": (lambda x: [form(x) for form, _ in FORMS], FORMS[0][1]),
    "plane_point": of(partial(optics.plane_point, normal=(0.1, -0.2, 0.97))),
    "eyeball_point": of(optics.eyeball_point),
    **{
        name: of(getattr(optics, name))
        for name in dir(optics)
        if getattr(getattr(optics, name), "__module__", "") == "eyespot.optics.models"
        and name != "closed_form_distance"
    },
    **{name: of(getattr(optics, name)) for name in ("slope", "enclosed", "indirect_irradiance")},
    "wall_irradiance": (
        lambda x: optics.wall_irradiance(TENT, beam(x[:7]), WALL, radius=x[7:8], angle=x[8:]),
        [*AT_BEAM, 0.31, 0.4],
    ),
    "glue_lens": (lens, AT_LENS),
    "emitted_rays": (
        lambda x: optics.emitted_rays(
            lens(x),
            medium_index=1.0,
            points=jnp.array([[0.1, 0.05]]),
            directions=jnp.array([[0.02, 0.03]]),
        ),
        AT_LENS,
    ),
    "half_maximum_radius": (lambda x: optics.half_maximum_radius(TENT, distance=x), [3.0]),
    "isophote_radius": (
        lambda x: optics.isophote_radius(TENT, distance=x[:1], level=x[1:]),
        [3.0, 0.3],
    ),
}
SLOW: dict[str, tuple[Callable, list[float]]] = {
    "spot_ellipse": (lambda x: optics.spot_ellipse(beam(x), PLANE, camera()), AT_BEAM),
    "exact_distance": of(
        partial(optics.exact_distance, WALL, camera()),
        {name: value for name, value in BEAM.items() if name != "distance"}
        | {"semi_minor_px": 60.0},
    ),
    "distance_by_area": (
        lambda x: optics.distance_by_area(
            optics.ellipse_of_contour(x[0] * clean()),
            WALL,
            camera(),
            axis=optics.beam_at_spot(WALL, **BEAM).axis,
            **POSE_CONE,
        ),
        [1.0],
    ),
    "half_maximum_contour": (
        lambda x: optics.half_maximum_contour(TENT, beam(x), WALL, points=8),
        AT_BEAM,
    ),
    "pose_from_contour": (
        lambda x: optics.pose_from_contour(
            clean() * x[0], WALL, camera(), sigma_px=0.05, **POSE_CONE
        ).best[:3],
        [1.0],
    ),
    "pose_from_ellipse": (
        lambda x: optics.pose_from_ellipse(
            optics.ellipse_of_contour(clean() * x[0]),
            WALL,
            camera(),
            covariance=jnp.diag(jnp.array([1e-4, 1e-4, 1e-4, 1e-4, 1e-5])),
            prior=optics.DirectionPrior(optics.beam_at_spot(WALL, **BEAM).axis, 0.1),
            **POSE_CONE,
        ).best[:3],
        [1.0],
    ),
    "transmitted_power": (lambda x: optics.transmitted_power(lens(x), medium_index=1.336), AT_LENS),
    "vector_irradiance": (
        lambda x: optics.vector_irradiance(
            lens(x[:-2]), medium_index=1.336, radius=x[-2:-1], distance=x[-1:]
        ),
        [*AT_LENS, 0.23, 2.0],
    ),
}
ELSEWHERE = {
    "components": "an unpacking",
    "dot": "three products",
    "tip_radius": "the larger of two numbers",
    "irradiance_table": "test_irradiance_table: accuracy of look-ups and derivatives",
    "effective_cone": "test_irradiance_table: the slope's derivative by the lens",
    "spread_nodes": "numbers of a quadrature, without arguments that could be traced",
    "lit_share": "test_wall_spread: the closed form of a half plane, one batched look-up",
    "spread_contours": "a loop in Python over compiled batches",
    "spread_spots": "a loop in Python over compiled batches",
    "spot_truth": "a loop in Python over compiled batches",
    "ambiguous_distances": "a list of intervals, found by NumPy",
    "lens_names": "reads files",
    "load_lens": "reads a file",
}

CASES = [
    *(pytest.param(name, case, id=name) for name, case in QUICK.items()),
    *(pytest.param(name, case, id=name, marks=pytest.mark.slow) for name, case in SLOW.items()),
]


def test_every_public_function_is_accounted_for():
    offered = {name: getattr(optics, name) for name in dir(optics)}
    functions = {
        name for name, value in offered.items() if callable(value) and not inspect.isclass(value)
    }
    assert functions == QUICK.keys() | SLOW.keys() | ELSEWHERE.keys()


@pytest.mark.parametrize(("name", "case"), CASES)
def test_function_compiles_batches_and_has_the_derivative_of_its_differences(name, case):
    called, point = case
    x = jnp.asarray(point, float)

    def function(x):
        return flat(called(x))

    direction = jnp.asarray(np.random.default_rng(len(name)).standard_normal(x.size)) * x
    # Cube root of the rounding error: the error of central differences is its square, 1e-9 of the
    # scale of the function, some hundred times that where curvature is large.
    h = 1e-5
    batch = jnp.stack([x, x + h * direction, x - h * direction])
    # One compilation of everything together: most of the time goes into compiling.
    values, slopes = jax.jit(jax.vmap(lambda x: jax.jvp(function, (x,), (direction,))))(batch)
    plain = np.stack([function(row) for row in batch])
    # Compiled sums are taken in another order: some hundred roundings.
    size = 1e-12 * (1.0 + np.abs(plain).max())
    np.testing.assert_allclose(values, plain, rtol=1e-9, atol=size)
    assert np.isfinite(slopes).all()
    difference = (values[1] - values[2]) / (2 * h)
    scale = np.abs(difference).max() + np.abs(plain).max()
    np.testing.assert_allclose(slopes[0], difference, rtol=1e-6, atol=1e-7 * scale)
