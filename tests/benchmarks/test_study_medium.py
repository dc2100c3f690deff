"""Study of media: what air's cone is worth elsewhere, and where a radius has several distances."""

import math

import numpy as np
import pytest

from eyespot.benchmarks.reporting import rows_of
from eyespot.benchmarks.studies import medium
from eyespot.benchmarks.studies.medium import AIR, VITREOUS, Curve, Method, Regression
from eyespot.scenes.world.world import Cone

DISTANCE = np.linspace(0.05, 8.0, 1600)
ASKED = np.linspace(0.5, 6.0, 12)


def straight(k: float, b: float, name: str) -> Curve:
    """A light that is a cone in its medium."""
    regression = Regression("a", name, k, b, 1.0, math.nan, math.nan)
    return Curve(DISTANCE, (DISTANCE - b) / k, regression)


def test_no_medium_changes_what_an_ideal_cone_says():
    cone = Cone(math.atan(1 / 20), -5.117)
    air, vitreous = (medium.cone_curve(cone, name) for name in (AIR, VITREOUS))
    rows = medium.analytic_errors(air, vitreous, distances=ASKED)
    assert set(rows.method) == set(Method)
    # Rounding of numbers near 10, times k.
    assert rows.error_mm.abs().max() < 1e-12
    assert not rows.ambiguous.any()


def test_airs_cone_is_off_by_the_ratio_of_the_slopes():
    air, vitreous = straight(12.0, -3.0, AIR), straight(16.0, -4.0, VITREOUS)
    rows = medium.analytic_errors(air, vitreous, distances=ASKED)
    for row in rows_of(rows):
        # R = (d + 4)/16, read as 12 R - 3 = 3/4 d: a quarter of the distance is lost.
        expected = -0.25 * row.d_mm if row.method == Method.AIR_CONE else 0.0
        assert row.error_mm == pytest.approx(expected, abs=1e-12)


def test_a_radius_on_both_sides_of_a_waist_is_ambiguous_and_gives_the_farther_answer():
    air = straight(20.0, -5.0, AIR)
    waist = 2.0
    radius = np.hypot(0.2, 0.1 * (DISTANCE - waist))
    vitreous = Curve(DISTANCE, radius, air.cone._replace(medium=VITREOUS))
    rows = medium.analytic_errors(air, vitreous, distances=np.array([1.0, 3.0, 5.0]))
    by_lens = rows[rows.method == Method.LENS].set_index("d_mm")
    # The same on both sides, 2 (waist - d) apart; 5 mm's other side lies behind the tip. Linear
    # between samples 5 um apart: 1e-6 of the radius, a few um of distance.
    assert by_lens.error_mm[1.0] == pytest.approx(2.0, abs=1e-4)
    assert by_lens.error_mm[3.0] == pytest.approx(-2.0, abs=1e-4)
    assert by_lens.error_mm[5.0] == pytest.approx(0.0, abs=1e-4)
    assert by_lens.ambiguous[[1.0, 3.0, 5.0]].tolist() == [True, True, False]


@pytest.mark.slow
def test_a_flat_end_in_vitreous_is_the_same_lens_seen_from_farther_off():
    air, vitreous = (medium.lens_curve("paper-candidate", name) for name in (AIR, VITREOUS))
    # Snell: sin(angle) = NA/n; the profile depends on d tan(angle)/a but for cosines, which are
    # 1 within (0.1)^2/2 = 0.5 %.
    longer = math.tan(math.asin(0.10)) / math.tan(math.asin(0.10 / 1.336))
    for d in (0.5, 1.5, 3.0, 4.0):
        near = np.interp(d, air.distance, air.radius)
        far = np.interp(longer * d, vitreous.distance, vitreous.radius)
        assert far == pytest.approx(near, rel=0.01)


@pytest.mark.slow
def test_a_quick_run_finds_airs_cone_wrong_and_the_lens_model_right(tmp_path):
    errors = medium.medium(out=tmp_path / "run", quick=True)
    rendered = errors[(errors.source == "rendered") & (errors.medium == VITREOUS)]

    def worst(light: str, method: Method) -> float:
        rows = rendered[(rendered.light == light) & (rendered.method == method)]
        return rows.error_mm[~rows.ambiguous].abs().max()

    assert worst("paper-candidate", Method.AIR_CONE) > 1.0
    assert worst("paper-candidate", Method.LENS) < 0.1
    # Spots good to 0.1 px are distances good to k delta 0.1 px = 0.013 mm, twice: fit and use.
    assert worst("cone", Method.AIR_CONE) < 0.03
    for name in ("report.html", "medium_error.csv", "medium_cones.csv", "figures/error.png"):
        assert (tmp_path / "run" / name).stat().st_size > 0
