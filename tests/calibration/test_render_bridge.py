"""The bridge from renderers to JAX, tried with a renderer whose image is a formula."""

import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

from eyespot.calibration.bridge import render_as_jax

SHAPE = (6, 8)
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
START = np.array([3.2, 2.4, 1.7])


class Blob:
    """Host renderer of a Gaussian spot by its place and width, px; counts its calls."""

    def __init__(self) -> None:
        self.values = self.jacobians = 0

    def value(self, parameters):
        self.values += 1
        return _blob(parameters)

    def value_and_jacobian(self, parameters):
        self.jacobians += 1
        u, v, width = parameters
        image = _blob(parameters)
        squared = (U - u) ** 2 + (V - v) ** 2
        slopes = ((U - u) / width**2, (V - v) / width**2, squared / width**3)
        return image, np.stack([image * slope for slope in slopes], axis=-1)


def _blob(parameters, exp=np.exp):
    u, v, width = parameters
    return exp(-((U - u) ** 2 + (V - v) ** 2) / (2 * width**2))


native = partial(_blob, exp=jnp.exp)
"""The same image in JAX alone, which differentiates it by itself."""


@pytest.fixture
def host():
    return Blob()


@pytest.fixture
def image(host):
    return render_as_jax(host.value, host.value_and_jacobian, shape=SHAPE)


TRANSFORMS: dict[str, Callable[..., Any]] = {
    "value": jax.jit,
    "jacfwd": lambda f: jax.jit(jax.jacfwd(f)),
    "jacrev": lambda f: jax.jit(jax.jacrev(f)),
    "jvp": lambda f: jax.jit(lambda p: jax.jvp(f, (p,), (jnp.ones(3),))),
    "vjp": lambda f: jax.jit(lambda p: jax.vjp(f, p)[1](jnp.asarray(U))),
    "grad, without jit": lambda f: jax.grad(lambda p: jnp.sum(f(p) ** 2)),
    "batch": lambda f: jax.jit(lambda p: jax.vmap(f)(_several(p))),
    "gradients of a batch": lambda f: jax.jit(
        lambda p: jax.vmap(jax.grad(lambda q: jnp.sum(f(q) ** 2)))(_several(p))
    ),
    "jacobian of a batch": lambda f: jax.jit(jax.jacrev(lambda p: jax.vmap(f)(_several(p)))),
}


def _several(parameters):
    return jnp.stack([parameters, parameters + 0.5])


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_a_renderer_behind_the_bridge_acts_like_a_jax_function(image, transform):
    parameters = jnp.asarray(START)
    # The same formulas in float64, in another order.
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14),
        TRANSFORMS[transform](image)(parameters),
        TRANSFORMS[transform](native)(parameters),
    )


def test_an_image_without_derivatives_pays_for_none(image, host):
    jax.jit(image)(START).block_until_ready()
    assert (host.values, host.jacobians) == (1, 0)


@pytest.mark.parametrize("jacobian", [jax.jacfwd, jax.jacrev])
def test_a_whole_jacobian_costs_one_render(image, host, jacobian):
    jax.jit(jacobian(image))(START).block_until_ready()
    assert (host.values, host.jacobians) == (0, 1)


def test_levenberg_marquardt_finds_the_spot_through_the_bridge(image, host):
    truth = np.array([3.5, 2.0, 1.4])
    measured = _blob(truth)
    solver: optx.AbstractLeastSquaresSolver = optx.BestSoFarLeastSquares(
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10)
    )
    solution: optx.Solution = optx.least_squares(
        lambda parameters, _: (image(parameters) - measured).ravel(), solver, jnp.asarray(START)
    )
    # Without noise the solver stops when steps are below its tolerance.
    np.testing.assert_allclose(solution.value, truth, atol=1e-8)
    assert host.jacobians < 40


def test_a_thousand_calls_under_jit_come_back(image, host):
    """Values and gradients in turn, from a thread that a deadlock would keep."""
    loss = jax.jit(jax.value_and_grad(lambda p: jnp.sum(image(p) ** 2)))
    plain = jax.jit(image)

    def call() -> None:
        for number in range(500):
            parameters = jnp.asarray(START) + 1e-3 * number
            loss(parameters)
            plain(parameters).block_until_ready()

    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(timeout=120)
    assert not thread.is_alive()
    assert (host.values, host.jacobians) == (500, 500)


def test_a_thousand_calls_from_one_computation_come_back(image, host):
    def step(parameters, _):
        gradient = jax.grad(lambda p: jnp.sum(image(p)))(parameters)
        return parameters + 1e-6 * gradient, None

    jax.jit(lambda p: jax.lax.scan(step, p, None, length=1000))(START)[0].block_until_ready()
    assert host.jacobians == 1000


def test_large_images_do_not_lock_the_threads_that_compute_with_them():
    # Larger than what JAX copies at once, and an operand of a product that takes all its threads.
    shape = (480, 640, 3)
    large = render_as_jax(
        lambda p: np.full(shape, p.sum()),
        lambda p: (np.full(shape, p.sum()), np.ones((*shape, p.size))),
        shape=shape,
    )

    @jax.jit
    def gauss_newton(parameters):
        residual, derivative = large(parameters).ravel(), jax.jacfwd(large)(parameters)
        return residual @ derivative.reshape(residual.size, -1)

    for number in range(20):
        product = gauss_newton(jnp.arange(4.0) + number)
    np.testing.assert_allclose(product, np.prod(shape) * (6.0 + 4 * 19))


def test_jax_inside_of_the_renderer_is_refused():
    image = render_as_jax(lambda p: np.asarray(jnp.sin(p)), lambda p: (p, np.eye(3)), shape=(3,))
    with pytest.raises((RuntimeError, jax.errors.JaxRuntimeError), match="no_execution"):
        jax.jit(image)(START).block_until_ready()


def test_a_renderer_s_own_error_comes_through():
    def refuse(parameters):
        raise ValueError("sag must lie in [0, 0.25]; got 0.3.")

    image = render_as_jax(refuse, refuse, shape=(3,))
    with pytest.raises(jax.errors.JaxRuntimeError, match="sag must lie in"):
        jax.jit(image)(START).block_until_ready()


def test_an_array_of_another_shape_is_named():
    image = render_as_jax(lambda p: np.zeros((2, 2)), lambda p: (p, p), shape=(3,))
    with pytest.raises(jax.errors.JaxRuntimeError, match=r"shape \(2, 2\) instead of \(3,\)"):
        jax.jit(image)(START).block_until_ready()


def test_second_derivatives_are_refused(image):
    with pytest.raises(ValueError, match="do not support JVP"):
        jax.hessian(lambda p: jnp.sum(image(p)))(jnp.asarray(START))
