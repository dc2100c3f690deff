"""A lens's light is found if the fibre was glued askew, so that its beam is not its motion."""

import math

import pytest

from tests.photon_fits import fitted
from tests.photon_stacks import Recording
from tests.photons import Drop


@pytest.mark.slow  # half a minute to compile, to count photons and to fit
def test_a_beam_two_degrees_off_the_motion_does_not_change_the_lens():
    drop = Drop(core=0.25, aperture=0.30, sag=0.07, rim=0.04, aperture_na=0.15)
    askew = Recording(drop=drop, beam_off=(math.radians(1.2), math.radians(1.6)))
    fit, _ = fitted(askew, seed=2)
    assert fit.converged
    truth = {
        "sag": drop.sag,
        "numerical_aperture": drop.aperture_na,
        "sensitivity": askew.sensitivity,
    }
    for name, true in truth.items():
        value, sigma = fit.parameters[name]
        print(f"{name}: {value:.6g} +- {sigma:.2g}, z {(value - true) / sigma:+.2f}")
        # Three parameters at 3.3 standard errors: a false alarm in 300 seeds; this one is fixed.
        assert abs(value - true) < 3.3 * sigma, name
        # The misfit that finite photons cause does not make the test empty.
        assert sigma < 0.01 * true, name
    angles = [fit.parameters[f"boresight{end}"] for end in ("", "_sideways")]
    found = math.hypot(*(value for value, _ in angles))
    sigma = max(error for _, error in angles)
    # `Recording.beam_off` are tangents along two perpendiculars.
    true = math.atan(math.hypot(*askew.beam_off))
    print(f"boresight: {found:.6g} rad, z {(found - true) / sigma:+.2f}")
    assert abs(found - true) < 3.3 * sigma
