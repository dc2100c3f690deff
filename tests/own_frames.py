"""Frames drawn in NumPy alone, by other formulas than those of `scenes`.

A frame is wall * (spot + ambient) + noise, rounded to 8 bits. The wall has texture with a spectrum
of 1/f and vessels of 10 to 20 % contrast, or is any picture that is passed in.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import erfc

SHAPE = (480, 640)
STEP, AMBIENT, NOISE = 180.0, 15.0, 3.0
"""Grey levels: the spot above its surroundings, the surroundings, noise of a channel."""

_TIMES = 48  # moments of an exposure during which the spot moves

Light = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Light (1 at its peak) from the elliptical radius and the distance to the contour, px."""


@dataclass(frozen=True)
class Ellipse:
    """A half-maximum contour, px and rad; the attributes follow `formats.spots.PARAMETERS`."""

    x: float
    y: float
    semi_major: float
    semi_minor: float
    angle: float

    @property
    def parameters(self) -> np.ndarray:
        """All five, in the order of `formats.spots.PARAMETERS`."""
        return np.array([self.x, self.y, self.semi_major, self.semi_minor, self.angle])


@dataclass(frozen=True)
class OwnFrame:
    """A frame and its true ellipse."""

    image: np.ndarray
    truth: Ellipse


def disc(blur_px: float) -> Light:
    """An even disc with an edge blurred by a Gaussian."""
    return lambda radius, distance: 0.5 * erfc(distance / (math.sqrt(2) * blur_px))


def bell(power: float) -> Light:
    """A bell that falls like exp(-r**power); 2 is a Gaussian."""
    return lambda radius, distance: np.exp2(-(radius**power))


def any_ellipse(rng: np.random.Generator, smallest: float, largest: float) -> Ellipse:
    """An ellipse of a random size and shape (a/b to 1.25), wholly in view."""
    semi_minor = rng.uniform(smallest, largest)
    semi_major = semi_minor * rng.uniform(1, 1.25)
    margin = semi_major + 40
    return Ellipse(
        rng.uniform(margin, SHAPE[1] - margin),
        rng.uniform(margin, SHAPE[0] - margin),
        semi_major,
        semi_minor,
        rng.uniform(-math.pi / 2, math.pi / 2),
    )


def textured_wall(rng: np.random.Generator) -> np.ndarray:
    """Reflectance with a texture of 10 to 20 % (spectrum 1/f) and vessels, (H, W)."""
    height, width = SHAPE
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    frequency[0, 0] = math.inf
    waves = np.fft.rfft2(rng.standard_normal(SHAPE)) / frequency
    texture = np.fft.irfft2(waves, s=SHAPE)
    wall = 1 + rng.uniform(0.1, 0.2) / 2 * texture / texture.std()
    for _ in range(int(rng.integers(2, 7))):
        wall = wall * (1 - rng.uniform(0.1, 0.2) * _vessel(rng))
    return wall


