"""The microscope behind a viewing path: from a wall point to its pixel and back."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, ScalarLike

from optics import Camera, InputError, Surface, components
from optics.viewing.chebyshev import chebyshev_nodes, series, series_and_slope
from optics.viewing.path import ViewingPath, lines_of_sight
from optics.viewing.trace import SEEN, VIGNETTED

TERMS = 28  # of the Chebyshev series of a camera
_NEWTON_STEPS = 8
_SCAN = 400
_WIDEST_AIM_MM = 14.0
_BISECTIONS = 30
_BEYOND_THE_IRIS = 1.3
_SAFE = 0.98
"""The series covers 0.98 of the field in which lines of sight reach the retina, and no more than
1.3 of what the iris lets through. Towards the edge of the field they converge slowly."""


class PathCamera(Camera):
    r"""The microscope as it sees the eye's inside through a viewing path.

    The path is symmetric about the axis, so two functions of one variable describe all its lines of
    sight. A line that aims at a distance t from the axis crosses the pole's height at a distance
    $t\,a(t^2)$ from it, with the slope $t\,b(t^2)$ against it. Both are Chebyshev series in t².
    A point at a height $\Delta$ above the pole and a distance $\rho$ from the axis is seen at the t
    that solves

        $$ t\,(a(t^2) - b(t^2)\,\Delta) = \rho. $$

    It takes the place of a `Microscope` wherever points are projected.

    Attributes:
        scale: delta, mm per px at the pole.
        principal_point: (u0, v0), px.
        pole_height: Z of the retinal pole, mm.
        crossing: Chebyshev coefficients of a.
        steepness: Chebyshev coefficients of b, 1/mm.
        passing: Chebyshev coefficients of the transmittance.
        widest: largest t of the series, mm.
        pupil: largest t that passes the iris, mm; infinite if the iris stops no line of sight.
        orientation: +1 if the image is upright, -1 if it is inverted.
    """

    scale: Float[Array, ""]
    principal_point: Float[Array, "2"]
    pole_height: Float[Array, ""]
    crossing: Float[Array, "terms"]
    steepness: Float[Array, "terms"]
    passing: Float[Array, "terms"]
    widest: Float[Array, ""]
    pupil: Float[Array, ""]
    orientation: Float[Array, ""]

    @property
    def magnification(self) -> Float[Array, ""]:
        """a(0), mm on the retina per mm of t; negative through a wide-field lens."""
        return series(self.crossing, -1.0)

    @property
    def inverse_working_distance(self) -> Float[Array, ""]:
        """kappa of the paraxial pinhole inside the eye, b(0)/a(0), 1/mm."""
        return series(self.steepness, -1.0) / self.magnification

    def field(self, surface: Surface) -> Float[Array, ""]:
        """Largest eccentricity c on a wall that the microscope sees, mm."""
        edge = jnp.stack([jnp.minimum(self.widest, self.pupil), jnp.zeros(())])
        point, direction = self.ray(self.principal_point + edge * self.px_per_aim)
        hit = surface.intersect(point, direction).point
        return jnp.hypot(hit[0], hit[1])

    def project(self, points: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch 2"]:
        """Image of points inside the eye.

        Args:
            points: X, Y, Z in mm, eye frame; `sees` says which are visible.

        Returns:
            (u, v) in px of the window. Points outside the field have values without meaning.
        """
        x, y, z = components(jnp.asarray(points))
        per_mm = self._aim_per_mm(x * x + y * y, z - self.pole_height) * self.px_per_aim
        return self.principal_point + jnp.stack([x * per_mm, -y * per_mm], axis=-1)

    def ray(
        self, pixels: Float[ArrayLike, "*batch 2"]
    ) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
        """Line of sight of pixels inside the eye, as `Camera.ray` describes it."""
        aim = self.aim(pixels)
        # Without `keepdims`, as XLA does not vectorise a loop whose innermost length is 1.
        place = self.place(jnp.sum(aim * aim, axis=-1))
        crossing, steepness = series(self.crossing, place), series(self.steepness, place)
        return self.line_of_sight(crossing[..., None] * aim, steepness[..., None] * aim)

    def sees(self, points: Float[ArrayLike, "*batch 3"]) -> Bool[Array, "*batch"]:
        """Whether points lie inside the field and the iris does not hide them."""
        x, y, z = components(jnp.asarray(points))
        squared = x * x + y * y
        t2 = self._aim_per_mm(squared, z - self.pole_height) ** 2 * squared
        return t2 <= jnp.minimum(self.widest, self.pupil) ** 2

    def transmittance(self, pixels: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch"]:
        """Fraction of the light of pixels that passes the surfaces; 0 behind the iris."""
        t2 = jnp.sum(jnp.square(self.aim(pixels)), axis=-1)
        visible = t2 <= jnp.minimum(self.widest, self.pupil) ** 2
        return jnp.where(visible, series(self.passing, self.place(t2)), 0.0)

    def on_sensor_of(self, other: PathCamera) -> PathCamera:
        """This camera with the sensor of another: a line of sight's aim decides on its pixel.

        Colours share a sensor, but not delta.
        """
        scale = other.scale * jnp.abs(self.magnification / other.magnification)
        return eqx.tree_at(
            lambda c: (c.scale, c.principal_point), self, (scale, other.principal_point)
        )

    @property
    def px_per_aim(self) -> Float[Array, ""]:
        """Pixels per mm of t; negative if the image is turned upright."""
        return self.orientation * jnp.abs(self.magnification) / self.scale

    def aim(self, pixels: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Where lines of sight aim, (x, y), mm; their distance from the axis is t."""
        offset = (jnp.asarray(pixels) - self.principal_point) / self.px_per_aim
        return offset * jnp.array([1.0, -1.0])

    def place(self, t2: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Argument of the series at aims whose distances from the axis have these squares."""
        return jnp.minimum(2.0 * t2 / self.widest**2 - 1.0, 1.0)

    def _aim_per_mm(
        self, squared: Float[Array, "*batch"], above: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """t/rho of the line of sight that meets a point, by Newton's method.

        Args:
            squared: rho², mm².
            above: height above the pole, mm.
        """
        # The point's own series, so that each step evaluates one series and its derivative.
        terms = [a - b * above for a, b in zip(self.crossing, self.steepness, strict=True)]
        growth = 4.0 * squared / self.widest**2

        def step(_: int, ratio: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
            value, derivative = series_and_slope(terms, self.place(ratio**2 * squared))
            residual = ratio * value - 1.0
            return ratio - residual / (value + growth * ratio**2 * derivative)

        start = 1.0 / series_and_slope(terms, -jnp.ones_like(above))[0]
        # Unrolled, the loop would take seconds to compile wherever it is used.
        return jax.lax.fori_loop(0, _NEWTON_STEPS, step, start)


def path_camera(path: ViewingPath, *, scale: ScalarLike, upright: bool = False) -> PathCamera:
    """The microscope behind a path.

    Args:
        path: the viewing path.
        scale: delta, mm/px at the retinal pole.
        upright: turn the inverted image of a wide-field lens, as a stereo inverter does.

    Raises:
        InputError: no line of sight reaches the retina; not under tracing.
    """
    camera = _camera(path, jnp.asarray(scale, float), upright)
    if not isinstance(camera.widest, jax.core.Tracer) and not camera.widest > 0.0:
        raise InputError(
            "no line of sight through this viewing path reaches the retina. Check the order of its "
            "surfaces, or choose another viewing lens."
        )
    return camera


@eqx.filter_jit
def _camera(path: ViewingPath, scale: Float[Array, ""], upright: bool) -> PathCamera:
    widest, pupil = jax.lax.stop_gradient(_limits(path))
    nodes, to_series = chebyshev_nodes(TERMS)
    t = widest * jnp.sqrt((nodes + 1.0) / 2.0)
    seen = lines_of_sight(path, t)
    a, b = to_series @ (seen.height / t), to_series @ (seen.slope / t)
    return PathCamera(
        scale=scale,
        principal_point=jnp.zeros(2),
        pole_height=-path.retina_semi_axes[2],
        crossing=a,
        steepness=b,
        passing=to_series @ seen.transmittance,
        widest=widest,
        pupil=pupil,
        orientation=jnp.sign(series(a, -1.0)) if upright else jnp.ones(()),
    )


def _limits(path: ViewingPath) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Largest t of the series, and largest t that passes the iris, mm."""

    def passes(aim: Float[Array, "*batch"]) -> Bool[Array, "2 *batch"]:
        """Whether lines reach the retina, and whether the iris lets them pass, too."""
        seen = lines_of_sight(path, aim)
        # A line through the equator's plane outside the eyeball comes from beyond its wall.
        at_equator = seen.height - seen.slope * path.retina_semi_axes[2]
        inside = jnp.abs(at_equator) < path.retina_semi_axes[0]
        reaches = ((seen.status == SEEN) | (seen.status == VIGNETTED)) & inside
        return jnp.stack([reaches, seen.status == SEEN])

    step = _WIDEST_AIM_MM / _SCAN
    fine = passes(step * (1.0 + jnp.arange(_SCAN)))
    everywhere = jnp.all(fine, axis=1)
    last = step * jnp.where(everywhere, _SCAN, jnp.argmin(fine, axis=1))

    def halved(
        _: int, bounds: tuple[Float[Array, "2"], Float[Array, "2"]]
    ) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
        low, high = bounds
        middle = (low + high) / 2
        inside = jnp.diagonal(passes(middle))
        return jnp.where(inside, middle, low), jnp.where(inside, high, middle)

    low, _ = jax.lax.fori_loop(0, _BISECTIONS, halved, (last, last + step))
    field = jnp.where(everywhere[0], _WIDEST_AIM_MM, low[0])
    pupil = jnp.where(everywhere[1], jnp.inf, low[1])
    return jnp.minimum(_SAFE * field, _BEYOND_THE_IRIS * pupil), pupil
