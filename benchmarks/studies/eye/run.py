"""`eyespot study eye`: distances through cornea, crystalline lens and viewing lens.

DIR/eye_errors.csv  median and 95 % error of every recipe, by path and c
    limits.csv      up to which c each recipe keeps 95 % of the eyes within 0.1 and 0.5 mm
    eyes.csv        fitted pinhole and field of every eye behind every path
    causes.csv      Shapley's share of each part of the eye
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.evaluation import coalitions, shapley_values
from benchmarks.reporting import Request, Study
from benchmarks.studies.eye.errors import fields, path_errors, together
from benchmarks.studies.eye.findings import QUANTILE, REFRACTIONS_D, EyeFindings, Share
from benchmarks.studies.eye.geometry import PATHS, Spots, grid
from benchmarks.studies.eye.population import PARTS, Drawn, drawn
from benchmarks.studies.eye.recipes import Recipe
from benchmarks.studies.eye.report import report
from optics.viewing import Eye, load_eye

_NM = 555.0
_ECCENTRICITIES_MM = np.arange(0.0, 8.1, 1.0)
_DISTANCES_MM = np.array([0.5, 2.0, 4.0, 6.0])
_TILTS_DEG = ((0.0, 0.0), (30.0, 0.0), (30.0, 90.0), (30.0, 180.0))
_QUICK_DISTANCES_MM = np.array([1.0, 3.0, 5.0])
_EYES, _QUICK_EYES = 1000, 47
_CAUSES_EYES, _QUICK_CAUSES_EYES = 95, 31
_CAUSES_PATH = "flat, phakic"
_NOISE = "noise of the calibration"
_PINHOLE = "a pinhole for the mean eye"
_SCHEMATIC = "the mean eye is not Navarro's"
_SHOWN_MM = (2.0, 3.0, 4.0)


def run(request: Request) -> EyeFindings:
    """Compute and report.

    Args:
        request: the arguments; of the scene only the seed is used.

    Raises:
        InputError: the folder has other files.
    """
    study = Study("eye", request)
    quick = request.quick
    random = drawn(_QUICK_EYES if quick else _EYES, study.seed)
    distances = _QUICK_DISTANCES_MM if quick else _DISTANCES_MM
    spots = grid(_ECCENTRICITIES_MM, distances, _TILTS_DEG)
    navarro = _stacked([load_eye("navarro", wavelength_nm=_NM)])
    # Eyes of one structure are one group, which is compiled once.
    groups, gradient = [together(navarro, random.eyes())], []
    if not quick:
        gradient = [load_eye("liou-brennan", wavelength_nm=_NM)]
        gradient += [load_eye("atchison", wavelength_nm=_NM, refraction_d=d) for d in REFRACTIONS_D]
        groups.append(_stacked(gradient))
    with study.timed("errors in all eyes"):
        paths = {path: path_errors(path, groups, spots, seed=study.seed) for path in PATHS}
    with study.timed("fields"):
        seen = {path: fields(path, groups) for path in PATHS}
    count = len(random.values)
    some = random._replace(values=random.values[: _QUICK_CAUSES_EYES if quick else _CAUSES_EYES])
    with study.timed("causes"):
        shares = _causes(_CAUSES_PATH, some, navarro, spots, seed=study.seed)
    names = ["navarro", *(f"random {k}" for k in range(count))]
    if gradient:
        names += ["liou-brennan", *(f"atchison {d:+g} D" for d in REFRACTIONS_D)]
    findings = EyeFindings(
        scene=study.scene,
        eccentricities=_ECCENTRICITIES_MM,
        names=names,
        population=count,
        paths=paths,
        fields=seen,
        causes=shares,
        causes_path=_CAUSES_PATH,
    )
    study.publish(report, findings)
    return findings


def _stacked(eyes: list[Eye]) -> Eye:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *eyes)


def _causes(
    path: str, eyes_drawn: Drawn, schematic: Eye, spots: Spots, *, seed: int
) -> list[Share]:
    """Shares of the parts of the eye, and of the noise, in the 95 % error of the area recipes.

    In a coalition of parts the eyes differ in these parts only; the other parts are the mean of the
    population. What remains with no part is the error in the mean eye.

    Args:
        path: name of the viewing path.
        eyes_drawn: the random eyes.
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
        eyes = together(schematic, eyes_drawn.eyes(parts))
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
