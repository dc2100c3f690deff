"""Frames without a spot: false spots, and how soon a lost spot is found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.bench.output import show
from estimator import NoSpot, Reason, Spot, SubpixelSettings, TrackState, measure
from scenes.drawn import (
    SHAPE,
    Drawing,
    Truth,
    any_truth,
    any_wall,
    frame_of,
    with_glints,
    with_shaft,
)

_LOST_FRAMES = 3
_LONGEST = 10  # frames after which the search is given up


def spotless_frame(rng: np.random.Generator) -> np.ndarray:
    """A retina without a spot, with random ambient light, and sometimes glints or a shaft."""
    scene = Drawing(
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
    """Number of false spots in frames without a spot; half of the searches start at a point."""
    rng = np.random.default_rng(seed)
    states = (TrackState(), TrackState(at_px=(SHAPE[1] / 2, SHAPE[0] / 2)))
    settings = SubpixelSettings()
    results = (measure(spotless_frame(rng), states[k % 2], settings)[0] for k in range(number))
    return sum(isinstance(result, Spot) for result in results)


def run(*, full: bool) -> None:
    """Print false spots, and after how many frames a lost spot is found.

    Args:
        full: ten times as many frames.
    """
    spotless, losses = (10_000, 200) if full else (1000, 20)
    found, until = false_spots(spotless, seed=1), frames_until_found(losses, seed=1)
    show(
        f"{found} false spots in {spotless} frames without a spot. A lost spot is found again in "
        f"its frame {np.mean(until):.2f} (mean of {losses} losses; the latest: {max(until)})."
    )


def frames_until_found(number: int, seed: int) -> list[int]:
    """Number of frames until a spot is found again that vanished and returned elsewhere.

    1 means: in the first frame that shows it again.
    """
    rng = np.random.default_rng(seed)
    settings = SubpixelSettings()
    counts = []
    for _ in range(number):
        wall, first = any_wall(rng), any_truth(rng, rng.uniform(30, 90))
        scene = Drawing(truth=first, wall=wall)
        state = TrackState()
        dark = [replace(scene, amplitude=0.0)] * _LOST_FRAMES
        for shown in (scene, scene, *dark):
            _, state = measure(frame_of(shown, rng), state, settings)
        back = replace(scene, truth=_elsewhere(first, rng))
        result: Spot | NoSpot = NoSpot(Reason.NONE_FOUND)
        count = 0
        while not result and count < _LONGEST:
            result, state = measure(frame_of(back, rng), state, settings)
            count += 1
        counts.append(count)
    return counts


def _elsewhere(truth: Truth, rng: np.random.Generator) -> Truth:
    """The ellipse at a random position in the frame, up to a third larger or smaller."""
    growth, margin = rng.uniform(0.75, 1.33), 1.33 * truth.semi_major
    return replace(
        truth,
        x=rng.uniform(margin, SHAPE[1] - margin),
        y=rng.uniform(margin, SHAPE[0] - margin),
        semi_major=growth * truth.semi_major,
        semi_minor=growth * truth.semi_minor,
    )
