"""Fits of several recordings apart: how far they differ, and what they say together.

The estimates x_i of the same parameters have errors of their own, with the covariance N_i, and
follow errors d_s that they share, such as that of the microscope's scale, by r_is standard
deviations: x_i = x + n_i + sum_s r_is d_s. So the covariance of all of them is V, whose blocks are
N_i on the diagonal and r_is r_js^T everywhere. What a fit states is C_i = N_i + sum_s r_is r_is^T.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from eyespot.calibration.command.fit_verdict import Fitted
from eyespot.estimator.distance.consistency import CONTRADICTION_SIGMAS
from eyespot.formats.calibration import BEAM

OF_ONE = ("touch", "clock_offset")
"""What a rig states anew for each recording; the errors of all else are shared."""
OF_MOUNTING, OF_GAIN = BEAM, ("brightness",)
"""Parameters that differ between recordings of one beam."""
CHANCE = 2.0 * stats.norm.sf(CONTRADICTION_SIGMAS)
"""Probability below which recordings disagree, as of any other comparison."""
_LOST = 1e-9
"""Share of the largest variance below which a direction is exact, as where one parameter follows
another."""
_INFORMED = 0.01
"""Share of a stated variance that must be a recording's own, or the shared errors decide alone."""


class Apart(NamedTuple):
    """Estimates of the same parameters by several recordings, with their covariances.

    Attributes:
        values: x_i.
        covariances: C_i.
        joint: V.
    """

    names: list[str]
    values: Float[np.ndarray, "n p"]
    covariances: Float[np.ndarray, "n p p"]
    joint: Float[np.ndarray, "n p n p"]

    @property
    def chance(self) -> float:
        """Probability that recordings of one beam differ as much (chi-squared)."""
        count, size = self.values.shape
        contrasts = np.kron(np.eye(count)[:-1] - np.eye(count)[-1], np.eye(size))
        off = contrasts @ self.values.ravel()
        joint = contrasts @ self.joint.reshape(count * size, -1) @ contrasts.T
        alone = np.zeros((count, size, count, size))
        for one, covariance in enumerate(self.covariances):
            alone[one, :, one] = covariance
        stated = contrasts @ alone.reshape(count * size, -1) @ contrasts.T
        white = _whitening(stated)
        share, turn = np.linalg.eigh(white.T @ joint @ white)
        informed = share > _INFORMED
        along = turn[:, informed].T @ white.T @ off
        return float(stats.chi2.sf(np.sum(along**2 / share[informed]), informed.sum()))

    @property
    def shares(self) -> Float[np.ndarray, "n p p"]:
        """Derivatives of the mean by the values: each counts by its stated covariance.

        Along directions that are exact, the mean is the first recording's.
        """
        inverses = np.array([_inverse(covariance) for covariance in self.covariances])
        shares = np.asarray(_inverse(inverses.sum(axis=0)) @ inverses)
        shares[0] += np.eye(len(self.names)) - shares.sum(axis=0)
        return shares

    @property
    def mean(self) -> Float[np.ndarray, "p"]:
        """The weighted mean."""
        off = self.values - self.values[0]
        return self.values[0] + np.einsum("nij,nj->i", self.shares, off)

    @property
    def covariance(self) -> Float[np.ndarray, "p p"]:
        """Of the mean."""
        exact = ~self.covariances.diagonal(axis1=1, axis2=2).any(axis=0)
        found = self._propagated(self.shares)
        found[exact, :] = found[:, exact] = 0.0  # without the rounding of its inverse
        return found

    def of_difference(self, one: int) -> Float[np.ndarray, "p p"]:
        """Covariance of a recording's values less the mean."""
        slopes = -self.shares
        slopes[one] += np.eye(len(self.names))
        return self._propagated(slopes)

    def _propagated(self, slopes: Float[np.ndarray, "n p p"]) -> Float[np.ndarray, "p p"]:
        """Covariance of what follows all values by these slopes."""
        return np.asarray(np.einsum("nij,njmk,mlk->il", slopes, self.joint, slopes))

    def moved(self, rows: Sequence[Float[np.ndarray, "m p"]]) -> Float[np.ndarray, "m p"]:
        """How far the mean follows what moves each recording's values by rows."""
        return np.einsum("nij,nmj->mi", self.shares, np.array(rows))

    def without(self, one: int) -> "Apart":
        """The other recordings."""
        joint = np.delete(np.delete(self.joint, one, axis=0), one, axis=2)
        return Apart(
            self.names,
            np.delete(self.values, one, axis=0),
            np.delete(self.covariances, one, axis=0),
            joint,
        )


