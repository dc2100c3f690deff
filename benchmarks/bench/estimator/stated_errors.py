"""Whether the errors lie within the stated standard deviations, and what is taken for a spot.

Each frame is independent: another wall, another ellipse, other noise, no tracking. The frames are
drawn by `own_frames`, whose formulas are not those of `scenes`, or rendered. The constants of the
detector were set on drawn retinas and on texture of spectrum 1/f, those of bells' centres on the
photograph too.
"""

from __future__ import annotations

import functools
import math
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import binom

from benchmarks.bench.estimator import own_frames
from benchmarks.bench.estimator.lookalikes import LOOKALIKES, taken_for_spots
from benchmarks.bench.estimator.own_frames import Ellipse, OwnFrame
from benchmarks.bench.output import show, table
from estimator import Spot, SubpixelSettings, TrackState, measure
from scenes.description import Phantom
from scenes.drawn import any_wall
from scenes.walls import PICTURE_MM, PICTURE_PX, wall_picture

_FRAMES, _FRAMES_FULL = 60, 500
_RENDERED, _RENDERED_FULL = 6, 500
_LOOKALIKES = 200
_SCALE_MM_PX = 0.0067
_PHOTOGRAPH_MM = 4.5, 8.3  # a little less than what the picture shows of it
_GOALS = ((1.0, 0.62, 0.74), (1.96, 0.92, 0.98))  # sigmas, least and largest share within them
_SURE = 0.99
_WIDTH = 150


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


def covered(errors: np.ndarray, sigmas: np.ndarray) -> tuple[list[float], bool]:
    """Shares of errors within 1 and 1.96 sigma, and whether both meet their goals.

    A share meets its goal inside the goal's limits, or inside those of 99 % of binomial samples
    with the nominal probability.
    """
    shares, met = [], True
    for width, least, largest in _GOALS:
        within = np.abs(errors) < width * sigmas
        number, share = within.size, float(within.mean()) if within.size else math.nan
        nominal = math.erf(width / math.sqrt(2))
        low, high = np.array(binom.interval(_SURE, number, nominal)) / max(number, 1)
        met &= min(least, low) <= share <= max(largest, high)
        shares.append(share)
    return shares, met


def _row(name: str, goal_px: float, found: Measured) -> list[str]:
    b = found.errors[:, 3]
    rmse = math.sqrt(float(np.mean(b * b))) if b.size else math.nan
    cells = [name, f"{b.size}", f"{found.missed}", f"{rmse:.3f}"]
    cells.append(f"{goal_px:g}" if math.isfinite(goal_px) else "")
    all_met = rmse <= goal_px and not (math.isfinite(goal_px) and found.missed)
    for column in range(4):
        shares, met = covered(found.errors[:, column], found.sigmas[:, column])
        cells.append(" ".join(f"{share:.0%}" for share in shares) + ("" if met else " !"))
        all_met &= met
    return [*cells, "yes" if all_met else "NO"]


def run(*, full: bool, seed: int) -> None:
    """Print both tables.

    Args:
        full: 500 frames of each kind, rendered ones, too.
        seed: of all that is random.
    """
    # One thread per worker; workers read these variables when they start.
    os.environ |= {"OPENCV_FOR_THREADS_NUM": "1", "OMP_NUM_THREADS": "1"}
    goals = {name: kind.goal_px for name, kind in kinds().items()}
    goals |= dict.fromkeys(RENDERS, math.inf)
    drawn, of_renders = (_FRAMES_FULL, _RENDERED_FULL) if full else (_FRAMES, _RENDERED)
    numbers = [of_renders if name in RENDERS else drawn for name in goals]
    shown = table(
        f"stated errors, seed {seed}: share of the errors within 1 σ and 1.96 σ\n"
        "(goals 62-74 % and 92-98 %, or the 99 % limits of so few frames; ! marks others)",
        *("frames", "spots", "missed", "RMSE of b, px", "goal"),
        *("x", "y", "a", "b", "met"),
    )
    others = table("taken for a spot", "frames", "number", "spots", "goal", "met")
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), mp_context=spawn) as pool:
        results = pool.map(measured, goals, numbers, [seed] * len(goals))
        for (name, goal), found in zip(goals.items(), results, strict=True):
            shown.add_row(*_row(name, goal, found))
        count = len(LOOKALIKES)
        spots = pool.map(taken_for_spots, LOOKALIKES, [_LOOKALIKES] * count, [seed] * count)
        for name, number in zip(LOOKALIKES, spots, strict=True):
            others.add_row(name, f"{_LOOKALIKES}", f"{number}", "0", "NO" if number else "yes")
    show(shown, others, width=_WIDTH)
