"""The results as data: errors by path, recipe and eccentricity, and their causes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from benchmarks.reporting import Column
from benchmarks.studies.eye.errors import PathErrors
from benchmarks.studies.eye.recipes import Recipe
from scenes import Scene

LIMITS_MM = (0.1, 0.5)
REFRACTIONS_D = (-10.0, -6.0, -3.0, 0.0, 4.0)
"""Of the schematic eyes that depend on it (Atchison 2006)."""

QUANTILE = 0.95
"""Share of the eyes that a recipe must serve."""


class Summary(NamedTuple):
    """Row of eye_errors.csv: largest |error| over distances and tilts, over the eyes.

    `tilt` is "square" for perpendicular beams only, "any" with tilts of 30 degrees, too.
    """

    path: Annotated[str, Column("path")]
    recipe: Annotated[str, Column("recipe")]
    tilt: Annotated[str, Column("tilt")]
    c_mm: Annotated[float, Column("c, mm", 1)]
    eyes: Annotated[int, Column("eyes")]
    median_mm: Annotated[float, Column("median, mm")]
    p95_mm: Annotated[float, Column("95 %, mm")]


class Limit(NamedTuple):
    """Row of limits.csv: c up to which a recipe keeps half or 95 % of the eyes within a limit."""

    path: Annotated[str, Column("path")]
    recipe: Annotated[str, Column("recipe")]
    tilt: Annotated[str, Column("tilt")]
    median_0_1_mm: Annotated[float, Column("half of the eyes, 0.1 mm", 1)]
    median_0_5_mm: Annotated[float, Column("half, 0.5 mm", 1)]
    within_0_1_mm: Annotated[float, Column("95 %, 0.1 mm", 1)]
    within_0_5_mm: Annotated[float, Column("95 %, 0.5 mm", 1)]


class EyeRow(NamedTuple):
    """Row of eyes.csv: what one eye shows behind one path.

    The errors are the largest at c = 3 mm over distances and tilts, with the ellipse's area.
    """

    path: Annotated[str, Column("path")]
    eye: Annotated[str, Column("eye")]
    kappa_per_mm: Annotated[float, Column("κ, 1/mm", 3, sign=True)]
    field_mm: Annotated[float, Column("field, mm", 2)]
    fitted_error_mm: Annotated[float, Column("own pinhole, mm")]
    schematic_error_mm: Annotated[float, Column("Navarro's, mm")]


class PathRow(NamedTuple):
    """Pinholes and fields of a path."""

    path: Annotated[str, Column("path")]
    paraxial: Annotated[float, Column("paraxial κ, 1/mm", 3, sign=True)]
    schematic: Annotated[float, Column("κ, Navarro", 3, sign=True)]
    mean: Annotated[float, Column("κ, mean", 3, sign=True)]
    deviation: Annotated[float, Column("σ of κ", 3)]
    field_low: Annotated[float, Column("field, 5 %", 1)]
    field: Annotated[float, Column("50 %", 1)]
    field_high: Annotated[float, Column("95 %, mm", 1)]


class Share(NamedTuple):
    """Row of causes.csv: Shapley's share of a part in the 95 % error of a recipe."""

    recipe: Annotated[str, Column("recipe")]
    c_mm: Annotated[float, Column("c, mm", 1)]
    cause: Annotated[str, Column("cause")]
    share_mm: Annotated[float, Column("share of the 95 % error, mm", sign=True)]


