"""Drawn rigs: what they read lies where they say, also where nothing says how far the tip was."""

import pytest

from eyespot.benchmarks.bench.promises import judged, readings_of_cones


@pytest.mark.parametrize("number", [35, 45])
def test_a_withdrawal_that_begins_anywhere_is_fitted_from_its_core(number):
    # From a first distance of 3 mm the solver went astray in 19 of 24 such rigs, these two too.
    row = readings_of_cones(1, first=number).iloc[0]
    assert row.core and not row.refused
    assert abs(row.error_mm) < 4 * row.sigma_mm


@pytest.mark.slow
def test_intervals_of_drawn_rigs_hold_the_truth():
    found = readings_of_cones(60)
    table = judged(found)
    # Of 60 with 95 % each, 52 or fewer inside has a probability of 0.7 %.
    assert found[~found.refused].inside.sum() >= 53 - found.refused.sum()
    assert table.refused_percent["all"] <= 5
