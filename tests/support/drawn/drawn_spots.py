"""Images of one spot by formula, what may hide it, and the spot that the estimator finds."""

import math
from dataclasses import replace
from statistics import NormalDist

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from eyespot.estimator import LiteralSettings, SubpixelSettings, TrackState, measure
from eyespot.formats.spot import Spot
from eyespot.scenes.drawn import SHAPE, Drawing, Profile, Truth, erf_edge, light_of

SUB_PIXELS = 5
"""On a side of a pixel: a bell of 3 px changes by 2e-3 over half of one."""


def sub_pixel_grid(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of sub-pixels in units of pixels, integers at the centres of pixels."""
    v, u = ((np.arange(n * SUB_PIXELS) + 0.5) / SUB_PIXELS - 0.5 for n in shape)
    return u, v[:, None]


def over_pixels(light: np.ndarray) -> np.ndarray:
    """Mean of the light of sub-pixels over each pixel."""
    height, width = (n // SUB_PIXELS for n in light.shape)
    return light.reshape(height, SUB_PIXELS, width, SUB_PIXELS).mean(axis=(1, 3))


def domed_edge(sigma_px: float, drop: float) -> Profile:
    """Disc whose light falls by `drop` from the centre to the rim, with the same blur."""
    # On the contour, dome times edge is 1/2, so the middle of the edge lies further inside.
    shift = NormalDist().inv_cdf(0.5 / (1 - drop))
    return lambda t, distance: (1 - drop * t * t) * ndtr(shift - distance / sigma_px)


def flank(width: float) -> Profile:
    """Plateau with a linear flank, `width` radii wide, as behind a flat glue lens."""
    return lambda t, distance: np.clip(0.5 + (1 - t) / width, 0, 1)


def bell(t: np.ndarray, distance: np.ndarray) -> np.ndarray:
    return np.exp(-math.log(2) * t * t)


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
    """A grey image of one spot as `Truth` describes it, before it is rounded to whole samples.

    Args:
        profile: "disc", even up to an edge, or "bell", an elliptical Gaussian.
        blur: standard deviation of a disc's edge, px; the profile along a normal of the ellipse is
            an error function, of which the middle lies on the ellipse.
        peak: above the background.
        noise: standard deviation, the same in all pixels.
        clip: largest value; larger ones become this.
    """
    truth = Truth(x=x, y=y, semi_major=semi_major, semi_minor=semi_minor, angle=angle)
    light = bell if profile == "bell" else erf_edge(blur)
    drawing = Drawing(truth=truth, profile=light, amplitude=peak, ambient=background)
    image = light_of(drawing, shape)[..., 0]
    if noise:
        assert rng is not None
        image = image + rng.normal(0, noise, shape)
    return np.minimum(image, clip)


def disc(
    shape: tuple[int, int], x: float, y: float, radius: float, bright: float = 180.0
) -> np.ndarray:
    """A disc on 20 of 255, with an edge a pixel wide, 8 bit."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    inside = np.clip(radius + 0.5 - np.hypot(u - x, v - y), 0, 1)
    return np.rint(20 + (bright - 20) * inside).astype(np.uint8)


def spot_in(
    frame: np.ndarray,
    settings: LiteralSettings | SubpixelSettings | None = None,
    at: tuple[float, float] | None = None,
) -> Spot:
    """The spot of a first frame, which must have one."""
    spot, _ = measure(frame, TrackState(at_px=at), settings or SubpixelSettings())
    assert isinstance(spot, Spot), spot
    return spot


def with_shaft(
    drawing: Drawing, rng: np.random.Generator, reach: float, width_px: float
) -> Drawing:
    """A drawing with a shaft. Its tip ends `reach` semi-minor axes before the spot's centre."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    truth, heading = drawing.truth, rng.uniform(0, 2 * math.pi)
    away = reach * truth.semi_minor
    tip = truth.x + away * math.cos(heading), truth.y + away * math.sin(heading)
    right, down = u - tip[0], v - tip[1]
    along = right * math.cos(heading) + down * math.sin(heading)
    across = down * math.cos(heading) - right * math.sin(heading)
    hidden = np.clip(np.minimum(along, width_px / 2 - np.abs(across)) + 0.5, 0, 1)
    return replace(drawing, seen=1 - hidden)


def with_quarter_in_shadow(drawing: Drawing, rng: np.random.Generator) -> Drawing:
    """A drawing with a sector of 90 degrees in shadow; its edges are blurred by 1.5 px."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    direction = np.arctan2(v - drawing.truth.y, u - drawing.truth.x) - rng.uniform(0, 2 * math.pi)
    lit = (direction % (2 * math.pi) > math.pi / 2).astype(float)
    return replace(drawing, lit=gaussian_filter(lit, 1.5))


def with_glints(
    drawing: Drawing,
    rng: np.random.Generator,
    *,
    on_edge: bool,
    number: int = 4,
    level: float = 250.0,
) -> Drawing:
    """A drawing with bright discs of 3 to 9 px radius on the contour, or within 1.6 radii."""
    v, u = np.ogrid[: SHAPE[0], : SHAPE[1]]
    glints = np.zeros(SHAPE)
    for _ in range(number):
        angle, radius = rng.uniform(0, 2 * math.pi), rng.uniform(3, 9)
        away = drawing.truth.semi_minor * (1.0 if on_edge else rng.uniform(0.2, 1.6))
        x, y = drawing.truth.x + away * math.cos(angle), drawing.truth.y + away * math.sin(angle)
        glints[(u - x) ** 2 + (v - y) ** 2 < radius**2] = level
    return replace(drawing, glints=gaussian_filter(glints, 1.0))
