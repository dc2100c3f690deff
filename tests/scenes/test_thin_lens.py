"""The microscope as a thin lens: light from out of focus is spread over a disc, none is lost."""

import functools
import math
from typing import Any

import numpy as np
import pytest

from eyespot.scenes import Renderer
from tests.support.drawn.scene_tables import BARE, scene_of

SCALE_MM_PX = 0.02


@functools.cache
def spot(pinhole_height_mm: float, **microscope: Any) -> np.ndarray:
    """A cone's spot on a matt plane at the pole, square to it, with no other light."""
    window = {"scale_mm_px": SCALE_MM_PX, "width_px": 80, "height_px": 80, "samples": 1024}
    seen = {**window, "pinhole_height_mm": pinhole_height_mm, **microscope}
    plain = {
        "phantom": {"kind": "plane"},
        "spot": {"incidence_deg": 0.0},
        "motion": {"start_mm": 3.0, "travel_mm": 1.0, "frames": 1},
    }
    image = Renderer(scene_of(BARE, plain, {"microscope": seen})).render(0).radiance
    return image[..., 0].astype(float)


def moments(image: np.ndarray) -> np.ndarray:
    """Power, place (x, y), and variance across (x, y), px."""
    v, u = np.indices(image.shape)
    power = image.sum()
    x, y = (image * u).sum() / power, (image * v).sum() / power
    spread = [(image * (u - x) ** 2).sum() / power, (image * (v - y) ** 2).sum() / power]
    return np.array([power, x, y, *spread])


@pytest.mark.parametrize("pinhole_height_mm", [11.5, 200.0, math.inf])
@pytest.mark.parametrize("focus_mm", [2.0, -2.0])
def test_a_plane_out_of_focus_is_spread_over_the_lens_s_disc(pinhole_height_mm, focus_mm):
    aperture, samples = 0.1, 256
    sharp = moments(spot(pinhole_height_mm, samples=samples))
    lens = {"numerical_aperture": aperture, "focus_mm": focus_mm}
    blurred = moments(spot(pinhole_height_mm, samples=samples, **lens))
    # Similar triangles: a disc of 2 mm tan(asin NA), whose variance across is radius^2 / 4.
    radius_px = 2.0 * math.tan(math.asin(aperture)) / SCALE_MM_PX
    # The grid of 16 x 16 places in pixel and lens misses 1/256 of a variance and puts the sharp
    # edge right to 1/16 px.
    assert blurred[3:] - sharp[3:] == pytest.approx([radius_px**2 / 4] * 2, rel=0.01)
    assert blurred[:3] == pytest.approx(sharp[:3], rel=2e-3)


@pytest.mark.parametrize("pinhole_height_mm", [11.5, math.inf])
def test_a_plane_in_focus_is_as_sharp_as_through_a_pinhole(pinhole_height_mm):
    sharp = spot(pinhole_height_mm)
    # float32 moves a sample by less than 1e-4 px over the edge: of 1024 some change sides.
    changed = np.abs(spot(pinhole_height_mm, numerical_aperture=0.1) - sharp) / sharp.max()
    assert changed.max() < 0.06
    assert (changed > 1e-5).mean() < 0.05
