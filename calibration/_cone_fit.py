r"""The exact geometry fitted to measured ellipses: cone, scale, eye, and each trial's nuisances.

A trial is a withdrawal along one beam. The robot tells how far the tip has gone and, to a degree or
so, where the beam points; it does not know where the wall is. So each trial brings four nuisances:
where its first reading is (`touch`: the rim meets the wall before the centre does), the spot's
place in the image (two), and how the axis leans from what the robot says (two). They are fitted
along with the parameters asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, ScalarLike

import optics
from calibration._least_squares import Solution, least_squares

PARAMETERS = ("half_angle", "b", "scale", "eye_radius", "inverse_working_distance")
"""What a fit may leave free: rad, mm, mm/px, mm, 1/mm."""

_NUISANCES = ("touch", "u", "v", "lean", "lean_sideways")
_POINTS = 32
_PART = 0.1  # of a unit direction, from which on a parameter has a part in it
_UNDETERMINED = 0.5
"""Information, in units of a parameter's own size (or of a nuisance's prior), below which a
direction counts as not seen: its standard error exceeds the parameter itself."""


class Prior(NamedTuple):
    """What is known of a parameter beforehand, in its unit."""

    mean: float
    sigma: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Spots along one beam, and what the robot says of it.

    Attributes:
        ellipses: measured, one a frame, px; leading axis n.
        covariances: of each ellipse's (centre u, centre v, semi-major, semi-minor, angle), n x 5 x
            5.
        readings: distance along the beam since the touch, mm.
        axis: unit vector from the tip towards the wall, eye frame.
        principal_point: (u0, v0) of this trial's window, px.
        touch: distance at reading 0, mm.
        kind: "eyeball", a sphere about the origin, or "plane", through its pole and square to z.
    """

    ellipses: optics.Ellipse
    covariances: Float[np.ndarray, "n 5 5"]
    readings: Float[np.ndarray, "n"]
    axis: Float[np.ndarray, "3"]
    principal_point: Float[np.ndarray, "2"]
    touch: Prior
    kind: str


class ConeFit(NamedTuple):
    """Parameters that were free, and how well the data know them.

    Attributes:
        values: by name, in the units of `PARAMETERS`, the given ones too.
        free: names of the fitted ones, in the covariance's order.
        covariance: of the fitted ones, from the noise model (the ellipses' covariances).
        touch: per trial, mm: the distance at reading 0.
        chi_squared: sum of squared whitened residuals, priors included.
        degrees_of_freedom: data and priors minus parameters.
        undetermined: directions that neither data nor priors hold, in words; empty if none.
        converged: whether the solver says so.
    """

    values: dict[str, float]
    free: tuple[str, ...]
    covariance: Float[np.ndarray, "p p"]
    touch: Float[np.ndarray, "trials"]
    chi_squared: float
    degrees_of_freedom: int
    undetermined: tuple[str, ...]
    converged: bool


