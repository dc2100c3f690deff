r"""Light of a uniform cone: the lit part of pixels at its edge, and light that the wall spreads.

On cells the light is a share of the cone's solid angle, in closed form. A cone of constant
intensity sends light in proportion to the solid angle, seen from its apex. So the light through a
patch is a sum over the patch's straight sides. The part of a side inside the cone adds the solid
angle of its triangle with the axis (Van Oosterom and Strackee 1983),

$$ \tan\frac{\Omega}{2} = \frac{\mathbf u \cdot (\mathbf p \times \mathbf q)}
   {|\mathbf p||\mathbf q| + (\mathbf u\cdot\mathbf p)|\mathbf q|
    + (\mathbf u\cdot\mathbf q)|\mathbf p| + \mathbf p\cdot\mathbf q}, $$

over that of the cone. A part outside adds its angle about the axis, over a whole turn: its triangle
with the axis holds that share of the cone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm
from jaxtyping import Array, Float, ScalarLike

import optics
from optics import dot
from optics.wall_light.cells import Sides, WallPixels, off_axis_part

_ACROSS = 1e-3  # px; avoids a width of 0 for an edge parallel to a pixel's side
_SPREAD_LINES = 16  # through a wall point, of the light of a cone
_FAR_PX, _FAR_SIGMAS = 2.0, 9.0  # distance from an edge beyond which a pixel is fully lit or dark


class Edge(NamedTuple):
    """Position of pixels relative to an edge.

    Attributes:
        inside: distance of the pixels' centres from the edge, px, positive on the lit side.
        normal_u, normal_v: components of the edge's unit normal towards the lit side.
    """

    inside: Float[Array, "*n"]
    normal_u: Float[Array, "*n"]
    normal_v: Float[Array, "*n"]


class Cone(eqx.Module):
    """A uniform cone: constant intensity inside, none outside.

    Attributes:
        half_angle: alpha, rad.
        apex_offset: b, mm.
        blur: sigma of the microscope's Gaussian blur at the cone's edge, px, or None.
        spread: L of the light's spread in the wall (`optics.truth`), mm, or None.
    """

    half_angle: Float[Array, ""]
    apex_offset: Float[Array, ""]
    blur: Float[Array, ""] | None
    spread: Float[Array, ""] | None = None

    def irradiance(
        self, wall: WallPixels, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
    ) -> Float[Array, "n"]:
        """Intensity over squared distance, times cosine, over the pixel's part inside the cone."""
        if self.spread is not None:
            return self._spread_light(wall, tip, axis, spread=self.spread) / self._solid_angle()
        edge = self._edge(wall, tip, axis)
        along = edge.normal_u[:, None] * wall.right + edge.normal_v[:, None] * wall.down
        bend = edge.normal_u[:, None] * wall.bend_right + edge.normal_v[:, None] * wall.bend_down

        def even(point: Array, normal: Array) -> Array:
            offset = point - (tip + self.apex_offset * axis)
            squared = dot(offset, offset)
            return -dot(offset, normal) / (squared * jnp.sqrt(squared))

        value, slope = jax.jvp(even, (wall.point, wall.normal), (along, bend))
        # The centre of a cut pixel's lit part is not the pixel's centre.
        whole = lit_part(edge, blur=self.blur) * value + lit_moment(edge, blur=self.blur) * slope
        return whole / self._solid_angle()

    def _solid_angle(self) -> Array:
        return 2.0 * jnp.pi * (1.0 - jnp.cos(self.half_angle))

    def _spread_light(
        self,
        wall: WallPixels,
        tip: Float[Array, "3"],
        axis: Float[Array, "3"],
        *,
        spread: Array,
    ) -> Float[Array, "n"]:
        """Light that the wall has spread, as the mean over lines through wall points.

        A line is inside the cone between two distances from the point. Of the light that arrives
        along it, the kernel's share between them is lit. For distances t along w, from the point at
        o from the apex, these are the roots of a t^2 + 2 b t + c = cos^2(alpha) |o + t w|^2 -
        ((o + t w) . axis)^2.
        """
        squared_cosine = jnp.square(jnp.cos(self.half_angle))
        first = wall.right / jnp.linalg.norm(wall.right, axis=-1, keepdims=True)
        second = jnp.cross(wall.normal, first)
        rises = dot(first, axis), dot(second, axis)
        # Gauss-Hermite nodes with the variance of the pixel and of the microscope's blur.
        aside = jnp.sqrt(1.0 / 12.0 + (0.0 if self.blur is None else jnp.square(self.blur)))

        def at_corner(total: Array, corner: Array) -> tuple[Array, None]:
            point = wall.point + aside * (corner[0] * wall.right + corner[1] * wall.down)
            offset = point - (tip + self.apex_offset * axis)
            height = dot(offset, axis)
            c = squared_cosine * dot(offset, offset) - jnp.square(height)
            b_first, b_second = (
                squared_cosine * dot(offset, way) - height * rise
                for way, rise in zip((first, second), rises, strict=True)
            )

            def quadratic(cosine: Array, sine: Array) -> tuple[Array, Array]:
                rise = cosine * rises[0] + sine * rises[1]
                return squared_cosine - jnp.square(rise), cosine * b_first + sine * b_second

            axis_angle, reach = _lines_inside(quadratic, c)

            def along_line(lit: Array, turn: Array) -> tuple[Array, None]:
                # From a point outside the cone only some lines meet it; all nodes are among them.
                sine = reach * jnp.sin(turn)
                cosine = jnp.sqrt(1.0 - jnp.square(sine))
                angle = axis_angle + jnp.arctan2(sine, cosine)
                a, b = quadratic(jnp.cos(angle), jnp.sin(angle))
                inside = jnp.square(b) - a * c
                meets = inside > 0.0
                root = jnp.sqrt(jnp.where(meets, inside, 1.0))
                near, far = (-b - root) / a, (-b + root) / a
                share = jnp.zeros(())
                for begin, end in ((near, far), (-far, -near)):  # ahead, and behind
                    begin, end = jnp.maximum(begin, 0.0), jnp.maximum(end, 0.0)
                    share += optics.enclosed(end, spread)
                    share -= optics.enclosed(begin, spread)
                weight = reach * jnp.cos(turn) / cosine / (2 * _SPREAD_LINES)
                return lit + jnp.where(meets, weight * share, 0.0), None

            turns = (np.arange(_SPREAD_LINES) + 0.5) * (np.pi / _SPREAD_LINES) - 0.5 * np.pi
            lit = jax.lax.scan(along_line, jnp.zeros(c.shape), jnp.asarray(turns))[0]
            squared = dot(offset, offset)
            even = -dot(offset, wall.normal) / (squared * jnp.sqrt(squared))
            return total + 0.25 * even * lit, None

        corners = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
        return jax.lax.scan(at_corner, jnp.zeros(wall.coaxial.shape), jnp.asarray(corners))[0]

    def lit(
        self, wall: WallPixels, *, tip: Float[Array, "3"], axis: Float[Array, "3"]
    ) -> Float[Array, "n"]:
        """Fraction of each pixel inside the cone."""
        if self.spread is not None:  # no edge is as sharp as a pixel
            return jnp.ones(wall.coaxial.shape)
        return lit_part(self._edge(wall, tip, axis), blur=self.blur)

    def _edge(self, wall: WallPixels, tip: Float[Array, "3"], axis: Float[Array, "3"]) -> Edge:
        """The edge's place and direction in the image."""
        offset = wall.point - (tip + self.apex_offset * axis)
        along, lateral = dot(offset, axis), off_axis_part(offset, axis)
        off_axis = jnp.sqrt(dot(lateral, lateral) + 1e-24)
        sin_a, cos_a = jnp.sin(self.half_angle), jnp.cos(self.half_angle)
        # Distance from the cone's surface, mm. Divided by its slope in the image, it is in px.
        inside = along * sin_a - off_axis * cos_a
        inwards = sin_a * axis - cos_a * lateral / off_axis[:, None]
        slope_u, slope_v = dot(inwards, wall.right), dot(inwards, wall.down)
        per_px = jnp.hypot(slope_u, slope_v)
        normal_u, normal_v = slope_u / per_px, slope_v / per_px
        # The edge is curved, so the mean over a pixel or over the blur lies behind its tangent.
        tangent = normal_u[:, None] * wall.down - normal_v[:, None] * wall.right
        around = dot(tangent, jnp.cross(axis, lateral)) / off_axis
        width = 1.0 / 12.0 + (0.0 if self.blur is None else jnp.square(self.blur))
        # The radius is the edge's. With a wide blur, a pixel's own may be far from it.
        recedes = 0.5 * width * cos_a**2 * jnp.square(around) / (jnp.abs(along) * sin_a + 1e-12)
        return Edge((inside - recedes) / per_px, normal_u, normal_v)

    def emitted(self) -> Float[Array, ""]:
        """1: the whole power."""
        return jnp.ones(())


