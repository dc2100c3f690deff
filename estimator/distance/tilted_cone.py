"""The spot of a tilted cone and its distance, with derivatives, for budgets in every frame.

In NumPy. The same contour and the same definition of its ellipse as `optics.spot_ellipse`, which
needs JAX. A test compares the two.
"""

import math
from typing import Any, NamedTuple

import numpy as np

_POINTS = 32
"""Generators: 1e-4 px. `optics` has 128 for 1e-9 px."""
_STEPS = 4
"""Of the fixed point. Each reduces the error to about 5 %, from 1 mm to 6 um, then to nothing."""
_TURN = np.arange(_POINTS) * (2 * np.pi / _POINTS)
_COS, _SIN = np.cos(_TURN)[:, None], np.sin(_TURN)[:, None]


class ConeView(NamedTuple):
    """Cone, wall and pinhole; arrays (n,) or numbers, mm and rad.

    Attributes:
        k: 1/tan(half-angle).
        b: apex offset.
        scale: delta, mm/px at the pole.
        eye_radius: r.
        inverse_working_distance: kappa = 1/(z_F + r), 1/mm.
        normal: of a plane wall through the pole; None for the sphere.
    """

    k: Any
    b: Any
    scale: Any
    eye_radius: Any
    inverse_working_distance: Any
    normal: tuple[float, float, float] | None = None

    def wall_point(self, at_px: np.ndarray) -> np.ndarray:
        """What the pinhole sees at image points, (n, 2) px from the principal point: (n, 3)."""
        from eyespot import optics

        seen: Any = {
            "right_px": at_px[:, 0],
            "down_px": at_px[:, 1],
            "scale": self.scale,
            "eye_radius": self.eye_radius,
            "inverse_working_distance": self.inverse_working_distance,
        }
        if self.normal is not None:
            return np.asarray(optics.plane_point(**seen, normal=self.normal)).T
        return np.asarray(optics.eyeball_point(**seen)).T

    def outward(self, point: np.ndarray) -> np.ndarray:
        """Unit normals of the wall out of the eye, (n, 3)."""
        if self.normal is not None:
            return np.broadcast_to(-np.asarray(self.normal), point.shape)
        return np.asarray(point / np.linalg.norm(point, axis=-1, keepdims=True))


class SpotImage(NamedTuple):
    """Centres, (n, 2), and semi-axes, (n,), of spots, from the principal point, px."""

    centre: np.ndarray
    semi_major: np.ndarray
    semi_minor: np.ndarray

    def size(self, *, by_area: bool) -> np.ndarray:
        """The root of the axes' product, or the semi-minor axis, (n,)."""
        return np.sqrt(self.semi_major * self.semi_minor) if by_area else self.semi_minor


def spot_image(
    eye: ConeView, *, spot: np.ndarray, axis: np.ndarray, distance: np.ndarray
) -> SpotImage:
    """Ellipse of the image of a cone's edge on the wall; NaN where part of it misses the wall.

    The conic is uniform in its own angle, as that of `optics.ellipse_of_contour`.

    Args:
        spot: O, (n, 3), mm.
        axis: unit vectors from the tip towards the wall, (n, 3).
        distance: d = |SO|, (n,), mm.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        _, contour = spot_edge(eye, spot=spot, axis=axis, distance=distance)
        even = _fitted(contour, np.ones(contour.shape[:2]))
        offset = contour - even.centre[:, None]
        # An ellipse's area swept from its centre grows evenly with its eccentric angle.
        step = np.roll(offset, -1, axis=1) - np.roll(offset, 1, axis=1)
        swept = np.abs(offset[..., 0] * step[..., 1] - offset[..., 1] * step[..., 0])
        return _fitted(contour, swept / swept.mean(axis=1, keepdims=True))


def spot_edge(
    eye: ConeView, *, spot: np.ndarray, axis: np.ndarray, distance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Edge of the spot on the wall, (n, points, 3) mm, and its image from the principal point, px.

    Args: as for `spot_image`.
    """
    first, second = _across(axis)
    around = _COS * first[:, None] + _SIN * second[:, None]
    apex = spot - (distance - eye.b)[:, None] * axis
    ray = axis[:, None] + around / np.reshape(eye.k, (-1, 1, 1))
    edge = apex[:, None] + _to_wall(eye, apex, ray)[..., None] * ray
    height = edge[..., 2] + np.reshape(eye.eye_radius, (-1, 1))
    depth = 1.0 - np.reshape(eye.inverse_working_distance, (-1, 1)) * height
    per_px = np.reshape(eye.scale, (-1, 1)) * depth
    return edge, np.stack([edge[..., 0] / per_px, -edge[..., 1] / per_px], axis=-1)


