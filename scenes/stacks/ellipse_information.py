"""Fisher information of an image about the ellipse of its light."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


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
