"""Pencils of a microscope with a lens's pupil: lines of sight about each pixel's own."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, ScalarLike

from eyespot.optics.viewing.path import ViewingPath, radial_nodes, series, skew_lines
from eyespot.optics.viewing.projection import PathCamera


class Pencils(eqx.Module):
    r"""Lines of sight through a pupil, to first order in their slopes against the central ones.

    In front of the path all lines of a pixel cross in one point of a plane, which the path images
    into the plane in focus inside the eye. A line with the slope $\sigma$ against the central one,
    which aims at t, lies

    $$ p(t^2)\,\sigma + q(t^2)\,(t\cdot\sigma)\,t $$

    beside it. Field curvature and astigmatism of the path are included; its coma and spherical
    aberration within a pencil are of higher order.

    Attributes:
        camera: its central lines.
        across: Chebyshev coefficients of p at the pole's height, mm, and of its growth with depth.
        along: the same of q, 1/mm, and of its growth.
    """

    camera: PathCamera
    across: Float[Array, "2 terms"]
    along: Float[Array, "2 terms"]

    def ray(
        self, pixels: Float[ArrayLike, "*batch 2"], slope: Float[ArrayLike, "*batch 2"]
    ) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
        """Lines of sight inside the eye, as `Camera.ray` describes them.

        Args:
            pixels: (u, v), px.
            slope: of the lines against the central ones in front of the path, X and Y.
        """
        point, direction = self.camera.ray(pixels)
        aim, slope = self.camera.aim(pixels), jnp.asarray(slope)
        place = self.camera.place(jnp.sum(aim * aim, axis=-1))
        turned = jnp.sum(aim * slope, axis=-1, keepdims=True) * aim
        at_pole, growth = (
            series(p, place)[..., None] * slope + series(q, place)[..., None] * turned
            for p, q in zip(self.across, self.along, strict=True)
        )
        central = direction[..., :2] / -direction[..., 2:]
        return self.camera.line_of_sight(point[..., :2] + at_pole, central + growth)


@eqx.filter_jit
def focal_depth(path: ViewingPath, *, focus: ScalarLike) -> Float[Array, ""]:
    """Depth of the plane whose paraxial image by the path is a plane inside the eye.

    Args:
        focus: height of the plane inside the eye above the retinal pole, mm.

    Returns:
        mm below the cornea's vertex, as if there were only air; negative above it.
    """

    def at_focus(aim: Float[Array, ""], slope: Float[Array, ""]) -> Float[Array, ""]:
        line = (jnp.stack([value, jnp.zeros(())]) for value in (aim, slope))
        at_pole, growth, _ = skew_lines(path, *line)
        return at_pole[0] - growth[0] * focus

    by_aim, by_slope = jax.jacfwd(at_focus, (0, 1))(jnp.zeros(()), jnp.zeros(()))
    return by_slope / by_aim


@eqx.filter_jit
def pencils(path: ViewingPath, camera: PathCamera, *, depth: ScalarLike) -> Pencils:
    """The pencils of a microscope that is focused on a plane.

    Args:
        camera: the microscope behind it (`path_camera`).
        depth: of the plane in focus in front of the path, mm (`focal_depth`).
    """
    t, to_series = radial_nodes(camera.widest)

    def deviation(t: Float[Array, ""], slope: Float[Array, "2"]) -> Float[Array, "2 2"]:
        aim = jnp.stack([t, jnp.zeros(())])

        def moved(part: Float[Array, ""]) -> Float[Array, "2 2"]:
            # It crosses the central line at the depth in focus.
            beside = aim - depth * part * slope
            return jnp.stack(
                skew_lines(path, beside, path.pinhole_closeness * aim + part * slope)[:2]
            )

        return jax.jvp(moved, (jnp.zeros(()),), (jnp.ones(()),))[1]

    radial, sideways = (jax.vmap(deviation, (0, None))(t, slope) for slope in jnp.eye(2))
    p, q = sideways[..., 1], (radial[..., 0] - sideways[..., 1]) / t[:, None] ** 2
    return Pencils(camera=camera, across=(to_series @ p).T, along=(to_series @ q).T)
