"""Grey images of one spot by formula, and the spot that the estimator finds in a frame."""

from __future__ import annotations

import math

import numpy as np

from estimator import LiteralSettings, SubpixelSettings, TrackState, measure
from formats.spots import Spot
from scenes.drawn import Drawing, Truth, bell, erf_edge, light_of


def spot_image(
    shape: tuple[int, int],
    x: float,
    y: float,
    semi_major: float,
    semi_minor: float,
    angle: float,
    *,
    profile: str = "disc",
    blur: float = 1.5,
    peak: float = 200.0,
    background: float = 20.0,
    noise: float = 0.0,
    clip: float = math.inf,
    rng: np.random.Generator | None = None,
) -> np.ndarray:
    """A grey image of one spot, before it is rounded to whole samples.

    Args:
        shape: (H, W), px.
        x: of the centre, to the right from the centre of the first pixel, px.
        y: of the centre, downwards, px.
        semi_major: of the ellipse at half of the height above the background, px.
        semi_minor: likewise, px.
        angle: of the major axis, from x towards y, rad.
        profile: "disc", even up to an edge, or "bell", an elliptical Gaussian.
        blur: standard deviation of a disc's edge, px; the profile along a normal of the ellipse is
            an error function, of which the middle lies on the ellipse.
        peak: above the background.
        background: level of the image without the spot.
        noise: standard deviation, the same in all pixels.
        clip: largest value; larger ones become this.
        rng: of the noise.

    Returns:
        (H, W), float64.
    """
    truth = Truth(x=x, y=y, semi_major=semi_major, semi_minor=semi_minor, angle=angle)
    light = bell if profile == "bell" else erf_edge(blur)
    drawing = Drawing(truth=truth, profile=light, amplitude=peak, ambient=background)
    image = light_of(drawing, shape)[..., 0]
    if noise:
        assert rng is not None
        image = image + rng.normal(0, noise, shape)
    return np.minimum(image, clip)


def spot_in(
    frame: np.ndarray,
    settings: LiteralSettings | SubpixelSettings | None = None,
    at: tuple[float, float] | None = None,
) -> Spot:
    """The spot of a first frame, which must have one."""
    spot, _ = measure(frame, TrackState(at_px=at), settings or SubpixelSettings())
    assert isinstance(spot, Spot), spot
    return spot
