"""The fibre's beam: a cone, given by tip and axis, by spot and distance, or through a trocar."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, ScalarLike

from eyespot.optics.lines import cone_generators
from eyespot.optics.surface import Intersection, Sphere, Surface


class Beam(eqx.Module):
    r"""Cone of light: radius $R(s) = (s - b)\tan\alpha$ at distance s from the tip.

    Zhou et al. 2020, eq. 1 (d = kR + b) with $k = 1/\tan\alpha$; the virtual apex is
    $S + b\,\mathbf{u}$ and lies behind the tip for b < 0.

    Attributes:
        tip: S, mm, eye frame.
        axis: unit vector from the tip towards the wall.
        half_angle: alpha, rad.
        apex_offset: b, mm.
    """

    tip: Float[Array, "3"]
    axis: Float[Array, "3"]
    half_angle: Float[Array, ""]
    apex_offset: Float[Array, ""]

    def __init__(
        self,
        *,
        tip: Float[ArrayLike, "3"],
        axis: Float[ArrayLike, "3"],
        half_angle: ScalarLike,
        apex_offset: ScalarLike,
    ) -> None:
        self.tip, self.axis = jnp.asarray(tip, float), jnp.asarray(axis, float)
        self.half_angle = jnp.asarray(half_angle, float)
        self.apex_offset = jnp.asarray(apex_offset, float)

    @property
    def apex(self) -> Float[Array, "3"]:
        """Virtual apex, mm."""
        return self.tip + self.apex_offset * self.axis

    def generators(self, angles: Float[Array, "n"]) -> Float[Array, "n 3"]:
        """Unit directions of the cone's generators at angles (rad) around the axis."""
        return cone_generators(self.axis, self.half_angle, angles)

    def spot(self, surface: Surface) -> Intersection:
        """O, where the axis meets the wall; `distance` is d = |SO|, mm."""
        return surface.intersect(self.tip, self.axis)


def slope(half_angle: ArrayLike) -> Array:
    """k = 1/tan(theta/2), dimensionless (Zhou et al. 2020, eq. 1); half_angle in rad.

    Example:
        >>> round(float(slope(0.0499584)), 3)  # half of 5.7 degrees: the default cone
        20.0
    """
    return 1.0 / jnp.tan(half_angle)


def beam_at_spot(
    surface: Surface,
    *,
    eccentricity: ScalarLike,
    distance: ScalarLike,
    azimuth: ScalarLike = 0.0,
    incidence: ScalarLike = 0.0,
    incidence_azimuth: ScalarLike = 0.0,
    half_angle: ScalarLike,
    apex_offset: ScalarLike,
) -> Beam:
    """Beam that meets the wall at a given spot from a given distance.

    Args:
        eccentricity: c, distance of O from the microscope's axis, mm, in [0, r).
        distance: d = |SO|, mm.
        azimuth: azimuth of O around the microscope's axis, rad.
        incidence: angle between the beam's axis and the outward normal at O, rad.
        incidence_azimuth: 0 if the beam travels towards larger eccentricity, so that the tip is
            nearer to the microscope's axis than O; increases with the azimuth, rad.
        half_angle: alpha, rad.
        apex_offset: b, mm.
    """
    frame = surface.frame_at(
        eccentricity=jnp.asarray(eccentricity, float), azimuth=jnp.asarray(azimuth, float)
    )
    sideways = (
        jnp.cos(incidence_azimuth) * frame.meridional + jnp.sin(incidence_azimuth) * frame.azimuthal
    )
    axis = jnp.cos(incidence) * frame.outward + jnp.sin(incidence) * sideways
    return Beam(
        tip=frame.origin - distance * axis,
        axis=axis,
        half_angle=half_angle,
        apex_offset=apex_offset,
    )


def tip_radius(*, fibre_diameter: float, half_angle: float, apex_offset: float) -> float:
    """Radius of the rim that touches the wall first, mm: the fibre's.

    The ideal cone of an old file may be wider at the tip than its fibre (-b tan(alpha)). Its edge
    is then the rim, because no light reaches a point of the wall behind the tip.

    Args:
        fibre_diameter: mm.
        half_angle: alpha, rad.
        apex_offset: b, mm.
    """
    return max(fibre_diameter / 2, -apex_offset * math.tan(half_angle))


def contact_distance(
    surface: Surface, *, incidence: ScalarLike, rim_radius: ArrayLike
) -> Float[Array, ""]:
    r"""Distance d along the beam at which the rim of a tilted flat tip touches the wall.

    On a plane $\rho\tan\iota$. Inside a sphere the rim point deepest towards the wall satisfies
    $(r\cos\iota - d)^2 + (r\sin\iota + \rho)^2 = r^2$.

    Args:
        incidence: iota, rad.
        rim_radius: rho, radius of the tip's face, mm.

    Returns:
        d at first contact, mm; at perpendicular incidence 0 on a plane, slightly above 0 in a
        sphere.
    """
    if isinstance(surface, Sphere):
        r = surface.radius
        return r * jnp.cos(incidence) - jnp.sqrt(r**2 - (r * jnp.sin(incidence) + rim_radius) ** 2)
    return jnp.asarray(rim_radius) * jnp.tan(jnp.asarray(incidence, float))
