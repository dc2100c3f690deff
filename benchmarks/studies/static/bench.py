"""Rendered withdrawals, photographed and measured under each set of causes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from benchmarks.evaluation import LITERAL, Photographer, Shot, Way
from benchmarks.studies.static.causes import Draws
from benchmarks.studies.static.findings import ALL, FROM_MM, NONE, Measured

EVEN = -1
"""Number of the even wall among the textures."""

Key = tuple[int, int, int]
"""Trial, texture, tilt (-1, 0 or 1)."""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Photographs and measures rendered withdrawals.

    Attributes:
        planes: withdrawals from the plane.
        spheres: withdrawals in the eyeball.
        draws: sizes of the causes.
        pool: workers that measure.
    """

    planes: Mapping[Key, Photographer]
    spheres: Sequence[Photographer]
    draws: Draws
    pool: Executor

    def variants(self) -> dict[str, Measured]:
        """Literal mode on planes without causes, with each alone, and with all."""
        draws = self.draws
        without = self._planes(lambda run, trial: ((trial, EVEN, 0), Shot()))
        return {
            NONE: without,
            "noise": self._planes(
                lambda run, trial: ((trial, EVEN, 0), Shot(seed=_seed(run, trial)))
            ),
            "texture": self._planes(
                lambda run, trial: ((trial, int(draws.texture[run]), 0), Shot())
            ),
            "touch": self._touched(without),
            "tilt": self._planes(
                lambda run, trial: ((trial, EVEN, int(draws.tilt[run, trial])), Shot())
            ),
            "exposure": self._planes(
                lambda run, trial: ((trial, EVEN, 0), Shot(light=float(draws.light[run, trial])))
            ),
            "threshold": self._planes(
                lambda run, trial: ((trial, EVEN, 0), Shot(threshold=int(draws.threshold[run])))
            ),
            ALL: self.together(LITERAL),
        }

    def together(self, way: Way) -> Measured:
        """Planes under all causes at once."""
        draws = self.draws
        return self._touched(
            self._planes(
                lambda run, trial: (
                    (trial, int(draws.texture[run]), int(draws.tilt[run, trial])),
                    self._shot(way, run, trial),
                ),
                way=way,
            )
        )

    def curved(self, way: Way) -> Measured:
        """Spheres under all causes that apply: they have one wall, and no plane to tilt."""
        tasks = [
            (self.spheres[trial], self._shot(way, run, trial))
            for run, trial in np.ndindex(self.draws.touch.shape)
        ]
        return self._touched(self._measured(tasks, way))

    def _shot(self, way: Way, run: int, trial: int) -> Shot:
        shot = Shot(seed=_seed(run, trial))
        if way is not LITERAL:  # metered frames, no threshold
            return shot
        return shot._replace(
            light=float(self.draws.light[run, trial]), threshold=int(self.draws.threshold[run])
        )

    def _planes(
        self, task: Callable[[int, int], tuple[Key, Shot]], *, way: Way = LITERAL
    ) -> Measured:
        tasks = [task(run, trial) for run, trial in np.ndindex(self.draws.touch.shape)]
        return self._measured([(self.planes[key], shot) for key, shot in tasks], way)

    def _measured(self, tasks: Sequence[tuple[Photographer, Shot]], way: Way) -> Measured:
        """Measure every task once, however many runs share it."""
        shots: dict[Photographer, dict[Shot, None]] = {}
        for photographer, shot in tasks:
            shots.setdefault(photographer, {})[shot] = None
        spots = self.pool.map(lambda of: of[0].measure(way, list(of[1])), shots.items())
        found = {
            (photographer, shot): semi_minor
            for (photographer, asked), measured in zip(shots.items(), spots, strict=True)
            for shot, semi_minor in zip(asked, measured, strict=True)
        }
        shape = (*self.draws.touch.shape, -1)
        semi_minor = np.reshape([found[task] for task in tasks], shape)
        readings = np.reshape([photographer.readings for photographer, _ in tasks], shape)
        return Measured(
            semi_minor=np.where(readings > FROM_MM - 1e-6, semi_minor, np.nan), readings=readings
        )

    def _touched(self, measured: Measured) -> Measured:
        """The same with readings that count from a missed touch."""
        return Measured(
            semi_minor=measured.semi_minor, readings=measured.readings - self.draws.touch[..., None]
        )


def _seed(run: int, trial: int) -> int:
    return 1 + 1000 * run + trial
