"""Conic surfaces of revolution about the microscope's axis, by depth below the cornea's vertex."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, ScalarLike

from optics import components


class Conic(eqx.Module):
    r"""Conic of revolution, $c(x^2 + y^2 + (1 + Q)\zeta^2) = 2\zeta$ with zeta from its vertex.

    The frame of a viewing path: zeta grows along the light from the microscope into the eye, x and
    y are those of the eye frame. The curvature c is positive if the centre lies deeper than the
    vertex, as that of the cornea does.

    Attributes:
        depth: zeta of the vertex, mm below the cornea's vertex.
        curvature: c = 1/R, 1/mm; 0 is a plane.
        asphericity: Q, 0 for a sphere, -1 for a paraboloid.
    """

    depth: Float[Array, ""]
    curvature: Float[Array, ""]
    asphericity: Float[Array, ""]

    def __init__(
        self, *, depth: ScalarLike, curvature: ScalarLike = 0.0, asphericity: ScalarLike = 0.0
    ) -> None:
        self.depth = jnp.asarray(depth, float)
        self.curvature = jnp.asarray(curvature, float)
        self.asphericity = jnp.asarray(asphericity, float)

    def reversed(self) -> Conic:
        """The same surface for light that comes back: depths count upwards."""
        return Conic(depth=-self.depth, curvature=-self.curvature, asphericity=self.asphericity)

    def distance(
        self, origin: Float[Array, "*batch 3"], direction: Float[Array, "*batch 3"]
    ) -> tuple[Float[Array, "*batch"], Bool[Array, "*batch"]]:
        """Distance along a ray to the sheet around the vertex, mm, and whether the ray meets it.

        The ray may start behind the surface; the distance is then negative.
        """
        x, y, z = components(origin)
        dx, dy, dz = components(direction)
        z = z - self.depth
        stretch = 1.0 + self.asphericity
        a = self.curvature * (dx * dx + dy * dy + stretch * dz * dz)
        b = dz - self.curvature * (x * dx + y * dy + stretch * z * dz)
        c = self.curvature * (x * x + y * y + stretch * z * z) - 2.0 * z
        discriminant = b * b - a * c
        meets = discriminant > 0.0
        # The inner `where` keeps the root's derivative finite. This form of the root has no
        # cancellation and holds for a plane, where a is 0.
        return c / (b + jnp.sqrt(jnp.where(meets, discriminant, 1.0))), meets

    def normal(self, point: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
        """Unit normal along the light at a point of the surface."""
        x, y, z = components(point)
        along = 1.0 - self.curvature * (1.0 + self.asphericity) * (z - self.depth)
        normal = jnp.stack([-self.curvature * x, -self.curvature * y, along], axis=-1)
        return normal / jnp.linalg.norm(normal, axis=-1, keepdims=True)
