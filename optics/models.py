"""Models from spot size to distance: planar, small_plane, corrected, stereographic.

Each is a closed form for a beam perpendicular to the wall. Terms of the paper's derivation are
separate functions, so that a study can measure the error of an approximation. The model `exact`
needs the beam's direction and is in `distance`.

The functions accept floats, NumPy arrays and JAX arrays. They compute in JAX if an argument is a
JAX array, otherwise in NumPy. This file does not import JAX, so that a program on the robot can use
the closed forms without it. The result is NaN if a model has no such spot.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eyespot.formats.inputs import InputError
from eyespot.optics.lines import array_namespace

if TYPE_CHECKING:
    from jaxtyping import Array, ArrayLike, Float

    Batch = Float[Array, "*batch"]


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


CLOSED_FORMS = ("planar", "small_plane", "corrected", "stereographic")
"""Names of the models of `closed_form_distance`."""

MODELS = (*CLOSED_FORMS, "exact")
"""Names of the models that need one semi-axis of the spot; `area` needs both."""


def closed_form_distance(
    model: str,
    *,
    semi_minor_px: ArrayLike,
    scale: ArrayLike,
    k: ArrayLike,
    b: ArrayLike,
    eccentricity: ArrayLike,
    eye_radius: ArrayLike,
    inverse_working_distance: ArrayLike,
) -> Batch:
    r"""Distance by the model with this name; each model uses only the arguments that it needs.

    `planar` is for a plane parallel to the sensor (Zhou et al. 2020, eq. 6). The others find the
    spot's radius e1 in an eyeball and insert it in eq. 5 (`sphere_distance`): `small_plane` is the
    paper's (eq. 9 and 10), `corrected` has the correct factor to first order for the pinhole's
    height (`corrected_factor`). `stereographic` is exact for a pinhole on the sphere: with
    $m = \delta e_1'/2r$, $\beta = \arctan m + \arcsin(m\cos\varphi/\sqrt{1+m^2})$,
    $e_1 = r\sin\beta$.

    Args:
        model: one of `CLOSED_FORMS`.
        semi_minor_px: e1', px.
        scale: delta, mm/px at the pole.
        k: 1/tan(half-angle).
        b: apex offset, mm.
        eccentricity: c, mm.
        eye_radius: r, mm.
        inverse_working_distance: 1/(z_F + r), 1/mm; 0 is telecentric, below 0 the pinhole lies
            behind the retina.

    Returns:
        d, mm.

    Raises:
        InputError: no closed form has this name.

    Example:
        A spot 3 mm from the axis under a microscope at 200 mm, read by two models:

        >>> spot = {"semi_minor_px": 60.0, "eccentricity": 3.0}
        >>> known = {"scale": 0.0067, "k": 20.0, "b": -5.117, "eye_radius": 11.5}
        >>> for model in ("small_plane", "corrected"):
        ...     d = closed_form_distance(model, **spot, **known, inverse_working_distance=1 / 211.5)
        ...     print(model, round(float(d), 3))
        small_plane 2.651
        corrected 3.171
    """
    xp = array_namespace(
        semi_minor_px, scale, k, b, eccentricity, eye_radius, inverse_working_distance
    )
    size, r = scale * xp.asarray(semi_minor_px), xp.asarray(eye_radius)
    match model:
        case "planar":
            return planar_distance(semi_minor_px=semi_minor_px, scale=scale, k=k, b=b)
        case "small_plane":
            radius = size * paper_foreshortening(eccentricity=eccentricity, eye_radius=r)
        case "corrected":
            radius = size * corrected_factor(
                eccentricity=eccentricity,
                eye_radius=r,
                inverse_working_distance=inverse_working_distance,
            )
        case "stereographic":
            m = size / (2.0 * r)
            cos_phi = xp.sqrt(1.0 - (xp.asarray(eccentricity) / r) ** 2)
            beta = xp.arctan(m) + xp.arcsin(m * cos_phi / xp.sqrt(1.0 + m**2))
            radius = r * xp.sin(beta)
        case _:
            raise InputError(
                f"closed_form_distance(model=...) must be one of {', '.join(CLOSED_FORMS)}; got "
                f"{model!r}."
            )
    return sphere_distance(spot_radius=radius, k=k, b=b, eye_radius=eye_radius)


def planar_distance(*, semi_minor_px: ArrayLike, scale: ArrayLike, k: ArrayLike, b: ArrayLike):
    """Distance d (mm) on a plane parallel to the sensor, d = delta k e1' + b.

    Zhou et al. 2020, eq. 6. Args: as for `closed_form_distance`.

    Example:
        >>> d = planar_distance(semi_minor_px=60.0, scale=0.0067, k=20.0, b=-5.117)
        >>> round(float(d), 3)
        2.923
    """
    xp = array_namespace(semi_minor_px, scale, k, b)
    return scale * k * xp.asarray(semi_minor_px) + b


def sagitta(*, spot_radius: ArrayLike, eye_radius: ArrayLike) -> Batch:
    """S'O = r - sqrt(r^2 - e1^2), depth of the spot's cap, mm (Zhou et al. 2020, eq. 4).

    Computed as e1^2/(r + sqrt(r^2 - e1^2)), which avoids cancellation for small spots.

    Example:
        >>> round(float(sagitta(spot_radius=1.0, eye_radius=11.5)), 4)
        0.0436
    """
    xp = array_namespace(spot_radius, eye_radius)
    squared = xp.asarray(spot_radius) ** 2
    return squared / (eye_radius + xp.sqrt(xp.asarray(eye_radius) ** 2 - squared))


def sphere_distance(*, spot_radius: ArrayLike, k: ArrayLike, b: ArrayLike, eye_radius: ArrayLike):
    """d = k e1 + b + r - sqrt(r^2 - e1^2), mm; exact at perpendicular incidence.

    Zhou et al. 2020, eq. 5.
    """
    xp = array_namespace(spot_radius, k, b, eye_radius)
    return k * xp.asarray(spot_radius) + b + sagitta(spot_radius=spot_radius, eye_radius=eye_radius)


def paper_foreshortening(*, eccentricity: ArrayLike, eye_radius: ArrayLike) -> Batch:
    """cos(atan(c / sqrt(r^2 - c^2))) = cos(phi), the factor of Zhou et al. 2020, eq. 9."""
    xp = array_namespace(eccentricity, eye_radius)
    return xp.sqrt(1.0 - (xp.asarray(eccentricity) / eye_radius) ** 2)


def paper_angle_s_d_e(
    *, eccentricity: ArrayLike, eye_radius: ArrayLike, spot_radius: ArrayLike
) -> Batch:
    """Angle S'DE of Zhou et al. 2020, eq. 8, rad; the paper neglects the term with its cosine.

    Its pinhole lies on the sphere: FP = r + sqrt(r^2 - c^2).
    """
    xp = array_namespace(eccentricity, eye_radius, spot_radius)
    r, c = xp.asarray(eye_radius), xp.asarray(eccentricity)
    fp = r + xp.sqrt(r**2 - c**2)
    return xp.arctan(fp * xp.cos(0.5 * xp.arcsin(c / r)) / spot_radius)


def small_plane_distance(
    *,
    semi_minor_px: ArrayLike,
    scale: ArrayLike,
    k: ArrayLike,
    b: ArrayLike,
    eccentricity: ArrayLike,
    eye_radius: ArrayLike,
) -> Batch:
    """The paper's distance d (mm) in the eyeball: eq. 9 inserted in eq. 5.

    Zhou et al. 2020, eq. 10. Args: as for `closed_form_distance`.
    """
    xp = array_namespace(semi_minor_px, scale, k, b, eccentricity, eye_radius)
    foreshortening = paper_foreshortening(eccentricity=eccentricity, eye_radius=eye_radius)
    radius = scale * xp.asarray(semi_minor_px) * foreshortening
    return sphere_distance(spot_radius=radius, k=k, b=b, eye_radius=eye_radius)


def corrected_factor(
    *,
    eccentricity: ArrayLike,
    eye_radius: ArrayLike,
    inverse_working_distance: ArrayLike,
) -> Batch:
    r"""e1/(delta e1') to first order in the spot's size, for a pinhole at any height.

    $\frac{z_F + r\cos\varphi}{z_F + r} / \min(1, m)$ with
    $m = \cos\varphi + \frac{r\sin^2\varphi}{z_F + r\cos\varphi}$: magnification by depth, and
    foreshortening if the meridional axis is the shorter one. With $\kappa = 1/(z_F + r)$,
    $z_F + r\cos\varphi = (1 - \kappa r (1 - \cos\varphi))/\kappa$, finite for $\kappa = 0$.
    Args: as for `closed_form_distance`.
    """
    xp = array_namespace(eccentricity, eye_radius, inverse_working_distance)
    r = xp.asarray(eye_radius)
    sin_phi = xp.asarray(eccentricity) / r
    cos_phi = xp.sqrt(1.0 - sin_phi**2)
    depth = 1.0 - xp.asarray(inverse_working_distance) * r * (1.0 - cos_phi)
    meridional = cos_phi + inverse_working_distance * r * sin_phi**2 / depth
    return depth / xp.minimum(1.0, meridional)
