"""Accuracy and speed of the estimator on ellipses that are known exactly.

    OPENCV_FOR_THREADS_NUM=1 OMP_NUM_THREADS=1 python -m benchmarks.estimator_accuracy

prints the error of the semi-minor axis for the sub-pixel mode, the literal mode and scikit-image's
EllipseModel on a plain contour, all of the same frames, beside the Cramér-Rao bound; then the false
spots on frames without one, and the time of a frame.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.estimator_frames import (
    SHAPE,
    Profile,
    Scene,
    Truth,
    any_truth,
    any_wall,
    bell,
    domed_edge,
    erf_edge,
    flank,
    frame_of,
    with_glints,
    with_quarter_in_shadow,
    with_shaft,
)
from estimator import LiteralSettings, Spot, SubpixelSettings, TrackState, measure

Make = Callable[[np.random.Generator], Scene]
Method = Callable[[np.ndarray, tuple[float, float], np.ndarray | None], float]
"""Semi-minor axis (px) of a frame, a start point and maybe a reference frame; NaN for none."""

_FRAMES = 60
_SPOTLESS = 1000
_TIMED = 300
_CROP = 200
_SHAFT_PX = 75.0


def subpixel(frame: np.ndarray, at: tuple[float, float], reference: np.ndarray | None) -> float:
    """Our default mode."""
    settings = SubpixelSettings(reference=reference)
    spot, _ = measure(frame, TrackState(at_px=at), settings)
    return spot.semi_minor_px if isinstance(spot, Spot) else math.nan


def literal(frame: np.ndarray, at: tuple[float, float], reference: np.ndarray | None) -> float:
    """The paper's algorithm with its fixed threshold."""
    spot, _ = measure(frame, TrackState(at_px=at), LiteralSettings())
    return spot.semi_minor_px if isinstance(spot, Spot) else math.nan


def ellipse_model(
    frame: np.ndarray, at: tuple[float, float], reference: np.ndarray | None
) -> float:
    """scikit-image: longest contour at the crop's Otsu threshold, EllipseModel through it."""
    from skimage.color import rgb2gray
    from skimage.filters import threshold_otsu
    from skimage.measure import EllipseModel, find_contours

    x, y = (round(v) for v in at)
    crop = frame[max(y - _CROP, 0) : y + _CROP, max(x - _CROP, 0) : x + _CROP]
    grey = rgb2gray(crop)
    contours = find_contours(grey, threshold_otsu(grey))
    if not contours:
        return math.nan
    model = EllipseModel.from_estimate(max(contours, key=len)[:, ::-1])
    return min(model.axis_lengths) if model else math.nan


_METHODS: dict[str, Method] = {
    "sub-pixel": subpixel,
    "literal": literal,
    "EllipseModel": ellipse_model,
}


def _even(semi_minor: float, **changes: object) -> Make:
    return lambda rng: replace(Scene(truth=any_truth(rng, semi_minor)), **changes)  # type: ignore[arg-type]


def _textured(semi_minor: float, **changes: object) -> Make:
    return lambda rng: replace(_even(semi_minor, **changes)(rng), wall=any_wall(rng))


def _shafted(reach: float) -> Make:
    return lambda rng: with_shaft(_textured(80)(rng), rng, reach, _SHAFT_PX)


def _clipped(rng: np.random.Generator) -> Scene:
    scene = _textured(60)(rng)
    return replace(scene, truth=replace(scene.truth, x=0.4 * scene.truth.semi_minor))


def _profiles() -> dict[str, Profile]:
    blurs = {f"blur {sigma} px": erf_edge(sigma) for sigma in (1, 4, 8)}
    return blurs | {"dome 20 %": domed_edge(2, 0.2), "flank": flank(0.7), "bell": bell}


def cases() -> dict[str, Make]:
    """Scenes by name; b is the semi-minor axis in px, the blur 2 px unless the name says other."""
    sizes = (20, 40, 60, 100, 150)
    made: dict[str, Make] = {f"even wall, b {b}": _even(b) for b in sizes}
    made |= {f"retina, b {b}": _textured(b) for b in sizes}
    for name, profile in _profiles().items():
        made[f"even wall, {name}"] = _even(60, profile=profile)
        made[f"retina, {name}"] = _textured(60, profile=profile)
    made |= {
        "even wall, half as bright": _even(60, amplitude=90.0),
        "even wall, bright": _even(60, amplitude=235.0),
        "even wall, bright, blur 4 px": _even(60, amplitude=235.0, profile=erf_edge(4)),
        "even wall, saturated 1.2 x": _even(60, amplitude=300.0),
        "even wall, saturated 1.7 x": _even(60, amplitude=430.0),
        "retina, red saturated 2 x": _textured(60, amplitude=500.0),
    }
    made |= {
        "retina, b 80, shaft 48 px short": _shafted(0.6),
        "retina, b 80, shaft past middle": _shafted(-0.3),
        "retina, b 80, shaft across": _shafted(-3.0),
        "retina, a quarter in shadow": lambda rng: with_quarter_in_shadow(_textured(60)(rng), rng),
        "retina, glints on the edge": lambda rng: with_glints(
            _textured(60)(rng), rng, on_edge=True
        ),
        "retina, glints anywhere": lambda rng: with_glints(_textured(60)(rng), rng, on_edge=False),
        "retina, clipped by the border": _clipped,
    }
    return made


