"""The microscope behind a viewing path: from a wall point to its pixel and back.

Then what such a camera sees: a microscope whose pinhole lies beside the axis of the eye, as half of
a stereo pair; the wall point of a pixel and the local magnification there, which a spot's size
needs; how the microscope's coaxial light thins out on the wall; the pencils of a microscope with a
lens's pupil, lines of sight about each pixel's own; and the reflexes of a lamp at the surfaces of
the path, Purkinje's images.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, ScalarLike

from formats.inputs import InputError
from optics import Camera, Surface, components, refract
from optics.surface import bisected
from optics.viewing.path import (
    ViewingPath,
    before_path,
    last_medium,
    lines_of_sight,
    radial_nodes,
    radial_place,
    series,
    series_and_slope,
    skew_lines,
)
from optics.viewing.trace import (
    SEEN,
    VIGNETTED,
    Element,
    Iris,
    Refracting,
    ThinLens,
    TracedRays,
    trace,
)

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
    low, _ = bisected(lambda aim: jnp.diagonal(passes(aim)), last, last + step, steps=_BISECTIONS)
    field = jnp.where(everywhere[0], _WIDEST_AIM_MM, low[0])
    pupil = jnp.where(everywhere[1], jnp.inf, low[1])
    return jnp.minimum(_SAFE * field, _BEYOND_THE_IRIS * pupil), pupil


_SIDE_NEWTON_STEPS = 6
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
    _check_finite(path, "side_camera")

    def at_pole(aim: Float[Array, ""]) -> Float[Array, ""]:
        return lines_of_sight(path, aim).height

    magnification = jax.jvp(at_pole, (jnp.zeros(()),), (jnp.ones(()),))[1]
    orientation = jnp.sign(magnification) if upright else 1.0
    return SideCamera(
        path=path,
        aside=jnp.asarray(aside, float),
        scale=jnp.asarray(scale, float),
        principal_point=jnp.zeros(2),
        pole_height=-path.retina_semi_axes[2],
        px_per_aim=orientation * jnp.abs(magnification) / scale,
    )


def _check_finite(path: ViewingPath, needs: str) -> None:
    closeness = path.pinhole_closeness
    if not isinstance(closeness, jax.core.Tracer) and not closeness > 0.0:
        raise InputError(
            f"{needs} needs a pinhole at a finite height; got a path with pinhole_distance inf. "
            "Give viewing_path(pinhole_distance=...) in mm."
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
    """Point of the wall that pixels see through a path, mm; NaN where the iris or the field ends.

    Args:
        pixels: (u, v), px.
    """
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
        camera: a viewing path, or a microscope.
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


_DEGREE = 10  # leaves 3e-4 of the light at the pole in all eyes and lenses of the package
_RAYS = 200


def coaxial_falloff(camera: PathCamera, wall: Surface) -> tuple[np.ndarray, float]:
    """Irradiance across the light relative to the pole, by the height on the wall.

    The microscope is so far away that its light is even where it meets the path (within 0.1 % at
    200 mm and 5 mm from the axis). Behind the path, light that entered between the aims t and
    t + dt lies between the distances rho and rho + drho from the axis, so it is thinner by
    (rho/t)(drho/dt) across a horizontal plane.

    Args:
        camera: the microscope behind the path.
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
    return np.polynomial.polynomial.polyfit(place, light / light[0], _DEGREE), float(height[-1])


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


_STEEPEST = 1.0
"""Largest slope of returning light: steeper lines go far past every lamp."""
_SAFE_SLOPE = 0.98  # towards a total reflection the series converge slowly


