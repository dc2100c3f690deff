"""What a fit of some frames found: their states, how well they are known, and the wall's map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_solve, lapack

from estimator.pixels.beam import POSE
from estimator.pixels.frame_state import OWN, FrameState, Linear


@dataclass(frozen=True, eq=False)
class Solution:
    """The states of all frames, and how well they are known.

    Attributes:
        frames: with their new states.
        linear: their models at these states.
        own: changes of the beam's own parameters, see `BeamLight`.
        covariance: of all states: `OWN` of each frame, then the beam's own.
        cost: -2 log likelihood, up to a constant of the data.
        texture_map: log reflectance of the cells.
        factor: Cholesky factor of the precision of this map.
        converged: whether the last step was small.
    """

    frames: list[FrameState]
    linear: list[Linear]
    own: Float[np.ndarray, "q"]
    covariance: Float[np.ndarray, "s s"]
    cost: float
    texture_map: Float[np.ndarray, "n"]
    factor: tuple[np.ndarray, bool]
    converged: bool

    @property
    def chi_squared(self) -> float:
        """Of all data given texture and noise, by their number; 1 where the model is right."""
        total = sum(line.weight @ np.square(line.residual) for line in self.linear)
        total -= sum((line.weight * line.residual) @ self.texture_map for line in self.linear)
        return float(total / max(sum(np.count_nonzero(line.weight) for line in self.linear), 1))

    @property
    def together(
        self,
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"], Float[np.ndarray, "p n"]]:
        """What all frames say of the wall, as if it was one frame of many states.

        Residual, weight and derivatives, as `texture_of` takes them. How the frames differ from
        each other says nothing of the reflectance.
        """
        weight = np.sum([line.weight for line in self.linear], axis=0)
        shares = [line.weight / np.where(weight > 0, weight, 1.0) for line in self.linear]
        parts = list(zip(shares, self.linear, strict=True))
        residual = np.sum([share * line.residual for share, line in parts], axis=0)
        return residual, weight, np.concatenate([share * line.slopes for share, line in parts])

    @property
    def newest_covariance(self) -> Float[np.ndarray, "5 5"]:
        """Of the newest pose."""
        return self.newest_states(slice(POSE))

    @property
    def shown_covariance(self) -> Float[np.ndarray, "5 5"]:
        """The same as if the beam's own parameters were known: what the frames leave open."""
        if not len(self.own):
            return self.newest_covariance
        at, own = OWN * (len(self.frames) - 1), len(self.own)
        with_own = self.covariance[at : at + POSE, -own:]
        slopes = np.linalg.solve(self.covariance[-own:, -own:], with_own.T)
        return self.newest_covariance - with_own @ slopes

    def newest_states(self, states: slice) -> Float[np.ndarray, "k k"]:
        """Covariance of some of the newest frame's states."""
        at = OWN * (len(self.frames) - 1)
        newest = self.covariance[at : at + OWN, at : at + OWN]
        return newest[states, states]

    def answer(self, changes: list[Float[np.ndarray, "n"]]) -> Float[np.ndarray, "15"]:
        """How the newest frame's states move if the log light of all frames' cells changes."""
        weighted = [line.weight * more for line, more in zip(self.linear, changes, strict=True)]
        texture_map = solved(self.factor, np.sum(weighted, axis=0))
        pulls, shared = [], np.zeros(len(self.own))
        for line, pull in zip(self.linear, weighted, strict=True):
            rest = pull - line.weight * texture_map
            pulls.append(line.slopes @ rest)
            shared += line.shared @ rest
        at = OWN * (len(self.linear) - 1)
        return self.covariance[at : at + OWN] @ np.concatenate([*pulls, shared])

    def strange(self, k: int, trust: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """How far cells of frame k are from what the other data say, in standard deviations.

        Args:
            k: number of the frame.
            trust: factors on the weights of its cells, which are not taken for noise.
        """
        line = self.linear[k]
        spread = 1.0 / inverse_diagonal(self.factor)
        rest = np.maximum(spread - line.weight, 1e-9 * spread)  # precision without this datum
        used = line.weight > 0
        mean = (spread * self.texture_map - line.weight * line.residual) / rest
        variance = 1.0 / rest + trust / np.where(used, line.weight, 1.0)
        return np.where(used, (line.residual - mean) / np.sqrt(variance), 0.0)


def solved(factor: tuple[np.ndarray, bool], values: np.ndarray) -> np.ndarray:
    """A positive definite system solved by the Cholesky factor of its matrix."""
    return cho_solve(factor, values, check_finite=False)


def inverse_diagonal(factor: tuple[np.ndarray, bool]) -> Float[np.ndarray, "n"]:
    """Diagonal of a positive definite matrix's inverse, by its lower Cholesky factor."""
    inverse, _ = lapack.dtrtri(factor[0], lower=True)
    return np.square(np.tril(inverse)).sum(axis=0)
