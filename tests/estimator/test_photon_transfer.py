"""A camera's noise measured from pairs of frames, against the data sheet that made the frames."""

import cv2
import numpy as np
import pytest

from eyespot.estimator.camera_noise import camera_noise
from eyespot.estimator.photon_transfer import measured_noise
from eyespot.formats.inputs import InputError
from eyespot.formats.rig import read_rig
from eyespot.scenes.sensor import CameraSensor
from tests.support.command_line import printed
from tests.support.drawn.made_up import a_microscope_file
from tests.support.drawn.scene_tables import scene_of

_SHEET = {"full_well_e": 8000.0, "read_noise_e": 12.0, "black_level_dn": 6.0, "prnu": 0.01}
_LEVELS = (0.0, 0.12, 0.25, 0.4, 0.6, 0.8)


def _pairs(**camera):
    size = {"width_px": 640, "height_px": 480}
    made = CameraSensor(scene_of({"camera": {**_SHEET, **camera}, "microscope": size}), seed=5)

    def exposed(level, *seed):
        # 200 full wells per second and unit of radiance: the scene's own sensitivity.
        light = np.full((480, 640, 3), level / 200.0, np.float32)
        return made.written(made.raw(light, exposure_s=1.0, noise_seed=[*seed]))

    return [(exposed(level, n, 0), exposed(level, n, 1)) for n, level in enumerate(_LEVELS)]


def test_the_data_sheet_is_found():
    found = measured_noise(_pairs(), bit_depth=8).sheet
    # Each variance has 230,400 samples, 0.3 %; the gain follows from five of them.
    assert found.full_well_e == pytest.approx(8000.0, rel=0.01)
    assert found.black_level_dn == pytest.approx(6.0, abs=0.02)
    # Read noise is 0.37 DN, and rounding to whole numbers adds 0.29 DN, which is not quite white.
    assert found.read_noise_e == pytest.approx(12.0, rel=0.1)
    assert found.prnu == pytest.approx(0.01, rel=0.1)


def test_pairs_that_show_no_noise_are_refused():
    white = np.full((64, 64, 3), 255, np.uint8)
    for pairs, said in (
        (_pairs(response=1.5), "straight line"),
        ([(white, white)] * 2, "all 2 pairs the light reaches full scale, 255 DN"),
        (_pairs()[1:], "light off"),
    ):
        with pytest.raises(InputError, match=said):
            measured_noise(pairs, bit_depth=8)


def test_the_command_writes_the_noise_into_a_microscope_file(tmp_path):
    folder = tmp_path / "flats"
    folder.mkdir()
    for number, pair in enumerate(_pairs()):
        for k, frame in enumerate(pair):
            cv2.imwrite(f"{folder}/{2 * number + k + 1}.png", frame[..., ::-1])
    microscope = a_microscope_file(tmp_path)
    out = tmp_path / "rig.toml"
    printed("camera", folder, "--rig", microscope, "--out", out)
    view = read_rig(out).view
    assert view is not None
    noise = camera_noise(view)
    assert noise is not None
    # Half a full well: shot noise of 4,000 electrons, 1 % of PRNU, read noise, and a twelfth of the
    # square of a step of 8000/249 electrons.
    expected = np.sqrt(4000 + 40.0**2 + 12.0**2 + (8000 / 249) ** 2 / 12) / 8000.0
    sigma = np.sqrt(noise.channel_variance(np.array([0.5]))[0])
    assert sigma == pytest.approx(expected, rel=0.02)
