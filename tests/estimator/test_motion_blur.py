import math
from dataclasses import replace

import numpy as np
import pytest

from estimator import SubpixelSettings, TrackState, measure
from formats.spots import NoSpot, Reason
from scenes.drawn import SHAPE, Drawing, Truth, frame_of
from tests.drawn_spots import bell, spot_in

_TRUTH = Truth(x=321.3, y=238.8, semi_major=66, semi_minor=60, angle=0.7)
_MIDDLE = TrackState(at_px=(SHAPE[1] / 2, SHAPE[0] / 2))


def _measured(scene, seed):
    return spot_in(frame_of(scene, np.random.default_rng(seed)), at=_MIDDLE.at_px)


@pytest.mark.parametrize("heading", [0.0, 1.1, 2.5])
def test_a_spot_that_moved_by_half_a_diameter_is_measured_in_the_middle_of_its_path(heading):
    path = 60 * math.cos(heading), 60 * math.sin(heading)
    spot = _measured(Drawing(truth=_TRUTH, path_px=path), seed=1)
    # The requirement is an RMSE of 0.15 px, with texture; the stated error is that of an even wall.
    assert np.abs(_TRUTH.errors(spot)).max() < 3 * 0.15
    # The size along the path follows from the smeared ends alone: a path along the minor axis is
    # the worst case, in which the stated error is the required one. It is estimated from the some
    # 20 blocks of 16 px that these ends cover, so its own relative error is 1 / sqrt(2 * 20).
    assert spot.sigma_semi_minor_px < 0.15 * (1 + 3 / math.sqrt(40))
    # The edge is as wide as that of a spot at rest.
    assert spot.edge_width_px == pytest.approx(2.0, abs=0.3)


def test_a_moving_spot_is_measured_past_a_glint():
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    glint = np.where(np.hypot(u - 300, v - 190) < 5, 250.0, 0.0)
    spot = _measured(Drawing(truth=_TRUTH, path_px=(40.0, 20.0), glints=glint), seed=2)
    assert np.abs(_TRUTH.errors(spot)).max() < 3 * 0.15


def test_a_still_bell_is_not_taken_for_a_moving_disc():
    scene = Drawing(truth=_TRUTH, profile=bell)
    still, elongated = _measured(scene, seed=3), replace(_TRUTH, semi_major=90)
    # A Gaussian that is half at b has the slope of a blurred step of 0.58 b.
    assert still.edge_width_px > 0.4 * _TRUTH.semi_minor
    longer = _measured(replace(scene, truth=elongated), seed=3)
    assert np.abs(elongated.errors(longer)).max() < 0.01 * elongated.semi_major


@pytest.mark.parametrize("reach", [20, 35, 50, 70])
@pytest.mark.parametrize("seed", [4, 5, 6])
def test_a_moving_spot_whose_ends_are_hidden_is_a_failure(reach, seed):
    # Two tools hide the ends of every ray along the path, which lie 33 to 93 px from the middle:
    # the path's length, and so the size, is unknown.
    u = np.arange(SHAPE[1])[None, :] * np.ones((SHAPE[0], 1))
    seen = (np.abs(u - _TRUTH.x) < reach).astype(float)
    drawing = Drawing(truth=_TRUTH, path_px=(60.0, 0.0), seen=seen)
    result, _ = measure(frame_of(drawing, np.random.default_rng(seed)), _MIDDLE, SubpixelSettings())
    assert isinstance(result, NoSpot)
    assert result.reason is Reason.OCCLUDED or reach == 70  # hardly hidden
