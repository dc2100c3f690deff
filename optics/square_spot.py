"""The spot of a beam perpendicular to the wall, and its image, in closed form.

These functions are the inverses of `models`. They accept floats, NumPy arrays and JAX arrays, and
do not import JAX.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from optics.array_namespace import array_namespace

if TYPE_CHECKING:
    from jaxtyping import Array, ArrayLike, Float

    Batch = Float[Array, "*batch"]


def planar_semi_minor(*, distance: ArrayLike, scale: ArrayLike, k: ArrayLike, b: ArrayLike):
    """e1' in px of a spot at distance d (mm) on a plane; inverse of `planar_distance`."""
    xp = array_namespace(distance, scale, k, b)
    return (xp.asarray(distance) - b) / (scale * k)


def square_spot_radius(
    *, distance: ArrayLike, k: ArrayLike, b: ArrayLike, eye_radius: ArrayLike
) -> Batch:
    """Radius of the lit circle in a sphere, mm; inverse of `sphere_distance`.

    e1 solves (1 + k^2) e1^2 + 2 k q e1 + q^2 = r^2 with q = r - d + b.

    Example:
        >>> radius = square_spot_radius(distance=2.0, k=20.0, b=-5.117, eye_radius=11.5)
        >>> round(float(radius), 4)
        0.3556
    """
    xp = array_namespace(distance, k, b, eye_radius)
    q = xp.asarray(eye_radius) - distance + b
    k2 = 1.0 + xp.asarray(k) ** 2
    return (xp.sqrt(xp.asarray(eye_radius) ** 2 * k2 - q**2) - k * q) / k2


def stereographic_semi_axis(
    *,
    spot_radius: ArrayLike,
    eccentricity: ArrayLike,
    eye_radius: ArrayLike,
    scale: ArrayLike,
) -> Batch:
    r"""Image radius of a lit circle for a pinhole on the sphere (z_F = r).

    $e_1' = f\sin\beta/(\cos\varphi + \cos\beta)$ with $\sin\beta = R/r$, $\sin\varphi = c/r$ and
    $f = 2r/\delta$: the pinhole is the centre of a stereographic projection, so the image is a
    circle (c is that of O, the beam's axis on the wall, not of the image circle's centre).

    Args:
        spot_radius: R, mm.
        eccentricity: c of O, mm.
        eye_radius: r, mm.
        scale: delta, mm/px at the pole.

    Returns:
        e1', px.
    """
    xp = array_namespace(spot_radius, eccentricity, eye_radius, scale)
    r = xp.asarray(eye_radius)
    sin_beta = xp.asarray(spot_radius) / r
    cos_beta = xp.sqrt(1.0 - sin_beta**2)
    cos_phi = xp.sqrt(1.0 - (xp.asarray(eccentricity) / r) ** 2)
    return 2.0 * r / scale * sin_beta / (cos_phi + cos_beta)


def square_spot_axes(
    *,
    spot_radius: ArrayLike,
    eccentricity: ArrayLike,
    eye_radius: ArrayLike,
    scale: ArrayLike,
    inverse_working_distance: ArrayLike,
) -> tuple[Batch, Batch]:
    r"""Image semi-axes of the lit circle for any pinhole height, in closed form.

    The circle $(p + q\cos t, R\sin t)$ seen at depth $A - B\cos t$ images as an ellipse with axes
    along and across the meridian:
    $a_m = (qA + pB)/(A^2 - B^2)/\delta$, $a_t = R/\sqrt{A^2 - B^2}/\delta$,
    $p = \sqrt{r^2 - R^2}\sin\varphi$, $q = R\cos\varphi$,
    $A = 1 - \kappa(r - \sqrt{r^2 - R^2}\cos\varphi)$, $B = \kappa R\sin\varphi$.

    Args:
        spot_radius: R, mm.
        eccentricity: c of O, mm.
        eye_radius: r, mm.
        scale: delta, mm/px at the pole.
        inverse_working_distance: kappa, 1/mm; 0 is telecentric.

    Returns:
        Meridional and tangential semi-axis, px; e1' is the smaller.
    """
    xp = array_namespace(spot_radius, eccentricity, eye_radius, scale, inverse_working_distance)
    r, spot = xp.asarray(eye_radius), xp.asarray(spot_radius)
    sin_phi = xp.asarray(eccentricity) / r
    cos_phi = xp.sqrt(1.0 - sin_phi**2)
    height = xp.sqrt(r**2 - spot**2)
    kappa = inverse_working_distance
    a = 1.0 - kappa * (r - height * cos_phi)
    b = kappa * spot * sin_phi
    denominator = a**2 - b**2
    meridional = (spot * cos_phi * a + height * sin_phi * b) / denominator
    tangential = spot / xp.sqrt(denominator)
    return meridional / scale, tangential / scale


