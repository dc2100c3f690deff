"""Whether the mode pixels takes the wrong distance where the spot's radius belongs to two.

Behind a lens the half-maximum radius falls and then grows with the distance. Withdrawals and hands
over 0.3 to 6 mm on an even wall (`pixel_stacks`); each fifth frame is read as a first one, because
later ones follow a distance that is known.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.table import Table
from scipy.stats import chi2

from benchmarks.bench.output import show, table
from benchmarks.bench.pixel_frames import FrameErrors, frame_errors, half_maximum_px
from benchmarks.bench.pixel_stacks import (
    MM_PER_FRAME,
    Circumstances,
    drawn_calibration,
    drawn_stack,
    prepare,
)
from benchmarks.evaluation import largest, rms
from estimator.files import Stack
from scenes import Scene
from scenes.world import World

_BEAMS = ("dome, vitreous", "candidate, air")
_FRAMES, _ALONE_EVERY = 20, 5
_STACKS, _STACKS_FULL = 10, 100  # of all beams
_NEAREST_MM, _FARTHEST_MM = 0.3, 6.0
_BETWEEN_MM = {
    "withdrawal": (_NEAREST_MM, _FARTHEST_MM - MM_PER_FRAME * _FRAMES),
    "hand": (_NEAREST_MM, _FARTHEST_MM),
}
_WRONG_MM = 0.1
"""Of the distance. The two branches are nearer only where the radius hardly changes."""
_WRONG = 1e-4
"""Over the number of frames: probability of a chi squared that no honest pose has."""
_COMPARED_MM = np.arange(0.25, 9.0, 0.125)  # distances that the mode looks at
_WIDTH = 200  # characters of the table


class _Frame(NamedTuple):
    """A frame's errors, and whether its true radius belongs to another distance, too."""

    errors: FrameErrors
    twofold: bool


def run(*, full: bool) -> None:
    """Render, read, and print the errors (`full`: 2,000 frames instead of 200)."""
    prepare()
    rng = np.random.default_rng(20261125)
    frames: dict[str, list[_Frame]] = {beam: [] for beam in _BEAMS}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(_STACKS_FULL if full else _STACKS):
            beam = _BEAMS[number % 2]
            motion = "hand" if number // 2 % 2 else "withdrawal"
            what = Circumstances(beam, "uniform", motion, _FRAMES, between_mm=_BETWEEN_MM[motion])
            stack = drawn_stack(what, rng, Path(folder) / f"{number}")
            calibration = drawn_calibration(what, rng)
            errors = list(frame_errors(stack, calibration, rng, alone_every=_ALONE_EVERY))
            frames[beam] += map(_Frame, errors, _twofold(stack))
    show(_table(frames), _unsure(frames), width=_WIDTH)


def _twofold(stack: Stack) -> list[bool]:
    """Of each frame, whether another distance has its radius, too, where the first spot is."""
    first, world = stack.labels[0], World(Scene.model_validate(stack.description["scene"]))
    axis = np.array(first.axis)
    tips = np.array(first.spot_mm) - _COMPARED_MM[:, None] * axis
    radii = half_maximum_px(world, tips, axis)
    distances = np.array([labels.d_mm for labels in stack.labels])
    return share_a_radius(distances, _COMPARED_MM, radii).tolist()


def share_a_radius(distances: np.ndarray, grid: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Whether a curve of radii over a growing grid takes the value at a distance twice."""
    larger = radii > np.interp(distances, grid, radii)[:, None]
    crossings = np.count_nonzero(np.diff(larger, axis=1), axis=1)
    return np.asarray(crossings > 1)


def _table(frames: dict[str, list[_Frame]]) -> Table:
    number = sum(map(len, frames.values()))
    limit = chi2.isf(_WRONG / number, 5)
    made = table(
        f"even wall, {_NEAREST_MM:g} to {_FARTHEST_MM:g} mm, {number:,} frames",
        *("beam", "", "frames", "twofold", "with a pose", "doubtful", "no pose", "wrong"),
        *("wrong branch", "d, µm", "stated", "tip, µm", "axis, °", "chi²_5 / 5"),
        *("e₁′, px", "sub-pixel", "literal"),
        caption="twofold: the radius belongs to two distances; wrong: chi squared above "
        f"{limit:.0f} (p = {_WRONG:g} over the number of frames); wrong branch: and the distance "
        f"by more than {_WRONG_MM:g} mm; RMS errors, in brackets the largest ones",
    )
    for beam, own in frames.items():
        alone = [one for one in own if one.errors.frame % _ALONE_EVERY == 0]
        later = [one for one in own if one.errors.frame % _ALONE_EVERY]
        for name, some in (("read as first", alone), ("later", later)):
            posed = [one.errors for one in some if one.errors.posed]
            wrong = [one for one in posed if one.chi_squared > limit]
            other = [one for one in wrong if abs(one.distance_mm) > _WRONG_MM]
            unknown = sum(np.isnan(one.errors.distance_mm) for one in some)
            squares = [one.chi_squared / 5 for one in posed]
            made.add_row(
                beam,
                name,
                f"{len(some)}",
                f"{sum(one.twofold for one in some)}",
                f"{len(posed)}",
                f"{len(some) - len(posed) - unknown}",
                f"{unknown}",
                f"{len(wrong)}",
                f"{len(other)}",
                _rms_and_largest([1e3 * one.distance_mm for one in posed], 1),
                f"{1e3 * rms(one.sigma_mm for one in posed):.1f}",
                _rms_and_largest([1e3 * one.tip_mm for one in posed], 1),
                _rms_and_largest([one.axis_deg for one in posed], 3),
                f"{np.mean(squares):.2f} ({largest(squares):.1f})",
                _rms_and_largest([one.half_maximum_px for one in posed], 2),
                _rms_and_largest([one.subpixel_px for one in posed], 2),
                _rms_and_largest([one.literal_px for one in posed], 2),
            )
    return made


def _rms_and_largest(errors: list[float], digits: int) -> str:
    return f"{rms(errors):.{digits}f} ({largest(errors):.{digits}f})"


def _unsure(frames: dict[str, list[_Frame]]) -> str:
    """The frames without a sure pose."""
    unsure = [
        f"{beam}, {one.errors.d_mm:.2f} mm: {one.errors.doubt}"
        for beam, own in frames.items()
        for one in own
        if not one.errors.posed
    ]
    return "Frames without a sure pose: " + ("; ".join(unsure) or "none") + "."
