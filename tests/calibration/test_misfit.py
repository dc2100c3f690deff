"""Misfit of a fit to pixels: found where it is, and contained in the standard errors."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage, optimize, stats

from eyespot.calibration.least_squares import accepted_range, excess_variance
from eyespot.calibration.pixels.fit_result import covariance_with
from eyespot.calibration.pixels.misfit import Pixels, found_misfit
from eyespot.calibration.spots.cone_trials import Prior

FRAMES, SIDE = 8, 40
V, U = (x.ravel() - 19.5 for x in np.mgrid[:SIDE, :SIDE].astype(float))
NOISE = 0.02


def spot(values, frame):
    """A bell whose height, place and width follow a line of time."""
    height, u, v, width, growth = values
    wide = width + growth * frame
    return height * np.exp(-((U - u) ** 2 + (V - v) ** 2) / (2 * wide**2)) + 0.05


TRUTH = np.array([1.0, 0.3, -0.2, 7.0, 0.4])


def fitted(light):
    """Least squares to frames: pixels at the solution, covariance, values."""

    def residuals(values):
        return (np.concatenate([spot(values, f) for f in range(FRAMES)]) - light.ravel()) / NOISE

    found = optimize.least_squares(residuals, TRUTH, jac="3-point", method="lm")
    parts = zip(np.split(found.fun, FRAMES), np.split(found.jac.T, FRAMES, axis=1), strict=True)
    frames = []
    for frame, (off, slopes) in enumerate(parts):
        seen = spot(found.x, frame)
        weight = np.full(U.size, 1 / NOISE)
        frames.append(Pixels(frame, U, V, seen - 0.05, seen, weight, off, slopes))
    return frames, np.linalg.inv(found.jac.T @ found.jac), found.x


def judged(light):
    frames, covariance, values = fitted(light)
    misfit, enlarged = found_misfit(frames, covariance, share=0.0)
    return misfit, enlarged, covariance, values


def noise(seed):
    return NOISE * np.random.default_rng(seed).standard_normal((FRAMES, U.size))


CLEAN = np.array([spot(TRUTH, frame) for frame in range(FRAMES)])


def test_noise_alone_has_structure_as_rarely_as_the_chance_says():
    runs = 100
    chances = np.array([judged(CLEAN + noise(seed))[0].chance for seed in range(runs)])
    # Bonferroni's bound of two tests that depend on each other is conservative, by at most 2.
    for level in (0.05, 0.2):
        count = np.sum(chances < level)
        low, high = stats.binom.ppf(0.001, runs, level / 2), stats.binom.ppf(0.999, runs, level)
        assert low <= count <= high


def test_noise_alone_leaves_the_covariance_as_it_is():
    for seed in range(10):
        misfit, enlarged, covariance, _ = judged(CLEAN + noise(seed))
        assert not misfit.structured
        assert misfit.inflation == 1.0
        assert misfit.where == ""
        np.testing.assert_array_equal(enlarged, covariance)


def ring(frame):
    """2 % of light that the model lacks, in a ring."""
    return 0.02 * np.exp(-((np.hypot(U, V) - 12) ** 2) / 8)


def side(frame):
    """3 % of the light in the outer part of the right side."""
    return 0.03 * (spot(TRUTH, frame) - 0.05) * (U > 5) * (np.abs(V) < U)


def flicker(frame):
    """Light that is 2 % too bright in the second quarter of the time."""
    return 0.02 * (spot(TRUTH, frame) - 0.05) * (FRAMES // 4 <= frame < FRAMES // 2)


@pytest.mark.parametrize("departure", [ring, side, flicker])
def test_the_standard_errors_contain_the_bias_of_a_misfit_that_chi_squared_hardly_shows(departure):
    light = CLEAN + [departure(frame) for frame in range(FRAMES)] + noise(3)
    misfit, enlarged, covariance, values = judged(light)
    assert misfit.structured
    off = np.abs(values - TRUTH)
    assert (off > 3 * np.sqrt(np.diag(covariance))).any()
    assert (off < 3 * np.sqrt(np.diag(enlarged))).all()
    assert misfit.inflation > 2


def test_the_standard_errors_contain_the_bias_of_a_wall_with_texture():
    # Grains of 5 px, the same in all frames, that change the light by 2 % (RMS).
    z = []
    for seed in range(12):
        grain = ndimage.gaussian_filter(
            np.random.default_rng(seed).standard_normal((SIDE, SIDE)), 2
        )
        textured = (1 + 0.02 * grain.ravel() / grain.std()) * CLEAN
        misfit, enlarged, covariance, values = judged(textured + noise(seed))
        assert misfit.structured
        z.append((values - TRUTH) / np.sqrt([np.diag(enlarged), np.diag(covariance)]))
    contained, of_noise = np.sqrt(np.mean(np.square(z), axis=(0, 2)))
    # The errors are known from few grains, so they are only roughly of the right size.
    assert of_noise > 3
    assert contained < 1


def test_the_sentence_names_the_side_and_the_sign():
    misfit, *_ = judged(CLEAN + [side(frame) for frame in range(FRAMES)] + noise(3))
    assert "right side" in misfit.where and "brighter" in misfit.where
    late = np.arange(FRAMES) >= FRAMES // 2
    patch = 0.03 * late[:, None] * (np.hypot(U, V) < 5)
    misfit, *_ = judged(CLEAN + patch + noise(3))
    assert "core" in misfit.where and "brighter" in misfit.where
    assert "the later half of the frames" in misfit.where


def test_undetermined_parameters_stay_so():
    frames, covariance, _ = fitted(CLEAN + noise(0) + [ring(0)] * FRAMES)
    covariance[1, :] = covariance[:, 1] = np.inf
    _, enlarged = found_misfit(frames, covariance, share=0.0)
    assert np.isinf(enlarged[1]).all() and np.isinf(enlarged[:, 1]).all()
    assert np.isfinite(np.delete(np.delete(enlarged, 1, 0), 1, 1)).all()


def test_a_scale_that_is_considered_is_not_known_by_rounding():
    # What is measured is the product of an aperture and a scale, to 1e-6; a second number does not
    # depend on the scale, but its derivative errs by 1e-3.
    jacobian = np.array([[1.0, 1.0], [0.0, 1e-3]]) / 1e-6
    fit: Any = SimpleNamespace(
        of=SimpleNamespace(names=("numerical_aperture", "scale")),
        sizes=np.ones(2),
        point=SimpleNamespace(values={"numerical_aperture": 1.0, "scale": 1.0}),
    )
    by_noise, of_considered, lost = covariance_with(
        fit, jacobian.T @ jacobian, {"scale": Prior(1.0, 0.01)}
    )
    assert lost == ()
    by_noise[1, 1] = 0.0
    # The aperture is off by as much as the scale, and in the other sense.
    expected = 1e-4 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    np.testing.assert_allclose(by_noise + of_considered, expected, rtol=1e-6)


def test_chi_squared_is_accepted_as_often_as_its_distribution_says():
    for degrees in (5, 50, 300_000):
        low, high = accepted_range(degrees)
        inside = np.diff(stats.chi2.cdf(np.array([low, high]) * degrees, degrees))
        assert inside[0] == pytest.approx(0.998, abs=1e-6)
        assert excess_variance(0.99 * high, degrees) == 1.0
        assert excess_variance(1.01 * high, degrees) == pytest.approx(1.01 * high)