def lit_part(edge: Edge, *, blur: ScalarLike | None = None) -> Float[Array, "*n"]:
    r"""Exact fraction of a pixel on the lit side of a straight edge, with or without Gaussian blur.

    A pixel projected along the edge is a trapezoid, the convolution of boxes of width $|n_u|$ and
    $|n_v|$. Its lit fraction is therefore a mixed second difference of $G_2$, the second integral
    of the step, $\max(t, 0)^2/2$, or of the blurred step $\Phi(t/\sigma)$.

    Args:
        edge: position of the pixels relative to the edge.
        blur: sigma, px, or None.
    """
    return _second_difference(2, edge, blur)


def lit_moment(edge: Edge, *, blur: ScalarLike | None = None) -> Float[Array, "*n"]:
    r"""First moment of a pixel's lit part about its centre, along the edge's normal, px.

    $-t\,L(t) + \int L\,dt$ with L the lit fraction: 0 for fully lit and for dark pixels.

    Args: as for `lit_part`.
    """
    t = _near(edge, blur)
    return _second_difference(3, edge, blur) - t * _second_difference(2, edge, blur)


def _near(edge: Edge, blur: ScalarLike | None) -> Array:
    far = _FAR_PX + (0.0 if blur is None else _FAR_SIGMAS * jnp.asarray(blur))
    return jnp.clip(edge.inside, -far, far)


