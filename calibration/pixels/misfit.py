r"""What the model of a fit to pixels leaves in the residuals, and how much it may bias the fit.

Noise is independent from pixel to pixel; the light that a model lacks is not. A tenth of a percent
of misfit, far below the noise of a pixel, moves a parameter by many standard errors if it has the
same sign over half of the spot. So chi squared alone cannot show it, and the square root of chi
squared per degree of freedom is much too small a correction.

Pixels are divided into cells by the brightness of the beam (from the core to the dark), by the side
of the spot and by the time. For each group of cells g the scores $S_g = \sum_{i \in g} J_i r_i$ are
what its pixels would change in the fit. With noise alone the scores are independent, with
covariance $A_g = \sum_{i \in g} J_i J_i^T$. Hence two uses:

- Test: $\sum_g S_g^T A_g^{-1} S_g - S^T A^{-1} S$ is chi squared distributed (a score test of
  whether every group has the same parameters, Chow 1960).
- Standard errors: the covariance becomes $A^{-1} (A + c\,E) A^{-1}$ with
  $E = \sum_g S_g S_g^T - A$, the excess of the scores' scatter over noise (Liang and Zeger 1986).
  It is summed over three divisions: zones and sides of the spot in halves of the time, and blocks
  of the frame, because a wall's texture has the same place in all frames.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from eyespot.calibration.least_squares import CHANCE

_ZONES = (0.02, 0.2, 0.8)
"""Brightness over the frame's peak that separates dark, tail, edge and core."""
_ZONE_NAMES = ("dark part", "tail", "edge", "core")
_SIDES = ("right", "lower", "left", "upper")
_HALVES = ("earlier", "later")
_SHAPE = (len(_ZONE_NAMES), len(_SIDES))
_HIDDEN = 4.0
"""c: the fit hides the part of a misfit that looks like its parameters. This factor makes the bias
of every departure of `photon_fits` in v0.2.1 less than twice its standard error."""
_BLOCK_PX = 16
"""Side of the blocks of a frame, that of the largest squares that are fitted as one datum."""
_NEGLIGIBLE = 1e-9  # relative; smaller eigenvalues are rounding errors


class Misfit(NamedTuple):
    """The light that a fit's model lacks.

    Attributes:
        share: RMS of the misfit over the light, weighted as in the fit; 0 if noise explains the
            residuals.
        chance: probability that noise alone gives residuals with as much structure.
        structured: whether the chance is so small that the residuals have structure.
        inflation: largest factor by which the misfit enlarges a standard error.
        where: the part of the frames with the clearest misfit, as a sentence; empty without
            structure.
    """

    share: float
    chance: float
    structured: bool
    inflation: float
    where: str


class Pixels(NamedTuple):
    """Pixels of one frame at the solution.

    Attributes:
        frame: its number.
        u, v: px.
        direct: the beam's light, full wells.
        light: all light, full wells.
        weight: 1 over the light's sigma.
        residual: model minus light, over sigma.
        slopes: derivatives of `residual` with respect to the parameters.
    """

    frame: int
    u: Float[np.ndarray, "n"]
    v: Float[np.ndarray, "n"]
    direct: Float[np.ndarray, "n"]
    light: Float[np.ndarray, "n"]
    weight: Float[np.ndarray, "n"]
    residual: Float[np.ndarray, "n"]
    slopes: Float[np.ndarray, "p n"]


def found_misfit(
    frames: Iterable[Pixels],
    covariance: Float[np.ndarray, "p p"],
    *,
    share: float,
) -> tuple[Misfit, Float[np.ndarray, "p p"]]:
    """Test residuals for structure, and enlarge the covariance by what it may cause.

    Args:
        frames: all pixels of the fit, one entry a frame, in order.
        covariance: covariance from noise and priors; infinite for undetermined parameters.
        share: part of the light, RMS, that the model misses; the weights contain it.

    Returns:
        The misfit, and the covariance with noise and misfit.
    """
    scores, information, tone, blocks = _cells(frames, len(covariance))
    total = information.sum(axis=(0, 1, 2))
    zones = scores.sum(axis=2), information.sum(axis=2)
    sides = scores.sum(axis=1), information.sum(axis=1)
    chance = min(1.0, 2 * min(_chance(*zones, total), _chance(*sides, total)))
    known = np.isfinite(np.diag(covariance))
    enlarged = covariance.copy()
    inside = np.ix_(known, known)
    own = covariance[inside]
    structured = chance < CHANCE
    if structured:
        excess = _scatter(zones[0].sum(axis=0)) + _scatter(sides[0]) + _scatter(blocks) - 3 * total
        root = _of_positive(own, np.sqrt)
        extra = root @ excess[inside] @ root
        own = own + _HIDDEN * root @ _of_positive(extra, np.asarray) @ root
    enlarged[inside] = own
    errors, first = np.diag(enlarged)[known], np.diag(covariance)[known]
    inflation = math.sqrt(float(np.max(errors / first, initial=1.0)))
    where = _sentence(tone) if structured else ""
    return Misfit(share, chance, structured, inflation, where), enlarged


