"""Compares errors, false spots and times of the estimator with their limits.

For each kind of frame, a table gives the error of the semi-minor axis of the sub-pixel mode, of the
literal mode and of other software on the same crops, with the Cramér-Rao bound. Other tables give
the false spots on frames without a spot, how soon a lost spot is found again, and the time per
frame.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np
from rich.table import Column, Table

from benchmarks.bench import show, table
from benchmarks.bench.estimator.frame_kinds import FrameKind, cramer_rao_bound, frame_kinds
from benchmarks.bench.estimator.methods import METHODS, MethodInput, available
from benchmarks.bench.estimator.renders import LIMITS, RENDERS, rendered
from benchmarks.bench.estimator.speed import Times, frame_times
from benchmarks.bench.estimator.spotless import false_spots, frames_until_found
from benchmarks.rivals import PACKAGE, why_unavailable
from estimator.image import GREY_WEIGHTS
from scenes.drawn import SHAPE, Drawing, Truth, frame_of

_WRONG_PX = 0.5  # larger errors need a flag
_FRAMES, _FRAMES_FULL = 20, 200
_SPOTLESS, _SPOTLESS_FULL = 1000, 10_000
_LOSSES, _LOSSES_FULL = 20, 200
_TIMED = 400
_BATCH = 250  # spotless frames per task
_LATEST = 2  # frames within which a lost spot must be found
_MEDIAN_MS, _TAIL_MS, _TIMES_FASTER = 0.5, 1.5, 2.0

_WIDTH = 250  # characters of the widest table
_SHORT = {"silent_wrong": "wrong", "rmse": "RMSE"}

Errors = dict[str, np.ndarray]
"""By method, (frames, 2): error of the semi-minor axis, px (NaN if missed), and 1 if flagged."""


class Figures(NamedTuple):
    """Figures of a method on one kind of frame; px and numbers of frames.

    Attributes:
        bias: mean error of the semi-minor axis.
        std: standard deviation of the error.
        rmse: root of its mean square.
        missed: frames without a spot.
        silent: spots without a flag.
        silent_wrong: spots without a flag whose error exceeds half a pixel.
    """

    bias: float
    std: float
    rmse: float
    missed: int
    silent: int
    silent_wrong: int

    @classmethod
    def of(cls, errors: np.ndarray) -> Figures:
        """Figures from (frames, 2), see `Errors`."""
        seen = np.isfinite(errors[:, 0])
        error, silent = errors[seen, 0], errors[seen, 1] == 0
        wrong = np.abs(error) > _WRONG_PX
        bias, std, rmse = math.nan, math.nan, math.nan
        if error.size:
            bias, std, rmse = error.mean(), error.std(), math.sqrt((error**2).mean())
        numbers = errors.shape[0] - error.size, silent.sum(), (silent & wrong).sum()
        return cls(float(bias), float(std), rmse, *(int(n) for n in numbers))

    def meets(self, limits: dict[str, float]) -> bool:
        """Whether no figure exceeds its limit; NaN exceeds it."""
        return all(abs(getattr(self, name)) <= most for name, most in limits.items())


def errors_of(name: str, number: int) -> Errors | str:
    """Errors of every method on one kind of frame, or the reason why there are none."""
    from scenes import RendererUnavailable

    rng = np.random.default_rng(2020)
    methods = available()
    found: dict[str, list[tuple[float, float]]] = {method: [] for method in methods}
    try:
        for view, truth in _views(name, number, rng):
            for method, measured_by in methods.items():
                semi_minor, flagged = measured_by(view)
                found[method].append((semi_minor - truth.semi_minor, flagged))
    except RendererUnavailable as error:
        return str(error)
    return {method: np.array(rows, float) for method, rows in found.items()}


def _views(name: str, number: int, rng: np.random.Generator) -> Iterator[tuple[MethodInput, Truth]]:
    if name in RENDERS:
        yield from rendered(name, rng)
        return
    kind = frame_kinds()[name]
    for _ in range(number):
        scene = kind.make(rng)
        image, reference = frame_of(scene, rng), kind.reference_of(scene, rng)
        dx, dy = rng.uniform(-10, 10, 2)
        at = (
            min(max(scene.truth.x + dx, 0), SHAPE[1] - 1),
            min(max(scene.truth.y + dy, 0), SHAPE[0] - 1),
        )
        yield MethodInput(image, at, _half_level(scene), reference), scene.truth


def _half_level(scene: Drawing) -> float:
    wall = 1.0 if scene.wall is None else float(scene.wall.mean(axis=(0, 1)) @ GREY_WEIGHTS)
    return wall * (scene.ambient + scene.amplitude / 2)


def _row(name: str, kind: FrameKind | None, errors: Errors | str) -> list[str]:
    limits = LIMITS if kind is None else kind.limits
    wanted = ", ".join(
        f"{_SHORT.get(figure, figure)} ≤ {most:.2g}" for figure, most in limits.items()
    )
    if isinstance(errors, str):
        return [name, wanted, f"not available here: {errors}"]
    ours = Figures.of(errors["sub-pixel"])
    bound = ""
    if kind is not None and kind.blur_px is not None:
        scene = kind.make(np.random.default_rng(0))
        bound = f"{cramer_rao_bound(scene.truth.semi_minor, kind.blur_px, scene):.4f}"
    cells = [f"{ours.bias:+.3f}", f"{ours.std:.4f}", bound, f"{ours.rmse:.3f}"]
    cells += [str(ours.missed), str(ours.silent), str(ours.silent_wrong), _said(ours.meets(limits))]
    for method in list(METHODS)[1:]:
        theirs = Figures.of(errors[method]) if method in errors else None
        cells.append("" if theirs is None else f"{theirs.rmse:.3f} ({theirs.missed})")
    return [name, wanted, *cells]


def _said(met: bool) -> str:
    return "yes" if met else "NO"


def _accuracy(pool: ProcessPoolExecutor, number: int) -> Table:
    columns = ("bias", "std", "bound", "RMSE", "missed", "silent", "wrong", "met")
    made = Table(
        Column("frames", no_wrap=True),
        Column("limits", no_wrap=True),
        *columns,
        *list(METHODS)[1:],
        title=f"error of the semi-minor axis, px, {number} frames of each kind (fewer renders).\n"
        "Left: sub-pixel mode; silent: spots without a flag; wrong: silent with errors > 0.5 px."
        "\nRight: the other methods on the same crops, RMSE (missed).",
    )
    known: dict[str, FrameKind | None] = {**frame_kinds(), **dict.fromkeys(RENDERS)}
    results = pool.map(errors_of, known, [number] * len(known))
    for (name, kind), errors in zip(known.items(), results, strict=True):
        made.add_row(*_row(name, kind, errors))
    return made


def _tracking(pool: ProcessPoolExecutor, spotless: int, losses: int) -> Table:
    made = Table("tracking", "limit", "measured", "met")
    batches = [min(_BATCH, spotless - first) for first in range(0, spotless, _BATCH)]
    found = sum(pool.map(false_spots, batches, range(1, 1 + len(batches))))
    made.add_row(
        f"false spots in {spotless} frames without a spot", "0", f"{found}", _said(not found)
    )
    counts = np.array(pool.submit(frames_until_found, losses, 1).result())
    late = f"{counts.max()} (mean {counts.mean():.2f})"
    name = f"frames until found again, worst of {losses} losses"
    made.add_row(name, f"≤ {_LATEST}", late, _said(counts.max() <= _LATEST))
    return made


def _speed(measured: list[Times]) -> Table:
    made = table(
        "spot tracked, lost by a jump every 50 frames and found again",
        "ms per frame, one thread",
        *("median", f"≤ {_MEDIAN_MS}", "99 %", f"≤ {_TAIL_MS}"),
        *("literal: median", "99 %", "literal / ours", f"≥ {_TIMES_FASTER}"),
    )
    for times in measured:
        median, tail = (1e3 * float(np.percentile(times.subpixel, q)) for q in (50, 99))
        slow, slow_tail = (1e3 * float(np.percentile(times.literal, q)) for q in (50, 99))
        made.add_row(
            times.frames,
            *(f"{median:.2f}", _said(median <= _MEDIAN_MS)),
            *(f"{tail:.2f}", _said(tail <= _TAIL_MS)),
            *(f"{slow:.2f}", f"{slow_tail:.2f}", f"{slow / median:.2f}"),
            _said(slow >= _TIMES_FASTER * median),
        )
    return made


def run(*, full: bool) -> None:
    """Print all tables.

    Args:
        full: ten times as many frames.
    """
    # One thread per worker; workers read these variables when they start.
    os.environ |= {"OPENCV_FOR_THREADS_NUM": "1", "OMP_NUM_THREADS": "1"}
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu"}
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn) as alone:
        measured = alone.submit(frame_times, _TIMED).result()
    show(_speed(measured), width=_WIDTH)
    if reason := why_unavailable():
        show(f"{PACKAGE}: not available here: {reason}")
    with ProcessPoolExecutor(os.cpu_count(), mp_context=spawn) as pool:
        show(_accuracy(pool, _FRAMES_FULL if full else _FRAMES), width=_WIDTH)
        spotless = _SPOTLESS_FULL if full else _SPOTLESS
        show(_tracking(pool, spotless, _LOSSES_FULL if full else _LOSSES), width=_WIDTH)