def cramer_rao_bound(scene: Scene, sigma_px: float) -> float:
    """Least standard deviation (px) of the semi-minor axis of a near-circle on an even wall.

    (s / D) sqrt(3 w / (sqrt(pi) B)) with the grey mean's noise s, the step D, the edge's blur w and
    the radius B (DESIGN of the estimator: pixels of the edge band, five parameters).
    """
    grey_noise = scene.noise * math.hypot(0.299, 0.587, 0.114)
    size = scene.truth.semi_minor
    return grey_noise / scene.amplitude * math.sqrt(3 * sigma_px / (math.sqrt(math.pi) * size))


def errors_of(make: Make, number: int, *, with_reference: bool = False) -> np.ndarray:
    """Error of the semi-minor axis by frame and method, px; NaN for a miss."""
    rng = np.random.default_rng(2020)
    rows = []
    for _ in range(number):
        scene = make(rng)
        image = frame_of(scene, rng)
        reference = frame_of(replace(scene, amplitude=0.0), rng) if with_reference else None
        dx, dy = rng.uniform(-10, 10, 2)
        at = (
            min(max(scene.truth.x + dx, 0), SHAPE[1] - 1),
            min(max(scene.truth.y + dy, 0), SHAPE[0] - 1),
        )
        found = [method(image, at, reference) for method in _METHODS.values()]
        rows.append([size - scene.truth.semi_minor for size in found])
    return np.array(rows)


def _accuracy(number: int) -> Table:
    columns = [f"{name}: bias" for name in _METHODS]
    table = Table(
        "frames",
        *(part for name in columns for part in (name, "std", "worst", "missed")),
        title=f"error of the semi-minor axis, px, {number} frames each",
    )
    rows = [(name, make, False) for name, make in cases().items()]
    rows.append(("retina, bell, reference frame", _textured(60, profile=bell), True))
    for name, make, with_reference in rows:
        cells = []
        for errors in errors_of(make, number, with_reference=with_reference).T:
            seen = errors[np.isfinite(errors)]
            if seen.size:
                worst = np.abs(seen).max()
                cells += [f"{seen.mean():+.3f}", f"{seen.std():.3f}", f"{worst:.2f}"]
            else:
                cells += ["", "", ""]
            cells.append(str(errors.size - seen.size))
        table.add_row(name, *cells)
    return table


def spotless_frame(rng: np.random.Generator) -> np.ndarray:
    """A retina under any ambient light, with glints or a shaft or neither, and no spot."""
    scene = Scene(
        truth=any_truth(rng, 60),
        amplitude=0.0,
        ambient=rng.uniform(3, 180),
        noise=rng.uniform(0.5, 5),
        wall=any_wall(rng),
    )
    if rng.random() < 0.6:
        scene = with_glints(scene, rng, on_edge=False, number=int(rng.integers(1, 8)))
    if rng.random() < 0.5:
        scene = with_shaft(scene, rng, rng.uniform(-2, 2), rng.uniform(40, 100))
    return frame_of(scene, rng)


def false_spots(number: int, seed: int) -> int:
    """How many of so many frames without a spot show one, half of them searched round a point."""
    rng = np.random.default_rng(seed)
    states = (TrackState(), TrackState(at_px=(SHAPE[1] / 2, SHAPE[0] / 2)))
    settings = SubpixelSettings()
    results = (measure(spotless_frame(rng), states[k % 2], settings)[0] for k in range(number))
    return sum(isinstance(result, Spot) for result in results)


def _times(number: int) -> Table:
    rng = np.random.default_rng(0)
    table = Table("one frame, ms", "sub-pixel: median", "99 %", "literal: median", "99 %")
    for shape in (SHAPE, (1080, 1920)):
        for name, walled in (("even wall", False), ("retina", True)):
            truth = Truth(x=330, y=230, semi_major=66, semi_minor=60, angle=0.5)
            wall = any_wall(rng, shape) if walled else None
            image = frame_of(Scene(truth=truth, wall=wall), rng, shape)
            cells = []
            for settings in (SubpixelSettings(), LiteralSettings(threshold=90)):
                _, state = measure(image, TrackState(at_px=(truth.x, truth.y)), settings)
                seconds = []
                for _ in range(number):
                    began = time.perf_counter()
                    measure(image, state, settings)
                    seconds.append(time.perf_counter() - began)
                cells += [f"{1e3 * np.percentile(seconds, q):.2f}" for q in (50, 99)]
            table.add_row(f"{shape[1]} x {shape[0]}, {name}, tracked", *cells)
    return table


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--frames", type=int, default=_FRAMES, help="frames of each case")
    parser.add_argument("--spotless", type=int, default=_SPOTLESS, help="frames without a spot")
    asked = parser.parse_args()
    console = Console(width=max(Console().width, 170))
    console.print(_accuracy(asked.frames))
    scene = _even(60)(np.random.default_rng(0))
    console.print(f"Cramér-Rao bound, even wall, b 60: {cramer_rao_bound(scene, 2.0):.4f} px")
    found = false_spots(asked.spotless, seed=1)
    console.print(f"false spots on {asked.spotless} frames without one: {found}")
    console.print(_times(_TIMED))
    if os.environ.get("OPENCV_FOR_THREADS_NUM") != "1":
        console.print("Times with all threads; set OPENCV_FOR_THREADS_NUM=1 for those of one.")


if __name__ == "__main__":
    main()
