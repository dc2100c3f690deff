"""Frames without a spot: retinas, and bright things: lamps' reflexes, text, polygons, rings."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import gaussian_filter
from scipy.special import erfc

from eyespot.estimator import SubpixelSettings, TrackState, measure
from eyespot.formats.spot import Spot
from eyespot.scenes.drawn import SHAPE, Drawing, any_truth, any_wall, frame_of, light_of
from tests.support.drawn.drawn_spots import with_glints, with_shaft
from tests.support.drawn.own_frames import (
    any_ellipse,
    camera_image,
    photographed_wall,
    textured_wall,
    vessel,
)

STEP, AMBIENT = Drawing.amplitude, Drawing.ambient

_LETTERS = list("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghklmnopqrstuvwxyz0123456789@&")
"""No dots, not even those of i and j: thick ones are discs."""


def lamps(rng: np.random.Generator) -> np.ndarray:
    """One to three saturated blobs with halos; a third of them are squares."""
    light = rng.uniform(10, 60) * textured_wall(rng)
    for _ in range(int(rng.integers(1, 4))):
        radius = rng.uniform(15, 70)
        along, across = _turned(rng, squeezed=rng.uniform(0.6, 1))
        square = rng.random() < 1 / 3
        outside = np.maximum(abs(along), abs(across)) if square else np.hypot(along, across)
        outside = outside - radius
        light += rng.uniform(400, 3000) / (
            1 + np.exp(np.clip(outside / rng.uniform(1, 4), -50, 50))
        )
        reach = radius * rng.uniform(0.2, 1.2)
        light += rng.uniform(20, 150) * np.exp(-np.maximum(outside, 0) / reach)
    return camera_image(rng, light)


def text(rng: np.random.Generator) -> np.ndarray:
    """One to three words of thin or thick letters."""
    page = Image.new("L", SHAPE[::-1])
    pen = ImageDraw.Draw(page)
    for _ in range(int(rng.integers(1, 4))):
        word = "".join(rng.choice(_LETTERS, int(rng.integers(1, 8))))
        size = rng.uniform(40, 200)
        at = rng.uniform(0, 300), rng.uniform(0, 350)
        thickness = size * rng.uniform(0, 0.12)
        pen.text(at, word, fill=255, font=ImageFont.load_default(size), stroke_width=thickness)
    letters = gaussian_filter(np.asarray(page) / 255.0, rng.uniform(0.7, 2))
    return camera_image(rng, (AMBIENT + rng.uniform(100, 230) * letters) * textured_wall(rng))


def hexagon(rng: np.random.Generator) -> np.ndarray:
    """A regular hexagon with edges blurred by 1 to 3 px, squeezed by up to a fifth."""
    along, across = _turned(rng, squeezed=rng.uniform(0.8, 1))
    normals = np.arange(6) * math.pi / 3
    sides = [along * math.cos(normal) + across * math.sin(normal) for normal in normals]
    outside = np.max(sides, axis=0) - rng.uniform(30, 100)
    light = 0.5 * STEP * erfc(outside / (math.sqrt(2) * rng.uniform(1, 3)))
    return camera_image(rng, (light + AMBIENT) * textured_wall(rng))


def ring(rng: np.random.Generator) -> np.ndarray:
    """An elliptical ring; its hole has 0.25 to 0.8 of its radius."""
    outer, share = any_ellipse(rng, 30, 100), rng.uniform(0.25, 0.8)
    inner = replace(outer, semi_major=share * outer.semi_major, semi_minor=share * outer.semi_minor)
    disc, hole = (light_of(Drawing(truth=one, ambient=0.0))[..., 0] for one in (outer, inner))
    return camera_image(rng, (disc - hole + AMBIENT) * textured_wall(rng))


def field_stop(rng: np.random.Generator) -> np.ndarray:
    """A fundus camera's round field over a retina, more than half as high as the frame."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    radius = rng.uniform(0.28, 0.6) * SHAPE[0]
    x, y = SHAPE[1] / 2 + rng.uniform(-30, 30), SHAPE[0] / 2 + rng.uniform(-15, 15)
    outside = np.hypot(u - x, v - y) - radius
    stop = np.clip(0.5 - outside / rng.uniform(1, 4), 0, 1)
    wall = any_wall(rng) if rng.random() < 0.5 else photographed_wall(rng)
    shade = (
        1 + rng.uniform(-0.2, 0.2) * (u - x) / radius - rng.uniform(0, 0.4) * (outside / radius + 1)
    )
    return camera_image(
        rng, rng.uniform(60, 200) * (stop * shade)[..., None] * wall + rng.uniform(0, 8)
    )