def _whitening(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p k"]:
    """Directions with unit variance, without the exact ones."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    variance, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = variance > _LOST * variance[-1]
    return np.asarray(axes[:, kept] / np.sqrt(variance[kept]) / scale[:, None])


def _inverse(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """The inverse, 0 along exact directions."""
    white = _whitening(covariance)
    return white @ white.T


def compared(apart: Sequence[Fitted], *, but: Sequence[str] = (*OF_MOUNTING, *OF_GAIN)) -> Apart:
    """What all fits have in common, but for some parameters."""
    names = [
        name
        for name in apart[0].values
        if all(name in fit.values for fit in apart) and name not in but
    ]
    at = [[list(fit.values).index(name) for name in names] for fit in apart]
    values = np.array([[fit.values[name] for name in names] for fit in apart])
    covariances = np.array(
        [fit.covariance[np.ix_(own, own)] for fit, own in zip(apart, at, strict=True)]
    )
    joint = np.zeros((len(apart), len(names)) * 2)
    for one, covariance in enumerate(covariances):
        joint[one, :, one] = covariance
    for name in apart[0].shared:
        rows = np.array([fit.shared[name][:, own] for fit, own in zip(apart, at, strict=True)])
        of_all = np.einsum("nai,maj->nimj", rows, rows)
        for one in range(len(apart)):
            of_all[one, :, one] = 0.0  # C_i contains its own part
        joint += of_all
    return Apart(names, values, covariances, joint)


def together(apart: Sequence[Fitted]) -> Fitted:
    """Several recordings' weighted mean, in the form that all fits share."""
    first, stated = apart[0], {}
    gain = compared(apart, but=[name for name in first.values if name not in OF_GAIN])
    # Cameras of another gain have no mean.
    own = () if gain.names and gain.chance >= CHANCE else OF_GAIN
    every = compared(apart, but=(*OF_MOUNTING, *own))
    for name in first.stated:
        at = [[list(fit.values).index(value) for value in every.names] for fit in apart]
        rows = [fit.stated[name][:, columns] for fit, columns in zip(apart, at, strict=True)]
        if name in OF_ONE:
            moves = [
                every.moved([row * (other == one) for other, row in enumerate(rows)])
                for one in range(len(rows))
            ]
            stated[name] = np.concatenate(moves)
        else:
            stated[name] = every.moved(rows)
    named = [(fit, fit.recordings[0].name) for fit in apart]
    return Fitted(
        calibration_model=first.calibration_model,
        values=dict(zip(every.names, every.mean.tolist(), strict=True)),
        covariance=every.covariance,
        stated=stated,
        microscope=first.microscope if len({fit.microscope for fit in apart}) == 1 else "",
        converged=all(fit.converged for fit in apart),
        residuals={},
        recordings=[one for fit in apart for one in fit.recordings],
        used=sum(fit.used for fit in apart),
        degrees_of_freedom=sum(fit.degrees_of_freedom for fit in apart),
        chi_squared=sum(fit.chi_squared or 0.0 for fit in apart),
        others=[
            (f"{name} of {of}", value, sigma, unit)
            for fit, of in named
            for name, value, sigma, unit in fit.others
        ],
        notes=[f"{of}: {note}" for fit, of in named for note in fit.notes],
        parts=apart,
    )
