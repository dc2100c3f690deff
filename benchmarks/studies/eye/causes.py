"""Which part of the eye causes the error that a recipe leaves: Shapley's shares."""

from __future__ import annotations

import numpy as np

from benchmarks.evaluation import coalitions, shapley_values
from benchmarks.studies.eye.errors import path_errors, together
from benchmarks.studies.eye.findings import QUANTILE, Share
from benchmarks.studies.eye.geometry import Spots
from benchmarks.studies.eye.population import PARTS, Drawn
from benchmarks.studies.eye.recipes import Recipe
from optics.viewing import Eye

_NOISE = "noise of the calibration"
_PINHOLE = "a pinhole for the mean eye"
_SCHEMATIC = "the mean eye is not Navarro's"
_SHOWN_MM = (2.0, 3.0, 4.0)


def causes(path: str, drawn: Drawn, schematic: Eye, spots: Spots, *, seed: int) -> list[Share]:
    """Shares of the parts of the eye, and of the noise, in the 95 % error of the area recipes.

    In a coalition of parts the eyes differ in these parts only; the other parts are the mean of the
    population. What remains with no part is the error in the mean eye.

    Args:
        path: name of the viewing path.
        drawn: the random eyes.
        schematic: the eye that stands for all where no calibration is made, with a leading axis.
        spots: c x d x tilts; as for the errors in all eyes, so that nothing is compiled again.
        seed: of the noise.
    """
    players = (*PARTS, _NOISE)
    recipes = (Recipe.AREA_SCHEMATIC, Recipe.AREA)
    shown = np.isin(np.asarray(spots.eccentricity)[:, 0, 0], _SHOWN_MM)
    worth = np.zeros((len(recipes), len(_SHOWN_MM), 2 ** len(players)))
    for row, members in enumerate(coalitions(len(players))):
        parts = [part for part, inside in zip(PARTS, members, strict=False) if inside]
        eyes = together(schematic, drawn.eyes(parts))
        noise = seed if members[-1] else None
        found = path_errors(path, [eyes], spots, seed=noise, recipes=recipes)
        for k, recipe in enumerate(recipes):
            largest = np.abs(found.errors[recipe][1:]).max(axis=(2, 3))
            worth[k, :, row] = np.quantile(largest[:, shown], QUANTILE, axis=0)
    shares = shapley_values(worth)
    return [
        Share(recipe, float(c), cause, float(value))
        for k, recipe in enumerate(recipes)
        for j, c in enumerate(_SHOWN_MM)
        for cause, value in (
            (_SCHEMATIC if recipe is Recipe.AREA_SCHEMATIC else _PINHOLE, worth[k, j, 0]),
            *zip(players, shares[k, j], strict=True),
        )
    ]
