"""Fits of several recordings apart, whose errors hang together: agreement, mean and its errors."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import stats

from eyespot.calibration.command.apart import compared, together
from eyespot.calibration.command.fit_verdict import Fault, Fitted, doubts

# A lens: two shapes that a scale moves, one length that follows the other, one given exactly.
NAMES = ("sag", "numerical_aperture", "glue_length", "glue_index")
TRUTH = np.array([0.08, 0.12, 0.10, 1.49])
FOLLOWS = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
SHARED = np.array([3e-3, 2e-3])
"""By a standard deviation of the scale."""
TOUCH = np.array([5e-4, -5e-4])
"""By one of the first distance, which each recording has anew."""


def drawn(rng, *, count=3, spread=1e-3, off=(0.0, 0.0)):
    """Fits that scatter as they state; those after the first are off by so much."""
    scale, fits = rng.normal(), []
    for number in range(count):
        factor = np.array([[1.0, 0.3], [0.0, 0.8]]) * spread * (1.0 + number)
        own = factor @ rng.normal(size=2) + TOUCH * rng.normal()
        rows = {
            "scale": (FOLLOWS @ (SHARED * (1.0 + 0.2 * number)))[None],
            "touch": (FOLLOWS @ TOUCH)[None],
        }
        values = TRUTH + FOLLOWS @ (own + SHARED * (1.0 + 0.2 * number) * scale)
        values = values + FOLLOWS @ np.array(off) * (number > 0)
        covariance = FOLLOWS @ factor @ factor.T @ FOLLOWS.T
        covariance += sum(row.T @ row for row in rows.values())
        fits.append(
            Fitted(
                calibration_model="lens",
                values=dict(zip(NAMES, values.tolist(), strict=True)),
                covariance=covariance,
                stated=rows,
                shared={"scale": rows["scale"]},
                converged=True,
                residuals={},
                recordings=cast(Any, [SimpleNamespace(name="ABC"[number])]),
                used=30,
                chi_squared=100.0,
                degrees_of_freedom=100,
                others=[("touch", 0.1, 0.02, "mm")],
            )
        )
    return fits


def test_the_chance_of_recordings_that_share_an_error_is_uniform():
    rng = np.random.default_rng(1)
    chances = [compared(drawn(rng)).chance for _ in range(400)]
    assert stats.kstest(chances, "uniform").pvalue > 1e-3  # the level of one test
    # Counted as independent, the shared error would make the recordings agree too well.
    alone = [compared([replace(fit, shared={}) for fit in drawn(rng)]).chance for _ in range(400)]
    assert stats.kstest(alone, "uniform").pvalue < 1e-6


def test_another_lens_is_found_though_the_scale_hides_its_size():
    # The first two differ by 0.0024 of their own, and by 0.0006 of the scale.
    rng = np.random.default_rng(2)
    found = [compared(drawn(rng, off=(0.02, 0.0))).chance for _ in range(50)]
    assert max(found) < 1e-3


def test_the_mean_scatters_as_its_covariance_says_and_keeps_what_is_exact():
    rng = np.random.default_rng(3)
    means = [together(drawn(rng)) for _ in range(1000)]
    values = np.array([list(one.values.values()) for one in means])
    # Of 1,000 draws a standard deviation is known to 1 / sqrt(2000) = 2.2 %.
    sigma = np.sqrt(np.diag(means[0].covariance))
    assert np.std(values, axis=0)[:3] == pytest.approx(sigma[:3], rel=0.1)
    assert np.mean(values, axis=0) == pytest.approx(TRUTH, abs=5 * sigma.max() / math.sqrt(1000))
    assert np.ptp(values[:, 3]) == 0.0  # given exactly
    assert values[:, 2] - values[:, 0] == pytest.approx(0.02, abs=1e-9)  # one follows the other
    # The shared error does not average out; the recordings' own do.
    assert sigma[0] > SHARED[0]
    alone = np.sqrt(np.diag(drawn(rng)[0].covariance))
    assert (sigma[:2] < 1.2 * alone[:2]).all()


def test_the_mean_says_how_far_it_follows_each_cause():
    rng = np.random.default_rng(4)
    one = together(drawn(rng))
    assert one.stated["scale"].shape == (1, 4) and one.stated["touch"].shape == (3, 4)
    # The scale moves every recording by 1 to 1.4 of SHARED, and so their mean.
    part = one.stated["scale"][0, :2] / SHARED
    assert ((part > 0.9) & (part < 1.5)).all()
    # What is left is the recordings' own.
    rest = one.covariance - sum(row.T @ row for row in one.stated.values())
    assert np.linalg.eigvalsh(rest[:2, :2]).min() > 0
    assert [name for name, *_ in one.others] == ["touch of A", "touch of B", "touch of C"]


def with_brightness(fit, value):
    covariance = np.pad(fit.covariance, ((0, 1), (0, 1)))
    covariance[-1, -1] = 0.01**2
    none = {name: np.pad(rows, ((0, 0), (0, 1))) for name, rows in fit.stated.items()}
    return replace(
        fit,
        values=fit.values | {"brightness": value},
        covariance=covariance,
        stated=none,
        shared={"scale": none["scale"]},
    )


def test_the_brightness_of_cameras_with_another_gain_has_no_mean():
    fits = drawn(np.random.default_rng(6), count=2)
    alike, apart = (
        [with_brightness(f, v) for f, v in zip(fits, (1.0, b), strict=True)] for b in (1.01, 1.5)
    )
    # Of equal errors the mean is the middle.
    assert together(alike).values["brightness"] == pytest.approx(1.005, abs=1e-6)
    assert "brightness" not in together(apart).values
    assert compared(alike).names == compared(apart).names == list(NAMES)


def test_a_bad_part_is_named_in_the_verdict():
    rng = np.random.default_rng(5)
    fits = drawn(rng)
    fits[1] = replace(fits[1], converged=False)
    (found,) = doubts(together(fits))
    assert found.fault is Fault.STEPS and found.reason.startswith("B: ")
