"""Frames computed by formula, without rendering; their ellipses are known exactly.

A frame is a camera image of wall * (light + ambient), partly hidden by instruments. The true
ellipse is the contour on which the light, without the wall's texture, is half of its peak.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from eyespot.formats.spot import Spot
from eyespot.scenes.walls.fundus import fundus

Profile = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Light (peak 1) from the elliptical radius (1 on the contour) and the distance from it in px."""


def erf_edge(sigma_px: float) -> Profile:
    """Uniform disc with an edge blurred by a Gaussian."""
    return lambda t, distance: ndtr(-distance / sigma_px)


SHAPE = (480, 640)

_SHAFT_LEVEL = 5.0
_SOFT_DISC = erf_edge(2.0)


@dataclass(frozen=True, kw_only=True)
class Truth:
    """The half-maximum ellipse of a spot, px and rad."""

    x: float
    y: float
    semi_major: float
    semi_minor: float
    angle: float = 0.0

    def moved(self, dx: float, dy: float) -> "Truth":
        """The same ellipse, shifted."""
        return replace(self, x=self.x + dx, y=self.y + dy)

    def errors(self, spot: Spot) -> tuple[float, float, float, float]:
        """Errors (estimate minus truth) of x, y, semi-major and semi-minor axis, px."""
        return (
            spot.x_px - self.x,
            spot.y_px - self.y,
            spot.semi_major_px - self.semi_major,
            spot.semi_minor_px - self.semi_minor,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawing:
    """Content of a synthetic frame. Levels refer to the brightest channel; full scale is 255.

    Attributes:
        truth: the ellipse of the spot.
        amplitude: peak of its light on the mean wall.
        ambient: uniform light on the mean wall.
        noise: standard deviation of each channel.
        wall: (H, W, 3) reflectance with mean 1 in the brightest channel; None for a uniform wall.
        lit: (H, W) fraction of the spot's light that arrives, 1 without shadow.
        seen: (H, W) visible fraction of the wall, 1 without a shaft.
        glints: (H, W) light that is added to every channel.
        path_px: (x, y) motion of the spot during the exposure, straight and uniform; the true
            ellipse lies in the middle of it.
    """

    truth: Truth
    profile: Profile = _SOFT_DISC
    amplitude: float = 180.0
    ambient: float = 15.0
    noise: float = 3.0
    wall: np.ndarray | None = None
    lit: np.ndarray | None = None
    seen: np.ndarray | None = None
    glints: np.ndarray | None = None
    path_px: tuple[float, float] | None = None


def light_of(drawing: Drawing, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """Noise-free values of the three channels, neither clipped nor rounded, (H, W, 3)."""
    spot = np.zeros(shape)
    if drawing.amplitude:
        truth, (v, u) = drawing.truth, np.mgrid[: shape[0], : shape[1]].astype(float)
        c, s = math.cos(truth.angle), math.sin(truth.angle)
        x = ((u - truth.x) * c + (v - truth.y) * s) / truth.semi_major
        y = ((v - truth.y) * c - (u - truth.x) * s) / truth.semi_minor
        t = np.maximum(np.hypot(x, y), 1e-9)
        # The signed distance to the contour is exact to first order.
        gradient = np.hypot(x / truth.semi_major, y / truth.semi_minor) / t
        spot = drawing.amplitude * drawing.profile(t, (t - 1) / np.maximum(gradient, 1e-9))
    if drawing.path_px is not None:
        spot = _moved(spot, *drawing.path_px)
    if drawing.lit is not None:
        spot = spot * drawing.lit
    image = np.repeat((spot + drawing.ambient)[..., None], 3, axis=2)
    if drawing.wall is not None:
        image *= drawing.wall
    if drawing.seen is not None:
        image = _SHAFT_LEVEL + (image - _SHAFT_LEVEL) * drawing.seen[..., None]
    if drawing.glints is not None:
        image += drawing.glints[..., None]
    return image


def frame_of(
    drawing: Drawing, rng: np.random.Generator, shape: tuple[int, int] = SHAPE
) -> np.ndarray:
    """The camera's 8-bit RGB frame."""
    image = light_of(drawing, shape)
    noise = rng.standard_normal(image.shape, dtype=np.float32)
    noise *= drawing.noise
    image += noise
    np.clip(np.rint(image, out=image), 0, 255, out=image)
    return image.astype(np.uint8)


def _moved(light: np.ndarray, x: float, y: float) -> np.ndarray:
    """Mean of the light over a straight path about its position (a sinc in the spectrum).

    It is exact for frequencies that the pixels resolve. The light must not reach the border.
    """
    along_y = np.fft.fftfreq(light.shape[0])[:, None] * y
    along_x = np.fft.rfftfreq(light.shape[1]) * x
    spectrum = np.fft.rfft2(light) * np.sinc(along_x + along_y)
    return np.fft.irfft2(spectrum, s=light.shape)


_SCALE_MM_PX = 0.0067
_RETINA_PX = 2000


def any_truth(rng: np.random.Generator, semi_minor: float, axis_ratio: float = 1.1) -> Truth:
    """A random ellipse of a given size near the middle of the frame."""
    dx, dy = rng.uniform(-5.0, 5.0, 2)
    return Truth(
        x=SHAPE[1] / 2 + dx,
        y=SHAPE[0] / 2 + dy,
        semi_major=semi_minor * axis_ratio,
        semi_minor=semi_minor,
        angle=rng.uniform(-math.pi / 2, math.pi / 2),
    )


@functools.lru_cache(maxsize=4)
def _retina(seed: int) -> np.ndarray:
    return fundus(seed=seed, extent_mm=_RETINA_PX * _SCALE_MM_PX, pixels=_RETINA_PX)


def any_wall(rng: np.random.Generator, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """A random window of a printed retina, with mean 1 in the brightest channel."""
    retina = _retina(int(rng.integers(4)))
    row = rng.integers(retina.shape[0] - shape[0] + 1)
    column = rng.integers(retina.shape[1] - shape[1] + 1)
    wall = retina[row : row + shape[0], column : column + shape[1]].astype(float)
    return wall / wall.mean(axis=(0, 1)).max()