def distance_of(
    eye: ConeView, *, at_px: np.ndarray, size_px: np.ndarray, axis: np.ndarray, by_area: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the cone whose spot has this centre and this size, for a known axis.

    The iteration of `optics.exact_distance` and `optics.distance_by_area`.

    Args:
        at_px: centre of the ellipse from the principal point, (n, 2).
        size_px: semi-minor axis, or with `by_area` the root of the axes' product, (n,).
        axis: unit vectors, (n, 3).

    Returns:
        d, (n,), mm, and O, (n, 3), mm; NaN where there is no such spot.
    """
    pixel = at_px
    distance = eye.b + eye.k * eye.scale * size_px
    spot = eye.wall_point(pixel)
    for _ in range(_STEPS):
        seen = spot_image(eye, spot=spot, axis=axis, distance=distance)
        pixel = pixel + at_px - seen.centre
        spot = eye.wall_point(pixel)
        distance = eye.b + (distance - eye.b) * size_px / seen.size(by_area=by_area)
    return distance, spot


def _across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across each axis and each other, (n, 3)."""
    # A frame without a trigonometric function or a branch (Duff et al. 2017).
    x, y, z = axis.T
    sign = np.copysign(1.0, z)
    scale = -1 / (sign + z)
    across = x * y * scale
    first = np.stack([1 + sign * x * x * scale, sign * across, -sign * x], axis=1)
    return first, np.stack([across, sign + y * y * scale, -y], axis=1)


def _to_wall(eye: ConeView, apex: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """How far along each ray the wall is, in the ray's own length, (n, points)."""
    radius = np.reshape(eye.eye_radius, (-1, 1))
    if eye.normal is not None:
        normal = np.asarray(eye.normal)
        above = (apex + np.array([0.0, 0.0, 1.0]) * radius) @ normal
        along = ray @ normal
        return -above[:, None] / np.where(along < 0, along, np.nan)
    square = np.einsum("npk,npk->np", ray, ray)
    along = np.einsum("nk,npk->np", apex, ray)
    inside = np.einsum("nk,nk->n", apex, apex)[:, None] - radius**2
    return (np.sqrt(along**2 - square * inside) - along) / square


def _fitted(contour: np.ndarray, weights: np.ndarray) -> SpotImage:
    """The conic A x^2 + B xy + C y^2 + D x + E y = 1 about the centroid."""
    middle = np.einsum("np,npk->nk", weights, contour) / weights.sum(axis=1)[:, None]
    offset = contour - middle[:, None]
    size = np.sqrt(np.einsum("npk,npk->n", offset, offset) / _POINTS)
    x, y = (offset[..., k] / size[:, None] for k in (0, 1))
    columns = np.stack([x * x, x * y, y * y, x, y], axis=1)
    weighted = columns * weights[:, None]
    normal = weighted @ columns.transpose(0, 2, 1)
    # A contour that misses the wall has no ellipse, and must not spoil the others'.
    normal = np.where(np.isfinite(normal), normal, np.eye(5))
    conic = np.linalg.solve(normal, weighted.sum(axis=2)[..., None])[..., 0]
    a, b, c, d, e = conic.T
    determinant = 4 * a * c - b * b
    x0, y0 = (b * e - 2 * c * d) / determinant, (b * d - 2 * a * e) / determinant
    level = 1 + a * x0 * x0 + b * x0 * y0 + c * y0 * y0
    mean, spread = (a + c) / 2, np.hypot(a - c, b) / 2
    return SpotImage(
        centre=middle + size[:, None] * np.stack([x0, y0], axis=-1),
        semi_major=size * np.sqrt(level / (mean - spread)),
        semi_minor=size * np.sqrt(level / (mean + spread)),
    )


_STEP = 1e-5  # of the differences, relative
_LEAST = 0.1  # of a quantity near zero, mm and 1/mm


def slopes_of(
    eye: ConeView, *, axis: np.ndarray, point: np.ndarray, distance: float, by_area: bool
) -> dict[str, float]:
    """Derivatives of `distance_of`, from those of the spot's size at the distance found.

    The size e depends on the distance d and on each quantity q, so that at a measured size
    dd/dq = -(de/dq)/(de/dd). The spot stays where it is seen. Axis and point O are (3,), mm.

    Returns:
        By `size`, `x` and `y` of the spot, mm/px; by `tilt` of the axis, mm/rad: the root of the
        squares across it; and by the quantities of `ConeView`, mm per their unit.
    """
    depth = 1 - eye.inverse_working_distance * (point[2] + eye.eye_radius)
    at_px = np.array([point[0], -point[1]]) / (eye.scale * depth)
    given = np.array([distance, *at_px, 0.0, 0.0, *(np.ravel(value)[0] for value in eye[:5])])
    steps = _STEP * np.maximum(np.abs(given), _LEAST)
    varied = given + np.vstack([np.zeros(given.size), np.diag(steps)])
    axes = axis + varied[:, 3:5] @ np.linalg.svd(axis[None])[2][1:]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    quantities: Any = dict(zip(eye._fields, varied.T[5:], strict=False))  # all but the normal
    seen = eye._replace(**quantities)
    spot = seen.wall_point(varied[:, 1:3])
    image = spot_image(seen, spot=spot, axis=axes, distance=varied[:, 0])
    size = image.size(by_area=by_area)
    by_distance, *others = ((size[1:] - size[0]) / steps).tolist()
    x, y, first, second, *of_eye = (-slope / by_distance for slope in others)
    of_spot = {"size": 1 / by_distance, "x": x, "y": y, "tilt": math.hypot(first, second)}
    return of_spot | dict(zip(quantities, of_eye, strict=True))
