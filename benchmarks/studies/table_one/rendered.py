"""Lenses of the scan on rendered stacks: three withdrawals from a plane, tracked in both modes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomli_w

import scenes
from benchmarks.evaluation import (
    LITERAL,
    SUBPIXEL,
    TABLE_I,
    Photographer,
    PlaneRow,
    Shot,
    fit_lines,
    paper_trials,
)
from benchmarks.reporting import Study
from benchmarks.studies.table_one.scan import NEAR_CONTACT_MM, Choice, Family, misses
from benchmarks.studies.validate import ALL_PLANES, Criterion, reproduction
from scenes import Scene

LIGHTS = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2)
"""Factors on the fixed exposure: the light that a place's picture throws back is not its mean."""
_TRIALS = tuple(name for name in TABLE_I if name != ALL_PLANES)


class Line(NamedTuple):
    """Row of table_one_rendered.csv: a line through measured spots of one lens.

    `level` is the threshold over the peak at 5 mm on a wall of the mean colour.
    """

    numerical_aperture: float
    sag_mm: float
    level: float
    from_mm: float
    to_mm: float
    scale_mm_px: float
    way: str
    trial: str
    delta_k_mm_px: float
    b_mm: float
    r_squared: float
    rmse_mm: float
    contact_radius_px: float
    spots: int


class Confirmed(NamedTuple):
    """A choice of the scan on rendered stacks.

    Attributes:
        choice: of the scan, with the threshold and the first reading at which the rendered spots
            come nearest to Table I.
        spots: e1' (px, NaN where none counts) and d_r (mm) by (way, trial).
        lines: by (way, trial), "all planes" among them.
    """

    choice: Choice
    spots: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]
    lines: dict[tuple[str, str], Line]

    def criteria(self, way: str) -> list[Criterion]:
        """What Table I asks of one way of measuring, and whether it is met."""
        return reproduction(
            {
                trial: PlaneRow(line.delta_k_mm_px, line.b_mm, line.r_squared, line.rmse_mm)
                for (measured, trial), line in self.lines.items()
                if measured == way
            }
        )

    @property
    def reproduces(self) -> bool:
        """Whether literal mode meets all that Table I asks, scatter as large as the paper's too."""
        return all(c.met for c in self.criteria(LITERAL.name))

    @property
    def straight(self) -> bool:
        """Whether it does but for a scatter that may be smaller than the paper's."""
        return all(
            all(value <= c.high for value in c.values) if c.low == 0.05 else c.met
            for c in self.criteria(LITERAL.name)
        )


def confirm(study: Study, choices: Sequence[Choice], *, frames: int) -> list[Confirmed]:
    """Render, track and fit.

    Args:
        study: its folder takes lens files and stacks.
        choices: of the scan.
        frames: of a trial.
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


def _scenes(study: Study, choice: Choice, *, frames: int) -> Mapping[str, Scene]:
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
    folder = folder.absolute()  # the stacks name the file, from wherever they are gone on with
    folder.mkdir(exist_ok=True)
    path = folder / f"{family.name}.toml"
    partial = path.with_suffix(".partial")
    partial.write_text(tomli_w.dumps({"schema": 1, "lens": family.lens}))
    os.replace(partial, path)
    return path


def _name(choice: Choice, trial: str) -> str:
    return f"{choice.family.name}-{trial.replace(' ', '-')}"


def _confirmed(choice: Choice, trials: Mapping[str, Photographer]) -> Confirmed:
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
        # Table I's slope is asked of all trials together, its scatter of each.
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
    lines = {}
    for way, spots in seen.items():
        for trial in _TRIALS:
            own = _from(start, {trial: spots[trial]}, readings)
            lines[way, trial] = _line(choice, way, trial, *own)
        lines[way, ALL_PLANES] = _line(choice, way, ALL_PLANES, *_from(start, spots, readings))
    return Confirmed(
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


def _line(
    choice: Choice,
    way: str,
    trial: str,
    semi_minor_px: np.ndarray,
    reading: np.ndarray,
) -> Line:
    delta_k, b, r_squared, rmse = (float(x) for x in fit_lines(semi_minor_px, reading))
    return Line(
        *choice.family,
        level=choice.level,
        from_mm=choice.from_mm,
        to_mm=choice.to_mm,
        scale_mm_px=choice.scale_mm_px,
        way=way,
        trial=trial,
        delta_k_mm_px=delta_k,
        b_mm=b,
        r_squared=r_squared,
        rmse_mm=rmse,
        contact_radius_px=-b / delta_k,
        spots=int(np.count_nonzero(np.isfinite(semi_minor_px))),
    )
