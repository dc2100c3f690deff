"""A fit is called good only where nothing speaks against it, and each reason is named."""

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eyespot.calibration.command.fit_verdict import (
    Fault,
    Fitted,
    PixelResiduals,
    bounds_hit,
    doubts,
    refusal,
    remedy,
    verdict,
)
from eyespot.calibration.command.fitting import MODELS
from eyespot.calibration.least_squares import slow_power
from eyespot.calibration.pixels.misfit import Misfit

BEND = np.linspace(-1, 1, 40) ** 2


def test_noise_is_called_structured_as_rarely_as_the_level_says():
    rng = np.random.default_rng(0)
    found = [slow_power(rng.standard_normal(52)) for _ in range(2000)]
    # Binomial(2000, 0.01): fewer than 8 or more than 34 have a chance of 0.4 %.
    assert 8 <= sum(chance < 0.01 for _, chance in found) <= 34
    # The mean of five squares of normal numbers, 2000 times: 1 +- 0.014.
    assert np.mean([power for power, _ in found]) == pytest.approx(1, abs=0.05)


def test_a_bend_under_the_noise_is_found():
    rng = np.random.default_rng(0)
    x = np.linspace(-1, 1, 61)
    assert slow_power(rng.standard_normal(61) + 4 * (x**2 - 1 / 3))[1] < 1e-3


def test_errors_grow_with_structure_as_much_as_it_moves_a_line():
    # Errors that ten neighbouring frames share, with variance 1, and a line fitted to them.
    rng = np.random.default_rng(0)
    x = np.linspace(-1, 1, 120)
    noise = np.repeat(rng.standard_normal((400, 12)), 10, axis=1)
    offset, slope = np.polynomial.polynomial.polyfit(x, noise.T, 1)
    left = noise - np.outer(offset, np.ones_like(x)) - np.outer(slope, x)
    growth = [power if chance < 0.01 else 1.0 for power, chance in map(slow_power, left)]
    moved = slope * np.sqrt(np.sum(x**2))
    # Ten equal errors instead of ten independent ones make a variance ten times as large (400 of
    # them: to 7 %). Dividing by a mean of five squares makes it a Student's t of five degrees, with
    # a variance of 5/3; the five waves fade by a fifth, and the smallest remain undetected.
    assert np.var(moved) == pytest.approx(10, rel=0.21)
    assert np.std(moved / np.sqrt(growth)) == pytest.approx(np.sqrt(5 / 3), rel=0.2)


def good(**changes):
    noise = np.random.default_rng(1).standard_normal(40)
    known: dict[str, Any] = {
        "converged": True,
        "bounds": (),
        "undetermined": (),
        "chi_squared_per_degree": 1.0,
        "degrees_of_freedom": 200,
        "misfit": None,
        "residuals": {"size": noise},
    }
    known |= changes
    per_degree, misfit = known.pop("chi_squared_per_degree"), known.pop("misfit")
    nothing = np.zeros(0)
    return doubts(
        Fitted(
            calibration_model="exact",
            values={},
            covariance=np.zeros((0, 0)),
            recordings=[],
            used=40,
            chi_squared=None if per_degree is None else per_degree * known["degrees_of_freedom"],
            pixels=misfit and PixelResiduals(nothing, [], nothing.astype(int), nothing, misfit),
            **known,
        )
    )


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"converged": False}, "did not converge"),
        ({"bounds": ("k = 0",)}, "hit a bound: k = 0"),
        (
            {"undetermined": ("scale is not determined",)},
            "do not determine all parameters: scale is not determined",
        ),
        ({"chi_squared_per_degree": 0.2}, "0.2.*noise is lower than assumed"),
        ({"chi_squared_per_degree": 2.1}, "2.1.*residuals are larger than the noise"),
        ({"residuals": {"size": 90 * BEND}}, "residuals of size have structure"),
        ({"residuals": {"size": 4 * BEND}}, "size may move.*, .*enlarged"),
    ],
)
def test_each_reason_against_a_fit_is_named(change, told):
    (doubt,) = good(**change)
    assert re.search(told, doubt.reason)
    assert doubt.fault.harmless == ("noise is lower than assumed" in told or "enlarged" in told)