def _second_difference(order: int, edge: Edge, blur: ScalarLike | None) -> Array:
    """Second difference of the step's integral of the given order over a pixel's two widths."""
    t = _near(edge, blur)
    a = jnp.maximum(jnp.abs(edge.normal_u), _ACROSS)
    b = jnp.maximum(jnp.abs(edge.normal_v), _ACROSS)

    def integral(x: Array) -> Array:
        if blur is None:
            return jnp.maximum(x, 0.0) ** order / order / (order - 1)
        variance, cdf = jnp.square(blur), norm.cdf(x / blur)
        density = blur * norm.pdf(x / blur)
        if order == 2:
            return 0.5 * ((x * x + variance) * cdf + x * density)
        return (x * (x * x + 3 * variance) * cdf + (x * x + 2 * variance) * density) / 6

    wide, narrow = 0.5 * (a + b), 0.5 * (a - b)
    ends = integral(t + wide) - integral(t + narrow) - integral(t - narrow) + integral(t - wide)
    return ends / (a * b)


def _lines_inside(
    quadratic: Callable[[Array, Array], tuple[Array, Array]], c: Array
) -> tuple[Array, Array]:
    """Which lines through wall points meet a cone: those around an angle, up to asin(reach) aside.

    b^2 - a c is a quadratic form of a line's direction. It is positive for lines that meet the
    cone: for all from a point inside. The result has no derivatives, because a mean over lines
    does not depend on how these are chosen.

    Args:
        quadratic: a and b by the cosine and sine of the line's angle.
        c: as in `Cone._spread_light`.
    """

    def form(angle: float) -> Array:
        a, b = quadratic(jnp.cos(angle), jnp.sin(angle))
        return jnp.square(b) - a * c

    right, down, between = form(0.0), form(0.5 * np.pi), form(0.25 * np.pi)
    mean, half, mixed = 0.5 * (right + down), 0.5 * (right - down), between - 0.5 * (right + down)
    differs = jnp.hypot(half, mixed)
    most, least = mean + differs, mean - differs
    outside = least < 0.0
    share = jnp.maximum(most, 0.0) / jnp.where(outside, most - least, 1.0)
    reach = jnp.where(outside, jnp.sqrt(jnp.clip(share, 0.0, 1.0)), 1.0)
    return jax.lax.stop_gradient((0.5 * jnp.arctan2(mixed, half), reach))


class UniformCone(eqx.Module):
    """Constant intensity inside a cone, none outside.

    Attributes:
        half_angle: alpha, rad.
        apex_offset: b, mm.
    """

    half_angle: Float[Array, ""]
    apex_offset: Float[Array, ""]

    @classmethod
    def of(cls, half_angle: float, apex_offset: float) -> UniformCone:
        """A cone by its half-angle, rad, and apex offset, mm."""
        return cls(jnp.asarray(half_angle), jnp.asarray(apex_offset))

    def changed(self, by: Float[Array, "2"]) -> UniformCone:
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
