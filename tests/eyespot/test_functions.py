"""`import eyespot`: the functions return what the commands write, and print nothing."""

from importlib import metadata
from pathlib import Path

import pandas as pd
import pytest

import eyespot
from eyespot.formats.calibration import read_calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.spots import read_spots
from tests.support.command_line import printed, run_python

TABLE = {
    "source.kind": "cone",
    "phantom.kind": "plane",
    "phantom.wall": "uniform",
    "motion.frames": 9,
    "spot.eccentricity_mm": 1,
    "exposures.kinds": ["metered"],
    "microscope.width_px": 320,
    "microscope.height_px": 240,
    "microscope.scale_mm_px": 0.0134,
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a stack, the fit of its beam, and what the process printed that made them."""
    folder = tmp_path_factory.mktemp("made")
    code = (
        "import eyespot\n"
        f"eyespot.render(eyespot.Scene(), 'stack', {TABLE})\n"
        "eyespot.fit('stack', model='plane').save('beam.json')\n"
        "eyespot.track('stack', calibration='beam.json')\n"
        "eyespot.score('stack', mode='subpixel')\n"
    )
    done = run_python(code, cwd=folder)
    assert done.exit_code == 0, done.stderr
    (folder / "printed.txt").write_text(done.stdout + done.stderr)
    return folder


def test_nothing_is_printed(made):
    assert (made / "printed.txt").read_text() == ""


@pytest.fixture(scope="module")
def spots(made):
    return eyespot.track(made / "stack", calibration=made / "beam.json")


def test_track_returns_what_the_command_writes(made, spots):
    out = made / "spots.csv"
    words = ("track", made / "stack", "--calibration", made / "beam.json", "-o", out)
    printed(*words)
    printed(*words, "--overwrite")
    written = pd.read_csv(out)
    numbers = written.select_dtypes("number").dropna(axis=1, how="all")
    assert len(numbers.columns) > 30
    pd.testing.assert_frame_equal(spots[numbers.columns], numbers, check_dtype=False, rtol=1e-12)
    spots.to_csv(made / "own.csv", index=False)
    assert read_spots(made / "own.csv")[1].result


def test_a_table_of_spots_begins_with_what_one_looks_at(spots):
    assert [*spots.columns[:9]] == [
        *("frame", "file_name", "time_s", "distance_mm", "distance_low_mm", "distance_high_mm"),
        *("x_px", "y_px", "semi_major_px"),
    ]
    assert spots.attrs["microscope"]["scale_mm_px"] == 0.0134
    assert spots.attrs["calibration"]["k"] == pytest.approx(20.0, rel=0.01)
    assert spots.attrs["ended"] == "complete"


def test_a_fit_has_its_parameters_with_standard_deviations(made):
    fit = eyespot.fit(made / "stack", model="plane")
    calibration = read_calibration(made / "beam.json")
    for name, value in calibration.values.items():
        assert fit.parameters.value[name] == pytest.approx(value, rel=1e-9)
        assert fit.parameters.sigma[name] == pytest.approx(calibration.sigma(name), rel=1e-9)
    assert fit.covariance.loc["b", "b"] == pytest.approx(fit.parameters.sigma["b"] ** 2)
    written = fit.summary["parameters"]["b"]["value"]  # in 15 digits
    assert written == pytest.approx(fit.parameters.value["b"], rel=1e-14)
    assert fit.plot().axes
    with pytest.raises(InputError, match=r"beam\.json"):
        fit.save(made / "beam.json")


def test_wrong_options_are_named(made):
    with pytest.raises(InputError, match="colour is unknown; known are mode"):
        eyespot.track(made / "stack", colour="red")
    with pytest.raises(InputError, match=r"model: .*got 'disc'"):
        eyespot.fit(made / "stack", model="disc")


def test_a_lens_file_may_be_a_path(made):
    lens = made / "none.toml"
    with pytest.raises(InputError, match="no such lens"):
        eyespot.render(eyespot.Scene(), made / "other", {"source.lens": lens})
    with pytest.raises(InputError, match="no such lens"):
        eyespot.fit(made / "stack", lens=lens)


def test_setting_what_the_study_varies_is_refused():
    with pytest.raises(InputError, match="no effect in this study"):
        eyespot.studies.eccentricity(out=Path("never"), changes=("spot.eccentricity_mm=6",))


def test_notebooks_show_a_stack_and_a_scene(made):
    stack = eyespot.read_stack(f"{made / 'stack'}")
    shown = stack._repr_html_()
    assert all(row.file_name in shown for row in stack.labels[:5])
    assert "pinhole_height_mm" in eyespot.Scene()._repr_html_()


def test_the_version_is_that_of_the_distribution():
    assert eyespot.__version__ == metadata.version("eyespot")
