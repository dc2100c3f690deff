"""A fit to pixels of which hardly any are usable says how many there are, and why."""

import numpy as np
import pytest

from calibration.pixels.data import BareFibre, Footage
from calibration.pixels.fit import fit_image
from formats.camera import CameraNoise, CameraSheet, Response
from formats.inputs import InputError
from formats.microscope import MicroscopeFile

pytestmark = pytest.mark.usefixtures("fast_compilation")

SIDE, SCALE, RADIUS, HEIGHT = 48, 0.04, 11.5, 200.0


def saturated_footage() -> Footage:
    """A bright disc on a plane in three frames, whose every pixel is black or saturated."""
    v, u = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    disc = np.where(np.hypot(u, v) < 8, 0.5, 0.01).astype(np.float32)
    focal, middle = (HEIGHT + RADIUS) / SCALE, (SIDE - 1) / 2
    microscope = MicroscopeFile(
        width_px=SIDE,
        height_px=SIDE,
        camera_matrix=np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1.0]]),
        distortion=np.zeros(5),
        scale_mm_px=SCALE,
        principal_point_px=(middle, middle),
        pinhole_height_mm=HEIGHT,
        eye_radius_mm=RADIUS,
        response=Response(),
        paper_exposure_s=None,
    )
    sheet = CameraSheet(full_well_e=5000.0, read_noise_e=10.0, black_level_dn=0.0, bit_depth=8)
    noise = CameraNoise(sheet, Response())
    return Footage(
        light=np.stack([disc] * 3),
        clear=np.zeros((3, SIDE, SIDE), bool),
        exposure_s=np.full(3, 0.01),
        readings=np.array([1.0, 2.0, 3.0]),
        motion=np.array([0.0, 0.0, -1.0]),
        axis=np.array([0.0, 0.0, -1.0]),
        noise=noise,
        microscope=microscope,
        instrument=BareFibre(0.25, 6.0),
        in_view=False,
        kind="plane",
        medium_index=1.0,
    )


def test_frames_without_usable_pixels_are_refused_with_their_number():
    start = {"half_angle": 0.05, "b": -5.0}
    with pytest.raises(
        InputError, match=r"0 cells .* are usable; .* parameters .* needs more"
    ) as told:
        fit_image(saturated_footage(), source="cone", start=start)
    assert "Change the exposure" in str(told.value)
