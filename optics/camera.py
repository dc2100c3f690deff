"""Pinhole microscope at any height: above the retina, at infinity, or behind it."""

from abc import abstractmethod
from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, ScalarLike

from eyespot.formats.inputs import InputError
from eyespot.optics.lines import dot, pinhole_image

_UNDISTORT_STEPS = 12


class Camera(eqx.Module):
    """What projects points of the eye: a `Microscope`, or a `PathCamera` of `optics.viewing`.

    Attributes:
        scale: delta, mm per px at the height of the pole.
        pole_height: Z of the retinal pole, mm.
        principal_point: (u0, v0), px; may lie outside the window.
    """

    scale: eqx.AbstractVar[Float[Array, ""]]
    pole_height: eqx.AbstractVar[Float[Array, ""]]
    principal_point: eqx.AbstractVar[Float[Array, "2"]]

    @abstractmethod
    def project(self, points: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch 2"]:
        """Image of points (X, Y, Z; mm, eye frame), px of the window."""

    @abstractmethod
    def ray(
        self, pixels: Float[ArrayLike, "*batch 2"]
    ) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
        """Line of sight of pixels (u, v), the inverse of `project`.

        Returns:
            The line's point at the pole's height, mm, and its unit direction away from the
            microscope.
        """

    def centred_on(
        self,
        point: Float[Array, "3"],
        *,
        width: int,
        height: int,
        offset: tuple[float, float] = (0.0, 0.0),
    ) -> Self:
        """The same camera with its sensor window shifted so that `point` is in the middle.

        It stays on the axis: the window is shifted, the camera is not tilted.

        Args:
            point: eye frame, mm.
            width: of the window, px, as its height.
            offset: of the window's middle from the point's image, px.
        """
        middle = jnp.array([(width - 1) / 2.0, (height - 1) / 2.0])
        shift = middle - jnp.array(offset) - self.project(point)
        return eqx.tree_at(lambda c: c.principal_point, self, self.principal_point + shift)

    def line_of_sight(
        self, at_pole: Float[Array, "*batch 2"], slope: Float[Array, "*batch 2"]
    ) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
        """Point and unit direction of lines that cross the pole's height at (X, Y), mm.

        Args:
            at_pole: X and Y there.
            slope: their growth per mm of descent.
        """
        height = jnp.broadcast_to(self.pole_height, (*at_pole.shape[:-1], 1))
        direction = jnp.concatenate([slope, -jnp.ones_like(height)], axis=-1)
        return (
            jnp.concatenate([at_pole, height], axis=-1),
            direction / jnp.linalg.norm(direction, axis=-1, keepdims=True),
        )


class Microscope(Camera):
    r"""Pinhole camera on the +z axis, looking down at the retinal pole.

    With the reciprocal working distance $\kappa = 1/(z_F + r)$ a point (X, Y, Z) images at

    $$ u = u_0 + \frac{X/\delta}{1 - \kappa (Z + r)}, \qquad
       v = v_0 - \frac{Y/\delta}{1 - \kappa (Z + r)}, $$

    which is $u_0 + f X/(z_F - Z)$ with $f = (z_F + r)/\delta$, and stays finite for the telecentric
    microscope ($\kappa = 0$). With $\kappa < 0$ the lines of sight meet behind the retina, so that
    magnification grows with depth, as it does through a contact lens. Integer pixel coordinates are
    pixel centres (OpenCV's convention). The attributes of `Camera` are not repeated.

    Attributes:
        inverse_working_distance: kappa, 1/mm; 0 is telecentric, below 0 the pinhole lies behind
            the retina.
        distortion: Brown-Conrady (k1, k2, p1, p2, k3) in OpenCV's order and normalisation
            (Brown 1966); without effect for a telecentric microscope.
    """

    scale: Float[Array, ""]
    inverse_working_distance: Float[Array, ""]
    pole_height: Float[Array, ""]
    principal_point: Float[Array, "2"]
    distortion: Float[Array, "5"]

    @property
    def inverse_focal(self) -> Float[Array, ""]:
        """1/f in 1/px, with the sign of kappa; 0 for a telecentric microscope."""
        return self.inverse_working_distance * self.scale

    @property
    def pinhole_height(self) -> Float[Array, ""]:
        """z_F in mm; infinite for a telecentric microscope."""
        return 1.0 / self.inverse_working_distance + self.pole_height

    def depth(self, points: Float[Array, "*batch 3"]) -> Float[Array, "*batch"]:
        """(z_F - Z)/(z_F + r): 1 at the pole, 0 or less for invisible points."""
        return 1.0 - self.inverse_working_distance * (points[..., 2] - self.pole_height)

    def project(self, points: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch 2"]:
        """Image of points in front of the pinhole (`depth` > 0), as `Camera.project` describes."""
        offset = pinhole_image(
            jnp.asarray(points),
            scale=self.scale,
            inverse_working_distance=self.inverse_working_distance,
            pole_height=self.pole_height,
        )
        return self.principal_point + _distort(offset, self.distortion, self.inverse_focal)

    def ray(
        self, pixels: Float[ArrayLike, "*batch 2"]
    ) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
        """Line of sight of pixels, as `Camera.ray` describes it."""
        offset = _undistort(
            jnp.asarray(pixels) - self.principal_point, self.distortion, self.inverse_focal
        )
        xy = offset * jnp.array([1.0, -1.0]) * self.scale
        return self.line_of_sight(xy, self.inverse_working_distance * xy)

    def camera_matrix(self) -> Float[Array, "3 3"]:
        """OpenCV's matrix K for a camera at F that looks down (x right, y down, z away), px."""
        f = 1.0 / self.inverse_focal
        (u, v), one, zero = self.principal_point, jnp.ones(()), jnp.zeros(())
        return jnp.array([[f, zero, u], [zero, f, v], [zero, zero, one]])


def microscope(
    *,
    scale: ScalarLike,
    pinhole_height: ScalarLike,
    eye_radius: ScalarLike,
    principal_point: tuple[float, float] = (0.0, 0.0),
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0),
) -> Microscope:
    """Microscope from its pinhole's height.

    Args:
        scale: delta, mm/px at the pole.
        pinhole_height: z_F, mm above the eyeball's centre; `inf` is telecentric; below
            -eye_radius the pinhole lies behind the retina.
        eye_radius: r, mm; the pole (or the plane phantom) lies at Z = -r.
        principal_point: (u0, v0), px.
        distortion: (k1, k2, p1, p2, k3), OpenCV's order.

    Raises:
        InputError: scale is not positive, or the working distance z_F + r is 0.
    """
    delta = jnp.asarray(scale, float)
    # Traced values have no known size; check the others.
    if not isinstance(delta, jax.core.Tracer) and not delta > 0:
        raise InputError(f"microscope(scale=...) must be positive; got {scale} mm/px.")
    reach = jnp.asarray(pinhole_height, float) + eye_radius
    if not isinstance(reach, jax.core.Tracer) and not (reach > 0 or -jnp.inf < reach < 0):
        raise InputError(
            "microscope(pinhole_height=...) must lie above the retinal pole at -eye_radius, or "
            f"below it, or be inf; got {pinhole_height} mm with eye_radius={eye_radius} mm. Move "
            "the pinhole."
        )
    return Microscope(
        scale=delta,
        inverse_working_distance=1.0 / reach,
        pole_height=-jnp.asarray(eye_radius, float),
        principal_point=jnp.asarray(principal_point, float),
        distortion=jnp.asarray(distortion, float),
    )


def _distort(
    offset: Float[Array, "*batch 2"],
    distortion: Float[Array, "5"],
    inverse_focal: Float[Array, ""],
) -> Float[Array, "*batch 2"]:
    """Distorted offset from the principal point, px, of an ideal offset in px."""
    k1, k2, p1, p2, k3 = distortion
    x, y = offset[..., 0], offset[..., 1]
    squared = x * x + y * y
    r2 = squared * inverse_focal**2
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return jnp.stack(
        [
            x * radial + inverse_focal * (2 * p1 * x * y + p2 * (squared + 2 * x * x)),
            y * radial + inverse_focal * (p1 * (squared + 2 * y * y) + 2 * p2 * x * y),
        ],
        axis=-1,
    )


@jax.jit  # else every call would compile the loop anew
def _undistort(
    offset: Float[Array, "*batch 2"],
    distortion: Float[Array, "5"],
    inverse_focal: Float[Array, ""],
) -> Float[Array, "*batch 2"]:
    """Inverse of `_distort` by fixed-point steps.

    Each step reduces the error by the distortion's size: 10 % distortion converges to 1e-12.
    """

    def step(_: int, ideal: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
        return ideal + offset - _distort(ideal, distortion, inverse_focal)

    # Unrolled, the loop would take a second to compile wherever it is used.
    return jax.lax.fori_loop(0, _UNDISTORT_STEPS, step, offset)


def nearest_point(
    first: tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]],
    second: tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]],
) -> Float[Array, "*batch 3"]:
    """The point halfway between two lines where they are nearest, mm: triangulation of a pair.

    Args:
        first: a point (mm) and a direction of any length, as those of `Camera.ray`.
        second: another line.
    """
    (p, u), (q, v) = first, second
    u, v = (w / jnp.linalg.norm(w, axis=-1, keepdims=True) for w in (u, v))
    across, cosine = q - p, dot(u, v)
    on_u, on_v = dot(across, u), dot(across, v)
    along_u = (on_u - cosine * on_v) / (1.0 - cosine**2)
    along_v = (cosine * on_u - on_v) / (1.0 - cosine**2)
    return (p + along_u[..., None] * u + q + along_v[..., None] * v) / 2.0
