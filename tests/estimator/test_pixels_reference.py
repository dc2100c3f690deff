"""The mode pixels with an image of the wall without the spot."""

import cv2
import numpy as np
import pytest

from estimator.distance.range import WallMemory
from estimator.run.options import Options
from estimator.sources.opening import open_source
from formats.inputs import InputError
from formats.poses import read_poses
from tests.pixel_stacks import calibration_in, cone_stack, reader_in

_RETINA = {"wall": "retina", "texture_seed": 6}


def _reference(folder, *, phantom):
    """An image of the wall alone: the beam's power is a millionth of the ambient light's."""
    dark = cone_stack(
        folder / "dark",
        phantom=phantom,
        source={"kind": "cone", "power_mw": 1e-9},
        motion={"start_mm": 2.0, "travel_mm": 0.1, "frames": 1, "speed_mm_s": 1.0},
    )
    image = next(iter(open_source(dark.folder))).image
    cv2.imwrite(str(folder / "reference.png"), image[..., ::-1])
    return folder / "reference.png"


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    return cone_stack(tmp_path_factory.mktemp("lit") / "stack", phantom=_RETINA)


def _first(stack, folder, **options):
    reader = reader_in(stack, folder, **options)
    # A retina is dark: the tip withdraws by some 60 um during an exposure.
    poses = read_poses(stack.folder / "kinematics.csv")
    frame = list(open_source(stack.folder))[1]
    found = reader.read(
        frame.image, time_s=frame.time_s, exposure_s=frame.exposure_s, poses=poses
    ).range
    assert found is not None
    (pose,) = found.poses
    assert pose.covariance is not None
    off = pose.tip_mm - np.array(stack.labels[1].tip_mm)
    return found, off @ np.linalg.solve(pose.covariance[:3, :3], off)


def test_a_wall_that_is_known_beforehand_makes_the_first_frame_better(stack, tmp_path):
    found, chi_squared = _first(stack, tmp_path, reference=_reference(tmp_path, phantom=_RETINA))
    blind, _ = _first(stack, tmp_path)
    assert (found.wall, blind.wall) == (WallMemory.KNOWN, WallMemory.NEW)
    # What is left is the camera's noise and cells that the edge cuts.
    assert found.sigma_mm < 0.8 * blind.sigma_mm
    # Chi squared of three numbers exceeds 21 once in 10,000.
    assert chi_squared < 21


def test_an_image_of_another_wall_is_noticed_and_left_out(stack, tmp_path):
    other = _reference(tmp_path, phantom=_RETINA | {"texture_seed": 8})
    found, chi_squared = _first(stack, tmp_path, reference=other)
    assert found.wall is WallMemory.DROPPED
    assert chi_squared < 21


def test_a_reference_of_another_size_or_for_another_mode_is_refused(stack, tmp_path):
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((100, 120, 3), np.uint8))
    options = {
        "calibration": calibration_in(tmp_path),
        "microscope": stack.folder / "microscope.json",
        "reference": small,
    }
    with pytest.raises(InputError, match="120x100 px, but the microscope file is made for 360x300"):
        Options.of({"mode": "pixels", **options}).reader()
    with pytest.raises(InputError, match="no effect in the mode subpixel"):
        Options.of(options).reader()
