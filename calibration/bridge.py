"""A renderer as a JAX function of its parameters, with derivatives.

Wraps functions of NumPy arrays, so it works for any renderer. docs/python.md lists what these
functions may contain.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from eyespot.formats.inputs import InputError

FLOAT32_LEVENBERG_MARQUARDT: optx.AbstractLeastSquaresSolver = optx.LevenbergMarquardt(
    rtol=1e-4, atol=1e-2
)
"""Solver for renderers that compute in float32, for residuals over their sigma.

It ends when a step changes no residual by more than 0.01. A smaller limit would never be reached,
because rounding is 0.001 if the light is a thousand sigma.
"""


def render_as_jax(
    value: Callable[[np.ndarray], np.ndarray],
    value_and_jacobian: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    *,
    shape: Sequence[int],
) -> Callable[[Float[Array, "p"]], Float[Array, "*shape"]]:
    r"""A renderer as a JAX function with forward- and reverse-mode derivatives.

    The derivative along $\mathbf t$ is $J\mathbf t$ with the Jacobian $J$ that the renderer
    returns. JAX can transpose this product, so the same rule is valid for `jvp`, `vjp`, `grad`,
    `jacfwd`, `jacrev` and Optimistix; each calls `value_and_jacobian` once. Calls without
    derivatives call `value` once. Under `vmap` the renderer is called once per set of parameters.
    JAX raises an error for second derivatives.

    Args:
        value: function from p parameters, float64, to an image. It must depend on nothing else
            (fix the seed). It must not compute with JAX, because JAX inside a JAX computation can
            deadlock; JAX raises an error in it instead.
        value_and_jacobian: the same, with the image's derivatives, `shape` and p.

    Returns:
        Function from p parameters to an image, float64. If the renderer raises, the function
        raises `jax.errors.JaxRuntimeError`, whose text ends with the renderer's.
    """
    shape = tuple(shape)
    image_type = jax.ShapeDtypeStruct(shape, np.float64)

    # Defined only once, because JAX compiles again for every new function object.
    def image_of(parameters: Any) -> np.ndarray:
        with jax.no_execution(True):
            return _checked(value(np.asarray(parameters)), shape, "value")

    def image_and_jacobian_of(parameters: Any) -> tuple[np.ndarray, np.ndarray]:
        with jax.no_execution(True):
            image, jacobian = value_and_jacobian(np.asarray(parameters))
        name = "value_and_jacobian"
        return _checked(image, shape, name), _checked(jacobian, (*shape, parameters.size), name)

    @jax.custom_jvp
    def image(parameters: Float[Array, "p"]) -> Float[Array, "*shape"]:
        return jax.pure_callback(image_of, image_type, parameters, vmap_method="sequential")

    @image.defjvp
    def image_jvp(primals, tangents):
        (parameters,), (tangent,) = primals, tangents
        jacobian_type = jax.ShapeDtypeStruct((*shape, parameters.size), np.float64)
        rendered, jacobian = jax.pure_callback(
            image_and_jacobian_of,
            (image_type, jacobian_type),
            parameters,
            vmap_method="sequential",
        )
        return rendered, jacobian @ tangent

    return lambda parameters: image(jnp.asarray(parameters, float))


def _checked(array: np.ndarray, shape: tuple[int, ...], name: str) -> np.ndarray:
    """The array in float64, after a check of its shape."""
    array = np.asarray(array, dtype=np.float64)
    if array.shape != shape:
        raise InputError(
            f"render_as_jax: {name} returned an array of shape {array.shape} instead of {shape}. "
            "Give the image's shape as shape=; a Jacobian has one more axis, the parameters."
        )
    return array
