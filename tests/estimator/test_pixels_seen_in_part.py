"""The mode pixels reads spots of which the sub-pixel mode sees too little: hidden or saturated."""

import numpy as np
import pytest

from estimator import SubpixelSettings, TrackState, measure, open_source
from estimator.pixels.cells import COUNT
from estimator.pixels.frame_model import covered, halo
from estimator.pixels.picture import hidden_pixels
from estimator.pixels.tracker import _like
from formats.spots import NoSpot, Outline, Reason
from tests.pixel_stacks import assert_posed, cone_stack, readings_of

_SPOT = Outline(150.3, 119.6, 60.0, 50.0, 0.4, edge_width_px=0.5)


def _ellipse(shape=(240, 300), *, parts=8):
    """Share of each pixel that an ellipse covers, by points in it."""
    height, width = shape
    v, u = (np.indices((height * parts, width * parts)) + 0.5) / parts - 0.5
    u, v = u - _SPOT.x_px, v - _SPOT.y_px
    along, across = (
        u * np.cos(_SPOT.angle_rad) + v * np.sin(_SPOT.angle_rad),
        v * np.cos(_SPOT.angle_rad) - u * np.sin(_SPOT.angle_rad),
    )
    inside = (along / _SPOT.semi_major_px) ** 2 + (across / _SPOT.semi_minor_px) ** 2 < 1
    return inside.reshape(height, parts, width, parts).mean(axis=(1, 3))


def _readings(folder, reason, **tables):
    """What `readings_of` says of frames that the sub-pixel mode does not measure."""
    spot = {"eccentricity_mm": 0.066, "azimuth_deg": 0.0, "incidence_deg": 31.4}
    microscope = {"width_px": 640, "height_px": 480, "scale_mm_px": 0.0067}
    stack = cone_stack(folder / "stack", **{"spot": spot, "microscope": microscope} | tables)
    for frame in open_source(stack.folder):
        result, _ = measure(frame.image, TrackState(), SubpixelSettings())
        assert result == NoSpot(reason)
    return list(readings_of(stack, folder))


def test_a_shadow_over_more_than_half_of_the_contour_leaves_a_pose(tmp_path):
    found = _readings(
        tmp_path,
        Reason.OCCLUDED,
        second_tool={
            "visible": True,
            "gauge": 23,
            "trocar_azimuth_deg": 190.9,
            "tip_mm": [0.0, -0.9, -9.9],
        },
        motion={"start_mm": 2.8, "travel_mm": 0.2, "frames": 2, "speed_mm_s": 1.0},
    )
    assert_posed(found)


def test_a_tip_at_the_wall_has_a_pose_with_a_beam_that_is_known_less_well(tmp_path):
    # The tool hides a third of the spot of a tip 0.15 mm off, and b is known to 0.028 mm.
    stack = cone_stack(
        tmp_path / "stack",
        instrument={"visible": True},
        spot={"incidence_deg": 30.0, "incidence_azimuth_deg": 90.0},
        microscope={"width_px": 640, "height_px": 480},
        motion={"start_mm": "contact", "travel_mm": 0.6, "frames": 4, "speed_mm_s": 0.1},
    )
    # The true b was told: what is left are the frame's own errors.
    assert_posed(readings_of(stack, tmp_path, sigma_b_mm=0.028), within_mm=0.028)


@pytest.mark.parametrize(("wall", "level"), [("printed paper", 0.12), ("retina", 0.18)])
def test_a_saturated_spot_has_a_pose(tmp_path, wall, level):
    # Its edge is 0.3 to 0.5 px outside of the spot's: 40 um of distance, if that is not known.
    found = _readings(
        tmp_path,
        Reason.SATURATED,
        phantom={"wall": wall, "texture_seed": 4},
        exposures={
            "kinds": ["paper"],
            "sensitivity_mm2_sr_mj": 20000.0,
            "paper_level": level,
        },
        motion={"start_mm": 2.8, "travel_mm": 0.4, "frames": 3, "speed_mm_s": 1.0},
    )
    assert_posed(found, within_mm=0.04)


@pytest.mark.parametrize("full_scales", [3.0, 30.0])
def test_cells_at_the_edge_of_a_saturated_spot_are_covered_in_part(full_scales):
    side, ambient = 7, 0.1
    share = _ellipse((side * COUNT, side * COUNT + 90))[:, 58:-32]
    seen = np.minimum(full_scales * share + ambient, 1.0)

    def cells(pixels):
        return pixels.reshape(COUNT, side, COUNT, side).mean(axis=(1, 3)).ravel()

    light = cells(full_scales * share)
    right, down = np.gradient(share, axis=1), np.gradient(share, axis=0)
    slopes = -full_scales * np.stack([cells(right), cells(down)])
    room = np.full(light.size, 1.0 - ambient)
    model = covered(light, room, slopes, pixel_mm=1.0).light + ambient
    # Light of r full scales moves the edge outwards by 0.64 (1 - 1/r), 0.43 and 0.62 px; a cell's
    # share of that beyond its side is lost, 0.03 px. The model moves it by 0.45.
    contour_px = np.pi * (_SPOT.semi_major_px + _SPOT.semi_minor_px)
    assert abs((model - cells(seen)).sum()) * side**2 < 0.2 * contour_px
    # In each cell the pixels that the edge cuts are right to half a pixel, seven or eight of them.
    assert np.abs(model - cells(seen)).max() < 0.5 * 8 / side**2


def test_a_lamp_has_a_halo_and_a_saturated_spot_has_none():
    v, u = np.indices((COUNT, COUNT)) - COUNT // 2
    radius = np.hypot(u, v)
    wall = np.full(COUNT**2, 0.2)
    lit = (radius < 9).ravel()
    assert halo(np.where(lit, 1.0, wall), lit) == pytest.approx(1.0)
    # The middle of what counts as beside it is 2.5 cells away, and of the rest 5.
    glow = 0.8 * np.exp(-np.maximum(radius - 9, 0) / 3).ravel()
    expected = (0.2 + 0.8 * np.exp(-2.5 / 3)) / (0.2 + 0.8 * np.exp(-5 / 3))
    assert halo(np.where(lit, 1.0, wall + glow), lit) == pytest.approx(expected, rel=0.1)


def test_what_hides_a_spot_is_found_with_its_border():
    share = _ellipse()
    light = np.repeat((0.02 + 0.6 * share)[..., None], 3, axis=2)
    assert hidden_pixels(light, _SPOT) is None
    tool = np.zeros(share.shape, bool)
    tool[:, 140:165] = True
    light[tool] = 0.03
    hidden = hidden_pixels(light, _SPOT)
    assert hidden is not None
    inside = share == 1
    assert hidden[tool & inside].mean() > 0.99
    # Of the light that is seen, only what is within 4 px of the tool.
    beside = np.zeros(share.shape, bool)
    beside[:, 136:169] = True
    assert not hidden[inside & ~beside].any()


def test_the_only_bright_region_may_be_a_spot_that_has_grown_threefold():
    # Behind a dome in vitreous a spot grew by that within 0.75 mm; its fitted light decides.
    def outline(size: float, x: float = 300.0) -> Outline:
        return Outline(x, 240.0, size, size, 0.0, measured=False)

    last, grown, other = outline(20.0), outline(40.0), outline(35.0, x=450.0)
    assert _like(last, [grown]) == grown
    # Of several, only one of about the last size can be told.
    assert _like(last, [grown, other]) == last
    assert _like(last, [grown, outline(21.0)]) == outline(21.0)
    assert _like(last, []) == last
