"""What each cause adds to the error of the paper's line: alone, and all together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.evaluation import Lines, fit_lines

TOUCH_MM = 0.1
TILT_DEG = 5.0
LIGHT = 0.1
THRESHOLD_DN = 10

CAUSES = {
    "noise": "the camera's",
    "texture": "printed retina in place of an even wall",
    "touch": f"{TOUCH_MM:g} mm, normal, a trial",
    "tilt": f"plane {TILT_DEG:g}° either way, a trial",
    "exposure": f"{100 * LIGHT:g} %, normal, a trial",
    "threshold": f"{THRESHOLD_DN:g} grey levels, normal, a run",
}
"""The causes and their sizes: assumptions, which the paper says nothing of."""

NONE, ALL = "none", "all"


@dataclass(frozen=True, kw_only=True)
class Draws:
    """Sizes of the causes by run (rows) and trial (columns).

    Attributes:
        touch: mm that readings are short of the distance since contact.
        tilt: -1, or 1, times TILT_DEG.
        light: factor on the exposure.
        threshold: of the literal mode, by run.
        texture: which of the walls, by run.
    """

    touch: np.ndarray
    tilt: np.ndarray
    light: np.ndarray
    threshold: np.ndarray
    texture: np.ndarray

    @classmethod
    def of(cls, *, runs: int, trials: int, textures: int, seed: int) -> Draws:
        """Drawn at random, the textures in turn."""
        rng = np.random.default_rng(seed)
        shape = runs, trials
        return cls(
            touch=TOUCH_MM * rng.standard_normal(shape),
            tilt=rng.choice((-1, 1), shape),
            light=np.exp(LIGHT * rng.standard_normal(shape)),
            threshold=np.rint(200 + THRESHOLD_DN * rng.standard_normal(runs)).astype(int),
            texture=np.arange(runs) % textures,
        )


class Part(NamedTuple):
    """Row of static_causes.csv: what a cause alone adds to the mean square error.

    `scope`: of the line through all trials, or of each trial's own, in the mean. The parts, with
    what all causes add beyond their sum ("together"), lead from the error without any to that with
    all.
    """

    scope: str
    cause: str
    size: str
    part_mm2: float
    standard_error_mm2: float
    rmse_mm: float


def lines(semi_minor: np.ndarray, reading: np.ndarray) -> tuple[Lines, Lines]:
    """Each trial's line, and the line through all.

    Args:
        semi_minor: runs x trials x frames, px.
        reading: the same, mm.

    Returns:
        Lines of runs x trials, and of runs.
    """
    runs = semi_minor.shape[0]
    every = np.broadcast_to(reading, semi_minor.shape)
    return (
        fit_lines(semi_minor, every),
        fit_lines(semi_minor.reshape(runs, -1), every.reshape(runs, -1)),
    )


def parts(
    semi_minor: Mapping[str, np.ndarray],
    readings: Mapping[str, np.ndarray],
    *,
    texture: np.ndarray,
) -> list[Part]:
    """Split the mean square error by cause, over paired runs.

    Args:
        semi_minor: e1' by variant, runs x trials x frames, px: of NONE, of each cause, of ALL.
        readings: d_r likewise, mm.
        texture: which wall each run has; what runs share a wall for is counted once.
    """
    both = {name: lines(semi_minor[name], readings[name]) for name in semi_minor}
    squares = {
        "each trial": {name: (own.rmse**2).mean(axis=1) for name, (own, _) in both.items()},
        "all trials": {name: pooled.rmse**2 for name, (_, pooled) in both.items()},
    }
    rows: list[Part] = []
    for scope, of in squares.items():
        causes = [name for name in CAUSES if name in of]
        alone = {name: of[name] - of[NONE] for name in causes}
        together = of[ALL] - of[NONE] - sum(alone.values())
        rows.append(_part(scope, NONE, "the light and pixels", of[NONE], of[NONE]))
        for name in causes:
            rows.append(_part(scope, name, CAUSES[name], alone[name], of[name]))
            if name == "texture":
                walls = [alone[name][texture == wall].mean() for wall in np.unique(texture)]
                rows[-1] = rows[-1]._replace(standard_error_mm2=_standard_error(np.array(walls)))
        rows.append(_part(scope, "together", "beyond their sum", together, None))
        rows.append(_part(scope, ALL, "", of[ALL], of[ALL]))
    return rows


def _part(scope: str, cause: str, size: str, part: np.ndarray, whole: np.ndarray | None) -> Part:
    rmse = float("nan") if whole is None else float(whole.mean()) ** 0.5
    return Part(scope, cause, size, float(part.mean()), _standard_error(part), rmse)


def _standard_error(values: np.ndarray) -> float:
    """Of the mean; NaN of a single value."""
    if values.size < 2:
        return float("nan")
    return float(values.std(ddof=1) / np.sqrt(values.size))
