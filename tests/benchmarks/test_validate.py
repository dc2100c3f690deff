"""The main job end to end: it resumes, refuses, repeats itself, and finds what is known."""

import pandas as pd
import pytest

from eyespot.benchmarks.paper import SUBPIXEL
from eyespot.benchmarks.reporting import rows_of, where
from eyespot.benchmarks.studies import validate

FILES = ("report.html", "summary.json", "model_error.csv", "run.json")


@pytest.fixture(scope="module")
def cone_run(tmp_path_factory):
    out = tmp_path_factory.mktemp("validate") / "run"
    findings = validate.validate(out=out, quick=True, seed=0, source="cone")
    return out, findings


@pytest.mark.slow
def test_a_run_leaves_everything_that_it_promises(cone_run):
    out, findings = cone_run
    for name in FILES:
        assert (out / name).stat().st_size > 0
    rows = pd.read_csv(out / "model_error.csv")
    assert len(rows) == len(findings.analytic) + len(findings.rendered)
    assert {*findings.trials.index} == {folder.name for folder in (out / "stacks").iterdir()}


@pytest.mark.slow
def test_sub_pixel_spots_of_the_ideal_cone_give_its_parameters(cone_run):
    _, findings = cone_run
    (fit,) = rows_of(where(findings.planes, trial="all planes", way=SUBPIXEL.name))
    # k = 20, delta = 0.0067; readings start at contact, 0.25 tan(30 deg) = 0.144 mm from the wall.
    # 0.02 px of 60 at either end of the range is 5e-4 of the slope.
    assert fit.delta_k_mm_px == pytest.approx(0.134, rel=2e-3)
    assert fit.b_mm == pytest.approx(-5.117 - 0.1443, abs=0.02)


@pytest.mark.slow
def test_exact_and_corrected_measure_rendered_spots_to_a_fraction_of_the_small_plane_error(
    cone_run,
):
    _, findings = cone_run
    at_five = findings.rendered[findings.rendered.c_mm == 5.0]
    # The small-plane models' factor is that of a beam in the plane across the meridian.
    across = at_five[(at_five.model == "exact") | (at_five.azimuth_deg == 90.0)]
    worst = across.error_mm.abs().groupby(across.model).max()
    # Spots good to 0.1 px are distances good to k delta 0.1 px = 0.013 mm.
    assert worst["exact"] < 0.015
    assert worst["corrected"] < 0.03
    assert worst["small_plane"] > 1.5


def test_a_folder_with_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match="has files that are not from `eyespot validate`"):
        validate.validate(out=tmp_path, quick=True, seed=0, source="cone")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
