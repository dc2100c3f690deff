from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eyespot.estimator import LiteralSettings, TrackState, measure, track
from eyespot.estimator.detector.literal import patch_check
from eyespot.formats.spot import NoSpot, Reason, Spot
from eyespot.scenes.drawn import Drawing, Truth, erf_edge, frame_of
from tests.support.drawn.drawn_spots import spot_in

_TRUTH = Truth(x=320.3, y=241.6, semi_major=66, semi_minor=60, angle=0.5)
_SCENE = Drawing(truth=_TRUTH, amplitude=235, ambient=10, noise=1.0)


@given(
    x=st.floats(-500, 1500),
    y=st.floats(-500, 1500),
    p=st.integers(1, 200),
    rows=st.integers(402, 600),
    columns=st.integers(402, 900),
)
def test_patch_check_keeps_the_patch_inside_the_image(x, y, p, rows, columns):
    cx, cy = patch_check(x, y, p, (rows, columns))
    assert 0 <= cx - p and cx + p <= columns
    assert 0 <= cy - p and cy + p <= rows


def test_patch_check_leaves_an_inner_point_alone():
    # Algorithm 2 as printed sends every small m_y to r_I - p - 1.
    assert patch_check(300, 210, 200, (480, 640)) == (300, 210)
    assert patch_check(10, 10, 200, (480, 640)) == (200, 200)


@pytest.mark.parametrize("order", ["filter_first", "threshold_first"])
def test_literal_ellipse_lies_where_the_value_crosses_200(order):
    frame = frame_of(_SCENE, np.random.default_rng(0))
    settings = LiteralSettings(order=order)
    spot = spot_in(frame, settings, at=(300, 230))
    inward = 2.0 * NormalDist().inv_cdf((200 - 10) / 235)
    # The boundary runs through pixel centres: up to 1 px inside the crossing, half a px on average;
    # the filters' blur moves the crossing by another 0.3 px.
    assert spot.semi_minor_px == pytest.approx(60 - inward - 0.5, abs=0.8)
    assert spot.x_px == pytest.approx(_TRUTH.x, abs=0.3)
    assert spot.y_px == pytest.approx(_TRUTH.y, abs=0.3)
    assert spot.angle_rad == pytest.approx(_TRUTH.angle, abs=0.1)
    assert np.isnan(spot.covariance).all()


def test_without_a_click_the_largest_bright_component_is_taken():
    frame = frame_of(_SCENE, np.random.default_rng(0))
    frame[20:30, 20:30] = 255
    spot, state = measure(frame, TrackState(), LiteralSettings())
    assert isinstance(spot, Spot)
    assert spot.x_px == pytest.approx(_TRUTH.x, abs=0.5)
    assert state.at_px == (spot.x_px, spot.y_px)


def test_failures_say_why_and_keep_the_last_position():
    state = TrackState(at_px=(320, 240))
    rng = np.random.default_rng(0)
    cases = [
        (replace(_SCENE, amplitude=0), LiteralSettings(), Reason.NONE_FOUND),
        (_SCENE, LiteralSettings(min_component_px=20_000), Reason.TOO_SMALL),
        (_SCENE, LiteralSettings(max_minor_axis_px=100), Reason.TOO_LARGE),
    ]
    for scene, settings, reason in cases:
        result, after = measure(frame_of(scene, rng), state, settings)
        assert result == NoSpot(reason)
        assert not result
        assert after == state


def test_literal_mode_follows_steps_that_leave_the_spot_in_its_patch():
    rng = np.random.default_rng(4)
    places = [(0, 0), (60, 0), (60, 60), (0, 0)]
    frames = [frame_of(replace(_SCENE, truth=_TRUTH.moved(dx, dy)), rng) for dx, dy in places]
    results = list(track(frames, LiteralSettings(), start=(320, 240)))
    for (dx, dy), result in zip(places, results, strict=True):
        assert isinstance(result, Spot)
        assert result.x_px == pytest.approx(_TRUTH.x + dx, abs=0.5)
        assert result.y_px == pytest.approx(_TRUTH.y + dy, abs=0.5)


def test_a_16_bit_frame_reads_as_its_8_bit_twin():
    frame = frame_of(_SCENE, np.random.default_rng(0))
    eight, sixteen = (
        spot_in(image, LiteralSettings(), at=(320, 240))
        for image in (frame, frame.astype(np.uint16) * 257)
    )
    assert sixteen.semi_minor_px == eight.semi_minor_px


def test_exposure_moves_the_literal_spot():
    # The reason for the sub-pixel mode: brighter light pushes the crossing of 200 outwards.
    rng = np.random.default_rng(0)
    scene = replace(_SCENE, truth=_TRUTH, profile=erf_edge(4.0), noise=0.0)
    sizes = []
    for amplitude in (210, 240):
        bright = replace(scene, amplitude=amplitude)
        spot = spot_in(frame_of(bright, rng), LiteralSettings(), at=(320, 240))
        sizes.append(spot.semi_minor_px)
    quantile = NormalDist().inv_cdf
    expected = 4 * (quantile(190 / 210) - quantile(190 / 240))
    # The boundary is known to a pixel's step, averaged over the contour: 0.4 px.
    assert sizes[1] - sizes[0] == pytest.approx(expected, abs=0.4)
