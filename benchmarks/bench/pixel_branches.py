"""Whether the mode pixels takes the wrong distance where the spot's radius belongs to two.

Behind a lens the half-maximum radius falls and then grows with the distance. Withdrawals and hands
over 0.3 to 6 mm on an even wall (`pixel_frames`); each fifth frame is read as a first one, because
later ones follow a distance that is known.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from rich.table import Table
from scipy.stats import chi2

from benchmarks.bench.output import rows_table, show
from benchmarks.bench.pixel_frames import (
    MM_PER_FRAME,
    Circumstances,
    Row,
    as_table,
    drawn_calibration,
    drawn_stack,
    frame_errors,
    half_maximum_px,
    prepare,
    sizes,
)
from benchmarks.paper import largest, rms
from benchmarks.reporting import grouped, rows_of
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


def run(*, full: bool) -> None:
    """Render, read, and print the errors (`full`: 2,000 frames instead of 200)."""
    prepare()
    rng = np.random.default_rng(20261125)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(_STACKS_FULL if full else _STACKS):
            beam = _BEAMS[number % 2]
            motion = "hand" if number // 2 % 2 else "withdrawal"
            what = Circumstances(beam, "uniform", motion, _FRAMES, between_mm=_BETWEEN_MM[motion])
            stack = drawn_stack(what, rng, Path(folder) / f"{number}")
            calibration = drawn_calibration(what, rng)
            errors = frame_errors(stack, calibration, rng, alone_every=_ALONE_EVERY)
            for twofold, row in zip(_twofold(stack), errors, strict=True):
                rows.append(row | {"beam": beam, "twofold": twofold})
    frames = as_table(rows).assign(alone=lambda table: table.frame % _ALONE_EVERY == 0)
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


def _table(frames: pd.DataFrame) -> Table:
    limit = chi2.isf(_WRONG / len(frames), 5)
    rows = []
    for beam, own in grouped(frames, "beam"):
        for name, some in (("read as first", own[own.alone]), ("later", own[~own.alone])):
            posed = some[some.posed]
            wrong = posed[posed.chi_squared > limit]
            unknown = some.distance_mm.isna().sum()
            squares = posed.chi_squared / 5
            rows.append(
                {
                    "beam": beam,
                    "": name,
                    "frames": len(some),
                    "twofold": some.twofold.sum(),
                    "with a pose": len(posed),
                    "doubtful": len(some) - len(posed) - unknown,
                    "no pose": unknown,
                    "wrong": len(wrong),
                    "wrong branch": (wrong.distance_mm.abs() > _WRONG_MM).sum(),
                    "d, µm": _rms_and_largest(1e3 * posed.distance_mm, 1),
                    "stated": sizes(some)["stated"],
                    "tip, µm": _rms_and_largest(1e3 * posed.tip_mm, 1),
                    "axis, °": _rms_and_largest(posed.axis_deg, 3),
                    "chi²_5 / 5": f"{squares.mean():.2f} ({squares.max():.1f})",
                    "e₁′, px": _rms_and_largest(posed.half_maximum_px, 2),
                    "sub-pixel": _rms_and_largest(posed.subpixel_px, 2),
                    "literal": _rms_and_largest(posed.literal_px, 2),
                }
            )
    return rows_table(
        f"even wall, {_NEAREST_MM:g} to {_FARTHEST_MM:g} mm, {len(frames):,} frames",
        rows,
        caption="twofold: the radius belongs to two distances; wrong: chi squared above "
        f"{limit:.0f} (p = {_WRONG:g} over the number of frames); wrong branch: and the distance "
        f"by more than {_WRONG_MM:g} mm; RMS errors, in brackets the largest ones",
    )


def _rms_and_largest(errors: pd.Series, digits: int) -> str:
    return f"{rms(errors):.{digits}f} ({largest(errors):.{digits}f})"


def _unsure(frames: pd.DataFrame) -> str:
    """The frames without a sure pose."""
    unsure = [f"{r.beam}, {r.d_mm:.2f} mm: {r.doubt}" for r in rows_of(frames[~frames.posed])]
    return "Frames without a sure pose: " + ("; ".join(unsure) or "none") + "."
