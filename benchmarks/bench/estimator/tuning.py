"""Effect of each constant of `estimator.detector.tuning` if it changes by 20 %.

The table gives the largest change of a semi-axis on drawn frames, and the number of frames whose
outcome changes. A constant without effect here may matter on other frames.
"""

from __future__ import annotations

import inspect
import math
from typing import NamedTuple

import numpy as np

from benchmarks.bench.estimator.frame_kinds import frame_kinds
from benchmarks.bench.estimator.spotless import spotless_frame
from benchmarks.bench.output import show, table
from estimator import NoSpot, SubpixelSettings, TrackState, measure
from estimator.detector import tuning
from scenes.drawn import frame_of

CHANGE = 0.2
SPOTLESS_FRAMES = 20


class Effect(NamedTuple):
    """Effect of a changed constant.

    Attributes:
        largest_px: largest change of a semi-axis.
        outcomes: number of frames in which a spot appears or vanishes, or the reason changes.
    """

    largest_px: float
    outcomes: int


AT_IMPORT = {
    "Capture.NEARNESS",
    "HalfLevel.NEAR_EDGE",
    "Motion.FLAT",
    "Sharp.SPOILED_RAYS",
    "Trimming.POSITIONS",
    "Trimming.SAMPLES",
    *(
        f"{stage.__name__}.{name}"
        for stage in (tuning.WideView, tuning.SpotProfile)
        for name in vars(stage)
    ),
}
"""Constants from which arrays are computed at import; a later change would be half a change."""


def constants() -> list[tuple[type, str]]:
    """All constants of the detector, each as class and name."""
    return [
        (stage, name)
        for _, stage in inspect.getmembers(tuning, inspect.isclass)
        if stage.__module__ == tuning.__name__
        for name, value in vars(stage).items()
        if not name.startswith("_") and isinstance(value, int | float)
        if f"{stage.__name__}.{name}" not in AT_IMPORT
    ]


def drawn() -> list[np.ndarray]:
    """One frame of each kind, and some frames without a spot."""
    frames = []
    for make in frame_kinds().values():
        rng = np.random.default_rng(2020)
        frames.append(frame_of(make(rng), rng))
    rng = np.random.default_rng(2020)
    return [*frames, *(spotless_frame(rng) for _ in range(SPOTLESS_FRAMES))]


def outcomes_of(frames: list[np.ndarray]) -> list[tuple[str, float, float]]:
    """For each frame "spot" or the reason of failure, and both semi-axes."""
    found = []
    for frame in frames:
        result, _ = measure(frame, TrackState(), SubpixelSettings())
        if isinstance(result, NoSpot):
            found.append((result.reason.value, math.nan, math.nan))
        else:
            found.append(("spot", result.semi_major_px, result.semi_minor_px))
    return found


def effect_of(
    stage: type, name: str, factor: float, frames: list[np.ndarray], usual: list
) -> Effect:
    """Measure the frames with one constant changed."""
    value = getattr(stage, name)
    changed = value * factor
    if isinstance(value, int):  # at least by one
        changed = math.ceil(changed) if factor > 1 else math.floor(changed)
    setattr(stage, name, changed)
    try:
        now = outcomes_of(frames)
    finally:
        setattr(stage, name, value)
    moved = [
        max(abs(a[1] - b[1]), abs(a[2] - b[2]))
        for a, b in zip(now, usual, strict=True)
        if a[0] == b[0] == "spot"
    ]
    others = sum(a[0] != b[0] for a, b in zip(now, usual, strict=True))
    return Effect(max(moved, default=0.0), others)


def run(*, full: bool) -> None:
    """Print the table (`full` changes nothing)."""
    frames = drawn()
    usual = outcomes_of(frames)
    effects = ("-20 %: px", "outcomes", "+20 %: px", "outcomes")
    made = table(f"{len(frames)} drawn frames", "constant", "value", *effects)
    for stage, name in constants():
        cells = []
        for factor in (1 - CHANGE, 1 + CHANGE):
            try:
                effect = effect_of(stage, name, factor, frames, usual)
            except (ValueError, IndexError, np.linalg.LinAlgError):
                cells += ["fails", ""]
            else:
                cells += [f"{effect.largest_px:.3f}", f"{effect.outcomes}"]
        made.add_row(f"{stage.__name__}.{name}", f"{getattr(stage, name):g}", *cells)
    show(made, width=100)
