"""What the network is shown: windows of the frames of a split, with their true numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.evaluation import VISIBLE_ENOUGH
from benchmarks.rivals.learned.crops import CELLS, Guess, Window, blob_in, cut
from benchmarks.rivals.learned.targets import NUMBERS, PLACES, place_of, targets_of
from benchmarks.sets.read import SetStack
from estimator import FrameLabels, read_microscope

WINDOWS = 8
"""Windows of each frame; an epoch shows one of them."""

_FIRST = 2  # so many are those of the blob, as in use; the others are around the true place
_MOVED = (0.0, 0.12, 0.12, 0.12, 0.12, 0.04, 0.04, 0.04)
"""By how much each window is moved and grows: standard deviations, in radii and in logarithms. The
last ones are like those around a first ellipse."""

_ELSEWHERE = (20.0, 120.0)  # px, radii that windows without a spot are cut for
_TRIES = 100


class Samples(NamedTuple):
    """Windows of n frames; `present` is 1 for frames with at least half of the contour in view.

    Attributes:
        windows: (n, WINDOWS + 1, 3, 64, 64), as `crops.cut` gives them; the last one of each frame
            lies where the spot's centre is not.
        places: (n, WINDOWS + 1, 4).
        targets: (n, WINDOWS + 1, 6); 0 where there is no spot.
        present: (n, WINDOWS + 1), 0 or 1.
    """

    windows: np.ndarray
    places: np.ndarray
    targets: np.ndarray
    present: np.ndarray


def samples_of(
    stacks: Sequence[SetStack], seed: int, *, progress: Callable[[], None] = lambda: None
) -> Samples:
    """Cut the windows of all frames, in the order of the stacks."""
    frames = sum(len(entry.open().labels) for entry in stacks)
    shape = frames, WINDOWS + 1
    made = Samples(
        windows=np.zeros((*shape, 3, CELLS, CELLS), np.float16),
        places=np.zeros((*shape, PLACES), np.float32),
        targets=np.zeros((*shape, len(NUMBERS)), np.float32),
        present=np.zeros(shape, np.float32),
    )
    row = 0
    for number, entry in enumerate(stacks):
        rng = np.random.default_rng([seed, number])
        microscope = read_microscope(entry.folder / "microscope.json")
        stack = entry.open()
        for labels in stack.labels:
            image = stack.image(labels)
            visible = labels.visible_fraction >= VISIBLE_ENOUGH
            for k, window in enumerate(_windows(image, labels, rng)):
                made.windows[row, k] = cut(image, window)
                made.places[row, k] = place_of(window, microscope)
                if k < WINDOWS and visible:
                    made.targets[row, k] = targets_of(labels, window)
                    made.present[row, k] = 1.0
            row += 1
        progress()
    return made


def _windows(image: np.ndarray, labels: FrameLabels, rng: np.random.Generator) -> list[Window]:
    radius = float(np.sqrt(labels.half_max_semi_major_px * labels.half_max_semi_minor_px))
    truth = Guess(labels.half_max_x_px, labels.half_max_y_px, radius)
    blob = blob_in(image)
    # A blob far from the spot is a frame that the network should refuse, not a window to learn on.
    near = blob is not None and np.hypot(blob.x - truth.x, blob.y - truth.y) < radius
    first = blob if blob is not None and near else truth
    around = [first] * _FIRST + [truth] * (WINDOWS - _FIRST)
    moved = [_moved(guess, by, rng) for guess, by in zip(around, _MOVED, strict=True)]
    return [Window.around(guess) for guess in (*moved, _elsewhere(image, truth, rng))]


def _moved(guess: Guess, by: float, rng: np.random.Generator) -> Guess:
    dx, dy = rng.normal(0, by * guess.radius, 2)
    return Guess(guess.x + dx, guess.y + dy, guess.radius * float(np.exp(rng.normal(0, by))))


def _elsewhere(image: np.ndarray, truth: Guess, rng: np.random.Generator) -> Guess:
    """A place at least as far from the spot's centre as half a window's side."""
    height, width = image.shape[:2]
    far = Guess(0.0, 0.0, _ELSEWHERE[0])
    for _ in range(_TRIES):
        radius = float(np.exp(rng.uniform(*np.log(_ELSEWHERE))))
        guess = Guess(rng.uniform(0, width), rng.uniform(0, height), radius)
        half = Window.around(guess).half
        if max(abs(guess.x - truth.x), abs(guess.y - truth.y)) > half + truth.radius / 2:
            return guess
    return far
