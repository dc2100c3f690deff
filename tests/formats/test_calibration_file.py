"""Calibration files: what is written is read again, and what no fit can give is refused."""

import json

import numpy as np
import pytest

from eyespot.formats.calibration import Calibration, read_calibration, write_calibration
from eyespot.formats.inputs import InputError
from tests.support.drawn.made_up import DOME


def calibration(**changed):
    given = {
        "model": "planar",
        "values": {"k": 20.1, "b": -5.117},
        "covariance": [[0.04, -0.012], [-0.012, 0.0049]],
        "medium": "air",
        "medium_index": 1.0,
        "fitted_on": "trials 1 to 3, d 0.3 to 5 mm",
        "data_sha256": "0123456789abcdef" * 4,
        "software": "eyespot 0.1.0",
    }
    return Calibration.of(**{**given, **changed})


@pytest.fixture
def edited(tmp_path):
    """Writes a good file, changes its content by hand, and gives its path."""

    def edit(change):
        path = tmp_path / "calibration.json"
        write_calibration(path, calibration())
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))
        return path

    return edit


@pytest.mark.parametrize(
    ("model", "values"),
    [
        ("planar", {"k": 20.1, "b": -5.117}),
        ("small_plane", {"b": -5.0, "k": 19.0, "eccentricity": 2.5, "eye_radius": 11.5}),
        ("exact", {"half_angle": 0.05, "b": -5.0, "scale": 0.0067}),
        ("exact", {"half_angle": 0.05, "b": -5.0, "beam_x": 0.03, "beam_y": -0.02}),
        ("lens", DOME),
        ("lens", {**DOME, "launch_radius": 0.1, "launch_aperture": 0.1, "brightness": 3e-3}),
    ],
)
def test_a_file_holds_every_digit(tmp_path, model, values):
    factor = np.random.default_rng(1).standard_normal((len(values), len(values))) / 10
    written = calibration(model=model, values=values, covariance=factor @ factor.T)
    write_calibration(tmp_path / "c.json", written)
    read = read_calibration(tmp_path / "c.json")
    assert list(read.values.items()) == list(values.items())
    np.testing.assert_array_equal(read.covariance, written.covariance)
    assert read == written
    assert [path.name for path in tmp_path.iterdir()] == ["c.json"]


@pytest.mark.parametrize(
    ("covariance", "sigmas"),
    [
        ([[0.04, -0.012], [-0.012, 0.0049]], (0.2, 0.07)),
        (np.zeros((2, 2)), (0.0, 0.0)),
        # Correlation -1: only a combination is known, as of k and b from one distance.
        (np.outer([0.2, -0.1], [0.2, -0.1]), (0.2, 0.1)),
    ],
)
def test_sigma_is_the_root_of_the_variance(covariance, sigmas):
    known = calibration(covariance=covariance)
    assert (known.sigma("k"), known.sigma("b")) == pytest.approx(sigmas)


def put(*keys, value):
    """An edit of one place in the file."""

    def change(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (put("model", value="sphere"), r"model must be one of planar.*'sphere'"),
        (put("parameters", "q", value={"value": 1, "unit": "1", "sigma": 0}), "q is unknown"),
        (put("parameters", "k", "unit", value="mm"), r"k must be in '1'; got unit 'mm'\. Convert"),
        (put("parameters", "k", "value", value=-20.0), r"k must lie in \(0, 1e\+06\) 1; got -20"),
        (
            put("parameters", "b", "value", value=-5117.0),
            "at most 25 mm radius at the tip; got -5117",
        ),
        (put("medium", "index", value=1.6), r"medium\.index of .* must lie from"),
        (put("parameters", "b", "sigma", value=0.01), "sigma of b is 0.01, but the covariance"),
        (put("covariance", "order", value=["b", "k"]), "order must list the parameters"),
        (put("covariance", "matrix", value=[[0.04]]), "matrix must have rows of 2 numbers"),
        (put("covariance", "matrix", value=[[1, 2], [3]]), "must have rows of 2 numbers"),
        (put("covariance", "matrix", 0, 1, value=0.5), "must be symmetric"),
        (put("covariance", "matrix", 0, 0, value=-0.04), "no negative variance"),
        (put("covariance", "matrix", 0, 0, value=float("inf")), "covariance must be finite"),
        (
            put("covariance", "matrix", value=[[0.04, 0.02], [0.02, 0.0049]]),
            "positive semi-definite.*no correlation may exceed 1",
        ),
        (put("covariance", "matrix", value=[[0, 0.02], [0.02, 0.0049]]), "symmetric|definite"),
        (put("fitted_on", "sha256", value="abc"), "sha256 must be 64 hexadecimal digits"),
    ],
)
def test_nonsense_is_refused_with_file_key_and_remedy(edited, change, told):
    path = edited(change)
    with pytest.raises(InputError, match=told) as error:
        read_calibration(path)
    assert str(error.value).startswith(str(path))


@pytest.mark.parametrize("content", [b"", b"k = 20", b"[1, 2]", b"\xff\xfe\x00", b"null"])
def test_what_is_no_calibration_file_is_refused(tmp_path, content):
    path = tmp_path / "c.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match="not a calibration file"):
        read_calibration(path)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"values": {"half_angle": 0.0, "b": -5.0}}, r"half_angle must lie in \(0, 1.5708\) rad"),
        ({"values": {"half_angle": np.pi / 2, "b": -5.0}}, r"half_angle must lie in \(0, 1.5708\)"),
        ({"values": {"k": 20.0, "half_angle": 0.05}}, "either k or half_angle"),
        ({"values": {"b": -5.0, "scale": 0.0067}}, "either k or half_angle"),
        ({"values": {"k": 20.0, "scale": 0.0067}}, "missing b"),
        (
            {"values": {"k": 20.0, "b": -5.0, "sag": 0.1}, "covariance": np.eye(3)},
            "not of this.*sag",
        ),
        ({"model": "lens"}, "missing aperture_radius.*not of this model b, k"),
    ],
)
def test_a_model_has_its_own_parameters(changed, told):
    with pytest.raises(InputError, match=told):
        calibration(**changed)
