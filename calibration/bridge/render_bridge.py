"""From a renderer to JAX: an image as a function of its parameters, with derivatives.

Knows no renderer: it wraps functions of NumPy arrays. What may stand in them, and what may not, is
in docs/bridge.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

Value = Callable[[np.ndarray], np.ndarray]
"""p parameters to an image."""

ValueAndJacobian = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""p parameters to an image and its derivatives, of the image's shape and p."""

FLOAT32_LEVENBERG_MARQUARDT: optx.AbstractLeastSquaresSolver = optx.LevenbergMarquardt(
    rtol=1e-4, atol=1e-2
)
"""For renderers that compute in float32, of residuals over their sigma.

It ends with a step that changes no residual by more than 0.01. Finer ones would follow the
renderer's rounding, which is 0.001 where light is a thousand sigma, and never end.
"""


def render_as_jax(
    value: Value, value_and_jacobian: ValueAndJacobian, *, shape: Sequence[int]
) -> Callable[[Float[Array, "p"]], Float[Array, "*shape"]]:
    r"""A renderer as a JAX function with forward- and reverse-mode derivatives.

    The derivative along $\mathbf t$ is $J\mathbf t$ with the Jacobian $J$ that the renderer
    returns. To JAX that is a plain product, which it can transpose; so one rule serves `jvp`,
    `vjp`, `grad`, `jacfwd`, `jacrev` and Optimistix, and each costs one call of
    `value_and_jacobian`. Calls without derivatives cost one of `value`. Under `vmap` the renderer
    is called once for each set of parameters. Second derivatives are refused by JAX.

    Args:
        value: p parameters, float64, to an image. It must depend on nothing else (fix the seed)
            and compute nothing with JAX, which inside of a JAX computation can wait for itself for
            ever: JAX is switched off while it runs, and raises.
        value_and_jacobian: the same, and the image's derivatives, `shape` and p.
        shape: of the image.

    Returns:
        The function: p parameters to an image, float64. Where the renderer raises, it raises
        `jax.errors.JaxRuntimeError`, whose text ends with the renderer's.
    """
    shape = tuple(shape)
    image_type = jax.ShapeDtypeStruct(shape, np.float64)

    # One function each for good: JAX compiles anew for every new one.
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
    """The array in float64, if it has the promised shape."""
    array = np.asarray(array, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(
            f"render_as_jax: {name} returned an array of shape {array.shape} instead of {shape}. "
            "Give the image's shape as shape=; a Jacobian has one more axis, the parameters."
        )
    return array
