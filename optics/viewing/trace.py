"""Rays traced from the microscope through the surfaces of a viewing path into the eye.

Surfaces are conics of revolution about the microscope's axis, by depth below the cornea's vertex.
Media have one index, or the index gradient of a crystalline lens.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, ScalarLike

from eyespot.optics import components, refract


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

    def reversed(self) -> "Conic":
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


_STEPS = 16
_CORRECTIONS = 4
"""Runge-Kutta steps through a layer, and Newton steps for the path's end.

16 steps through Liou and Brennan's lens leave 1e-11 mm (tests/optics/test_viewing.py).
"""

_ROUNDING = 1e-9  # mm


class Medium(eqx.Module):
    r"""A medium behind a surface; its index may vary as $n_0 + n_1\zeta + n_2\zeta^2 + n_3\rho^2$.

    zeta is the depth below the vertex of the surface in front, rho the distance from the axis, mm.

    Attributes:
        index: n_0.
        gradient: (n_1, n_2, n_3) in 1/mm, 1/mm^2, 1/mm^2, or None for a homogeneous medium.
    """

    index: Float[Array, ""]
    gradient: Float[Array, "3"] | None

    def __init__(self, index: ScalarLike, gradient: Float[Array, "3"] | None = None) -> None:
        self.index = jnp.asarray(index, float)
        self.gradient = None if gradient is None else jnp.asarray(gradient, float)

    def reversed(self, thickness: ScalarLike) -> "Medium":
        """The same medium for light that comes back from a surface `thickness` mm behind."""
        if self.gradient is None:
            return self
        n1, n2, n3 = self.gradient
        index = self.index + n1 * thickness + n2 * jnp.square(thickness)
        return Medium(index, jnp.stack([-n1 - 2.0 * n2 * thickness, n2, n3]))

    def index_at(
        self, point: Float[Array, "*batch 3"], *, front: ScalarLike
    ) -> Float[Array, "*batch"]:
        """Refractive index at points; `front` is the depth of the surface in front, mm."""
        x, y, z = components(point)
        if self.gradient is None:
            return jnp.broadcast_to(self.index, z.shape)
        n1, n2, n3 = self.gradient
        depth = z - front
        return self.index + n1 * depth + n2 * depth**2 + n3 * (x * x + y * y)

    def to_surface(
        self,
        origin: Float[Array, "*batch 3"],
        direction: Float[Array, "*batch 3"],
        surface: Conic,
        *,
        front: ScalarLike,
    ) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"], Float[Array, "*batch"]]:
        r"""Follow rays through the medium to its far surface.

        With $d\sigma = ds/n$ a ray obeys $d^2\mathbf r/d\sigma^2 = \frac12\nabla n^2$ (Sharma,
        Kumar and Ghatak 1982), which Runge and Kutta's fourth-order steps solve. The last sigma is
        found by Newton's method, so that the ray ends on the surface.

        Returns:
            Point on the surface, unit direction there, and whether the ray meets the surface.
        """
        distance, meets = surface.distance(origin, direction)
        # Beyond a lens's rim its back lies in front of its front.
        meets = meets & (distance > -_ROUNDING)
        if self.gradient is None:
            return origin + distance[..., None] * direction, direction, meets
        index = self.index_at(origin, front=front)
        sigma = distance / index
        start = (origin, index[..., None] * direction)

        def corrected(_step: int, sigma: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
            end, ray = self._follow(start, sigma, front)
            unit = ray / jnp.linalg.norm(ray, axis=-1, keepdims=True)
            missing, _ = surface.distance(end, unit)
            return sigma + missing / self.index_at(end, front=front)

        sigma = jax.lax.fori_loop(0, _CORRECTIONS, corrected, sigma)
        end, ray = self._follow(start, sigma, front)
        return end, ray / jnp.linalg.norm(ray, axis=-1, keepdims=True), meets

    def _follow(
        self,
        start: tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]],
        sigma: Float[Array, "*batch"],
        front: ScalarLike,
    ) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
        """Position and n times direction after a length of sigma."""
        assert self.gradient is not None
        n1, n2, n3 = self.gradient
        h = (sigma / _STEPS)[..., None]

        def force(point: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
            x, y, z = components(point)
            slope = jnp.stack([2 * n3 * x, 2 * n3 * y, n1 + 2 * n2 * (z - front)], axis=-1)
            return self.index_at(point, front=front)[..., None] * slope

        def step(
            _: int, state: tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]
        ) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
            # Nyström's form of the classical steps, for a force without velocity.
            point, ray = state
            first = force(point)
            middle = force(point + h / 2 * ray + h * h / 8 * first)
            last = force(point + h * ray + h * h / 2 * middle)
            return (
                point + h * ray + h * h / 6 * (first + 2 * middle),
                ray + h / 6 * (first + 4 * middle + last),
            )

        return jax.lax.fori_loop(0, _STEPS, step, start)


SEEN, VIGNETTED, REFLECTED, MISSED = 0, 1, 2, 3
"""Status of a line of sight: it reaches the eye's inside, the iris stops it, a surface reflects it
totally, or it misses a surface."""


class Refracting(eqx.Module):
    """A surface, and the medium behind it.

    Attributes:
        medium: the medium on its far side, seen from the microscope.
    """

    surface: Conic
    medium: Medium

    @property
    def depth(self) -> Float[Array, ""]:
        """Depth zeta of the vertex, mm below the cornea's vertex."""
        return self.surface.depth


