"""The error that each cause adds to the paper's line, alone and together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.studies.static.findings import (
    ALL,
    CAUSES,
    LIGHT,
    NONE,
    THRESHOLD_DN,
    TOGETHER,
    TOUCH_MM,
    CausePart,
    Scope,
)
from calibration import Lines, fit_lines


@dataclass(frozen=True, kw_only=True)
class Draws:
    """Sizes of the causes by run (rows) and trial (columns).

    Attributes:
        touch: distance since contact minus the reading, mm.
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
    semi_minor: Mapping[str, np.ndarray], readings: Mapping[str, np.ndarray], *, texture: np.ndarray
) -> list[CausePart]:
    """Split the mean square error by cause, over paired runs.

    Args:
        semi_minor: e1' by variant, runs x trials x frames, px: of NONE, of each cause, of ALL.
        readings: d_r likewise, mm.
        texture: which wall each run has; runs that share a wall count once in its standard error.
    """
    both = {name: lines(semi_minor[name], readings[name]) for name in semi_minor}
    squares = {
        Scope.OWN: {name: (own.rmse**2).mean(axis=1) for name, (own, _) in both.items()},
        Scope.POOLED: {name: pooled.rmse**2 for name, (_, pooled) in both.items()},
    }
    rows: list[CausePart] = []
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
        rows.append(_part(scope, TOGETHER, "beyond their sum", together, None))
        rows.append(_part(scope, ALL, "", of[ALL], of[ALL]))
    return rows


def _part(
    scope: Scope, cause: str, size: str, part: np.ndarray, whole: np.ndarray | None
) -> CausePart:
    rmse = float("nan") if whole is None else float(whole.mean()) ** 0.5
    return CausePart(scope, cause, size, float(part.mean()), _standard_error(part), rmse)


def _standard_error(values: np.ndarray) -> float:
    """Standard error of the mean; NaN for a single value."""
    if values.size < 2:
        return float("nan")
    return float(values.std(ddof=1) / np.sqrt(values.size))
