r"""Radiance of the wall behind pixels, lit by a cone or a lens, as a differentiable function.

A Lambertian wall of reflectance rho sends the radiance

$$ L = \frac{\rho}{\pi}\bigl(P\,E(X) + E_\mathrm{indirect} + E_0\,c(X)\bigr) $$

towards the microscope. P is the power, E the source's irradiance of the wall point X per unit
power, E_indirect the uniform light that a closed eyeball scatters back, and E_0 c(X) the
microscope's own light, E_0 at the pole. A pixel's mean is the value at its centre, with two
exceptions: pixels cut by the cone's edge, and the lens's light, whose edges can be one pixel wide.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, ScalarLike

import optics


class WallPixels(NamedTuple):
    """Wall points behind pixels, or behind squares of pixels.

    Attributes:
        point: X, mm, eye frame.
        normal: inward unit normal N.
        right, down: dX/du and dX/dv, mm per side of a pixel or square.
        bend_right, bend_down: dN/du and dN/dv, 1 per side.
        coaxial: irradiance from a light in the pinhole, relative to that at the pole.
    """

    point: Float[Array, "n 3"]
    normal: Float[Array, "n 3"]
    right: Float[Array, "n 3"]
    down: Float[Array, "n 3"]
    bend_right: Float[Array, "n 3"]
    bend_down: Float[Array, "n 3"]
    coaxial: Float[Array, "n"]


class BeamLight(Protocol):
    """A light source at a tip, pointing along an axis."""

    def irradiance(
        self, wall: WallPixels, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
    ) -> Float[Array, "n"]:
        """Mean irradiance of each pixel's wall per unit power, 1/mm²."""

    def lit(
        self, wall: WallPixels, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
    ) -> Float[Array, "n"]:
        """Fraction of each pixel on the lit side of a sharp edge."""

    def emitted(self) -> Float[Array, ""]:
        """Fraction of the power that reaches the wall."""


def wall_pixels(
    pixels: Float[Array, "n 2"],
    *,
    microscope: optics.Microscope,
    surface: optics.Surface,
    sides: Float[Array, "n"] | None = None,
) -> WallPixels:
    """Wall points behind pixels, with their derivatives with respect to u and v.

    Args:
        pixels: (u, v) of the pixels' centres, px.
        microscope: the camera.
        surface: the wall.
        sides: sides of squares of pixels, px; None: 1, which the light of a cone requires.
    """

    def hit(at: Array) -> tuple[tuple[Array, Array], Array]:
        origin, sight = microscope.ray(at)
        meeting = surface.intersect(origin, sight)
        return (meeting.point, meeting.normal), sight

    def moved(by: tuple[float, float]) -> tuple[tuple[Array, Array], tuple[Array, Array], Array]:
        return jax.jvp(hit, (pixels,), (jnp.broadcast_to(jnp.array(by), pixels.shape),), True)

    (point, normal), (right, bend_right), sight = moved((1.0, 0.0))
    _, (down, bend_down), _ = moved((0.0, 1.0))
    x, y, _ = optics.components(point)
    across = jnp.square(microscope.inverse_working_distance) * (x**2 + y**2)
    depth = microscope.depth(point)
    coaxial = -optics.dot(normal, sight) / (across + jnp.square(depth))
    wall = WallPixels(point, normal, right, down, bend_right, bend_down, coaxial)
    if sides is None:
        return wall
    return wall._replace(
        right=sides[:, None] * right,
        down=sides[:, None] * down,
        bend_right=sides[:, None] * bend_right,
        bend_down=sides[:, None] * bend_down,
    )


def radiance(
    wall: WallPixels,
    values: Mapping[str, ScalarLike],
    *,
    source: BeamLight,
    tip: Float[Array, "3"],
    axis: Float[Array, "3"],
    eyeball: bool,
) -> Float[Array, "n"]:
    """Radiance of the wall behind pixels, mW/(mm² sr).

    Args:
        wall: from `wall_pixels`.
        values: `reflectance`, `power` (mW), `illumination` (mW/mm² at the pole), `eye_radius` (mm).
        source: the light.
        tip: S, mm.
        axis: unit vector from the tip towards the wall.
        eyeball: whether the wall is a closed eyeball, which scatters light back onto itself.
    """
    light = jnp.asarray(values["power"]) * source.irradiance(wall, tip=tip, axis=axis)
    light += values["illumination"] * wall.coaxial
    if eyeball:
        light += optics.indirect_irradiance(
            flux=values["power"] * source.emitted(),
            reflectance=values["reflectance"],
            eye_radius=values["eye_radius"],
        )
    return jnp.asarray(values["reflectance"]) / jnp.pi * light


def off_axis_part(offset: Array, axis: Array) -> Array:
    """The part of vectors that is perpendicular to an axis."""
    return offset - optics.dot(offset, axis)[..., None] * axis