@dataclass(frozen=True, kw_only=True)
class EyeFindings:
    """All results of a run.

    Attributes:
        scene: the study's; only its seed is used.
        eccentricities: c, mm.
        names: of the eyes: Navarro's, the random ones, other schematic ones.
        population: number of random eyes.
        paths: errors by path.
        fields: largest c that each eye's dilated pupil shows, by path, mm.
        causes: shares of the parts of the eye in one path.
        causes_path: which.
    """

    scene: Scene
    eccentricities: np.ndarray
    names: list[str]
    population: int
    paths: dict[str, PathErrors]
    fields: dict[str, np.ndarray]
    causes: list[Share]
    causes_path: str

    @property
    def random(self) -> slice:
        """The random eyes among all."""
        return slice(1, 1 + self.population)

    def largest(self, path: str, recipe: Recipe, *, square: bool) -> np.ndarray:
        """Largest |error| of each random eye at each c, over distances (and tilts), mm."""
        errors = np.abs(self.paths[path].errors[recipe][self.random])
        errors = errors[..., :1] if square else errors
        # A spot that is not whole at any distance or tilt counts as not seen.
        return errors.max(axis=(2, 3))

    def summaries(self) -> list[Summary]:
        """Median and 95 % over the random eyes in which the spots are whole."""
        rows = []
        for path in self.paths:
            for recipe in Recipe:
                for square in (True, False):
                    largest = self.largest(path, recipe, square=square)
                    for c, values in zip(self.eccentricities, largest.T, strict=True):
                        seen = values[np.isfinite(values)]
                        # A quantile of the few eyes that show the spot would not be the eyes'.
                        enough = len(seen) > QUANTILE * self.population
                        rows.append(
                            Summary(
                                path,
                                recipe,
                                "square" if square else "any",
                                float(c),
                                len(seen),
                                float(np.median(seen)) if enough else np.nan,
                                float(np.quantile(seen, QUANTILE)) if enough else np.nan,
                            )
                        )
        return rows

    def limits(self) -> list[Limit]:
        """c up to which each recipe holds each limit, interpolated between the c of the grid."""
        rows = []
        summaries = self.summaries()
        for path, recipe, tilt in dict.fromkeys(row[:3] for row in summaries):
            own = [row for row in summaries if row[:3] == (path, recipe, tilt)]
            found = [
                crossing(self.eccentricities, np.array(curve), limit)
                for curve in ([row.median_mm for row in own], [row.p95_mm for row in own])
                for limit in LIMITS_MM
            ]
            rows.append(Limit(path, recipe, tilt, *found))
        return rows

    def path_rows(self) -> list[PathRow]:
        """Pinholes and fields of each path, over the random eyes."""
        rows = []
        for path, found in self.paths.items():
            kappas, fields = found.kappas[self.random], self.fields[path][self.random]
            quantiles = np.quantile(fields, [0.05, 0.5, 0.95])
            rows.append(
                PathRow(
                    path,
                    found.paraxial_kappa,
                    float(found.kappas[0]),
                    float(kappas.mean()),
                    float(kappas.std()),
                    *map(float, quantiles),
                )
            )
        return rows

    def eye_rows(self) -> list[EyeRow]:
        """Every eye behind every path."""
        rows = []
        place = int(np.flatnonzero(self.eccentricities == 3.0)[0])
        for path, found in self.paths.items():
            columns = [found.kappas, self.fields[path]]
            for recipe in (Recipe.AREA, Recipe.AREA_SCHEMATIC):
                columns.append(np.abs(found.errors[recipe][:, place]).max(axis=(1, 2)))
            rows += [
                EyeRow(path, name, *map(float, values))
                for name, values in zip(self.names, np.transpose(columns), strict=True)
            ]
        return rows

    def schematic_rows(self) -> list[EyeRow]:
        """The schematic eyes behind every path."""
        return [row for row in self.eye_rows() if not row.eye.startswith("random")]


def crossing(c: np.ndarray, error: np.ndarray, limit: float) -> float:
    """Last c before the error first exceeds a limit; NaN if it does at once."""
    beyond = ~(error <= limit)
    if not beyond.any():
        return float(c[-1])
    first = int(np.argmax(beyond))
    if first == 0:
        return float("nan")
    if np.isnan(error[first]):
        return float(c[first - 1])
    share = (limit - error[first - 1]) / (error[first] - error[first - 1])
    return float(c[first - 1] + share * (c[first] - c[first - 1]))
