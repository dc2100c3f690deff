"""Dark places inside an ellipse: those that something in front explains, and those of letters."""

import math

import numpy as np
import pytest

from estimator.detector.contour import hollow_share
from estimator.detector.ellipse import AffineEllipse, Patch
from estimator.detector.tuning import RAYS, Hollow
from scenes.drawn import SHAPE, Drawing, Truth, light_of
from tests.drawn_spots import spot_in
from tests.lookalikes import taken_for_spots
from tests.own_frames import camera_image, textured_wall

_SIDE = 200
_AXES = 80.0, 60.0
_AT = np.arange(_SIDE) - _SIDE / 2
_U, _V = np.meshgrid(_AT, _AT)
_RADIUS = np.hypot(_U / _AXES[0], _V / _AXES[1])
_ANGLES = 2 * math.pi * np.arange(RAYS) / RAYS


def _share(dark: np.ndarray) -> float:
    """Hollow share of an evenly lit ellipse with these dark places."""
    lit = ((_RADIUS < 1) & ~dark).astype(np.float32)
    ellipse = AffineEllipse.from_axes(_SIDE / 2, _SIDE / 2, *_AXES, 0.0)
    u, v = (0.97 * axis * f(_ANGLES) for axis, f in zip(_AXES, (np.cos, np.sin), strict=True))
    seen = lit[np.rint(v + _SIDE / 2).astype(int), np.rint(u + _SIDE / 2).astype(int)] > 0
    return hollow_share(Patch(lit, 0, 0), ellipse, seen, 0.5, 0.02)


@pytest.mark.parametrize("degrees", [0, 7, 19, 41])
@pytest.mark.parametrize("width", [6, 15, 40])
def test_a_shaft_explains_what_it_hides(degrees, width):
    turn = math.radians(degrees)
    along = _U * math.cos(turn) + _V * math.sin(turn)
    across = _V * math.cos(turn) - _U * math.sin(turn)
    shaft = np.abs(across - 10) < width / 2
    assert _share(shaft) <= Hollow.SHARE
    assert _share(shaft & (along > -20)) <= Hollow.SHARE
    assert _share(across > 25) <= Hollow.SHARE  # a shadow


@pytest.mark.parametrize("gap", [0.0, 0.2, 0.3])
def test_a_stroke_does_not_explain_the_dark_behind_it(gap):
    """An O has no gap; that of a C is as high as so many semi-axes."""
    inner = (_RADIUS < 0.65) | ((np.abs(_V) < gap / 2 * _AXES[1]) & (_U > 0))
    assert _share(inner) > Hollow.SHARE


def test_words_in_thick_letters_are_no_spots():
    # Where nothing looks inside an outline, these are spots.
    assert taken_for_spots("text", (68, 272), seed=3) == 0


@pytest.mark.parametrize("left", [0.12, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_an_edge_in_shadow_is_measured_too(left, seed):
    rng = np.random.default_rng(seed)
    truth = Truth(x=320.3, y=240.8, semi_major=66, semi_minor=60, angle=0.7)
    wall = textured_wall(rng)[..., None]
    behind = np.arange(SHAPE[1]) - 345
    lit = 1 - (1 - left) * np.clip(0.5 + behind / 8, 0, 1) * np.ones(SHAPE)
    spot = spot_in(camera_image(rng, light_of(Drawing(truth=truth, wall=wall, lit=lit))))
    # Two thirds of the contour are in full light; the rest less a rim on either side is shaded.
    assert spot.coverage > 0.85
    # Whole spots on this wall are off by 0.045 px RMS, arcs of two thirds by 0.15 px.
    assert abs(spot.semi_minor_px - truth.semi_minor) < 3 * 0.045