def _vessel(rng: np.random.Generator) -> np.ndarray:
    """1 on a winding band that crosses the frame, else 0; its rims are blurred by a pixel."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    heading = rng.uniform(0, math.pi)
    along = (u - rng.uniform(0, SHAPE[1])) * math.cos(heading)
    along += (v - rng.uniform(0, SHAPE[0])) * math.sin(heading)
    across = (v - rng.uniform(0, SHAPE[0])) * math.cos(heading)
    across -= (u - rng.uniform(0, SHAPE[1])) * math.sin(heading)
    across += rng.uniform(5, 40) * np.sin(along / rng.uniform(30, 120) + rng.uniform(0, 6.3))
    return gaussian_filter((np.abs(across) < rng.uniform(2, 7)).astype(float), 1.0)


def window_of(picture: np.ndarray, rng: np.random.Generator, zoom: float) -> np.ndarray:
    """A window of a picture at a random place, turned and mirrored at random, with mean 1.

    Args:
        picture: (h, w) or (h, w, 3).
        zoom: frame pixels per pixel of the picture.
    """
    height, width = SHAPE
    reach = math.hypot(height, width) / 2 / zoom
    turn = rng.uniform(0, 2 * math.pi)
    turn_cos, turn_sin = math.cos(turn) / zoom, math.sin(turn) / zoom
    y, x = (
        rng.uniform(reach, side - reach) if side > 2 * reach else side / 2
        for side in picture.shape[:2]
    )
    v, u = np.mgrid[:height, :width] - np.array([height / 2, width / 2])[:, None, None]
    u = u * rng.choice([-1, 1])
    places = [y + turn_sin * u + turn_cos * v, x + turn_cos * u - turn_sin * v]
    channels = picture[..., None] if picture.ndim == 2 else picture
    drawn = np.stack(
        [map_coordinates(c, places, order=1, mode="reflect") for c in np.moveaxis(channels, 2, 0)],
        axis=2,
    )
    drawn = drawn / drawn.mean(axis=(0, 1)).max()
    return drawn[..., 0] if picture.ndim == 2 else drawn


def drawn(
    rng: np.random.Generator,
    truth: Ellipse,
    light: Light,
    wall: np.ndarray,
    lit: np.ndarray | None = None,
    step: float = STEP,
) -> OwnFrame:
    """The frame of a spot on a wall; `lit` is the fraction of its light that arrives."""
    spot = light(*places_of(truth))
    return _exposed(rng, truth, spot if lit is None else spot * lit, wall, step)


def moved(
    rng: np.random.Generator,
    truth: Ellipse,
    light: Light,
    wall: np.ndarray,
    path: tuple[float, float],
    unevenness: float,
) -> OwnFrame:
    """The frame of a spot that moves along a path during the exposure.

    At the time t, from -1/2 to 1/2, it is at truth + path * (t + unevenness * t**2); the truth is
    its place in the middle of the exposure.
    """
    spot = np.zeros(SHAPE)
    for t in (np.arange(_TIMES) + 0.5) / _TIMES - 0.5:
        way = t + unevenness * t * t
        now = replace(truth, x=truth.x + path[0] * way, y=truth.y + path[1] * way)
        spot += light(*places_of(now)) / _TIMES
    return _exposed(rng, truth, spot, wall, STEP)


def shadow_over_a_third(rng: np.random.Generator, truth: Ellipse) -> np.ndarray:
    """Light of which a straight shadow takes 60 to 95 % from a third of the spot's area."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    heading = rng.uniform(0, 2 * math.pi)
    along = (u - truth.x) * math.cos(heading) + (v - truth.y) * math.sin(heading)
    inside = places_of(truth)[0] < 1
    start = np.quantile(along[inside], 2 / 3)
    return gaussian_filter(1 - rng.uniform(0.6, 0.95) * (along > start), 2.0)


def _exposed(
    rng: np.random.Generator, truth: Ellipse, spot: np.ndarray, wall: np.ndarray, step: float
) -> OwnFrame:
    light = step * spot + AMBIENT
    return OwnFrame(
        camera_image(rng, wall * (light if wall.ndim == 2 else light[..., None])), truth
    )


def camera_image(rng: np.random.Generator, light: np.ndarray) -> np.ndarray:
    """Light, (H, W) or (H, W, 3), with noise as an 8-bit image of three channels."""
    channels = light if light.ndim == 3 else light[..., None]
    image = channels + NOISE * rng.standard_normal((*SHAPE, 3))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def places_of(truth: Ellipse) -> tuple[np.ndarray, np.ndarray]:
    """Elliptical radius, and distance to the contour (px, positive outside, to first order)."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    cos, sin = math.cos(truth.angle), math.sin(truth.angle)
    along, across = (u - truth.x) * cos + (v - truth.y) * sin, (v - truth.y) * cos
    across -= (u - truth.x) * sin
    a, b = truth.semi_major, truth.semi_minor
    radius = np.maximum(np.hypot(along / a, across / b), 1e-9)
    steepness = np.hypot(along / a**2, across / b**2) / radius
    return radius, (radius - 1) / np.maximum(steepness, 1e-9)
