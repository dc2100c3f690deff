r"""Light of a uniform cone on cells, in closed form.

The light of a cell is a share of the cone's solid angle. A cone of constant intensity sends light
in proportion to the solid angle, seen from its apex. So the light through a patch is a sum over the
patch's straight sides. The part of a side inside the cone adds the solid angle of its triangle with
the axis (Van Oosterom and Strackee 1983),

$$ \tan\frac{\Omega}{2} = \frac{\mathbf u \cdot (\mathbf p \times \mathbf q)}
   {|\mathbf p||\mathbf q| + (\mathbf u\cdot\mathbf p)|\mathbf q|
    + (\mathbf u\cdot\mathbf q)|\mathbf p| + \mathbf p\cdot\mathbf q}, $$

over that of the cone. A part outside adds its angle about the axis, over a whole turn: its triangle
with the axis holds that share of the cone.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from eyespot.optics import dot
from eyespot.optics.wall_light.cells import Sides, off_axis_part


class UniformCone(eqx.Module):
    """Constant intensity inside a cone, none outside.

    Attributes:
        half_angle: alpha, rad.
        apex_offset: b, mm.
    """

    half_angle: Float[Array, ""]
    apex_offset: Float[Array, ""]

    @classmethod
    def of(cls, half_angle: float, apex_offset: float) -> "UniformCone":
        """A cone by its half-angle, rad, and apex offset, mm."""
        return cls(jnp.asarray(half_angle), jnp.asarray(apex_offset))

    def changed(self, by: Float[Array, "2"]) -> "UniformCone":
        """The cone with another half-angle (rad) and apex offset (mm)."""
        return UniformCone(self.half_angle + by[0], self.apex_offset + by[1])

    def through(
        self, sides: Sides, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
    ) -> Float[Array, "..."]:
        """Light between each side and the axis, per unit power; a wall's bend within it is left."""
        apex = tip + self.apex_offset * axis
        begin, end = sides.begin - apex, sides.end - apex
        enters, leaves = self._inside(begin, end, axis)
        first = begin + enters[..., None] * (end - begin)
        second = begin + leaves[..., None] * (end - begin)
        turned = _turn(begin, first, axis, enters > 0.0) + _turn(second, end, axis, leaves < 1.0)
        whole = 2.0 * jnp.pi * (1.0 - jnp.cos(self.half_angle))
        return _solid_angle(first, second, axis) / whole + turned / (2.0 * jnp.pi)

    def _inside(self, begin: Array, end: Array, axis: Array) -> tuple[Array, Array]:
        """Where a line from begin (0) to end (1) enters the cone and leaves it; equal if never.

        They have no derivatives: at the cone's surface the light of both parts grows alike.
        """
        squared_cosine = jnp.square(jnp.cos(self.half_angle))
        way = end - begin
        height, rise = dot(begin, axis), dot(way, axis)
        # The surface: height² = cos² |offset|². A side across the beam has a > 0.
        a = squared_cosine * dot(way, way) - rise**2
        b = squared_cosine * dot(begin, way) - height * rise
        c = squared_cosine * dot(begin, begin) - height**2
        inside = b**2 - a * c
        ahead = (height > 0.0) & (height + rise > 0.0) & (a > 0.0)
        root = jnp.sqrt(jnp.where(ahead & (inside > 0.0), inside, 0.0))
        a = jnp.where(ahead, a, 1.0)
        ends = jnp.clip((-b - root) / a, 0.0, 1.0), jnp.clip((-b + root) / a, 0.0, 1.0)
        return jax.lax.stop_gradient(ends)


def _solid_angle(first: Array, second: Array, axis: Array) -> Array:
    """Signed solid angle of the triangle of the axis and two points, from the origin."""
    from_origin, to_origin = jnp.sqrt(dot(first, first)), jnp.sqrt(dot(second, second))
    along = dot(first, axis) * to_origin + dot(second, axis) * from_origin
    across = dot(axis, jnp.cross(first, second))
    return 2.0 * jnp.arctan2(across, from_origin * to_origin + along + dot(first, second))


def _turn(first: Array, second: Array, axis: Array, apart: Array) -> Array:
    """Signed angle about the axis from one point to another, where they are apart; else 0."""
    across = dot(axis, jnp.cross(first, second))
    same = dot(off_axis_part(first, axis), second)
    return jnp.where(apart, jnp.arctan2(across, jnp.where(apart, same, 1.0)), 0.0)
