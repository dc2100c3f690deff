"""A microscope whose pinhole lies beside the axis of the eye: one half of a stereo pair."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, ScalarLike

from optics import Camera, InputError
from optics.viewing.path import ViewingPath, skew_lines
from optics.viewing.trace import SEEN, TracedRays

_NEWTON_STEPS = 6
_STEP_MM = 1e-4  # of the derivatives; Newton's steps then gain four digits each


class SideCamera(Camera):
    """A pinhole beside the axis, behind a viewing path.

    The path is symmetric about the axis, but the pinhole is not on it, so lines of sight are traced
    one by one. A pixel belongs to the point at which its line of sight, before any refraction,
    crosses the plane of the cornea's vertex. Both halves of a pair have this plane in common, as
    the two paths through one main objective do.

    Attributes:
        path: the viewing path; without elements, a pinhole alone. Its `pinhole_closeness` is
            the pinhole's height, measured along the axis.
        aside: X and Y of the pinhole, mm.
        scale: delta of the pinhole on the axis, mm per px at the pole.
        principal_point: image of the cornea's vertex, px.
        pole_height: Z of the retinal pole, mm.
        px_per_aim: pixels per mm in the plane of the cornea's vertex; negative if the image is
            turned upright.
    """

    path: ViewingPath
    aside: Float[Array, "2"]
    scale: Float[Array, ""]
    principal_point: Float[Array, "2"]
    pole_height: Float[Array, ""]
    px_per_aim: Float[Array, ""]

    def ray(
        self, pixels: Float[ArrayLike, "*batch 2"]
    ) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
        """Line of sight of pixels inside the eye, as `Camera.ray` describes it."""
        at_pole, slope, _ = self._lines(self._aim(pixels))
        return self.line_of_sight(at_pole, slope)

    def project(self, points: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch 2"]:
        """Image of points inside the eye, by Newton's method on the traced lines of sight.

        Args:
            points: X, Y, Z in mm, eye frame; `sees` says which are visible.

        Returns:
            (u, v) in px of the window. Points outside the field have values without meaning.
        """
        offset = self._aims_at(points) * self.px_per_aim * jnp.array([1.0, -1.0])
        return self.principal_point + offset

    def sees(self, points: Float[ArrayLike, "*batch 3"]) -> Bool[Array, "*batch"]:
        """Whether the line of sight of points passes every surface and the iris."""
        return self._lines(self._aims_at(points))[2].status == SEEN

    def transmittance(self, pixels: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch"]:
        """Fraction of the light of pixels that passes the surfaces; 0 where none passes."""
        rays = self._lines(self._aim(pixels))[2]
        return jnp.where(rays.status == SEEN, rays.transmittance, 0.0)

    def _aim(self, pixels: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        offset = (jnp.asarray(pixels) - self.principal_point) / self.px_per_aim
        return offset * jnp.array([1.0, -1.0])

    def _lines(
        self, aim: Float[Array, "*batch 2"]
    ) -> tuple[Float[Array, "*batch 2"], Float[Array, "*batch 2"], TracedRays]:
        """X and Y at the pole's height, their growth per mm of descent, and the rays."""
        slope = (aim - self.aside) * self.path.pinhole_closeness
        return skew_lines(self.path, aim, slope)

    def _aims_at(self, points: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch 2"]:
        """Where the lines of sight aim that meet points."""
        steps = _STEP_MM * jnp.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])

        def found(point: Float[Array, "3"]) -> Float[Array, "2"]:
            def step(_: int, aim: Float[Array, "2"]) -> Float[Array, "2"]:
                # Three lines in one call: derivatives of the trace would take longer to compile.
                at_pole, slope = self._lines(aim + steps)[:2]
                missed = at_pole - slope * (point[2] - self.pole_height) - point[:2]
                jacobian = (missed[1:] - missed[0]).T / _STEP_MM
                return aim - jnp.linalg.inv(jacobian) @ missed[0]

            return jax.lax.fori_loop(0, _NEWTON_STEPS, step, jnp.zeros(2))

        every = jnp.asarray(points)
        return jax.vmap(found)(every.reshape(-1, 3)).reshape(*every.shape[:-1], 2)


def side_camera(
    path: ViewingPath,
    *,
    aside: Float[ArrayLike, "2"] | tuple[float, float],
    scale: ScalarLike,
    upright: bool = False,
) -> SideCamera:
    """A microscope beside the axis; `centred_on` places its window.

    Args:
        path: the viewing path; `bare_path` for none.
        aside: X and Y of the pinhole, mm.
        scale: delta at the pole, mm/px, of a pinhole on the axis at the same height. The pixel is
            as large on the sensors of both halves of a pair.
        upright: turn the inverted image of a wide-field lens, as a stereo inverter does.

    Raises:
        InputError: the path's pinhole is at infinity, so it cannot be beside the axis.
    """
    closeness = path.pinhole_closeness
    if not isinstance(closeness, jax.core.Tracer) and not closeness > 0.0:
        raise InputError(
            "side_camera needs a pinhole at a finite height; got a path with pinhole_distance inf. "
            "Give viewing_path(pinhole_distance=...) in mm."
        )
    on_axis = SideCamera(
        path=path,
        aside=jnp.zeros(2),
        scale=jnp.asarray(scale, float),
        principal_point=jnp.zeros(2),
        pole_height=-path.retina_semi_axes[2],
        px_per_aim=jnp.ones(()),
    )
    magnification = jax.jacfwd(lambda aim: on_axis._lines(aim)[0])(jnp.zeros(2))[0, 0]
    orientation = jnp.sign(magnification) if upright else 1.0
    return eqx.tree_at(
        lambda c: (c.aside, c.px_per_aim),
        on_axis,
        (jnp.asarray(aside, float), orientation * jnp.abs(magnification) / scale),
    )


def bare_path(*, eye_radius: ScalarLike, pinhole_height: ScalarLike) -> ViewingPath:
    """The path without any optics, over a spherical eyeball.

    Args:
        eye_radius: r, mm. The plane that stands for the cornea's vertex touches the eyeball.
        pinhole_height: z_F, mm.
    """
    radius = jnp.asarray(eye_radius, float)
    return ViewingPath(
        elements=(),
        pinhole_closeness=1.0 / (jnp.asarray(pinhole_height, float) - radius),
        pole_depth=2.0 * radius,
        retina_semi_axes=jnp.stack([radius, radius, radius]),
    )
