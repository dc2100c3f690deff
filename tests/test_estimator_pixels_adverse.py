"""The mode pixels states its errors also where the camera is not the one that it believes."""

import pytest

from estimator.distance import WallMemory
from tests.pixel_stacks import cone_stack, readings_of

_MOST = 30.0  # chi squared of five numbers exceeds it once in 70,000


def _of(folder, *, wall="printed paper", options=None, **tables):
    phantom = {"wall": wall, "texture_seed": 4}
    stack = cone_stack(folder / "stack", phantom=phantom, **tables)
    return list(readings_of(stack, folder, **(options or {})))


@pytest.mark.parametrize("wall", ["printed paper", "retina"])
def test_a_blurred_edge_does_not_pull_the_distance(tmp_path, wall):
    # Blurred by a disc with a radius of 2 px. Where a cell's edge is believed to leak no light into
    # the next cell, the distance is 30 to 80 um off.
    microscope = {"numerical_aperture": 0.05, "focus_mm": 0.5, "samples": 64}
    found = _of(tmp_path, wall=wall, microscope=microscope | {"width_px": 360, "height_px": 300})
    assert max(abs(distance) for _, distance, _ in found) < 0.02
    assert max(chi_squared for _, _, chi_squared in found) < _MOST


@pytest.mark.parametrize("wall", ["printed paper", "retina"])
def test_the_noise_of_jpeg_is_no_other_wall(tmp_path, wall):
    found = _of(tmp_path, wall=wall, camera={"jpeg_quality": 90})
    assert WallMemory.DROPPED not in {memory for memory, _, _ in found}
    assert max(chi_squared for _, _, chi_squared in found) < _MOST


def test_a_stated_shake_is_within_the_errors_from_the_first_frame_on(tmp_path):
    stated = tmp_path / "stated.toml"
    stated.write_text("shake_px = 1.0\n")
    found = _of(tmp_path, unrest={"shake_px": 1.0, "seed": 3}, options={"stated": stated})
    # A pixel is 12 um; without the statement the first frame's tip has an error of one.
    assert max(chi_squared for _, _, chi_squared in found) < _MOST