def fit_cone(
    trials: Sequence[Trial],
    microscope: optics.Microscope,
    *,
    start: Mapping[str, float],
    free: Sequence[str] = ("half_angle", "b"),
    priors: Mapping[str, Prior] | None = None,
    lean_sigma: float = np.radians(1.0),
) -> ConeFit:
    """Fit the exact contour to the ellipses of all trials at once.

    Args:
        trials: planes and spheres together.
        microscope: ideal pinhole; `start` may replace its scale, eye radius and working distance,
            each trial has its own principal point.
        start: values of `half_angle` and `b`, and of others that the microscope does not tell;
            those that are not free stay as they are.
        free: names of `PARAMETERS` to fit.
        priors: of free parameters.
        lean_sigma: of the robot's axis, rad.

    Raises:
        ValueError: an unknown name, or no trial.
    """
    unknown = [name for name in (*free, *(priors or {})) if name not in PARAMETERS]
    if unknown or not trials:
        raise ValueError(
            f"fit_cone needs one trial or more and names of {', '.join(PARAMETERS)}; got "
            f"{len(trials)} trials and {', '.join(unknown) or 'no unknown name'}."
        )
    known = {
        "scale": float(microscope.scale),
        "eye_radius": -float(microscope.pole_height),
        "inverse_working_distance": float(microscope.inverse_working_distance),
    }
    fixed = known | dict(start)
    held = {name: prior for name, prior in (priors or {}).items() if name in free}
    # Steps of one size in all parameters keep the damping fair.
    sizes = np.array([abs(fixed[name]) or 1.0 for name in free])
    first = np.array([fixed[name] for name in free])
    groups = [
        _Group.of([trial for trial in trials if trial.kind == kind], kind, lean_sigma)
        for kind in sorted({trial.kind for trial in trials})
    ]
    # Every nuisance counts from what is expected of it, in units of its standard deviation.
    begin = jnp.zeros(len(free) + len(_NUISANCES) * len(trials))
    count = sum(group.data for group in groups) + len(held) + 3 * len(trials)
    solution = _solve(
        begin,
        groups,
        microscope,
        fixed,
        tuple(free),
        jnp.asarray(first),
        jnp.asarray(sizes),
        held,
        count,
    )
    information = np.asarray(solution.information)
    covariance, undetermined = _inverse(information, (*free, *_names(groups)))
    own = slice(len(free))
    found = np.asarray(solution.parameters)
    in_order = [t for group in groups for t in trials if t.kind == group.kind]
    touched = np.empty(len(trials))
    for trial, moved in zip(in_order, found[len(free) :: len(_NUISANCES)], strict=True):
        touched[trials.index(trial)] = trial.touch.mean + trial.touch.sigma * moved
    values = fixed | dict(zip(free, (first + sizes * found[own]).tolist(), strict=True))
    return ConeFit(
        values=values,
        free=tuple(free),
        covariance=covariance[own, own] * np.outer(sizes, sizes),
        touch=touched,
        chi_squared=float(np.sum(np.square(solution.residuals))),
        degrees_of_freedom=count - found.size,
        undetermined=undetermined,
        converged=bool(solution.converged),
    )


def phantom_wall(kind: str, *, eye_radius: ScalarLike) -> optics.Surface:
    """The wall of a `Trial.kind`; eye_radius in mm."""
    if kind == "plane":
        return optics.pole_plane(eye_radius=eye_radius)
    return optics.Sphere(eye_radius)


class _Group(eqx.Module):
    """Trials on walls of one kind, padded to one number of frames."""

    ellipses: optics.Ellipse
    whitening: Float[Array, "trials n 5 5"]
    readings: Float[Array, "trials n"]
    axes: Float[Array, "trials 3"]
    principal_points: Float[Array, "trials 2"]
    touch_means: Float[Array, "trials"]
    touch_sigmas: Float[Array, "trials"]
    lean_sigma: Float[Array, ""]
    kind: str = eqx.field(static=True)
    data: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        return self.readings.shape[0]

    @classmethod
    def of(cls, trials: list[Trial], kind: str, lean_sigma: float) -> _Group:
        longest = max(trial.readings.size for trial in trials)

        def stacked(arrays: list[np.ndarray]) -> Array:
            # A frame that pads a trial repeats its last, and weighs nothing.
            rows = [
                np.pad(a, [(0, longest - len(a)), *[(0, 0)] * (a.ndim - 1)], mode="edge")
                for a in map(np.asarray, arrays)
            ]
            return jnp.asarray(np.stack(rows))

        ellipses = optics.Ellipse(
            *(stacked(list(leaves)) for leaves in zip(*(t.ellipses for t in trials), strict=True))
        )
        covariances = stacked([t.covariances for t in trials])
        shape = jax.vmap(jax.vmap(optics.mismatch_covariance))(ellipses, covariances)
        whitening = jnp.linalg.inv(jnp.linalg.cholesky(shape))
        frames = np.array([t.readings.size for t in trials])
        real = np.arange(longest) < frames[:, None]
        return cls(
            ellipses=ellipses,
            whitening=whitening * real[..., None, None],
            readings=stacked([t.readings for t in trials]),
            axes=jnp.asarray(np.stack([t.axis for t in trials])),
            principal_points=jnp.asarray(np.stack([t.principal_point for t in trials])),
            touch_means=jnp.array([t.touch.mean for t in trials]),
            touch_sigmas=jnp.array([t.touch.sigma for t in trials]),
            lean_sigma=jnp.asarray(lean_sigma),
            kind=kind,
            data=5 * int(frames.sum()),
        )


