"""The paper's fits against NumPy's, known truth, and the spread that their errors promise."""

import math
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import scipy.stats

from eyespot import optics
from eyespot.calibration import fit_eccentricity, fit_lines, fit_plane

PLANE: dict[str, Any] = {"delta_k": 0.134, "b": -5.117}
EYE: dict[str, Any] = {"scale": 0.0067, "eye_radius": 11.5}


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


def sphere_data(c: float) -> tuple[np.ndarray, np.ndarray]:
    """Spots that obey the small-plane model itself, by inverting it on a fine grid."""
    axis = np.linspace(38.0, 95.0, 50)
    distance = optics.small_plane_distance(
        semi_minor_px=axis, k=20.0, b=-5.117, eccentricity=c, **EYE
    )
    return axis, np.asarray(distance)


@pytest.mark.parametrize(
    ("c", "loss"), [(1.0, "squares"), (4.584, "squares"), (6.982, "squares"), (4.0, "huber")]
)
def test_eccentricity_is_found_again_where_the_model_holds(c, loss):
    axis, distance = sphere_data(c)
    fit = fit_eccentricity(semi_minor_px=axis, distance=distance, loss=loss, **PLANE, **EYE)
    # The solver stops at 1e-10 of phi.
    assert fit.c == pytest.approx(c, abs=1e-6)
    assert fit.max_error < 1e-8
    assert fit.converged
    assert not fit.at_bound


def test_data_that_ask_for_no_eccentricity_are_flagged():
    axis, distance = sphere_data(0.0)
    fit = fit_eccentricity(semi_minor_px=axis * 0.98, distance=distance, **PLANE, **EYE)
    assert fit.at_bound
    assert math.isnan(fit.c_error)


def test_too_few_spots_are_refused():
    with pytest.raises(ValueError, match="3 spots or more of different sizes; got 2"):
        fit_plane(semi_minor_px=np.array([1.0, 2.0]), distance=np.array([1.0, 2.0]))
    with pytest.raises(ValueError, match="2 spots or more; got 1"):
        fit_eccentricity(semi_minor_px=np.array([50.0]), distance=np.array([1.0]), **PLANE, **EYE)


def test_huber_names_the_outliers_and_finds_the_minimum_that_scipy_finds():
    rng = np.random.default_rng(2)
    axis = np.linspace(38.0, 83.0, 61)
    distance = 0.134 * axis - 5.117 + rng.normal(0, 0.02, axis.size)
    distance[[5, 30, 55]] += (0.4, -0.3, 0.5)
    plain = fit_plane(semi_minor_px=axis, distance=distance)
    robust = fit_plane(semi_minor_px=axis, distance=distance, loss="huber")
    assert robust.converged
    assert robust.outliers == (5, 30, 55)
    assert plain.outliers == ()
    assert robust.b_error < 0.5 * plain.b_error

    def residual(p):
        return p[0] * axis + p[1] - distance

    scale = np.median(np.abs(residual((robust.delta_k, robust.b)))) / 0.6745
    theirs = scipy.optimize.least_squares(
        residual, [0.1, 0.0], loss="huber", f_scale=1.345 * scale, xtol=1e-14, ftol=1e-14, gtol=None
    )
    # SciPy's solver stops where the loss changes by 1e-14, which is flat to its square root.
    np.testing.assert_allclose([robust.delta_k, robust.b], theirs.x, rtol=1e-6)


def test_the_band_of_the_line_is_the_textbooks():
    rng = np.random.default_rng(3)
    axis = np.linspace(38.0, 83.0, 21)
    distance = 0.134 * axis - 5.117 + rng.normal(0, 0.05, axis.size)
    fit = fit_plane(semi_minor_px=axis, distance=distance)
    at = np.array([30.0, 60.0, 100.0])
    s = fit.rmse * math.sqrt(21 / 19)
    leverage = 1 / 21 + (at - axis.mean()) ** 2 / np.sum((axis - axis.mean()) ** 2)
    # Student's t of 19 degrees of freedom at 97.5 %, from its printed tables.
    np.testing.assert_allclose(fit.band(at), 2.0930 * s * np.sqrt(leverage), rtol=1e-4)