class Reflex(eqx.Module):
    """Where lines of sight end in the pinhole's plane if one surface reflects them.

    A line that aims at a distance t from the axis returns to a distance t m(t²) from it. A pixel
    shows the lamp if the lamp covers the place to which its line returns.

    Attributes:
        returning: Chebyshev coefficients of m.
        strength: Chebyshev coefficients of the part of the light that comes back.
        widest: largest t of the series, mm; up to it the iris stops no line.
    """

    returning: Float[Array, "terms"]
    strength: Float[Array, "terms"]
    widest: Float[Array, ""]

    @eqx.filter_jit
    def place(self, aim: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """X and Y to which lines of sight return in the pinhole's plane, mm."""
        aim = jnp.asarray(aim)
        place = radial_place(jnp.sum(aim * aim, axis=-1), self.widest)
        return series(self.returning, place)[..., None] * aim

    @eqx.filter_jit
    def part(self, aim: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch"]:
        """Part of the light that comes back: Fresnel's, there and back; 0 outside the series."""
        t2 = jnp.sum(jnp.square(jnp.asarray(aim)), axis=-1)
        strength = series(self.strength, radial_place(t2, self.widest))
        return jnp.where(t2 <= self.widest**2, strength, 0.0)


def reflexes(path: ViewingPath) -> tuple[Reflex, ...]:
    """The reflexes at a path's refracting surfaces, in their order; each line is reflected once.

    Raises:
        InputError: the path's pinhole is at infinity, and so would be the lamp.
    """
    _check_finite(path, "reflexes")
    surfaces = [k for k, element in enumerate(path.elements) if isinstance(element, Refracting)]
    return tuple(_reflex(path, at) for at in surfaces)


@eqx.filter_jit
def _reflex(path: ViewingPath, at: int) -> Reflex:
    step = _WIDEST_AIM_MM / _SCAN
    _, _, returns = _returned(path, at, step * (1.0 + jnp.arange(_SCAN)))
    # 0 if the first line is lost: then no line is shown.
    last = step * jnp.where(jnp.all(returns), _SCAN, jnp.argmin(returns))
    widest = jnp.maximum(_SAFE_SLOPE * last, 1e-3 * step)
    t, to_series = radial_nodes(widest)
    place, strength, _ = _returned(path, at, t)
    return Reflex(to_series @ (place / t), to_series @ strength, widest)


def _returned(
    path: ViewingPath, at: int, aim: Float[Array, "n"]
) -> tuple[Float[Array, "n"], Float[Array, "n"], Bool[Array, "n"]]:
    """Distance from the axis in the pinhole's plane, part of the light, and whether it returns."""
    before, mirror = path.elements[:at], path.elements[at]
    assert isinstance(mirror, Refracting)
    meridional = jnp.stack([aim, jnp.zeros_like(aim)], axis=-1)
    there = trace(before, *before_path(path, meridional, path.pinhole_closeness * meridional))
    medium, front = last_medium(before)
    point, direction, meets = medium.to_surface(
        there.point, there.direction, mirror.surface, front=front
    )
    normal = mirror.surface.normal(point)
    depth = mirror.depth
    _, passed, _ = refract(
        direction=direction,
        normal=normal,
        index_incident=medium.index_at(point, front=front),
        index_transmitted=mirror.medium.index_at(point, front=depth),
    )
    direction = direction - 2.0 * jnp.sum(direction * normal, axis=-1)[..., None] * normal
    # Seen upside down, the light goes on through the same elements in reversed order.
    upwards = jnp.array([1.0, 1.0, -1.0])
    back = trace(
        _reversed(before),
        upwards * point,
        upwards * direction,
        medium=medium.reversed(depth - front),
        front=-depth,
    )
    slope = back.direction[:, 0] / back.direction[:, 2]
    place = back.point[:, 0] + slope * (1.0 / path.pinhole_closeness - back.point[:, 2])
    part = there.transmittance * (1.0 - passed) * back.transmittance
    returns = meets & (there.status == SEEN) & (back.status == SEEN)
    return place, part, returns & (jnp.abs(slope) < _STEEPEST)


def _reversed(elements: tuple[Element, ...]) -> tuple[Element, ...]:
    """Elements as light meets them that comes back, with depths that count upwards."""
    found: list[Element] = []
    for number in reversed(range(len(elements))):
        element = elements[number]
        if isinstance(element, Refracting):
            medium, front = last_medium(elements[:number])
            behind = medium.reversed(element.depth - front)
            found.append(Refracting(element.surface.reversed(), behind))
        elif isinstance(element, ThinLens):
            found.append(ThinLens(depth=-element.depth, power=element.power))
        else:
            found.append(Iris(depth=-element.depth, radius=element.radius))
    return tuple(found)
