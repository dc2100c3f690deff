"""The models' closed forms in NumPy: from an ellipse's size and place to distance.

`optics.models` derives them and holds the same in JAX; a test compares the two. All take floats or
arrays and give NaN where the model has no such spot.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

Numbers = float | np.ndarray

CLOSED_FORMS = ("planar", "small_plane", "corrected", "stereographic")


class View(NamedTuple):
    """An eye and the ideal pinhole above it.

    Attributes:
        scale: delta, mm/px at the pole.
        eye_radius: r, mm.
        pinhole_height: z_F above the eyeball's centre, mm; may be infinite.
    """

    scale: Numbers
    eye_radius: Numbers
    pinhole_height: Numbers


def wall_point(view: View, *, right_px: Numbers, down_px: Numbers) -> np.ndarray:
    """Where the line of sight of an image point meets the retina.

    The line passes at q = delta (right, -down) beside the pole and narrows towards the pinhole by
    1 - kappa t at the height t over the pole, with kappa = 1/(z_F + r); on the sphere
    q^2 (1 - kappa t)^2 + (t - r)^2 = r^2, of which the lower t is the retina.

    Args:
        view: eye and pinhole.
        right_px: of the principal point.
        down_px: of the principal point.

    Returns:
        X, Y, Z in mm, eye frame, on the first axis.
    """
    r = view.eye_radius
    kappa = 1.0 / (view.pinhole_height + r)
    x, y = view.scale * right_px, -view.scale * down_px
    square = x**2 + y**2
    a, b = 1.0 + kappa**2 * square, r + kappa * square
    height = square / (b + np.sqrt(b**2 - a * square))
    narrowing = 1.0 - kappa * height
    return np.stack([x * narrowing, y * narrowing, height - r])


def spot_radius(
    model: str, view: View, *, semi_minor_px: Numbers, eccentricity: Numbers
) -> Numbers:
    """Radius of the lit circle on the wall, mm.

    planar: delta e1'. small_plane: delta e1' cos(phi) (Zhou et al. 2020, eq. 10). corrected: the
    magnification at O's height, over the foreshortening where the meridional axis is the shorter
    one. stereographic: beta = atan(m) + asin(m cos(phi)/sqrt(1 + m^2)), m = e1'/f, R = r sin(beta).

    Args:
        model: one of `CLOSED_FORMS`.
        view: eye and pinhole; on the sphere for stereographic.
        semi_minor_px: e1', px.
        eccentricity: c of O, mm.
    """
    size = view.scale * semi_minor_px
    if model == "planar":
        return size
    r = view.eye_radius
    sin_phi = eccentricity / r
    cos_phi = np.sqrt(1.0 - sin_phi**2)
    if model == "small_plane":
        return size * cos_phi
    if model == "stereographic":
        m = size / (2.0 * r)
        return r * np.sin(np.arctan(m) + np.arcsin(m * cos_phi / np.sqrt(1.0 + m**2)))
    kappa = 1.0 / (view.pinhole_height + r)
    depth = 1.0 - kappa * r * (1.0 - cos_phi)
    meridional = cos_phi + kappa * r * sin_phi**2 / depth
    return size * depth / np.minimum(1.0, meridional)


def distance(
    model: str,
    view: View,
    *,
    semi_minor_px: Numbers,
    eccentricity: Numbers,
    k: Numbers,
    b: Numbers,
) -> Numbers:
    """d of a beam square to the wall, mm.

    d = k R + b on a plane (Zhou et al. 2020, eq. 7), and the sagitta r - sqrt(r^2 - R^2) more in
    the eyeball (eq. 6).

    Args:
        model: one of `CLOSED_FORMS`.
        view: eye and pinhole.
        semi_minor_px: e1', px.
        eccentricity: c of O, mm.
        k: 1/tan(half-angle).
        b: apex offset, mm.
    """
    radius = spot_radius(model, view, semi_minor_px=semi_minor_px, eccentricity=eccentricity)
    if model == "planar":
        return k * radius + b
    r = view.eye_radius
    return k * radius + b + radius**2 / (r + np.sqrt(r**2 - radius**2))
