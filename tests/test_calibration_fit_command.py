"""`eyespot fit`: from rendered stacks, whose labels it never reads, to a calibration file."""

import numpy as np
import pytest
from typer.testing import CliRunner

import eyespot
import scenes
from estimator.calibration_file import read_calibration

K, B = 20.0, -5.117


@pytest.fixture(scope="module")
def stacks(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stacks")
    trials = {"plane": 1.5, "eyeball": 4.0}
    for kind, c in trials.items():
        scene = scenes.Scene.model_validate(
            {
                "schema": 1,
                "phantom": {"kind": kind, "wall": "uniform"},
                "source": {"kind": "cone", "cone_k": K, "cone_apex_offset_mm": B},
                "spot": {"eccentricity_mm": c},
                "motion": {"frames": 13},
                "exposures": {"kinds": ["metered"]},
            }
        )
        scenes.render_stack(scene, folder / kind)
    return [str(folder / kind) for kind in trials]


@pytest.mark.slow
def test_fit_finds_the_cone_that_was_rendered(stacks, tmp_path):
    out = tmp_path / "cone.json"
    result = CliRunner().invoke(eyespot.app, ["fit", *stacks, "--out", str(out)])
    assert result.exit_code == 0, result.output
    found = read_calibration(out)
    # Asked of rendered cones with camera noise: half-angle within 0.3 %, b within 0.02 mm.
    assert found.values["half_angle"] == pytest.approx(np.arctan(1 / K), rel=0.003)
    assert found.values["b"] == pytest.approx(B, abs=0.02)
    for name, true in (("half_angle", np.arctan(1 / K)), ("b", B)):
        assert abs(found.values[name] - true) < 4 * found.sigma(name)


@pytest.mark.slow
def test_the_planar_fit_moves_b_by_the_touch(stacks, tmp_path):
    out = tmp_path / "plane.json"
    result = CliRunner().invoke(
        eyespot.app, ["fit", *stacks, "--model", "plane", "--out", str(out)]
    )
    assert result.exit_code == 0, result.output
    found = read_calibration(out)
    # Readings count from the moment the rim touches: rho tan(30 deg) before the centre would.
    assert found.values["b"] == pytest.approx(B - 0.25 * np.tan(np.radians(30.0)), abs=0.02)
    assert found.values["k"] == pytest.approx(K, rel=0.005)


def test_what_is_no_stack_is_refused(tmp_path):
    with pytest.raises(ValueError, match="not a stack"):
        from calibration import fit_command

        fit_command.run(
            [tmp_path], model="cone", out=tmp_path / "c.json", exposure=None, free=["half_angle"]
        )
    assert not (tmp_path / "c.json").exists()