def test_c_and_its_band_follow_what_they_were_fitted_with():
    axis, distance = sphere_data(4.0)
    distance = distance + np.random.default_rng(4).normal(0, 0.02, axis.size)

    def c_of(delta_k, b):
        return fit_eccentricity(
            semi_minor_px=axis, distance=distance, delta_k=delta_k, b=b, **EYE
        ).c

    fit = fit_eccentricity(semi_minor_px=axis, distance=distance, **PLANE, **EYE)
    step = 1e-5
    by_differences = [
        (c_of(0.134 + step, -5.117) - c_of(0.134 - step, -5.117)) / (2 * step),
        (c_of(0.134, -5.117 + step) - c_of(0.134, -5.117 - step)) / (2 * step),
    ]
    # The implicit derivative leaves out the curvature times the residuals, 1e-3 of it here.
    np.testing.assert_allclose(fit.sensitivity, by_differences, rtol=5e-3)

    up, down = (
        optics.small_plane_distance(
            semi_minor_px=axis, k=20.0, b=-5.117, eccentricity=fit.c + sign * fit.c_error, **EYE
        )
        for sign in (1, -1)
    )
    band = fit.band(axis, delta_k=0.134, **EYE)
    student = 2.0096  # of 49 degrees of freedom at 97.5 %
    np.testing.assert_allclose(band, student * np.abs(up - down) / 2, rtol=1e-3)


@pytest.mark.parametrize("c", [2.0, 4.0, 6.0])
def test_c_is_what_scipy_finds(c):
    axis, distance = sphere_data(c)
    distance = distance + np.random.default_rng(5).normal(0, 0.05, axis.size)
    fit = fit_eccentricity(semi_minor_px=axis, distance=distance, **PLANE, **EYE)
    theirs = scipy.optimize.least_squares(
        lambda p: (
            20 * (r := 0.0067 * axis * p[0]) - 5.117 + 11.5 - np.sqrt(11.5**2 - r**2) - distance
        ),
        [0.9],
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    assert math.sqrt(1 - (fit.c / 11.5) ** 2) == pytest.approx(theirs.x[0], abs=1e-8)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    runs = 100
    hits = dict.fromkeys(("delta_k", "b", "c"), 0)
    axis, exact = sphere_data(4.0)
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        distance = 0.134 * axis - 5.117 + rng.normal(0, 0.05, axis.size)
        plane = fit_plane(semi_minor_px=axis, distance=distance)
        sphere = fit_eccentricity(
            semi_minor_px=axis, distance=exact + rng.normal(0, 0.05, axis.size), **PLANE, **EYE
        )
        wide = [scipy.stats.t.ppf(0.975, axis.size - p) for p in (2, 1)]
        hits["delta_k"] += abs(plane.delta_k - 0.134) < wide[0] * plane.delta_k_error
        hits["b"] += abs(plane.b + 5.117) < wide[0] * plane.b_error
        hits["c"] += abs(sphere.c - 4.0) < wide[1] * sphere.c_error
    # 95 % intervals by an exact binomial test at 1 %, over these and the six of the cone's fit.
    low, high = (scipy.stats.binom.ppf(p, runs, 0.95) for p in (0.01 / 18, 1 - 0.01 / 18))
    assert all(low <= count <= high for count in hits.values()), hits


def test_the_line_through_an_ideal_cone_is_its_k_and_b_whichever_spots_are_missing():
    d = np.linspace(0.0, 4.0, 21)
    radius = np.tile((d + 5.117) / 20.0, (3, 1))
    radius[1, ::3] = np.nan
    radius[2, 2:] = np.nan
    line = fit_lines(radius, d)
    # Rounding of numbers near 5 mm, times the leverage of b.
    assert line.delta_k[:2] == pytest.approx(20.0, rel=1e-12)
    assert line.b[:2] == pytest.approx(-5.117, rel=1e-12)
    assert line.rmse[:2] == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(line.delta_k[2])  # two spots are no line


def test_lines_are_those_of_numpys_polyfit():
    rng = np.random.default_rng(5)
    axis, d = rng.normal(50.0, 8.0, (4, 30)), rng.normal(2.0, 1.0, (4, 30))
    line = fit_lines(axis, d)
    for n in range(4):
        delta_k, b = np.polyfit(axis[n], d[n], 1)
        assert (line.delta_k[n], line.b[n]) == pytest.approx((delta_k, b), rel=1e-9)
        assert line.r_squared[n] == pytest.approx(np.corrcoef(axis[n], d[n])[0, 1] ** 2, rel=1e-9)
