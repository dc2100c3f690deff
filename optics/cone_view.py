"""How far is the tip whose spot is seen so, and what does each quantity do to that distance?

The contour of `contour` and its inverse for a pinhole without distortion, in NumPy and without JAX:
for budgets in every frame, and for programs that start faster than JAX is imported.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from eyespot.optics.ellipse import Ellipse, ellipse_of_contour
from eyespot.optics.lines import (
    cone_generators,
    distance_in_sphere,
    distance_to_plane,
    eyeball_point,
    generator_angles,
    pinhole_image,
    plane_point,
    ray_point,
)

if TYPE_CHECKING:
    from jaxtyping import Float

_ANGLES = generator_angles(32)
"""32 generators and one reweighting of the ellipse: 1e-4 px. `contour` has 128 for 1e-9 px."""
_REWEIGHTINGS = (0, 0, 1, 1)
"""Of the ellipse in each step of the fixed point. A step reduces the error to about 5 %: from 1 mm
to 2 um, then to nothing. The even weights err by 0.05 px, of which two steps leave nothing."""
_RELATIVE_STEP = 1e-5
"""Step of the differences, by which a derivative errs as much as by rounding."""
_LEAST_SIZE = 0.1
"""Size of which steps are taken for a quantity near zero, mm and 1/mm."""


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

    def wall_point(self, at_px: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """What the pinhole sees at image points, px from the principal point."""
        seen: Any = {
            "right_px": at_px[:, 0],
            "down_px": at_px[:, 1],
            "scale": self.scale,
            "eye_radius": self.eye_radius,
            "inverse_working_distance": self.inverse_working_distance,
        }
        if self.normal is not None:
            return plane_point(**seen, normal=self.normal).T
        return eyeball_point(**seen).T

    def outward(self, point: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Unit normals of the wall out of the eye."""
        if self.normal is not None:
            return np.broadcast_to(-np.asarray(self.normal), point.shape)
        return np.asarray(point / np.linalg.norm(point, axis=-1, keepdims=True))

    def spot_edge(
        self,
        *,
        spot: Float[np.ndarray, "n 3"],
        axis: Float[np.ndarray, "n 3"],
        distance: Float[np.ndarray, "n"],
    ) -> tuple[Float[np.ndarray, "n points 3"], Float[np.ndarray, "n points 2"]]:
        """Edge of spots on the wall, mm, and its image, px; NaN where a generator misses the wall.

        Args:
            spot: O, mm.
            axis: unit vectors from the tip towards the wall.
            distance: d = |SO|, mm.
        """
        half_angle, scale, radius, kappa = (
            np.reshape(value, (-1, 1))
            for value in (
                np.arctan2(1.0, self.k),
                self.scale,
                self.eye_radius,
                self.inverse_working_distance,
            )
        )
        apex = (spot - (distance - self.b)[:, None] * axis)[:, None]
        rays = cone_generators(axis[:, None], half_angle, _ANGLES)
        if self.normal is None:
            along, meets = distance_in_sphere(apex, rays, radius)
        else:
            pole = radius[..., None] * np.array([0.0, 0.0, -1.0])
            along, meets = distance_to_plane(apex, rays, pole, np.asarray(self.normal))
        edge = ray_point(apex, rays, np.where(meets & (along > 0), along, np.nan))
        image = pinhole_image(
            edge, scale=scale, inverse_working_distance=kappa, pole_height=-radius
        )
        return edge, image

    def spot_ellipse(self, **beam: np.ndarray) -> Ellipse:
        """Ellipses of the images of `spot_edge`, px, in arrays of n."""
        return ellipse_of_contour(self.spot_edge(**beam)[1], reweightings=1)

    def distance_of(
        self,
        *,
        at_px: Float[np.ndarray, "n 2"],
        size_px: Float[np.ndarray, "n"],
        axis: Float[np.ndarray, "n 3"],
        by_area: bool,
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"]]:
        """Distance of cones whose spots have these centres and sizes, for known axes.

        The iteration of `distance_by_area`.

        Args:
            at_px: centre of the ellipse from the principal point.
            size_px: semi-minor axis, or with `by_area` the radius by the ellipse's area.
            axis: unit vectors from the tip towards the wall.

        Returns:
            d and O, mm; NaN where there is no such spot.
        """
        pixel, distance = at_px, self.b + self.k * self.scale * size_px
        spot = self.wall_point(pixel)
        with np.errstate(invalid="ignore", divide="ignore"):
            for reweightings in _REWEIGHTINGS:
                _, contour = self.spot_edge(spot=spot, axis=axis, distance=distance)
                seen = ellipse_of_contour(contour, reweightings=reweightings)
                pixel = pixel + at_px - seen.centre
                spot = self.wall_point(pixel)
                distance = self.b + (distance - self.b) * size_px / seen.size(by_area=by_area)
        return distance, spot

    def slopes_of(
        self, *, axis: np.ndarray, point: np.ndarray, distance: float, by_area: bool
    ) -> dict[str, float]:
        """Derivatives of `distance_of`, from those of the spot's size at the distance found.

        The size e depends on the distance d and on each quantity q, so that at a measured size
        dd/dq = -(de/dq)/(de/dd). The spot stays where it is seen. Axis and point O are (3,), mm.

        Returns:
            By `size`, `x` and `y` of the spot, mm/px; by `tilt` of the axis, mm/rad: the root of
            the squares across it; and by the quantities of `ConeView`, mm per their unit.
        """
        at_px = pinhole_image(
            point,
            scale=self.scale,
            inverse_working_distance=self.inverse_working_distance,
            pole_height=-self.eye_radius,
        )
        given = np.array([distance, *at_px, 0.0, 0.0, *(np.ravel(value)[0] for value in self[:5])])
        steps = _RELATIVE_STEP * np.maximum(np.abs(given), _LEAST_SIZE)
        varied = given + np.vstack([np.zeros(given.size), np.diag(steps)])
        axes = axis + varied[:, 3:5] @ np.linalg.svd(axis[None])[2][1:]
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        quantities: Any = dict(zip(self._fields, varied.T[5:], strict=False))  # all but the normal
        seen = self._replace(**quantities)
        spot = seen.wall_point(varied[:, 1:3])
        image = seen.spot_ellipse(spot=spot, axis=axes, distance=varied[:, 0])
        size = image.size(by_area=by_area)
        by_distance, *others = ((size[1:] - size[0]) / steps).tolist()
        x, y, first, second, *of_view = (-slope / by_distance for slope in others)
        of_spot = {"size": 1 / by_distance, "x": x, "y": y, "tilt": math.hypot(first, second)}
        return of_spot | dict(zip(quantities, of_view, strict=True))
