"""Accuracy and speed of the estimator against ellipses that are known exactly."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

HEIGHT, WIDTH = 480, 640


@dataclass(frozen=True, kw_only=True)
class Truth:
    """A spot's half-maximum ellipse, px and rad."""

    x: float
    y: float
    semi_major: float
    semi_minor: float
    angle: float = 0.0


def radius_field(truth: Truth, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(t, distance): elliptical radius, 1 on the contour, and signed px from the contour.

    The distance is exact to first order in the distance from the contour, and zero on it.
    """
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    c, s = math.cos(truth.angle), math.sin(truth.angle)
    x = (u - truth.x) * c + (v - truth.y) * s
    y = -(u - truth.x) * s + (v - truth.y) * c
    t = np.hypot(x / truth.semi_major, y / truth.semi_minor)
    gradient = np.hypot(x / truth.semi_major**2, y / truth.semi_minor**2)
    gradient /= np.maximum(t, 1e-9)
    distance = (t - 1) / np.maximum(gradient, 1e-9)
    return t, distance


def normal_below(x: np.ndarray) -> np.ndarray:
    """Cumulative normal distribution, Abramowitz and Stegun 7.1.26 to 1.5e-7."""
    z = np.abs(x) / math.sqrt(2)
    k = 1 / (1 + 0.3275911 * z)
    poly = k * (
        0.254829592
        + k * (-0.284496736 + k * (1.421413741 + k * (-1.453152027 + k * 1.061405429)))
    )
    erf = 1 - poly * np.exp(-z * z)
    return 0.5 * (1 + np.sign(x) * erf)


def erf_edge(sigma_px: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Flat disc with a Gaussian-blurred edge."""
    return lambda t, distance: normal_below(-distance / sigma_px)


def domed_edge(sigma_px: float, drop: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Disc that falls by `drop` of its peak from the middle to the rim, scaled to half there."""

    def profile(t: np.ndarray, distance: np.ndarray) -> np.ndarray:
        # The contour is where dome * edge = 1/2: the edge is shifted to keep it at t = 1.
        z = -_normal_quantile(0.5 / (1 - drop))
        return (1 - drop * t * t) * normal_below(-(distance / sigma_px + z))

    return profile


def _normal_quantile(p: float) -> float:
    from statistics import NormalDist

    return NormalDist().inv_cdf(p)


def bell(t: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Gaussian with its half maximum at t = 1."""
    return np.exp(-math.log(2) * t * t)


def texture(shape: tuple[int, int], rng: np.random.Generator, spread: float = 0.12) -> np.ndarray:
    """Reflectance of a printed retina: soft blotches of two sizes and dark vessels, mean about 1."""
    soft = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 15)
    fine = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 4)
    wall = 1 + spread * (0.8 * soft / soft.std() + 0.6 * fine / fine.std())
    vessels = np.zeros(shape, np.float32)
    for _ in range(7):
        points = np.cumsum(rng.normal(0, 40, (12, 2)), axis=0) + rng.uniform(0, shape[::-1], 2)
        cv2.polylines(
            vessels, [points.astype(np.int32)], False, 1.0, int(rng.integers(4, 16)), cv2.LINE_AA
        )
    return np.clip(wall, 0.5, 1.6) * (1 - 0.3 * cv2.GaussianBlur(vessels, (0, 0), 2))


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A synthetic frame: light on a wall, things in the way, a camera."""

    truth: Truth
    profile: Callable[[np.ndarray, np.ndarray], np.ndarray] = field(
        default_factory=lambda: erf_edge(2.0)
    )
    amplitude: float = 180.0
    background: float = 15.0
    noise: float = 3.0
    wall: np.ndarray | None = None
    visible: np.ndarray | None = None
    lost_light: np.ndarray | None = None
    glints: np.ndarray | None = None
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    shape: tuple[int, int] = (HEIGHT, WIDTH)


def signal(scene: Scene) -> np.ndarray:
    """Noise-free light of the scene, one channel, full scale 255 unclipped."""
    t, distance = radius_field(scene.truth, scene.shape)
    light = scene.amplitude * scene.profile(t, distance)
    if scene.lost_light is not None:
        light = light * scene.lost_light
    image = light + scene.background
    if scene.wall is not None:
        image = image * scene.wall
    if scene.visible is not None:
        image = image * scene.visible + 4 * (1 - scene.visible)
    if scene.glints is not None:
        image = image + scene.glints
    return image


def frame(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """The camera's 8-bit RGB frame."""
    image = signal(scene)[..., None] * np.array(scene.gains)
    if scene.noise:
        image = image + scene.noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def shaft(
    tip: tuple[float, float], angle: float, width_px: float, shape: tuple[int, int]
) -> np.ndarray:
    """1 where the wall is seen, 0 behind a shaft that ends at the tip and runs off at the angle."""
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    along = (u - tip[0]) * math.cos(angle) + (v - tip[1]) * math.sin(angle)
    across = -(u - tip[0]) * math.sin(angle) + (v - tip[1]) * math.cos(angle)
    edge = np.minimum(along, width_px / 2 - np.abs(across))
    return 1 - np.clip(edge + 0.5, 0, 1)
