"""What a cone's fit to spots minimises: its unknowns, residuals and priors, and their minimum.

The unknowns are changes of `PARAMETERS`, then the nuisances of each trial (see `cone_trials`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from eyespot import optics
from eyespot.calibration.least_squares import Solution, accepted_range, least_squares
from eyespot.calibration.spots.cone_trials import (
    HELD,
    NUISANCES,
    ConeTrial,
    TrialGroup,
    first_nuisances,
    misfit,
    spots,
)

PARAMETERS = (
    "half_angle",
    "b",
    "scale",
    "eye_radius",
    "inverse_working_distance",
    "tilt_x",
    "tilt_y",
    "robot_scale",
    "clock_offset",
)
"""Parameters that can be fitted: rad, mm, mm/px, mm, 1/mm, the tangents of the plane's tilt, true
distances over the robot's, and by how much its clock is behind the camera's, s.

The focal length is 1/(scale inverse_working_distance) px; the pinhole's height is
1/inverse_working_distance - eye_radius.
"""
_SHORT_STEP = 0.01
"""In standard errors. Where a robot sets off, chi squared bends at the clock's offset, and only
hundreds of steps become as short as the solver wants them, 1e-10."""
_INFORMED, _WIDER = 0.9, 1.2
"""Part of the clock's prior below which an interval is the data's; and ratio of an interval's wider
side to its standard error from which the sides differ: of a parabola both are 1."""
_OF_CLOCK = np.array([name == "clock_offset" for name in PARAMETERS])


class ConeMinimum(NamedTuple):
    """A minimum, and the spots at reading 0 there, mm, with their derivatives."""

    solution: Solution
    spot: Float[Array, "trials 2"]
    spot_slopes: Float[Array, "trials 2 x"]

    @property
    def chi_squared(self) -> float:
        """Sum of squared residuals over their sigma, priors included."""
        return float(np.sum(np.square(np.asarray(self.solution.residuals))))

    @property
    def settled(self) -> bool:
        """Whether another step would be short, also where the solver's have not become tiny."""
        if self.solution.converged:
            return True
        jacobian = np.asarray(self.solution.jacobian)
        step = np.linalg.lstsq(jacobian, np.asarray(self.solution.residuals))[0]
        return float(np.sum(np.square(jacobian @ step))) < _SHORT_STEP**2


@dataclass(frozen=True, kw_only=True, eq=False)
class ConeProblem:
    """What is fitted, in arrays.

    Attributes:
        of_kinds: numbers of the trials on each kind of wall.
        missed: `size_sigmas` and `outline_sigmas` of `fit_cone`.
        fixed: where parameters begin.
        steps: changes of `PARAMETERS` by the solver's first unknowns, one for each free parameter.
        prior_means, prior_weights: of `prior_terms`.
        count: number of data and priors.
    """

    microscope: optics.Microscope
    of_kinds: list[list[int]]
    missed: tuple[Sequence[float], Sequence[float]]
    fixed: dict[str, float]
    steps: Float[np.ndarray, "q p"]
    prior_means: Float[np.ndarray, "q"]
    prior_weights: Float[np.ndarray, "q q"]
    count: int

    def groups(self, trials: Sequence[ConeTrial]) -> list[TrialGroup]:
        """The trials on each kind of wall."""
        return [
            TrialGroup.of(
                [trials[n] for n in own], *([part[n] for n in own] for part in self.missed)
            )
            for own in self.of_kinds
        ]

    def solved(
        self,
        groups: list[TrialGroup],
        begin: Array | None = None,
        *,
        clock_s: float | None = None,
    ) -> ConeMinimum:
        """The minimum near a beginning, by default the expected one; with that clock if given."""
        fixed, steps = self.fixed, self.steps
        if clock_s is not None:
            fixed = fixed | {"clock_offset": clock_s}
            steps = np.where(_OF_CLOCK[:, None], 0.0, steps)
        if begin is None:
            # Nuisances are deviations from their expected values, in standard deviations. Numbers
            # would be compiled in, anew for every fit.
            at_start = jax.tree.map(jnp.asarray, fixed)
            nuisances = [jnp.ravel(first_nuisances(g, self.microscope, at_start)) for g in groups]
            begin = jnp.concatenate([jnp.zeros(len(PARAMETERS)), *nuisances])
        found = _solve(
            begin,
            groups,
            self.microscope,
            jnp.array([fixed[name] for name in PARAMETERS]),
            # A step for each parameter that is not free moves nothing, and arrays replace names, so
            # that one compilation serves all choices.
            jnp.asarray(np.pad(steps, [(0, 0), (0, len(PARAMETERS) - steps.shape[1])])),
            jnp.asarray(self.prior_means),
            jnp.asarray(self.prior_weights),
            jnp.asarray(self.count),
        )
        return ConeMinimum(*found)

    def moving(self, found: ConeMinimum) -> Int[np.ndarray, "p"]:
        """Which of a minimum's unknowns can move: the free parameters, then the nuisances."""
        every = np.arange(found.solution.parameters.size)
        return np.delete(every, np.arange(self.steps.shape[1], len(PARAMETERS)))

    def explained(self, found: ConeMinimum) -> bool:
        """Whether noise explains the residuals of a minimum that was reached."""
        degrees = self.count - self.moving(found).size
        _, most = accepted_range(degrees)
        return found.settled and found.chi_squared <= most * degrees

    @property
    def clock(self) -> tuple[int, float]:
        """Which unknown the clock's offset is, and how many seconds its unit."""
        of_clock = self.steps[PARAMETERS.index("clock_offset")]
        at = int(np.flatnonzero(of_clock)[0])
        return at, float(of_clock[at])

    def with_clock(self, found: ConeMinimum, offset_s: float) -> Array:
        """A solution's parameters with another offset of the clock, which is free."""
        at, unit = self.clock
        return found.solution.parameters.at[at].set((offset_s - self.fixed["clock_offset"]) / unit)


