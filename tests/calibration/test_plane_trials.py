"""One line for trials that differ by their touches and the plane's tilt."""

import numpy as np
import pytest

from eyespot import optics
from eyespot.calibration import Prior, fit_plane
from eyespot.calibration.spots.paper_fits import PlaneTrial, fit_plane_trials
from tests.support.drawn.exact_spots import exact_spots

DELTA_K, B = 0.134, -5.117
AXIS = np.linspace(38.0, 83.0, 40)
PLACES = 3.0 * np.array([[1.0, 0.0], [-0.5, 0.87], [-0.5, -0.87]])
TOUCH = Prior(0.0, 0.1)
ALONG_X = np.tile([1.0, 0.0], (AXIS.size, 1))


def test_touch_errors_make_lines_differ_and_as_nuisances_explain_it():
    rng = np.random.default_rng(0)
    errors = (0.1, -0.1, 0.02)
    noise = 0.01
    trials = [
        PlaneTrial(
            semi_minor_px=AXIS,
            readings=DELTA_K * AXIS + B - error + rng.normal(0, noise, AXIS.size),
            minor_axes=ALONG_X,
            place=place,
            touch=TOUCH,
        )
        for error, place in zip(errors, PLACES, strict=True)
    ]
    own = [fit_plane(semi_minor_px=t.semi_minor_px, distance=t.readings) for t in trials]
    assert np.ptp([fit.b for fit in own]) == pytest.approx(0.2, abs=0.03)
    axis = np.concatenate([t.semi_minor_px for t in trials])
    reading = np.concatenate([t.readings for t in trials])
    # Pooled without them, the touches are the scatter: their RMS about their mean is 0.082 mm.
    assert fit_plane(semi_minor_px=axis, distance=reading).rmse > 0.07

    fit = fit_plane_trials(trials, inverse_working_distance=0.0, tilt_sigma=0.02)
    assert fit.converged
    # 120 spots know their noise to 1/sqrt(240) = 6.5 %: three of those.
    assert fit.noise == pytest.approx(noise, rel=0.2)
    # Only differences of touches are seen; a common one is the prior's.
    np.testing.assert_allclose(np.diff(fit.touch), np.diff(errors), atol=4 * noise / np.sqrt(40))
    assert abs(fit.b - B) < 3 * np.sqrt(fit.covariance[1, 1])
    # Three touches of 0.1 mm leave b no better known than to 0.1/sqrt(3).
    assert np.sqrt(fit.covariance[1, 1]) == pytest.approx(0.1 / np.sqrt(3), rel=0.05)


def test_the_tilt_of_a_plane_is_seen_in_exact_contours():
    tilt = (0.02, -0.01)
    eye = optics.microscope(scale=0.0067, pinhole_height=11.5, eye_radius=11.5)
    wall = optics.pole_plane(
        eye_radius=11.5, tilt=np.arctan(np.hypot(*tilt)), tilt_azimuth=np.arctan2(*tilt[::-1])
    )
    distance = np.linspace(0.5, 6.0, 12)

    seen = [
        exact_spots(wall, eye, [(3.0, np.arctan2(y, x), 0.5, 0.7, d) for d in distance])[0]
        for x, y in PLACES
    ]
    trials = [
        PlaneTrial(
            semi_minor_px=ellipses.semi_minor,
            readings=distance,
            minor_axes=np.stack([np.sin(ellipses.angle), np.cos(ellipses.angle)], axis=-1),
            place=place,
            touch=Prior(0.0, 0.02),
        )
        for ellipses, place in zip(seen, PLACES, strict=True)
    ]
    fit = fit_plane_trials(trials, inverse_working_distance=1 / 23, tilt_sigma=0.05)
    # The second order, tilt^2/2 in the semi-minor axis, is a tenth of the first, tilt c/(z_F + r).
    np.testing.assert_allclose(fit.tilt, tilt, atol=0.1 * max(tilt))
    assert fit.delta_k == pytest.approx(20 * 0.0067, rel=1e-3)
    assert fit.b == pytest.approx(B, abs=0.01)


def test_a_telecentric_microscope_leaves_the_tilt_to_its_prior():
    noisy = DELTA_K * AXIS + B + np.random.default_rng(0).normal(0, 0.01, AXIS.size)
    trials = [PlaneTrial(AXIS, noisy, ALONG_X, place, TOUCH) for place in PLACES]
    fit = fit_plane_trials(trials, inverse_working_distance=0.0, tilt_sigma=0.02)
    np.testing.assert_allclose(fit.tilt, 0.0, atol=1e-9)
    np.testing.assert_allclose(fit.tilt_error, 0.02, rtol=1e-3)
