"""The paper's fits against NumPy's, known truth, and the spread that their errors promise."""

import math

import numpy as np
import pytest

import optics
from calibration import fit_eccentricity, fit_plane


def test_plane_fit_is_the_linear_regression_of_numpy():
    rng = np.random.default_rng(0)
    axis = np.linspace(38.0, 83.0, 61)
    distance = 0.134 * axis - 5.117 + rng.normal(0, 0.05, axis.size)
    fit = fit_plane(semi_minor_px=axis, distance=distance)
    (slope, offset), covariance = np.polyfit(axis, distance, 1, cov=True)
    # Both solve the same linear problem; the iteration stops at 1e-10.
    np.testing.assert_allclose([fit.delta_k, fit.b], [slope, offset], rtol=1e-8)
    errors = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose([fit.delta_k_error, fit.b_error], errors, rtol=1e-6)
    residual = distance - np.polyval([slope, offset], axis)
    assert fit.rmse == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-8)
    assert fit.r_squared == pytest.approx(np.corrcoef(axis, distance)[0, 1] ** 2, rel=1e-8)
    assert fit.converged
    assert fit.spots == 61


def test_standard_errors_of_the_plane_fit_are_the_spread_over_noise():
    axis = np.linspace(38.0, 83.0, 40)
    rng = np.random.default_rng(1)
    fits = [
        fit_plane(semi_minor_px=axis, distance=0.134 * axis - 5.1 + rng.normal(0, 0.1, 40))
        for _ in range(300)
    ]
    spread = np.std([fit.b for fit in fits])
    # A standard deviation from 300 draws is known to 1/sqrt(600) = 4 %; three of those.
    assert spread == pytest.approx(np.mean([fit.b_error for fit in fits]), rel=0.13)


def sphere_data(c: float) -> tuple[np.ndarray, np.ndarray]:
    """Spots that obey the small-plane model itself, by inverting it on a fine grid."""
    axis = np.linspace(38.0, 95.0, 50)
    distance = optics.small_plane_distance(
        semi_minor_px=axis, scale=0.0067, k=20.0, b=-5.117, eccentricity=c, eye_radius=11.5
    )
    return axis, np.asarray(distance)


@pytest.mark.parametrize("c", [1.0, 4.584, 6.982])
def test_eccentricity_is_found_again_where_the_model_holds(c):
    axis, distance = sphere_data(c)
    fit = fit_eccentricity(
        semi_minor_px=axis,
        distance=distance,
        delta_k=0.134,
        b=-5.117,
        scale=0.0067,
        eye_radius=11.5,
    )
    # The solver stops at 1e-10 of phi.
    assert fit.c == pytest.approx(c, abs=1e-6)
    assert fit.max_error < 1e-8
    assert fit.converged
    assert not fit.at_bound


def test_data_that_ask_for_no_eccentricity_are_flagged():
    axis, distance = sphere_data(0.0)
    fit = fit_eccentricity(
        semi_minor_px=axis * 0.98,
        distance=distance,
        delta_k=0.134,
        b=-5.117,
        scale=0.0067,
        eye_radius=11.5,
    )
    assert fit.at_bound
    assert math.isnan(fit.c_error)


def test_too_few_spots_are_refused():
    with pytest.raises(ValueError, match="3 spots or more of different sizes; got 2"):
        fit_plane(semi_minor_px=np.array([1.0, 2.0]), distance=np.array([1.0, 2.0]))
    with pytest.raises(ValueError, match="2 spots or more; got 1"):
        fit_eccentricity(
            semi_minor_px=np.array([50.0]),
            distance=np.array([1.0]),
            delta_k=0.1,
            b=-5.0,
            scale=0.01,
            eye_radius=11.5,
        )