def rows_of(
    groups: list[TrialGroup], of_kinds: list[list[int]], trials: Sequence[ConeTrial]
) -> list[Int[np.ndarray, "n 5"]]:
    """Where the residuals of each trial's frames are in those of a minimum."""
    found: dict[int, np.ndarray] = {}
    at = len(PARAMETERS)
    for group, numbers in zip(groups, of_kinds, strict=True):
        for number in numbers:
            frames = trials[number].readings.size
            found[number] = at + np.arange(5 * frames).reshape(frames, 5)
            at += 5 * group.readings.shape[1] + HELD
    return [found[number] for number in range(len(trials))]


def with_both_sides_of_the_clock(
    problem: ConeProblem,
    found: ConeMinimum,
    groups: list[TrialGroup],
    covariance: Float[np.ndarray, "p p"],
    widest_s: float,
) -> Float[np.ndarray, "p p"]:
    """The covariance with the wider side of the clock's interval, where the sides differ.

    Readings bend where a robot sets off. So chi squared may rise on one side of the clock's offset
    and not on the other, and its curvature is that of neither. The interval ends where the least
    chi squared for a held offset is one more (Wilks 1938).
    """
    (at, unit), moving = problem.clock, problem.moving(found)
    sigma = math.sqrt(covariance[at, at]) * unit
    if not sigma < _INFORMED * widest_s:
        return covariance
    value = problem.fixed["clock_offset"] + unit * float(found.solution.parameters[at])
    wide, along = sigma, None
    for side in (-1.0, 1.0):
        step = sigma
        while True:
            beside = problem.solved(groups, found.solution.parameters, clock_s=value + side * step)
            rise = beside.chi_squared - found.chi_squared
            if rise >= 1.0 or step >= widest_s:
                break
            step = min(2.0 * step, widest_s)
        reach = step / math.sqrt(max(rise, 1.0))
        if reach > wide:
            wide = reach
            moved = np.asarray(beside.solution.parameters - found.solution.parameters)[moving]
            along = moved / (side * step / unit)
    if along is None or not wide > _WIDER * sigma:
        return covariance
    along[at] = 1.0
    return covariance + (wide**2 - sigma**2) / unit**2 * np.outer(along, along)


@eqx.filter_jit
def _solve(
    begin: Float[Array, "p"],
    groups: list[TrialGroup],
    microscope: optics.Microscope,
    fixed: Float[Array, "q"],
    steps: Float[Array, "q f"],
    prior_means: Float[Array, "q"],
    prior_weights: Float[Array, "q q"],
    count: Array,
) -> tuple[Solution, Float[Array, "trials 2"], Float[Array, "trials 2 x"]]:
    """The solution, and the spots of all trials with their derivatives, in the groups' order.

    Steps of the parameters come first, then the nuisances by group; the residuals have the same
    order.
    """

    def unpacked(x: Array) -> tuple[Array, dict[str, Array], optics.Microscope, list[Array]]:
        parameters = fixed + steps @ x[: steps.shape[1]]
        values = dict(zip(PARAMETERS, parameters, strict=True))
        camera = eqx.tree_at(
            lambda m: (m.scale, m.pole_height, m.inverse_working_distance),
            microscope,
            (values["scale"], -values["eye_radius"], values["inverse_working_distance"]),
        )
        nuisances, at = [], steps.shape[1]
        for group in groups:
            nuisances.append(x[at : at + group.size * len(NUISANCES)].reshape(group.size, -1))
            at += nuisances[-1].size
        return parameters, values, camera, nuisances

    def residual(x: Array) -> Array:
        parameters, values, camera, nuisances = unpacked(x)
        parts = [prior_weights @ (parameters - prior_means)]
        for group, own in zip(groups, nuisances, strict=True):
            parts.append(misfit(group, camera, values, own))
        return jnp.concatenate(parts)

    def spot_of_each(x: Array) -> Array:
        _, values, camera, nuisances = unpacked(x)
        of_groups = zip(groups, nuisances, strict=True)
        return jnp.concatenate([spots(g, camera, values, own)[:, :2] for g, own in of_groups])

    solution = least_squares(residual, begin, count=count)
    found = solution.parameters
    return solution, spot_of_each(found), jax.jacfwd(spot_of_each)(found)
