"""The Cramér-Rao bound of the ellipse in an image."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eyespot import optics
from eyespot.scenes.description.scene_keys import SceneError
from eyespot.scenes.rendering.render import Exposed, FineWall, ImageWindow, Renderer
from eyespot.scenes.sensor import light_information
from eyespot.scenes.world.world import World


class Affine(NamedTuple):
    """An ellipse as the frame of small changes: shift x, y, and stretch along and between its axes.

    The semi-axes change by the relative amounts g11 and g22; g12 shears the ellipse evenly, and so
    stays defined for a circle, whose angle is not.
    """

    x: float
    y: float
    semi_major: float
    semi_minor: float
    angle: float


def ellipse_information(
    direct: NDArray[np.floating],
    reflectance: NDArray[np.floating],
    information: NDArray[np.floating],
    *,
    ellipse: Affine,
    corner: tuple[float, float],
    factor: int,
) -> NDArray[np.float64]:
    r"""Fisher information of an image about the ellipse of its light.

    A pixel's light is the mean of $\rho V$ over its area. The wall's picture $\rho$ and the shape
    of the light $V$ are known. Free are the shift, stretch and shear of the light, its brightness,
    and the brightness of even light from all sides:

    $$\partial m/\partial\theta = -\langle \rho\, w_\theta\cdot\nabla V\rangle,\qquad
      F_{ij} = \sum_{\mathrm{pixels}} I\, \partial_i m\, \partial_j m,$$

    with the displacement $w_\theta$ of each parameter. Derivatives are central differences between
    places $h$ apart. A step's squared derivative is then smaller by a part in proportion to $h$
    ($2h/3$ for $h$ in pixels along the difference), so the information is extrapolated to $h = 0$
    from two distances.

    Args:
        direct: V, rows x columns x channels, at `factor` x `factor` places of each pixel.
        reflectance: ρ at the same places; 0 where the light cannot be seen.
        information: I of each pixel, per squared unit of ρV (`light_information`).
        ellipse: the ellipse, px.
        corner: column and row of the first pixel.
        factor: places along a side of a pixel.

    Returns:
        5 x 5, for x, y (px), g11, g22, g12, after the two brightnesses have been eliminated.
    """
    near, far = (
        _eliminated(_derivatives(direct, reflectance, ellipse, corner, factor, step), information)
        for step in (1, 2)
    )
    return 2 * near - far


def _derivatives(
    direct: NDArray[np.floating],
    reflectance: NDArray[np.floating],
    ellipse: Affine,
    corner: tuple[float, float],
    factor: int,
    step: int,
) -> NDArray[np.float64]:
    """Derivatives of the pixels' light by the five parameters and the two brightnesses."""
    in_x, in_y = (
        _binned(reflectance * _difference(direct, reflectance > 0, axis, step), factor)
        * (factor / (2 * step))
        for axis in (1, 0)
    )
    rows, columns = in_x.shape[:2]
    # Within a pixel the displacement is that of its centre: it varies by a pixel over the spot.
    u = corner[0] + np.arange(columns) - ellipse.x
    v = (corner[1] + np.arange(rows) - ellipse.y)[:, None]
    cosine, sine = np.cos(ellipse.angle), np.sin(ellipse.angle)
    along, across = (u * cosine + v * sine)[..., None], (-u * sine + v * cosine)[..., None]
    by_major, by_minor = cosine * in_x + sine * in_y, -sine * in_x + cosine * in_y
    return np.stack(
        [
            -in_x,
            -in_y,
            -along * by_major,
            -across * by_minor,
            -(across * by_major + along * by_minor),
            _binned(reflectance * direct, factor),
            _binned(reflectance, factor),
        ]
    )


def _difference(
    light: NDArray[np.floating], seen: NDArray[np.bool_], axis: int, step: int
) -> NDArray[np.floating]:
    """Light `step` places ahead minus that behind; 0 where one of them is not seen."""
    change = np.zeros_like(light)
    along = np.moveaxis(light, axis, 0)
    visible = np.moveaxis(seen, axis, 0)
    np.multiply(
        along[2 * step :] - along[: -2 * step],
        visible[2 * step :] & visible[: -2 * step],
        out=np.moveaxis(change, axis, 0)[step:-step],
    )
    return change


def _binned(fine: NDArray[np.floating], factor: int) -> NDArray[np.float64]:
    """Means over each pixel."""
    pixels = sum(fine[i::factor, j::factor] for i in range(factor) for j in range(factor))
    return np.asarray(pixels, dtype=float) / factor**2