def _cells(frames: Iterable[Pixels], p: int) -> tuple[np.ndarray, ...]:
    """Scores, information, and (misfit x light, light²) over variance, of cells; blocks' scores."""
    by_frame = []
    by_block: defaultdict[tuple[int, int], np.ndarray] = defaultdict(lambda: np.zeros(p))
    for own in frames:
        places = np.stack([own.u, own.v], axis=-1) // _BLOCK_PX
        found, block = np.unique(places, axis=0, return_inverse=True)
        pulls = np.zeros((len(found), p))
        np.add.at(pulls, block.ravel(), (own.slopes * own.residual).T)
        for place, pull in zip(found, pulls, strict=True):
            by_block[tuple(place)] += pull
        scores, information = np.zeros((*_SHAPE, p)), np.zeros((*_SHAPE, p, p))
        tone = np.zeros((*_SHAPE, 2))
        glow = np.maximum(own.direct, 0.0)
        if not glow.any():
            # All pixels that the beam reaches are black, saturated or hidden: there are no sides.
            scores[0, 0] = own.slopes @ own.residual
            information[0, 0] = own.slopes @ own.slopes.T
            by_frame.append((scores, information, tone))
            continue
        centre_u, centre_v = (np.average(x, weights=glow) for x in (own.u, own.v))
        # Sides are quarters around the axes of the image; v points down.
        turn = np.arctan2(own.v - centre_v, own.u - centre_u) / (2 * np.pi)
        side = np.floor(4 * turn + 0.5).astype(int) % len(_SIDES)
        zone = np.digitize(own.direct / own.direct.max(), _ZONES)
        for at in set(zip(zone.tolist(), side.tolist(), strict=True)):
            inside = (zone == at[0]) & (side == at[1])
            slopes, residual = own.slopes[:, inside], own.residual[inside]
            scores[at] = slopes @ residual
            information[at] = slopes @ slopes.T
            bright = own.light[inside] * own.weight[inside]
            tone[at] = -residual @ bright, bright @ bright
        by_frame.append((scores, information, tone))
    halves = by_frame[: len(by_frame) // 2], by_frame[len(by_frame) // 2 :]
    scores, information, tone = (
        np.stack([sum((f[k] for f in half), np.zeros(by_frame[0][k].shape)) for half in halves])
        for k in range(3)
    )
    return scores, information, tone, np.array(list(by_block.values()))


def _chance(
    scores: Float[np.ndarray, "a b p"],
    information: Float[np.ndarray, "a b p p"],
    total: Float[np.ndarray, "p p"],
) -> float:
    """Probability of scores that differ as much between groups, by noise alone."""
    squares, degrees = _squares(scores.sum(axis=(0, 1)), total)
    squares, degrees = -squares, -degrees
    for group in np.ndindex(scores.shape[:2]):
        own, free = _squares(scores[group], information[group])
        squares, degrees = squares + own, degrees + free
    return float(stats.chi2.sf(squares, degrees)) if degrees > 0 else 1.0


def _squares(
    score: Float[np.ndarray, "p"], information: Float[np.ndarray, "p p"]
) -> tuple[float, int]:
    """S^T A^-1 S over the directions that A determines, and their number."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    strength, directions = np.linalg.eigh(information / np.outer(size, size))
    known = strength > _NEGLIGIBLE * strength[-1]
    part = (directions.T @ (score / size))[known]
    return float(np.sum(part**2 / strength[known])), int(np.count_nonzero(known))


def _scatter(scores: Float[np.ndarray, "*groups p"]) -> Float[np.ndarray, "p p"]:
    rows = scores.reshape(-1, scores.shape[-1])
    return np.asarray(rows.T @ rows)


def _of_positive(
    matrix: Float[np.ndarray, "p p"], function: Callable[[np.ndarray], np.ndarray]
) -> Float[np.ndarray, "p p"]:
    """A function of the part of a symmetric matrix with positive eigenvalues."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * function(np.maximum(values, 0.0))) @ vectors.T)


def _sentence(tone: Float[np.ndarray, "2 4 4 2"]) -> str:
    """The cell, zone, side or half whose mean misfit is clearest."""
    best: tuple[float, str] = (0.0, "")
    for half in (slice(None), 0, 1):
        for zone in (slice(None), *range(len(_ZONE_NAMES))):
            for side in (slice(None), *range(len(_SIDES))):
                product, square = tone[half, zone, side].reshape(-1, 2).sum(axis=0)
                if not square > 0 or abs(product) / np.sqrt(square) <= best[0]:
                    continue
                where = "spot" if isinstance(zone, slice) else _ZONE_NAMES[zone]
                aside = "" if isinstance(side, slice) else f"{_SIDES[side]} side of the "
                time = "all" if isinstance(half, slice) else f"the {_HALVES[half]} half of the"
                more = "brighter" if product > 0 else "darker"
                percent = 100 * abs(product) / square
                best = (
                    abs(product) / np.sqrt(square),
                    f"the {aside}{where} is {percent:.2g} % {more} than the model in {time} frames",
                )
    return best[1]
