"""Frames with spots that are known exactly: the estimator's ground truth.

A frame is what a camera would give of wall * (light + ambient), seen past what is in the way. The
truth is the ellipse on which the light, without the wall's texture, is half of its peak.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from estimator import Spot

SHAPE = (480, 640)
SCALE_MM_PER_PX = 0.0067

Profile = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Light, 1 at its peak, of the elliptical radius (1 on the truth) and the distance from it (px)."""


@dataclass(frozen=True, kw_only=True)
class Truth:
    """A spot's half-maximum ellipse, px and rad."""

    x: float
    y: float
    semi_major: float
    semi_minor: float
    angle: float = 0.0

    def moved(self, dx: float, dy: float) -> Truth:
        """The same ellipse elsewhere."""
        return replace(self, x=self.x + dx, y=self.y + dy)

    def errors(self, spot: Spot) -> tuple[float, float, float, float]:
        """Estimate less truth of x, y, semi-major and semi-minor axis, px."""
        return (
            spot.x_px - self.x,
            spot.y_px - self.y,
            spot.semi_major_px - self.semi_major,
            spot.semi_minor_px - self.semi_minor,
        )


def erf_edge(sigma_px: float) -> Profile:
    """Flat disc with a Gaussian-blurred edge."""
    return lambda t, distance: ndtr(-distance / sigma_px)


def domed_edge(sigma_px: float, drop: float) -> Profile:
    """Disc that falls by `drop` of its peak from the middle to the rim, before the same blur."""
    # Dome times edge is 1/2 on the truth: a little outside the edge's own middle.
    shift = NormalDist().inv_cdf(0.5 / (1 - drop))
    return lambda t, distance: (1 - drop * t * t) * ndtr(shift - distance / sigma_px)


_SOFT_DISC = erf_edge(2.0)


def flank(width: float) -> Profile:
    """Plateau that falls off linearly over `width` radii, as behind a flat glue lens."""
    return lambda t, distance: np.clip(0.5 + (1 - t) / width, 0, 1)


