"""Small frames at random: textures, vessels, spots of all profiles, reflections, saturation, noise.

They need not look like an eye: they are to bring the detector where no picture of an eye would.
"""

from __future__ import annotations

import math

import numpy as np


def clouds(rng: np.random.Generator, shape: tuple[int, int], slope: float) -> np.ndarray:
    """Noise with an amplitude of frequency ** -slope; mean 0, standard deviation 1."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    frequency[0, 0] = math.inf  # no mean
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) / frequency**slope, s=shape)
    return noise / noise.std()


def random_frame(rng: np.random.Generator) -> np.ndarray:
    """A frame of 40 to 200 px, grey or RGB, of any type that the detector takes."""
    height, width = (int(side) for side in rng.integers(40, 200, 2))
    v, u = np.mgrid[:height, :width].astype(float)
    wall = np.exp(rng.uniform(0, 1.2) * clouds(rng, (height, width), rng.uniform(0.5, 2)))
    for _ in range(rng.integers(5)):
        wall *= _vessel(rng, u, v)
    light = rng.uniform(0, 0.3) + rng.uniform(0, 0.5) * _slope(rng, u / width, v / height)
    for _ in range(rng.integers(4)):
        light += rng.uniform(0.1, 2) * _blob(rng, u, v)
    image = light * wall if rng.random() < 0.8 else light
    for _ in range(rng.integers(4)):
        x, y, size = rng.uniform(0, width), rng.uniform(0, height), rng.uniform(1, 60)
        image += rng.uniform(0, 3) * np.exp(-((u - x) ** 2 + (v - y) ** 2) / size**2)
    image *= rng.uniform(0.1, 1.5)
    image += rng.normal(0, rng.choice([0, 0.01, 0.05]), image.shape)
    if rng.random() < 0.4:
        channels = [rng.uniform(0.2, 1.3) * image * wall ** rng.uniform(-0.5, 0.5) for _ in "RGB"]
        image = np.stack(channels, axis=-1)
    return _stored(rng, image)


def _vessel(rng: np.random.Generator, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    turn = rng.uniform(0, math.pi)
    across = (u - rng.uniform(0, u.max())) * math.cos(turn)
    across += (v - rng.uniform(0, v.max())) * math.sin(turn)
    across += rng.uniform(0, 10) * np.sin(u / rng.uniform(5, 30))
    return 1 - rng.uniform(0.2, 0.9) * np.exp(-((across / rng.uniform(0.5, 5)) ** 2))


def _slope(rng: np.random.Generator, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return rng.uniform(-1, 1) * x + rng.uniform(-1, 1) * y


def _blob(rng: np.random.Generator, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    semi_axes = rng.uniform(4, 0.7 * max(u.shape), 2)
    u, v = u - rng.uniform(0, u.max()), v - rng.uniform(0, v.max())
    turn = rng.uniform(0, math.pi)
    x, y = u * math.cos(turn) + v * math.sin(turn), v * math.cos(turn) - u * math.sin(turn)
    radius = np.hypot(x / semi_axes[0], y / semi_axes[1])
    kind = rng.choice(["bell", "disc", "cone"])
    if kind == "bell":
        return np.exp(-(radius**2))
    if kind == "disc":
        return 1 / (1 + np.exp(np.clip((radius - 1) * rng.uniform(3, 60), -50, 50)))
    return np.clip(1.5 - radius, 0, 1)


def _stored(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
    kind = rng.choice(["uint8", "uint16", "float32", "float64"], p=[0.6, 0.15, 0.15, 0.1])
    if kind == "uint8":
        return np.clip(np.rint(255 * image), 0, 255).astype(np.uint8)
    if kind == "uint16":
        return np.clip(np.rint(rng.choice([4095, 65535]) * image), 0, 65535).astype(np.uint16)
    if rng.random() < 0.2:
        image = image - rng.uniform(0, 1) * image.max()  # a dark frame too bright was subtracted
    scale = 10.0 ** rng.choice([0, 0, 0, 3, -6, 11, -30, -42])
    return np.clip(scale * image, -9e11, 9e11).astype(kind)
