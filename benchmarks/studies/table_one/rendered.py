"""Lenses of the scan on rendered stacks: three withdrawals from a plane, tracked in both modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import tomli_w

import scenes
from benchmarks.evaluation import (
    ALL_PLANES,
    LITERAL,
    PAPERS_PLANES,
    SUBPIXEL,
    Criterion,
    Photographer,
    PlaneRow,
    Shot,
    paper_trials,
    reproduction,
)
from benchmarks.reporting import Claim, Study, rows_of
from benchmarks.studies.table_one.scan import NEAR_CONTACT_MM, Family, LensChoice, misses
from calibration import fit_lines
from estimator.files import written_whole
from scenes import Scene

LIGHTS = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2)
"""Factors on the fixed exposure: a place of the picture reflects more or less than the mean."""
_TRIALS = tuple(PAPERS_PLANES)
_LENS = ("numerical_aperture", "sag_mm", "level", "from_mm", "to_mm", "scale_mm_px")


class ConfirmedLens(NamedTuple):
    """A choice of the scan on rendered stacks.

    Attributes:
        choice: of the scan, with the threshold and the first reading at which the rendered spots
            come nearest to Table I.
        spots: e1' (px, NaN where none counts) and d_r (mm) by (way, trial).
        lines: rows of table_one_rendered.csv, "all planes" among the trials.
    """

    choice: LensChoice
    spots: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]
    lines: pd.DataFrame

    def line(self, way: str, trial: str) -> Any:
        """The row of one way of measuring and one trial."""
        return rows_of(self.lines[(self.lines.way == way) & (self.lines.trial == trial)])[0]

    @property
    def criteria(self) -> dict[Criterion, Claim]:
        """The criteria of Table I in literal mode."""
        fits = {
            row.trial: PlaneRow(row.delta_k_mm_px, row.b_mm, row.r_squared, row.rmse_mm)
            for row in rows_of(self.lines[self.lines.way == LITERAL.name])
        }
        return reproduction(fits, name="Table I by the best lens")

    @property
    def reproduces(self) -> bool:
        """Whether all criteria are met, scatter as large as the paper's included."""
        return all(claim.holds for claim in self.criteria.values())

    @property
    def straight(self) -> bool:
        """Whether they are met if the scatter may be smaller than the paper's."""
        rmse = self.criteria[Criterion.RMSE]
        others = (c for criterion, c in self.criteria.items() if criterion != Criterion.RMSE)
        return np.max(rmse.value) <= rmse.high and all(claim.holds for claim in others)


def confirm(study: Study, choices: Sequence[LensChoice], *, frames: int) -> list[ConfirmedLens]:
    """Render, track and fit.

    Args:
        study: lens files and stacks are written into its folder.
    """
    wanted = {
        (choice, trial): scene
        for choice in choices
        for trial, scene in _scenes(study, choice, frames=frames).items()
    }
    stacks = study.stacks({_name(*key): scene for key, scene in wanted.items()})
    photographers = {
        key: Photographer(scene=scene, stack=stacks[_name(*key)]) for key, scene in wanted.items()
    }
    return [
        _confirmed(choice, {trial: photographers[choice, trial] for trial in _TRIALS})
        for choice in choices
    ]


def _scenes(study: Study, choice: LensChoice, *, frames: int) -> Mapping[str, Scene]:
    """The paper's three places on the plane, with a lens, threshold, range and scale."""
    lens = _lens_file(study.folder / "lenses", choice.family)
    places = [t for t in paper_trials(source="lens", quick=True, seed=0) if t.group in _TRIALS]
    return {
        trial.group: scenes.changed(
            study.scene,
            {
                "seed": study.seed + number,
                "source.kind": "lens",
                "source.lens": str(lens),
                "spot.eccentricity_mm": trial.scene.spot.eccentricity_mm,
                "spot.azimuth_deg": trial.scene.spot.azimuth_deg,
                "motion.travel_mm": choice.to_mm,
                "motion.frames": frames,
                "exposures.kinds": ["paper", "metered"],
                "exposures.paper_level": choice.level,
                "exposures.keep_linear": True,
            },
        )
        for number, trial in enumerate(places)
    }


def _lens_file(folder: Path, family: Family) -> Path:
    folder = folder.absolute()  # the stacks name the file; a run may resume elsewhere
    folder.mkdir(exist_ok=True)
    path = folder / f"{family.name}.toml"
    with written_whole(path, replace=True) as partial:
        partial.write_text(tomli_w.dumps({"schema": 1, "lens": family.lens}))
    return path


def _name(choice: LensChoice, trial: str) -> str:
    return f"{choice.family.name}-{trial.replace(' ', '-')}"


def _confirmed(choice: LensChoice, trials: Mapping[str, Photographer]) -> ConfirmedLens:
    measured = {
        trial: p.measure(LITERAL, [Shot(seed=p.scene.seed, light=light) for light in LIGHTS])
        for trial, p in trials.items()
    }
    literal = {
        light: {trial: spots[n] for trial, spots in measured.items()}
        for n, light in enumerate(LIGHTS)
    }
    readings = {trial: p.readings for trial, p in trials.items()}

    def miss(candidate: tuple[float, float]) -> float:
        light, start = candidate
        spots = literal[light]
        pooled = fit_lines(*_from(start, spots, readings))
        own = [fit_lines(*_from(start, {t: spots[t]}, readings)) for t in _TRIALS]
        # The slope of Table I is that of all trials together, its scatter that of each.
        asked = [line._replace(delta_k=pooled.delta_k, b=pooled.b) for line in own]
        return max(float(misses(line, scale=1.0)) for line in asked)

    light, start = min(product(LIGHTS, sorted({choice.from_mm, NEAR_CONTACT_MM})), key=miss)
    choice = choice._replace(level=choice.level / light, from_mm=start)
    seen = {
        LITERAL.name: literal[light],
        SUBPIXEL.name: {
            t: p.measure(SUBPIXEL, [Shot(seed=p.scene.seed)])[0] for t, p in trials.items()
        },
    }
    rows = []
    for way, spots in seen.items():
        for trial, of in [(t, {t: spots[t]}) for t in _TRIALS] + [(ALL_PLANES, spots)]:
            semi_minor, reading = _from(start, of, readings)
            line = PlaneRow(*(float(x) for x in fit_lines(semi_minor, reading)))
            count = int(np.count_nonzero(np.isfinite(semi_minor)))
            rows.append((way, trial, *line, -line.b / line.delta_k, count))
    columns = "way trial delta_k_mm_px b_mm r_squared rmse_mm contact_radius_px spots".split()
    lines = pd.DataFrame(rows, columns=columns)
    for n, name in enumerate(_LENS):
        lines.insert(n, name, getattr(choice, name))
    return ConfirmedLens(
        choice,
        {(way, t): (spots[t], readings[t]) for way, spots in seen.items() for t in _TRIALS},
        lines,
    )


def _from(
    start: float, spots: Mapping[str, np.ndarray], readings: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Spots and readings of all trials from a reading on."""
    axis = np.concatenate(list(spots.values()))
    reading = np.concatenate([readings[trial] for trial in spots])
    inside = reading > start - 1e-6
    return axis[inside], reading[inside]
