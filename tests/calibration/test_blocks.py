"""Least squares in blocks: the same minimum as SciPy finds without knowing of blocks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from calibration.solvers import gauss_newton_in_blocks

pytestmark = pytest.mark.usefixtures("fast_compilation")


def decays(shared, own, block):
    """Two shared rates, and each block's own height and offset with priors."""
    time, measured = block
    model = own[0] * (jnp.exp(-shared[0] * time) + shared[1]) + own[1]
    return jnp.concatenate([(model - measured) / 0.02, (own - jnp.array([1.0, 0.0])) / 0.5])


@pytest.fixture
def blocks():
    rng = np.random.default_rng(3)
    time = np.tile(np.linspace(0.0, 3.0, 20), (4, 1))
    heights, offsets = np.array([[0.8, 1.0, 1.3, 1.6], [0.1, -0.2, 0.0, 0.3]])
    clean = heights[:, None] * (np.exp(-0.9 * time) + 0.2) + offsets[:, None]
    return jnp.asarray(time), jnp.asarray(clean + 0.02 * rng.standard_normal(time.shape))


def test_blocks_reach_the_minimum_that_scipy_finds(blocks):
    start = jnp.array([0.5, 0.0]), jnp.tile(jnp.array([1.0, 0.0]), (4, 1))

    def every(z):
        own = jnp.asarray(z[2:]).reshape(4, 2)
        return np.asarray(jax.vmap(decays, (None, 0, 0))(jnp.asarray(z[:2]), own, blocks)).ravel()

    first = np.concatenate([start[0], np.ravel(start[1])])
    expected = least_squares(every, first, xtol=1e-12, ftol=1e-12, gtol=1e-12).x
    shared, own, converged = jax.jit(
        lambda x, y: gauss_newton_in_blocks(decays, x, y, blocks, tolerance=1e-9)
    )(*start)
    assert converged
    # SciPy's derivatives are differences: its gradient vanishes to 1e-8 of a standard error.
    np.testing.assert_allclose(np.append(shared, own), expected, atol=1e-6)


def test_a_tolerance_that_no_step_meets_is_not_reached(blocks):
    start = jnp.array([0.5, 0.0]), jnp.tile(jnp.array([1.0, 0.0]), (4, 1))
    *_, converged = gauss_newton_in_blocks(decays, *start, blocks, tolerance=-1.0)
    assert not converged