def plane_point(
    *,
    right_px: ArrayLike,
    down_px: ArrayLike,
    scale: ArrayLike,
    eye_radius: ArrayLike,
    inverse_working_distance: ArrayLike,
    normal: tuple[float, float, float],
) -> Float[Array, "3 *batch"]:
    r"""Intersection of an image point's line of sight with a plane through the pole.

    At a height t above the pole the line is at q (1 - kappa t), as for `eyeball_point`. It meets
    the plane at $t = -\mathbf n\cdot\mathbf q/(n_z - \kappa\,\mathbf n\cdot\mathbf q)$.

    Args:
        right_px: image point, to the right of the principal point, px.
        down_px: image point, below the principal point, px.
        scale: delta, mm/px at the pole.
        eye_radius: r, mm; the pole lies at -r.
        inverse_working_distance: kappa = 1/(z_F + r), 1/mm; 0 is telecentric.
        normal: of the plane, n_z > 0.

    Returns:
        X, Y, Z on the first axis, mm, eye frame; NaN if the line does not meet the plane.
    """
    xp = array_namespace(right_px, down_px, scale, eye_radius, inverse_working_distance)
    x, y = scale * xp.asarray(right_px), scale * -xp.asarray(down_px)
    lean = normal[0] * x + normal[1] * y
    slope = normal[2] - inverse_working_distance * lean
    height = -lean / xp.where(slope > 0, slope, xp.nan)
    narrowing = 1.0 - inverse_working_distance * height
    return xp.stack([x * narrowing, y * narrowing, height - eye_radius])


def eyeball_point(
    *,
    right_px: ArrayLike,
    down_px: ArrayLike,
    scale: ArrayLike,
    eye_radius: ArrayLike,
    inverse_working_distance: ArrayLike,
) -> Float[Array, "3 *batch"]:
    """Intersection of an image point's line of sight with the retina.

    At the pole's height the line is at q = delta (right, -down). At a height t above the pole it is
    at q (1 - kappa t). On the sphere q^2 (1 - kappa t)^2 + (t - r)^2 = r^2, whose lower root t is
    the retina.

    Args:
        right_px: image point, to the right of the principal point, px.
        down_px: image point, below the principal point, px.
        scale: delta, mm/px at the pole.
        eye_radius: r, mm.
        inverse_working_distance: kappa = 1/(z_F + r), 1/mm; 0 is telecentric.

    Returns:
        X, Y, Z on the first axis, mm, eye frame.
    """
    xp = array_namespace(right_px, down_px, scale, eye_radius, inverse_working_distance)
    r, kappa = xp.asarray(eye_radius), inverse_working_distance
    x, y = scale * xp.asarray(right_px), scale * -xp.asarray(down_px)
    square = x**2 + y**2
    p, q = 1.0 + kappa**2 * square, r + kappa * square
    height = square / (q + xp.sqrt(q**2 - p * square))
    narrowing = 1.0 - kappa * height
    return xp.stack([x * narrowing, y * narrowing, height - r])
