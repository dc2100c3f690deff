"""The microscope behind a viewing path: from a wall point to its pixel and back.

Then a microscope whose pinhole lies beside the axis of the eye, as half of a stereo pair; the wall
point of a pixel and the local magnification there, which a spot's size needs; and how the
microscope's coaxial light thins out on the wall.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, ScalarLike

from eyespot.formats.inputs import InputError
from eyespot.optics import Camera, Surface, components
from eyespot.optics.surface import bisected
from eyespot.optics.viewing.path import (
    SCANNED_MM,
    ViewingPath,
    check_finite,
    lines_of_sight,
    radial_nodes,
    radial_place,
    series,
    series_and_slope,
    skew_lines,
)
from eyespot.optics.viewing.trace import SEEN, VIGNETTED, TracedRays

_NEWTON_STEPS = 8
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

    It takes the place of a `Microscope` wherever points are projected. The attributes of `Camera`
    are not repeated.

    Attributes:
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
        """Image of points as `Camera.project`; without meaning for points that it does not see."""
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

    def on_sensor_of(self, other: "PathCamera") -> "PathCamera":
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
        return radial_place(t2, self.widest)

    def _aim_per_mm(
        self, squared: Float[Array, "*batch"], above: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """t/rho of the line of sight that meets a point of this rho² (mm²) above the pole (mm)."""
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
    def passes(aim: Float[Array, "*batch"]) -> Bool[Array, "2 *batch"]:
        """Whether lines reach the retina, and whether the iris lets them pass, too."""
        seen = lines_of_sight(path, aim)
        # A line through the equator's plane outside the eyeball comes from beyond its wall.
        at_equator = seen.height - seen.slope * path.retina_semi_axes[2]
        inside = jnp.abs(at_equator) < path.retina_semi_axes[0]
        reaches = ((seen.status == SEEN) | (seen.status == VIGNETTED)) & inside
        return jnp.stack([reaches, seen.status == SEEN])

    fine = passes(jnp.asarray(SCANNED_MM))
    everywhere = jnp.all(fine, axis=1)
    step = SCANNED_MM[0]
    last = step * jnp.where(everywhere, SCANNED_MM.size, jnp.argmin(fine, axis=1))
    low, _ = bisected(lambda aim: jnp.diagonal(passes(aim)), last, last + step, steps=_BISECTIONS)
    field, pupil = jax.lax.stop_gradient(
        jnp.where(everywhere, jnp.array([SCANNED_MM[-1], jnp.inf]), low)
    )
    widest = jnp.minimum(_SAFE * field, _BEYOND_THE_IRIS * pupil)
    t, to_series = radial_nodes(widest)
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


_SIDE_NEWTON_STEPS = 6
_STEP_MM = 1e-4  # step of the derivatives, with which each Newton step gains four digits


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
        scale: of the pinhole on the axis.
        principal_point: image of the cornea's vertex, px.
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
        """Image of points as `PathCamera.project`, by Newton's method on traced lines of sight."""
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

            return jax.lax.fori_loop(0, _SIDE_NEWTON_STEPS, step, jnp.zeros(2))

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
    check_finite(path, "side_camera")
    magnification = jax.jacfwd(lambda aim: lines_of_sight(path, aim).height)(jnp.zeros(()))
    orientation = jnp.sign(magnification) if upright else 1.0
    return SideCamera(
        path=path,
        aside=jnp.asarray(aside, float),
        scale=jnp.asarray(scale, float),
        principal_point=jnp.zeros(2),
        pole_height=-path.retina_semi_axes[2],
        px_per_aim=orientation * jnp.abs(magnification) / scale,
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


@eqx.filter_jit
def wall_point(
    camera: PathCamera, wall: Surface, pixels: Float[ArrayLike, "*batch 2"]
) -> Float[Array, "*batch 3"]:
    """Point of the wall that pixels see through a path, mm; NaN beyond the iris or the field."""
    point = wall.intersect(*camera.ray(pixels)).point
    seen = camera.transmittance(jnp.asarray(pixels)) > 0
    return jnp.where(seen[..., None], point, jnp.nan)


@eqx.filter_jit
def local_magnification(
    camera: Camera,
    wall: Surface,
    *,
    eccentricity: Float[ArrayLike, "*batch"],
    azimuth: Float[ArrayLike, "*batch"] = 0.0,
) -> Float[Array, "*batch 2"]:
    r"""Semi-axes of the image of a small circle on the wall, relative to a circle at the pole.

    Through a path that is symmetric about the axis, and on a wall of revolution, they are the
    magnifications across the meridian, h/c, and along it, dh/ds, with the image height h in mm at
    the pole and the arc s. A circle of radius e1 has the semi-minor axis e1'; so
    $e_1 = \delta e_1' / m$ with the smaller magnification m. `corrected_factor` is 1/m for a
    pinhole and a sphere.

    Args:
        eccentricity: c of the points, mm.
        azimuth: of the points, rad.

    Returns:
        The larger and the smaller one, 1 at the pole.
    """

    def at(c: Float[Array, ""], angle: Float[Array, ""]) -> Float[Array, "2"]:
        frame = wall.frame_at(eccentricity=c, azimuth=angle)
        tangents = jnp.stack([frame.meridional, frame.azimuthal], axis=-1)
        (p, q), (r, s) = camera.scale * jax.jacfwd(camera.project)(frame.origin) @ tangents
        # Singular values of a 2x2 matrix.
        one, other = jnp.hypot(p + s, q - r), jnp.hypot(p - s, q + r)
        return jnp.stack([one + other, jnp.abs(one - other)]) / 2.0

    return jnp.vectorize(at, signature="(),()->(k)")(
        jnp.asarray(eccentricity, float), jnp.asarray(azimuth, float)
    )


_FRESNEL_DEGREE = 10  # leaves 3e-4 of the light at the pole in all eyes and lenses of the package
_RAYS = 200


def coaxial_falloff(camera: PathCamera, wall: Surface) -> tuple[np.ndarray, float]:
    """Irradiance across the light relative to the pole, by the height on the wall.

    The microscope is so far away that its light is even where it meets the path (within 0.1 % at
    200 mm and 5 mm from the axis). Behind the path, light that entered between the aims t and
    t + dt lies between the distances rho and rho + drho from the axis, so it is thinner by
    (rho/t)(drho/dt) across a horizontal plane.

    Args:
        wall: seen along X; a stretched eyeball's other meridians are taken as that one.

    Returns:
        Coefficients of a polynomial in h/h_1, lowest first, and h_1, mm; h is the height above the
        pole.
    """
    edge = jnp.minimum(camera.pupil, camera.widest)
    aim = jnp.linspace(1e-3, 0.999, _RAYS) * edge

    def pixels(aim: jnp.ndarray) -> jnp.ndarray:
        return camera.principal_point + camera.px_per_aim * jnp.stack([aim, 0.0 * aim], axis=-1)

    point, direction = camera.ray(pixels(aim))
    hit = wall.intersect(point, direction).point

    def distance(aim: jnp.ndarray) -> jnp.ndarray:
        point, direction = camera.ray(pixels(aim))
        down = (hit[:, 2] - point[:, 2]) / direction[:, 2]
        return point[:, 0] + down * direction[:, 0]

    rho, growth = jax.jvp(distance, (aim,), (jnp.ones_like(aim),))
    thinner = (rho / aim) * growth * -direction[:, 2]
    light = np.asarray(camera.transmittance(pixels(aim)) / thinner)
    height = np.asarray(hit[:, 2] - camera.pole_height)
    place = height / height[-1]
    return np.polynomial.polynomial.polyfit(place, light / light[0], _FRESNEL_DEGREE), float(
        height[-1]
    )
