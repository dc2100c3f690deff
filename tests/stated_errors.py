"""Kinds of frames with known ellipses, and what the sub-pixel mode makes of them.

Each frame is independent: another wall, another ellipse, other noise, no tracking. The frames are
drawn by `own_frames`, whose formulas are not those of `scenes`, or rendered. The constants of the
detector were set on drawn retinas and on texture of spectrum 1/f, those of bells' centres on the
photograph too.
"""

from __future__ import annotations

import functools
import math
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from estimator import SubpixelSettings, TrackState, measure
from formats.spots import Spot
from scenes.description.settings import Phantom
from scenes.drawn import any_wall
from scenes.walls.picture import PICTURE_MM, PICTURE_PX, wall_picture
from tests import own_frames
from tests.own_frames import Ellipse, OwnFrame

_SCALE_MM_PX = 0.0067
_PHOTOGRAPH_MM = 4.5, 8.3  # a little less than what the picture shows of it


class Kind(NamedTuple):
    """A kind of frame: how a frame is made, and the largest RMSE of the semi-minor axis, px."""

    make: Callable[[np.random.Generator], OwnFrame]
    goal_px: float = math.inf


def _even(rng: np.random.Generator) -> np.ndarray:
    return np.ones(own_frames.SHAPE)


def _photograph(rng: np.random.Generator) -> np.ndarray:
    return own_frames.window_of(_fundus_photograph(), rng, PICTURE_MM / PICTURE_PX / _SCALE_MM_PX)


@functools.cache
def _fundus_photograph() -> np.ndarray:
    picture = wall_picture(Phantom(wall="photograph"))
    width, height = (round(mm / 2 * PICTURE_PX / PICTURE_MM) for mm in _PHOTOGRAPH_MM)
    middle = PICTURE_PX // 2
    return picture[middle - height : middle + height, middle - width : middle + width]


_WALLS = {
    "1/f": own_frames.textured_wall,
    "retina": any_wall,
    "photograph": _photograph,
}


def _still(
    wall: Callable[[np.random.Generator], np.ndarray],
    light: own_frames.Light,
    sizes: tuple[float, float] = (25, 110),
    step: float = own_frames.STEP,
) -> Callable[[np.random.Generator], OwnFrame]:
    def make(rng: np.random.Generator) -> OwnFrame:
        return own_frames.drawn(
            rng, own_frames.any_ellipse(rng, *sizes), light, wall(rng), step=step
        )

    return make


def _shadowed(rng: np.random.Generator) -> OwnFrame:
    truth = own_frames.any_ellipse(rng, 25, 110)
    lit = own_frames.shadow_over_a_third(rng, truth)
    return own_frames.drawn(
        rng, truth, own_frames.disc(2.0), own_frames.textured_wall(rng), lit=lit
    )


def _moved(
    wall: Callable[[np.random.Generator], np.ndarray], unevenness: float
) -> Callable[[np.random.Generator], OwnFrame]:
    def make(rng: np.random.Generator) -> OwnFrame:
        truth = own_frames.any_ellipse(rng, 30, 90)
        length, heading = rng.uniform(0.3, 1) * truth.semi_minor, rng.uniform(0, 2 * math.pi)
        path = length * math.cos(heading), length * math.sin(heading)
        uneven = rng.uniform(-unevenness, unevenness)
        return own_frames.moved(rng, truth, own_frames.disc(2.0), wall(rng), path, uneven)

    return make


def kinds() -> dict[str, Kind]:
    """All kinds of drawn frames by name."""
    disc, bell = own_frames.disc, own_frames.bell(2.0)
    made = {
        "disc, even wall": Kind(_still(_even, disc(2.0))),
        "disc, 1/f": Kind(_still(own_frames.textured_wall, disc(2.0)), 0.05),
        "disc blurred by 4 px, 1/f": Kind(_still(own_frames.textured_wall, disc(4.0)), 0.1),
        "disc with a third in shadow, 1/f": Kind(_shadowed, 0.1),
    }
    for name in ("retina", "photograph"):
        wall = _WALLS[name]
        made[f"disc, {name}"] = Kind(_still(wall, disc(2.0)))
        made[f"disc of b 20 px, {name}"] = Kind(_still(wall, disc(2.0), (20, 20.5)))
    for name, wall in _WALLS.items():
        made[f"bell, {name}"] = Kind(_still(wall, bell, (25, 80), 150.0))
    for name in ("retina", "photograph"):
        made[f"moved evenly, {name}"] = Kind(_moved(_WALLS[name], 0.0))
        made[f"moved unevenly, {name}"] = Kind(_moved(_WALLS[name], 0.5))
    return made


RENDERS = {f"rendered {light}, photograph": light for light in ("cone", "lens")}
"""Light of the source, by the name of the kind of rendered frame."""


def rendered(light: str, seed: int, number: int) -> Iterator[OwnFrame]:
    """Frames of as many stacks of one frame, with another place, beam and noise each."""
    from scenes import Scene, render_stack

    for k in range(number):
        rng = np.random.default_rng([seed, k])
        spot = {
            "eccentricity_mm": rng.uniform(0, 2),
            "azimuth_deg": rng.uniform(0, 360),
            "incidence_deg": rng.uniform(5, 30),
            "incidence_azimuth_deg": rng.uniform(0, 360),
        }
        scene = Scene.model_validate(
            {
                "schema": 1,
                "seed": int(rng.integers(2**30)),
                "phantom": {"wall": "photograph"},
                "source": {"kind": light},
                "spot": spot,
                "motion": {"start_mm": rng.uniform(2, 6), "travel_mm": 0.1, "frames": 1},
                "exposures": {"kinds": ["metered"]},
            }
        )
        with tempfile.TemporaryDirectory() as folder:
            stack = render_stack(scene, Path(folder) / "stack")
            for labels in stack.exposed("metered"):
                truth = Ellipse(
                    labels.half_max_x_px,
                    labels.half_max_y_px,
                    labels.half_max_semi_major_px,
                    labels.half_max_semi_minor_px,
                    labels.half_max_angle_rad,
                )
                yield OwnFrame(stack.image(labels), truth)


class Measured(NamedTuple):
    """Errors and stated standard deviations of x, y, semi-major and semi-minor axis, (n, 4), px."""

    errors: np.ndarray
    sigmas: np.ndarray
    missed: int


def measured(name: str, number: int, seed: int) -> Measured:
    """What the sub-pixel mode makes of the frames of one kind."""
    if name in RENDERS:
        frames = rendered(RENDERS[name], seed, number)
    else:
        make = kinds()[name].make
        frames = (make(np.random.default_rng([seed, k])) for k in range(number))
    errors, sigmas, missed = [], [], 0
    for frame in frames:
        spot, _ = measure(frame.image, TrackState(), SubpixelSettings())
        if isinstance(spot, Spot):
            errors.append((np.array(spot.ellipse) - frame.truth.parameters)[:4])
            sigmas.append(np.sqrt(np.diag(spot.covariance))[:4])
        else:
            missed += 1
    return Measured(np.reshape(errors, (-1, 4)), np.reshape(sigmas, (-1, 4)), missed)
