"""Walls and motions that `scenes.drawn` does not have: texture of spectrum 1/f, a photograph.

Levels, noise and the size of the frames are those of `Drawing`.
"""

import functools
import math
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from eyespot.scenes.description.scene_keys import Phantom
from eyespot.scenes.drawn import SHAPE, Drawing, Truth, light_of
from eyespot.scenes.walls.picture import PICTURE_MM, PICTURE_PX, wall_picture

_TIMES = 48  # moments of an exposure during which the spot moves
_SCALE_MM_PX = 0.0067
_PHOTOGRAPH_MM = 4.5, 8.3  # a little less than what the picture shows of it


def camera_image(rng: np.random.Generator, light: np.ndarray) -> np.ndarray:
    """Light, (H, W) or (H, W, 3), with noise as an 8-bit image of three channels."""
    channels = light if light.ndim == 3 else light[..., None]
    image = channels + Drawing.noise * rng.standard_normal((*SHAPE, 3))
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def any_ellipse(rng: np.random.Generator, smallest: float, largest: float) -> Truth:
    """An ellipse of a random size and shape (a/b to 1.25), wholly in view."""
    semi_minor = rng.uniform(smallest, largest)
    semi_major = semi_minor * rng.uniform(1, 1.25)
    margin = semi_major + 40
    return Truth(
        x=rng.uniform(margin, SHAPE[1] - margin),
        y=rng.uniform(margin, SHAPE[0] - margin),
        semi_major=semi_major,
        semi_minor=semi_minor,
        angle=rng.uniform(-math.pi / 2, math.pi / 2),
    )


def clouds(
    rng: np.random.Generator, shape: tuple[int, int] = SHAPE, slope: float = 1.0
) -> np.ndarray:
    """Noise with an amplitude of frequency ** -slope; mean 0, standard deviation 1."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    frequency[0, 0] = math.inf  # no mean
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) / frequency**slope, s=shape)
    return noise / noise.std()


def textured_wall(rng: np.random.Generator) -> np.ndarray:
    """Reflectance with a texture of 10 to 20 % (spectrum 1/f) and vessels, (H, W)."""
    texture = clouds(rng)
    wall = 1 + rng.uniform(0.1, 0.2) / 2 * texture
    for _ in range(int(rng.integers(2, 7))):
        wall = wall * (1 - rng.uniform(0.1, 0.2) * vessel(rng))
    return wall


def vessel(rng: np.random.Generator) -> np.ndarray:
    """1 on a winding band that crosses the frame, else 0; its rims are blurred by a pixel."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    heading = rng.uniform(0, math.pi)
    along = (u - rng.uniform(0, SHAPE[1])) * math.cos(heading)
    along += (v - rng.uniform(0, SHAPE[0])) * math.sin(heading)
    across = (v - rng.uniform(0, SHAPE[0])) * math.cos(heading)
    across -= (u - rng.uniform(0, SHAPE[1])) * math.sin(heading)
    across += rng.uniform(5, 40) * np.sin(along / rng.uniform(30, 120) + rng.uniform(0, 6.3))
    return gaussian_filter((np.abs(across) < rng.uniform(2, 7)).astype(float), 1.0)


@functools.cache
def _photograph() -> np.ndarray:
    width, height = (round(mm / 2 * PICTURE_PX / PICTURE_MM) for mm in _PHOTOGRAPH_MM)
    middle = PICTURE_PX // 2
    picture = wall_picture(Phantom(wall="photograph"))
    return picture[middle - height : middle + height, middle - width : middle + width]


def photographed_wall(rng: np.random.Generator) -> np.ndarray:
    """A window of a fundus photograph at a random place, turned and mirrored; mean 1, (H, W, 3)."""
    picture, zoom = _photograph(), PICTURE_MM / PICTURE_PX / _SCALE_MM_PX
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
    wall = np.dstack(
        [map_coordinates(c, places, order=1, mode="reflect") for c in np.moveaxis(picture, 2, 0)]
    )
    return wall / wall.mean(axis=(0, 1)).max()


def moved_light(drawing: Drawing, path: tuple[float, float], unevenness: float) -> np.ndarray:
    """Light of a spot that is at truth + path (t + unevenness t²) at the time t, -1/2 to 1/2."""
    light = np.zeros((*SHAPE, 3))
    for t in (np.arange(_TIMES) + 0.5) / _TIMES - 0.5:
        way = t + unevenness * t * t
        light += light_of(replace(drawing, truth=drawing.truth.moved(path[0] * way, path[1] * way)))
    return light / _TIMES
