"""Light on a lattice of cells by a beam whose pose is sought, compiled for the rig."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from eyespot import optics
from eyespot.optics.wall_light.cells import Lattice, lattice_irradiance

POSE = 5
"""Numbers of a pose's change: two shifts of the spot along the wall, mm; a growth of the distance,
mm; and two turns of the beam about the spot, rad."""


class BeamFrame(NamedTuple):
    """A beam that meets the wall, with the directions of its changes.

    Attributes:
        tip: S, mm.
        axis: unit vector towards the wall.
        distance: d = |SO|, mm.
        right: unit vector along the wall at O.
        down: unit vector along the wall at O, at right angles to `right`.
        first: unit vector across the axis.
        second: unit vector across the axis, at right angles to `first`.
    """

    tip: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    distance: Float[np.ndarray, ""]
    right: Float[np.ndarray, "3"]
    down: Float[np.ndarray, "3"]
    first: Float[np.ndarray, "3"]
    second: Float[np.ndarray, "3"]

    @property
    def spot(self) -> Float[np.ndarray, "3"]:
        """O, where the beam meets the wall, mm."""
        return self.tip + self.distance * self.axis

    @property
    def slopes(self) -> Float[np.ndarray, "5 5"]:
        """Derivatives of the tip and of the axis's turns by a change."""
        # The tip moves with the spot, along the axis, and with the turns about the spot.
        across = np.stack([self.first, self.second])
        slopes = np.zeros((POSE, POSE))
        slopes[:3] = np.stack([self.right, self.down, -self.axis, *(-self.distance * across)], -1)
        slopes[3, 3] = slopes[4, 4] = 1.0
        return slopes

    def moved(self, change: Any) -> tuple[Any, Any]:
        """Tip and axis after a change, five numbers of NumPy or JAX."""
        axis = self.axis + change[3] * self.first + change[4] * self.second
        axis = axis / (axis @ axis) ** 0.5
        spot = self.spot + change[0] * self.right + change[1] * self.down
        return spot - (self.distance + change[2]) * axis, axis

    def moved_on(self, wall: optics.Surface, change: Float[np.ndarray, "5"]) -> "BeamFrame | None":
        """The beam after a change; None if it meets no wall ahead of the tip any more."""
        return beam_at_wall(wall, *self.moved(change))


class Steps(NamedTuple):
    """Places of a beam that moves, relative to a pose.

    Attributes:
        tips: of the tip, mm.
        axes: of the axis, before its length is made 1 again.
        shares: of each place in the light; their sum is 1.
    """

    tips: Float[ArrayLike, "k 3"]
    axes: Float[ArrayLike, "k 3"]
    shares: Float[ArrayLike, "k"]


def beam_at_wall(
    wall: optics.Surface, tip: Float[ArrayLike, "3"], axis: Float[ArrayLike, "3"]
) -> BeamFrame | None:
    """The beam from a tip along a unit vector; None if it meets no wall ahead of the tip."""
    beam = BeamFrame(*map(np.asarray, _beam(wall, jnp.asarray(tip), jnp.asarray(axis))))
    return beam if beam.distance > 0 and np.isfinite(beam.spot).all() else None


@eqx.filter_jit
def _beam(wall: optics.Surface, tip: Float[Array, "3"], axis: Float[Array, "3"]) -> list[Array]:
    meeting = wall.intersect(tip, axis)
    across = (*optics.perpendicular_frame(meeting.normal), *optics.perpendicular_frame(axis))
    return [tip, axis, jnp.dot(meeting.point - tip, axis), *across]


@eqx.filter_jit
def irradiance_and_slopes(
    lattice: Lattice,
    source: Any,
    beam: BeamFrame,
    *,
    own: Float[ArrayLike, "q"],
    spread: Float[ArrayLike, "p q"],
    steps: Steps | None = None,
) -> tuple[Float[Array, "n"], Float[Array, "5+q n"]]:
    """Mean irradiance of the cells per unit power, 1/mm², and its derivatives.

    Args:
        source: the beam's light, a `CellBeam`.
        own: changes of the beam's own parameters, in the terms of `spread`.
        spread: turns `own` into changes of the parameters that `source.changed` takes.
        steps: places of a beam that moves; None for a beam at rest.

    Returns:
        The irradiance, and its derivatives by the `POSE` changes and by `own`.
    """

    def light(z: Array) -> Array:
        change, own = z[:POSE], z[POSE:]
        return irradiance_alone(
            lattice, source, beam, own=own, spread=spread, steps=steps, pose=change
        )

    z = jnp.concatenate([jnp.zeros(POSE), jnp.asarray(own)])
    # One evaluation serves all derivatives.
    return jax.vmap(lambda way: jax.jvp(light, (z,), (way,)), out_axes=(None, 0))(jnp.eye(z.size))


@eqx.filter_jit
def irradiance_alone(
    lattice: Lattice,
    source: Any,
    beam: BeamFrame,
    *,
    own: Float[ArrayLike, "q"],
    spread: Float[ArrayLike, "p q"],
    steps: Steps | None = None,
    pose: Any = (0.0,) * POSE,
) -> Float[Array, "n"]:
    """The irradiance of `irradiance_and_slopes`, in a third of the time."""
    moved, turned = beam.moved(pose)
    changed = source.changed(jnp.asarray(spread) @ own)
    if steps is None:
        return lattice_irradiance(lattice, changed, tip=moved, axis=turned).ravel()

    def at(way: Array, turn: Array) -> Array:
        along = turned + turn
        along = along / jnp.linalg.norm(along)
        return lattice_irradiance(lattice, changed, tip=moved + way, axis=along).ravel()

    # All at once, which two cores do in less time than one after the other.
    return jnp.asarray(steps.shares) @ jax.vmap(at)(*map(jnp.asarray, steps[:2]))
