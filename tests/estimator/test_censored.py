"""A saturated spot's edge, where what is left of its flank tells too little."""

import math

import numpy as np
import pytest

from estimator.detector.band import _flank, hidden_edge
from estimator.detector.ellipse import AffineEllipse, Patch
from estimator.detector.levels import Levels
from estimator.detector.tuning import RAYS


@pytest.mark.parametrize(("radius", "grey"), [(9.5, 0.3), (11.75, 0.85), (13.5, 0.85)])
def test_a_flank_of_a_single_grey_pixel_hides_its_edge(radius, grey):
    v, u = np.mgrid[:41, :41]
    off = np.hypot(u - 20.0, v - 20.0) - radius
    part = np.select([off < -0.25, off < 0.25], [1.0, grey])
    levels = Levels(
        peak=255.0,
        dome=(1.0, 0.0, 0.0),
        variance=0.0,
        background=0.0,
        background_radius=1.5,
        scatter=1.0,
        width=0.011,
        half_radius=1.0,
    )
    patch = Patch((255.0 * part).astype(np.float32), 0.0, 0.0, ceiling=255.0)
    ellipse = AffineEllipse.from_axes(20.0, 20.0, radius, radius, 0.0)
    # One number cannot tell height, place and width apart.
    assert hidden_edge(patch, ellipse, np.ones(RAYS, bool), levels, 0.2) is None


def test_a_flank_without_light_determines_nothing():
    """The inverse of its information is infinite, and a multiple of it no number."""
    x = np.linspace(0.9, 1.1, 20)
    start = np.array([0.3, -23.25, math.log(0.9)])
    with pytest.raises(np.linalg.LinAlgError):
        _flank(start, x, np.zeros(20), np.ones(20))
