"""Data, nuisances and residuals of the exact geometry.

A trial is a withdrawal along one beam. The robot reports the distance travelled and, to about a
degree, the direction of the beam, but not the position of the wall. So each trial has five
nuisances: the distance at the first reading (`touch`; the rim meets the wall before the centre
does), the spot's position in the image (two), and the deviation of the axis from the robot's (two).
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

NUISANCES = ("touch", "u", "v", "lean", "lean_sideways")
"""Nuisances of each trial: touch and lean in units of their priors' sigma, the position in px."""
_POINTS = 32


class Prior(NamedTuple):
    """Prior knowledge of a parameter, in the parameter's unit."""

    mean: float
    sigma: float


@dataclass(frozen=True, kw_only=True, eq=False)
class ConeTrial:
    """Spots along one beam, with the robot's readings and axis.

    Attributes:
        ellipses: measured ellipses, one per frame, px; leading axis n.
        covariances: covariance of each ellipse's (centre u, centre v, semi-major, semi-minor,
            angle), n x 5 x 5.
        readings: distance along the beam since the touch, mm.
        axis: unit vector from the tip towards the wall, eye frame.
        principal_point: (u0, v0) of this trial's window, px.
        touch: distance at reading 0, mm.
        kind: "eyeball", a sphere around the origin, or "plane", a plane through the sphere's pole
            that is perpendicular to z except for its tilt.
    """

    ellipses: optics.Ellipse
    covariances: Float[np.ndarray, "n 5 5"]
    readings: Float[np.ndarray, "n"]
    axis: Float[np.ndarray, "3"]
    principal_point: Float[np.ndarray, "2"]
    touch: Prior
    kind: str


def phantom_wall(
    kind: str, *, eye_radius: ScalarLike, tilt: tuple[ScalarLike, ScalarLike] = (0.0, 0.0)
) -> optics.Surface:
    """The wall of a `ConeTrial.kind`.

    Args:
        kind: "eyeball" or "plane".
        eye_radius: mm.
        tilt: tilt of the plane: tangents of its normal's angle from z, towards +X and +Y.
    """
    if kind == "eyeball":
        return optics.Sphere(eye_radius)
    pole = jnp.array([0.0, 0.0, -1.0]) * eye_radius
    inward = jnp.stack([*map(jnp.asarray, tilt), jnp.ones(())])
    return optics.Plane(point=pole, inward=inward / jnp.linalg.norm(inward))


class Group(eqx.Module):
    """Trials on walls of one kind, padded to the same number of frames."""

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
    numbers: tuple[int, ...] = eqx.field(static=True)

    @property
    def size(self) -> int:
        """Number of trials."""
        return self.readings.shape[0]

    @classmethod
    def of(cls, of_all_kinds: Sequence[ConeTrial], kind: str, lean_sigma: float) -> Group:
        """The trials on one kind of wall."""
        numbers = tuple(n for n, trial in enumerate(of_all_kinds) if trial.kind == kind)
        trials = [of_all_kinds[n] for n in numbers]
        longest = max(trial.readings.size for trial in trials)

        def stacked(arrays: list[np.ndarray]) -> Array:
            # Padding repeats the trial's last frame with weight 0.
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
            numbers=numbers,
        )


def spots(
    group: Group,
    camera: optics.Microscope,
    values: Mapping[str, ScalarLike],
    nuisances: Float[Array, "trials 5"],
) -> Float[Array, "trials 3"]:
    """The lit point of the wall in each trial's first frame, mm."""
    wall = _wall(group, values)

    def of_trial(ellipses: optics.Ellipse, principal_point: Array, nuisance: Array) -> Array:
        view = eqx.tree_at(lambda m: m.principal_point, camera, principal_point)
        # The spot's position is relative to the first frame's ellipse, px.
        return wall.intersect(*view.ray(ellipses.centre[0] + nuisance[1:3])).point

    return jax.vmap(of_trial)(group.ellipses, group.principal_points, nuisances)


def _wall(group: Group, values: Mapping[str, ScalarLike]) -> optics.Surface:
    return phantom_wall(
        group.kind, eye_radius=values["eye_radius"], tilt=(values["tilt_x"], values["tilt_y"])
    )


def misfit(group: Group, camera: optics.Microscope, values, nuisances) -> Array:
    """Residuals over their sigma: the mismatch of every frame and the priors of the nuisances."""
    wall = _wall(group, values)

    def of_trial(ellipses, whitening, readings, axis, principal_point, spot, touch, nuisance):
        view = eqx.tree_at(lambda m: m.principal_point, camera, principal_point)
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
        # The spot's position in the image has no prior.
        return jnp.concatenate([jnp.ravel(frames), nuisance[:1], nuisance[3:]])

    return jnp.ravel(
        jax.vmap(of_trial)(
            group.ellipses,
            group.whitening,
            group.readings,
            group.axes,
            group.principal_points,
            spots(group, camera, values, nuisances),
            group.touch_means + group.touch_sigmas * nuisances[:, 0],
            nuisances,
        )
    )