def lattice(rng: np.random.Generator) -> np.ndarray:
    """Dots on a grid, round and soft, as of a laser behind a grating; some are brighter."""
    along, across = _turned(rng, squeezed=rng.uniform(0.6, 1))
    radius = rng.uniform(3, 25)
    period = radius * rng.uniform(2.5, 8)
    column, row = np.round(along / period), np.round(across / period)
    away = np.hypot(along - period * column, across - period * row) / radius
    dots = np.exp(-math.log(2) * away ** rng.choice([2, 6]))
    fade = np.exp(-rng.uniform(0, 0.1) * (column**2 + row**2))
    light = rng.uniform(60, 300) * dots * fade
    return camera_image(rng, (AMBIENT + light) * textured_wall(rng))


def optic_disc(rng: np.random.Generator) -> np.ndarray:
    """A disc that is brighter by 20 to 90 %, with a cup, where vessels cross it."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    radius = rng.uniform(25, 90)
    away = np.hypot((u - SHAPE[1] / 2) / rng.uniform(0.85, 1), v - SHAPE[0] / 2) / radius
    light = 1 + rng.uniform(0.2, 0.9) * 0.5 ** (away ** rng.uniform(4, 10))
    light += rng.uniform(0, 0.4) * 0.5 ** (4 * away**2)
    wall = textured_wall(rng) * light
    for _ in range(4):
        wall *= 1 - rng.uniform(0.1, 0.4) * vessel(rng)
    return camera_image(rng, rng.uniform(40, 120) * wall[..., None] * (1.0, 0.6, 0.4))


def windows(rng: np.random.Generator) -> np.ndarray:
    """One to three bright rectangles."""
    light = np.full(SHAPE, rng.uniform(5, 60))
    for _ in range(int(rng.integers(1, 4))):
        along, across = _turned(rng, squeezed=1.0)
        inside = (abs(along) < rng.uniform(10, 60)) & (abs(across) < rng.uniform(10, 60))
        light += rng.uniform(60, 180) * gaussian_filter(inside.astype(float), rng.uniform(0.8, 3))
    return camera_image(rng, light)


LOOKALIKES: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "lamps' reflexes": lamps,
    "text": text,
    "hexagons": hexagon,
    "rings": ring,
    "field stops": field_stop,
    "lattices": lattice,
    "optic discs": optic_disc,
    "windows": windows,
}


def taken_for_spots(name: str, numbers: Iterable[int], seed: int) -> int:
    """In how many of these frames the sub-pixel mode finds a spot."""
    frames = (LOOKALIKES[name](np.random.default_rng([seed, k])) for k in numbers)
    results = (measure(frame, TrackState(), SubpixelSettings())[0] for frame in frames)
    return sum(isinstance(result, Spot) for result in results)


def _turned(rng: np.random.Generator, squeezed: float) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates about a random place in a random direction; the second one is stretched."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    u, v = u - rng.uniform(130, SHAPE[1] - 130), v - rng.uniform(130, SHAPE[0] - 130)
    turn = rng.uniform(0, 2 * math.pi)
    along = u * math.cos(turn) + v * math.sin(turn)
    return along, (v * math.cos(turn) - u * math.sin(turn)) / squeezed


def spotless_frame(rng: np.random.Generator) -> np.ndarray:
    """A retina without a spot, with random ambient light, and sometimes glints or a shaft.

    A glint is a lamp's mirror image, brighter than the camera can show: a round disc of these sizes
    that is not clipped is a small spot.
    """
    scene = Drawing(
        truth=any_truth(rng, 60),
        amplitude=0.0,
        ambient=rng.uniform(3, 180),
        noise=rng.uniform(0.5, 5),
        wall=any_wall(rng),
    )
    if rng.random() < 0.6:
        number = int(rng.integers(1, 8))
        scene = with_glints(scene, rng, on_edge=False, number=number, level=750.0)
    if rng.random() < 0.5:
        scene = with_shaft(scene, rng, rng.uniform(-2, 2), rng.uniform(40, 100))
    return frame_of(scene, rng)


def false_spots(number: int, seed: int) -> int:
    """Number of false spots in frames without a spot; half of the searches start at a point."""
    rng = np.random.default_rng(seed)
    states = (TrackState(), TrackState(at_px=(SHAPE[1] / 2, SHAPE[0] / 2)))
    settings = SubpixelSettings()
    results = (measure(spotless_frame(rng), states[k % 2], settings)[0] for k in range(number))
    return sum(isinstance(result, Spot) for result in results)