def test_a_refusal_has_three_lines_whatever_is_wrong():
    everything: dict[str, Any] = {
        "converged": False,
        "bounds": ("k = 0", "b = 0"),
        "undetermined": ("scale is not determined", "b is not determined"),
        "chi_squared_per_degree": 9.0,
        "degrees_of_freedom": 200,
        "misfit": None,
        "residuals": {name: 90 * BEND for name in ("along", "across", "size", "elongation")},
    }
    wrong, remedy, details = refusal(
        good(**everything), model="cone", report=Path("c.html")
    ).splitlines()
    assert (
        wrong == "not a good fit: the solver did not converge; it hit a bound: k = 0; and 5 more."
    )
    assert "--free" in remedy and "at its bound" in remedy
    assert "c.html" in details


def test_a_remedy_of_two_faults_is_named_once():
    found = good(chi_squared_per_degree=9.0, misfit=None, residuals={"size": 90 * BEND})
    _, tries, _ = refusal(found, model="cone", report=Path("c.html")).splitlines()
    assert len(found) == 2
    assert tries.count("--model lens") == 1
    assert "keeps still" in tries


def test_every_fault_has_a_remedy_with_options_that_the_model_has():
    for fault, model in itertools.product(Fault, MODELS):
        said = remedy(fault, model=model)
        assert "--lens" not in said or model == "lens"
        assert "--robust" not in said or model in ("plane", "sphere")
        assert not re.search("--(free|prior)", said) or model in ("cone", "image", "lens")
        assert f"--model {model}" not in said
    # Each has one for the models that can have it; only harmless faults need none.
    for fault in Fault:
        assert any(remedy(fault, model=model) for model in MODELS) != fault.harmless


@pytest.mark.parametrize(("degrees", "noise_explains"), [(40, True), (400, False)])
def test_the_accepted_chi_squared_depends_on_the_degrees_of_freedom(degrees, noise_explains):
    # 1.4 is 1.8 standard deviations sqrt(2/n) from 1 with 40 degrees of freedom, 5.7 with 400.
    found = good(chi_squared_per_degree=1.4, degrees_of_freedom=degrees)
    assert (found == []) == noise_explains
    if found:
        assert verdict(found).startswith("Accepted, with enlarged standard errors: chi squared")
        assert "enlarged 1.18 times" in found[0].reason


def pixels(share, structured, chi_squared, degrees=302_732):
    where = "the core is 1.1 % darker than the model in all frames" if structured else ""
    misfit = Misfit(share, 1e-9 if structured else 0.5, structured, 17.0, where)
    return good(
        chi_squared_per_degree=chi_squared, degrees_of_freedom=degrees, misfit=misfit, residuals={}
    )


def test_a_small_misfit_of_pixels_is_stated_with_its_place_and_its_effect():
    (doubt,) = found = pixels(0.009, True, 1.21)
    assert doubt.fault.harmless
    for words in ("0.9 %", "the core is 1.1 % darker", "enlarged up to 17 times"):
        assert words in doubt.reason
    assert verdict(found).startswith("Accepted, with enlarged standard errors")
    # Residuals with structure count even where chi squared does not show them.
    assert len(pixels(0.001, True, 1.0)) == 1


def test_a_large_misfit_of_pixels_is_not_a_good_fit():
    (doubt,) = pixels(0.03, True, 3.0)
    assert not doubt.fault.harmless
    assert "3 %" in doubt.reason and "limit is 2 %" in doubt.reason


def test_a_camera_noisier_than_its_data_sheet_by_a_few_percent_is_no_misfit():
    assert pixels(0.001, False, 1.05) == []
    assert pixels(0.0, False, 0.95) == []


def test_nothing_speaks_against_a_good_fit():
    assert good() == []
    assert good(chi_squared_per_degree=None) == []


def test_a_value_that_cannot_be_is_a_bound_hit():
    assert bounds_hit({"half_angle": 0.05, "b": -5.0}) == ()
    (told,) = bounds_hit({"half_angle": -0.01, "b": -5.0})
    assert told.startswith("half_angle = -0.01 rad")
