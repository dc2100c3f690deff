"""The paper's line through many trials at once."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.spots.cone_trials import fit_lines

K, B = 20.0, -5.117


def test_the_line_through_an_ideal_cone_is_its_k_and_b_whichever_spots_are_missing():
    d = np.linspace(0.0, 4.0, 21)
    radius = np.tile((d - B) / K, (3, 1))
    radius[1, ::3] = np.nan
    radius[2, 2:] = np.nan
    line = fit_lines(radius, d)
    # Rounding of numbers near 5 mm, times the leverage of b.
    assert line.delta_k[:2] == pytest.approx(K, rel=1e-12)
    assert line.b[:2] == pytest.approx(B, rel=1e-12)
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