def _names(groups: list[_Group]) -> list[str]:
    return [
        f"{name} of {group.kind} {number + 1}"
        for group in groups
        for number in range(group.size)
        for name in _NUISANCES
    ]


@eqx.filter_jit
def _solve(begin, groups, microscope, fixed, free, first, sizes, held, count) -> Solution:
    def residual(x: Array) -> Array:
        values = fixed | {
            name: value for name, value in zip(free, first + sizes * x[: len(free)], strict=True)
        }
        camera = eqx.tree_at(
            lambda m: (m.scale, m.pole_height, m.inverse_working_distance),
            microscope,
            tuple(
                jnp.asarray(value, float)
                for value in (
                    values["scale"],
                    -values["eye_radius"],
                    values["inverse_working_distance"],
                )
            ),
        )
        parts = [
            jnp.reshape((values[name] - prior.mean) / prior.sigma, (1,))
            for name, prior in held.items()
        ]
        at = len(free)
        for group in groups:
            nuisances = x[at : at + group.size * len(_NUISANCES)].reshape(group.size, -1)
            at += nuisances.size
            parts.append(_misfit(group, camera, values, nuisances))
        return jnp.concatenate(parts)

    return least_squares(residual, begin, count=count)


def _misfit(group: _Group, camera: optics.Microscope, values, nuisances) -> Array:
    """Whitened mismatch of every frame, and the priors of the nuisances."""
    wall = phantom_wall(group.kind, eye_radius=values["eye_radius"])

    def of_trial(ellipses, whitening, readings, axis, principal_point, touch, nuisance):
        view = eqx.tree_at(lambda m: m.principal_point, camera, principal_point)
        # The spot's place moves with the first frame's ellipse, in px.
        spot = wall.intersect(*view.ray(ellipses.centre[0] + nuisance[1:3])).point
        first, second = optics.perpendicular_frame(axis)
        aim = axis + group.lean_sigma * (nuisance[3] * first + nuisance[4] * second)
        aim /= jnp.linalg.norm(aim)

        def of_frame(ellipse, whiten, reading):
            beam = optics.Beam(
                tip=spot - (reading + touch) * aim,
                axis=aim,
                half_angle=values["half_angle"],
                apex_offset=values["b"],
            )
            contour = optics.spot_contour(beam, wall, view, points=_POINTS)
            return whiten @ optics.ellipse_mismatch(contour, ellipse)

        frames = jax.vmap(of_frame)(ellipses, whitening, readings)
        # The spot's place in the image has no prior.
        return jnp.concatenate([jnp.ravel(frames), nuisance[:1], nuisance[3:]])

    return jnp.ravel(
        jax.vmap(of_trial)(
            group.ellipses,
            group.whitening,
            group.readings,
            group.axes,
            group.principal_points,
            group.touch_means + group.touch_sigmas * nuisances[:, 0],
            nuisances,
        )
    )


def _inverse(
    information: Float[np.ndarray, "p p"], names: Sequence[str]
) -> tuple[Float[np.ndarray, "p p"], tuple[str, ...]]:
    """Covariance, and in words the directions in which there is none."""
    strength, directions = np.linalg.eigh(information)
    lost = strength < _UNDETERMINED
    told = []
    for direction in directions.T[lost]:
        parts = [n for n, share in zip(names, np.abs(direction), strict=True) if share > _PART]
        told.append(
            f"{' and '.join(parts)} only together: fix one, give a prior, or add a trial that "
            "tells them apart"
        )
    inverse = np.where(lost, 0.0, 1.0 / np.where(lost, 1.0, strength))
    covariance = (directions * inverse) @ directions.T
    hidden = np.abs(directions[:, lost]).max(axis=1, initial=0.0) > _PART
    covariance[hidden, :] = covariance[:, hidden] = np.inf
    return covariance, tuple(told)
