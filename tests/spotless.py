"""Frames without a spot, and how often the sub-pixel mode finds one there."""

import numpy as np

from estimator import SubpixelSettings, TrackState, measure
from formats.spots import Spot
from scenes.drawn import SHAPE, Drawing, any_truth, any_wall, frame_of
from tests.drawn_spots import with_glints, with_shaft


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