def bell(t: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Gaussian."""
    return np.exp(-math.log(2) * t * t)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What a synthetic frame shows; levels are of the brightest channel, full scale 255.

    Attributes:
        truth: the spot's ellipse.
        profile: of its light.
        amplitude: of the light at its peak on the mean wall.
        ambient: light everywhere, on the mean wall.
        noise: standard deviation of each channel's value.
        wall: (H, W, 3) reflectance, 1 on average in the brightest channel; None for an even wall.
        lit: (H, W) part of the spot's light that arrives, 1 without a shadow.
        seen: (H, W) part of the wall that is seen, 1 without a shaft.
        glints: (H, W) light that is added to every channel.
        path_px: (x, y) of the straight way that the spot moves during the exposure, evenly; the
            truth is the ellipse in the middle of it.
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


_SHAFT_LEVEL = 5.0


def light_of(scene: Scene, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """Noise-free values of the three channels, neither clipped nor rounded, (H, W, 3)."""
    if scene.amplitude == 0:
        spot = np.zeros(shape)
    else:
        spot = scene.amplitude * scene.profile(*_radius_and_distance(scene.truth, shape))
    if scene.path_px is not None:
        spot = _moved(spot, *scene.path_px)
    if scene.lit is not None:
        spot = spot * scene.lit
    image = np.repeat((spot + scene.ambient)[..., None], 3, axis=2)
    if scene.wall is not None:
        image *= scene.wall
    if scene.seen is not None:
        image = _SHAFT_LEVEL + (image - _SHAFT_LEVEL) * scene.seen[..., None]
    if scene.glints is not None:
        image += scene.glints[..., None]
    return image


def frame_of(scene: Scene, rng: np.random.Generator, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """The camera's 8-bit RGB frame."""
    image = light_of(scene, shape)
    noise = rng.standard_normal(image.shape, dtype=np.float32)
    noise *= scene.noise
    image += noise
    np.clip(np.rint(image, out=image), 0, 255, out=image)
    return image.astype(np.uint8)


def _radius_and_distance(truth: Truth, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Elliptical radius and signed distance; the latter is exact to first order at the contour."""
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    c, s = math.cos(truth.angle), math.sin(truth.angle)
    x = ((u - truth.x) * c + (v - truth.y) * s) / truth.semi_major
    y = ((v - truth.y) * c - (u - truth.x) * s) / truth.semi_minor
    t = np.maximum(np.hypot(x, y), 1e-9)
    gradient = np.hypot(x / truth.semi_major, y / truth.semi_minor) / t
    return t, (t - 1) / np.maximum(gradient, 1e-9)


def _moved(light: np.ndarray, x: float, y: float) -> np.ndarray:
    """Mean over a straight path about the middle: a box, which is a sinc in the spectrum.

    Exact for what the pixels resolve; the light must not reach the image's border.
    """
    along_y = np.fft.fftfreq(light.shape[0])[:, None] * y
    along_x = np.fft.rfftfreq(light.shape[1]) * x
    spectrum = np.fft.rfft2(light) * np.sinc(along_x + along_y)
    return np.fft.irfft2(spectrum, s=light.shape)


def any_truth(
    rng: np.random.Generator, semi_minor: float, axis_ratio: float = 1.1, about: float = 5.0
) -> Truth:
    """An ellipse of a given size near the middle of the frame, at any angle."""
    dx, dy = rng.uniform(-about, about, 2)
    return Truth(
        x=SHAPE[1] / 2 + dx,
        y=SHAPE[0] / 2 + dy,
        semi_major=semi_minor * axis_ratio,
        semi_minor=semi_minor,
        angle=rng.uniform(-math.pi / 2, math.pi / 2),
    )


@functools.lru_cache(maxsize=4)
def _retina(seed: int) -> np.ndarray:
    from scenes.walls import fundus

    return fundus(seed=seed, extent_mm=2000 * SCALE_MM_PER_PX, pixels=2000)


def any_wall(rng: np.random.Generator, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """A window of a printed retina, anywhere in the fundus, its brightest channel 1 on average."""
    retina = _retina(int(rng.integers(4)))
    row = rng.integers(retina.shape[0] - shape[0] + 1)
    column = rng.integers(retina.shape[1] - shape[1] + 1)
    wall = retina[row : row + shape[0], column : column + shape[1]].astype(float)
    return wall / wall.mean(axis=(0, 1)).max()


def behind_shaft(tip: tuple[float, float], heading: float, width_px: float) -> np.ndarray:
    """Part of the wall seen past a shaft that ends at the tip and runs off in a direction (rad)."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    along = (u - tip[0]) * math.cos(heading) + (v - tip[1]) * math.sin(heading)
    across = (v - tip[1]) * math.cos(heading) - (u - tip[0]) * math.sin(heading)
    return 1 - np.clip(np.minimum(along, width_px / 2 - np.abs(across)) + 0.5, 0, 1)


def with_shaft(scene: Scene, rng: np.random.Generator, reach: float, width_px: float) -> Scene:
    """A shaft whose tip lies `reach` semi-minor axes short of the centre (negative: beyond it)."""
    truth, heading = scene.truth, rng.uniform(0, 2 * math.pi)
    away = reach * truth.semi_minor
    tip = truth.x + away * math.cos(heading), truth.y + away * math.sin(heading)
    return replace(scene, seen=behind_shaft(tip, heading, width_px))


def with_quarter_in_shadow(scene: Scene, rng: np.random.Generator) -> Scene:
    """A sector of 90 degrees without the spot's light, its rims blurred by 1.5 px."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    direction = np.arctan2(v - scene.truth.y, u - scene.truth.x) - rng.uniform(0, 2 * math.pi)
    lit = (direction % (2 * math.pi) > math.pi / 2).astype(float)
    return replace(scene, lit=gaussian_filter(lit, 1.5))


def with_glints(scene: Scene, rng: np.random.Generator, *, on_edge: bool, number: int = 4) -> Scene:
    """Bright discs of 3 to 9 px radius, centred on the contour or anywhere within 1.6 radii."""
    v, u = np.ogrid[: SHAPE[0], : SHAPE[1]]
    glints = np.zeros(SHAPE)
    for _ in range(number):
        angle, radius = rng.uniform(0, 2 * math.pi), rng.uniform(3, 9)
        away = scene.truth.semi_minor * (1.0 if on_edge else rng.uniform(0.2, 1.6))
        x, y = scene.truth.x + away * math.cos(angle), scene.truth.y + away * math.sin(angle)
        glints[(u - x) ** 2 + (v - y) ** 2 < radius**2] = 250
    return replace(scene, glints=gaussian_filter(glints, 1.0))