def _eliminated(
    derivatives: NDArray[np.float64], information: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Information about the first five parameters if the others are unknown."""
    flat = derivatives.reshape(len(derivatives), -1)
    whole = (flat * information.ravel()) @ flat.T
    own, mixed, others = whole[:5, :5], whole[:5, 5:], whole[5:, 5:]
    # Without light of one kind, its brightness has no information.
    return np.asarray(own - mixed @ np.linalg.pinv(others, hermitian=True) @ mixed.T)


_STEP_MM = 0.02  # step of the tip for differences of ellipses: 3 px, over which they are linear
_MAX_BEND = 0.1  # most difference between forward and backward, as part of both together
_SHARP, _SMOOTH = 4, 1  # places along a side of a pixel for a cone's edge, and for other light
# Around the ellipse, in semi-axes: a cone's light ends at its edge, a lens's has tails.
_EDGE, _TAILS, _MARGIN_PX = 1.05, 2.5, 6
_MAX_EXPOSURE_PARTS = 9  # parts of an exposure; more of them change the mean light little
_MAX_CONDITION = 1e12  # beyond it, the image does not determine the ellipse


def ellipse_motion(world: World) -> tuple[list[Affine], NDArray[np.float64], NDArray[np.float64]]:
    """How the ellipses of a stack's frames and the distances change with the tip.

    By differences for a beam of constant direction.

    Returns:
        The half-maximum ellipse of each frame; the change of x, y, g11, g22, g12 by the tip,
        n x 5 x 3, px/mm and 1/mm, NaN where the ellipse jumps, as the half-maximum of a lens may
        near the wall; and the change of the distance d by the tip, n x 3.
    """
    beam = world.truth.beam
    tip, axis = np.asarray(beam.tip), np.asarray(beam.axis)
    steps = _STEP_MM * np.concatenate([np.eye(3), -np.eye(3)])
    moved = optics.spot_truth(
        world.wall,
        world.microscope,
        world.table,
        tip=(tip[:, None] + steps).reshape(-1, 3),
        axis=np.repeat(axis, len(steps), axis=0),
        half_angle=world.cone.half_angle,
        apex_offset=world.cone.apex_offset,
    )
    # The view's drift and shake shift both in the same way.
    views = np.repeat(world.unrest.views(world.times), len(steps), axis=0)
    in_view = moved.half_max._replace(centre=np.asarray(moved.half_max.centre) + views)
    here, there = _ellipses(world.truth.half_max), _ellipses(in_view)
    jacobian = np.empty((len(tip), 5, 3))
    approach = np.empty((len(tip), 3))
    distance = np.asarray(moved.distance).reshape(-1, len(steps))
    for frame, ellipse in enumerate(here):
        own = there[frame * len(steps) : (frame + 1) * len(steps)]
        for k in range(3):
            jacobian[frame, :, k] = _slope(ellipse, ahead=own[k], behind=own[k + 3])
        approach[frame] = (distance[frame, :3] - distance[frame, 3:]) / (2 * _STEP_MM)
    return here, jacobian, approach


def _ellipses(ellipse: optics.Ellipse) -> list[Affine]:
    centre = np.asarray(ellipse.centre)
    columns = (*centre.T, ellipse.semi_major, ellipse.semi_minor, ellipse.angle)
    return [Affine(*values) for values in np.stack([*map(np.asarray, columns)], axis=1).tolist()]


def _slope(ellipse: Affine, *, ahead: Affine, behind: Affine) -> NDArray[np.float64]:
    """Change per mm; NaN if it is not the same ahead and behind."""
    forward, backward = _change(ellipse, ahead, ellipse), _change(ellipse, ellipse, behind)
    in_px = np.array([1.0, 1.0, *[ellipse.semi_major] * 3])
    bend = np.linalg.norm((forward - backward) * in_px)
    if not bend <= _MAX_BEND * np.linalg.norm((forward + backward) * in_px):
        return np.full(5, np.nan)
    return np.asarray((forward + backward) / (2 * _STEP_MM))


def _even(place: float, size: int) -> int:
    """The nearest even column or row in the image: a Bayer filter repeats every two pixels."""
    return min(max(2 * round(place / 2), 0), size)


def _change(ellipse: Affine, ahead: Affine, behind: Affine) -> NDArray[np.float64]:
    """Difference of two ellipses close to a third, as x, y, g11, g22, g12."""
    cosine, sine = np.cos(ellipse.angle), np.sin(ellipse.angle)
    axes = np.array([[cosine, sine], [-sine, cosine]])
    matrix = axes @ (_matrix(ahead) - _matrix(behind)) @ axes.T
    a, b = ellipse.semi_major, ellipse.semi_minor
    return np.array(
        [
            ahead.x - behind.x,
            ahead.y - behind.y,
            matrix[0, 0] / (2 * a * a),
            matrix[1, 1] / (2 * b * b),
            matrix[0, 1] / (a * a + b * b),
        ]
    )


def _matrix(ellipse: Affine) -> NDArray[np.float64]:
    """Second moments: squares of the semi-axes, in image coordinates."""
    cosine, sine = np.cos(ellipse.angle), np.sin(ellipse.angle)
    axes = np.array([[cosine, -sine], [sine, cosine]])
    return np.asarray(axes @ np.diag([ellipse.semi_major**2, ellipse.semi_minor**2]) @ axes.T)


class Bounds:
    """Bounds of the images of one stack.

    Raises:
        SceneError: the light is sampled at random, so that differences of images have no meaning.
    """

    def __init__(self, renderer: Renderer) -> None:
        scene = renderer.scene
        spread, reflexes = renderer.world.wall_spread, renderer.world.reflections
        if renderer.images.random or spread is not None or reflexes is not None:
            raise SceneError(
                "exposures.bound needs light without random numbers, and of the wall alone. Set "
                "exposures.bound = false; or source.kind other than 'photons', phantom.indirect "
                "other than 'traced', phantom.spread = 'none', microscope.numerical_aperture = 0, "
                "and viewing.reflexes = false."
            )
        self._renderer, self._scene = renderer, scene
        self._ellipses, self._by_tip, self._approach = ellipse_motion(renderer.world)
        is_sharp = renderer.world.table is None
        self._reach, self._factor = (_EDGE, _SHARP) if is_sharp else (_TAILS, _SMOOTH)
        self._at_rest: FineWall | None = None

    def labels(self, frame: int, light: Exposed, exposure_s: float) -> dict[str, float]:
        """The labels bound_* of one image; without them if it does not determine an ellipse.

        Args:
            light: noise-free, during the exposure.
        """
        ellipse = self._ellipses[frame]
        top, bottom, left, right = window = self._window([ellipse])
        if bottom - top < 2 or right - left < 2:
            return {}
        direct, reflectance = self._renderer.fine_light(
            frame,
            self._wall(frame, window),
            exposure_s=exposure_s,
            sub_frames=min(light.sub_frames, _MAX_EXPOSURE_PARTS),
        )
        information = light_information(
            light.radiance[top:bottom, left:right],
            exposure=exposure_s * self._scene.exposures.sensitivity_mm2_sr_mj,
            settings=self._scene.camera,
        )
        found = ellipse_information(
            direct,
            reflectance,
            information,
            ellipse=ellipse,
            corner=(left, top),
            factor=self._factor,
        )
        return self._stated(frame, found)

    def _wall(self, frame: int, window: ImageWindow) -> FineWall:
        """The wall in a frame; if nothing but the tip moves, it is rendered once."""
        if not self._scene.unrest.still:
            return self._renderer.fine_wall(frame, window=window, factor=self._factor)
        if self._at_rest is None:
            whole = self._window(self._ellipses)
            self._at_rest = self._renderer.fine_wall(frame, window=whole, factor=self._factor)
        return self._at_rest.part(window)

    def _window(self, ellipses: Sequence[Affine]) -> ImageWindow:
        """The part of the image that contains the light of all these ellipses."""
        height, width = self._scene.microscope.height_px, self._scene.microscope.width_px
        reach = [self._reach * ellipse.semi_major + _MARGIN_PX for ellipse in ellipses]
        around = list(zip(ellipses, reach, strict=True))
        return ImageWindow(
            top=_even(min(ellipse.y - r for ellipse, r in around), height),
            bottom=_even(max(ellipse.y + r for ellipse, r in around), height),
            left=_even(min(ellipse.x - r for ellipse, r in around), width),
            right=_even(max(ellipse.x + r for ellipse, r in around), width),
        )

    def _stated(self, frame: int, information: NDArray[np.float64]) -> dict[str, float]:
        ellipse = self._ellipses[frame]
        scale = np.array([1.0, 1.0, ellipse.semi_major, ellipse.semi_minor, ellipse.semi_major])
        in_px = information / np.outer(scale, scale)
        if not np.all(np.isfinite(in_px)) or np.linalg.cond(in_px) > _MAX_CONDITION:
            return {}
        variance = np.diag(np.linalg.inv(in_px))
        by_tip = self._by_tip[frame].T @ information @ self._by_tip[frame]
        towards = self._approach[frame]
        variances = dict(
            zip(("x_px", "y_px", "semi_major_px", "semi_minor_px"), variance, strict=False)
        )
        if np.all(np.isfinite(by_tip)) and np.linalg.cond(by_tip) < _MAX_CONDITION:
            variances["d_mm"] = towards @ np.linalg.solve(by_tip, towards)
        return {f"bound_{name}": float(np.sqrt(v)) for name, v in variances.items() if v > 0}