class ThinLens(eqx.Module):
    """An ideal thin lens in air: it takes power times height off a ray's slope.

    Attributes:
        depth: zeta, mm below the cornea's vertex; negative above it.
        power: 1/f, 1/mm.
    """

    depth: Float[Array, ""]
    power: Float[Array, ""]


class Iris(eqx.Module):
    """The iris: rays farther from the axis than its radius are vignetted.

    Attributes:
        depth: zeta, mm below the cornea's vertex.
        radius: of the dilated pupil, mm.
    """

    depth: Float[Array, ""]
    radius: Float[Array, ""]


Element = Refracting | ThinLens | Iris


class TracedRays(NamedTuple):
    """Rays behind the last surface, in the frame of `Conic`.

    Attributes:
        point: a point of the ray inside the eye, mm.
        transmittance: fraction of the power that Fresnel's reflections leave.
        status: SEEN, VIGNETTED, REFLECTED or MISSED; the first that holds.
    """

    point: Float[Array, "*batch 3"]
    direction: Float[Array, "*batch 3"]
    transmittance: Float[Array, "*batch"]
    status: Int[Array, "*batch"]


def trace(
    elements: tuple[Element, ...],
    origin: Float[Array, "*batch 3"],
    direction: Float[Array, "*batch 3"],
    *,
    medium: Medium | None = None,
    front: ScalarLike = 0.0,
) -> TracedRays:
    """Trace rays through elements in the order in which light meets them.

    Args:
        elements: of the path; each refracting medium ends at the next surface.
        origin: mm, in the frame of `Conic`, in front of the first element.
        direction: unit vectors with a positive third component.
        medium: in which the rays start; None for air.
        front: depth of the surface at which that medium begins, mm.

    Returns:
        The rays behind the last surface. A vignetted ray is traced on; the values of a ray that
        misses a surface or is reflected have no meaning.
    """
    point, medium = origin, Medium(1.0) if medium is None else medium
    transmittance = jnp.ones(origin.shape[:-1])
    status = jnp.full(origin.shape[:-1], SEEN)
    for element in elements:
        if isinstance(element, Refracting):
            point, direction, meets = medium.to_surface(
                point, direction, element.surface, front=front
            )
            direction, passed, passes = refract(
                direction=direction,
                normal=element.surface.normal(point),
                index_incident=medium.index_at(point, front=front),
                index_transmitted=element.medium.index_at(point, front=element.depth),
            )
            status = _first(status, ~meets, MISSED)
            status = _first(status, ~passes, REFLECTED)
            transmittance = transmittance * passed
            medium, front = element.medium, element.depth
        else:
            along = (element.depth - point[..., 2]) / direction[..., 2]
            point = point + along[..., None] * direction
            x, y, _ = components(point)
            if isinstance(element, Iris):
                # Squares, because the derivative of the root is infinite on the axis.
                status = _first(status, x * x + y * y > element.radius**2, VIGNETTED)
            else:
                dx, dy, dz = components(direction)
                slopes = dx / dz - element.power * x, dy / dz - element.power * y
                slope = jnp.stack([*slopes, jnp.ones_like(dz)], axis=-1)
                direction = slope / jnp.linalg.norm(slope, axis=-1, keepdims=True)
    return TracedRays(point, direction, transmittance, status)


def _first(status: Int[Array, "*batch"], fails: Array, code: int) -> Int[Array, "*batch"]:
    return jnp.where((status == SEEN) & fails, code, status)
