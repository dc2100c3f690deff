"""The exact spot: cone and wall intersected generator by generator, projected, fitted.

Fitting ellipses inside a solver is slow. The fit's normal equations are enough to test whether a
given ellipse is the fitted one: `ellipse_mismatch`.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from eyespot.optics.beam import Beam
from eyespot.optics.camera import Camera
from eyespot.optics.ellipse import (
    Ellipse,
    ellipse_of_contour,
    in_unit_circle,
    steps_of_eccentric_angle,
)
from eyespot.optics.lines import generator_angles
from eyespot.optics.surface import Intersection, Surface

CONTOUR_POINTS = 128
"""Enough for 1e-9 px on every spot inside the working volume; the sums converge spectrally."""
FEW_POINTS = 32
"""A quarter of them, for a quarter of the time: 1e-7 px."""


def cone_contour(beam: Beam, surface: Surface, *, points: int = CONTOUR_POINTS) -> Intersection:
    """Edge of the lit spot on the wall: where the cone's generators meet it.

    Args:
        points: number of generators, uniform about the axis, from the virtual apex.

    Returns:
        Wall points in mm with a status each; for a sphere the curve is a quartic.
    """
    directions = beam.generators(jnp.asarray(generator_angles(points)))
    return surface.intersect(jnp.broadcast_to(beam.apex, directions.shape), directions)


def spot_contour(
    beam: Beam, surface: Surface, microscope: Camera, *, points: int = CONTOUR_POINTS
) -> Float[Array, "n 2"]:
    """Image of the spot's edge, px."""
    return microscope.project(cone_contour(beam, surface, points=points).point)


def spot_ellipse(
    beam: Beam, surface: Surface, microscope: Camera, *, points: int = CONTOUR_POINTS
) -> Ellipse:
    """Ellipse of the image of the spot's edge, px: the `exact` model, forward.

    Example:
        >>> from eyespot import optics
        >>> eye = optics.Sphere(11.5)
        >>> view = optics.microscope(scale=0.0067, pinhole_height=200.0, eye_radius=11.5)
        >>> cone = {"half_angle": 0.0499584, "apex_offset": -5.117}
        >>> beam = optics.beam_at_spot(eye, eccentricity=3.0, distance=2.0, **cone)
        >>> round(float(optics.spot_ellipse(beam, eye, view).semi_minor), 2)
        51.53
    """
    return ellipse_of_contour(spot_contour(beam, surface, microscope, points=points))


_LEAST_SINE = 0.25
"""Least variance of the sin 2t term over that of the cos 2t term. For uniform noise around a
circle the two are equal."""


def ellipse_mismatch(
    contour: Float[Array, "n 2"], ellipse: Ellipse, seen: Float[Array, "n"] | None = None
) -> Float[Array, "5"]:
    """Difference of a contour's fitted ellipse from a given one, to first order.

    In coordinates (p, q) in which the given ellipse is the unit circle: shift along p and q, and
    the terms of 1, cos 2t and sin 2t in the radius. They are exactly zero if the two ellipses are
    equal, because then the conic 1 - p^2 - q^2 satisfies the normal equations of the fit. Without
    the division by the contour's mean square radius, they would also vanish for a contour of size
    0, and a solver with many unknowns goes there.

    Args:
        contour: points in order around the curve, px; with 32 points the error is 1e-7 px.
        ellipse: the given ellipse, px.
        seen: share of each point's piece of the contour that is visible; None: all of it. The given
            ellipse was fitted to the visible part only, where the contour's third harmonic, which
            no ellipse has, looks in part like an ellipse's.

    Returns:
        Five numbers, relative to the ellipse's axes.
    """
    # Without the barrier XLA computes the contour again for each of its points: 3 ms, not 0.7.
    contour = jax.lax.optimization_barrier(contour)
    p, q = in_unit_circle(contour, ellipse)
    weights = steps_of_eccentric_angle(contour, ellipse)
    p, q, weights = jax.lax.optimization_barrier((p, q, weights))
    weights /= jnp.sum(weights)
    x, y = p - jnp.sum(weights * p), q - jnp.sum(weights * q)
    outside = (p * p + q * q - 1.0) / jnp.sum(weights * (x * x + y * y))
    terms = [x, y, x * x + y * y, x * x - y * y, 2.0 * x * y]
    parts = zip((1.0, 1.0, 0.5, 1.0, 1.0), terms, strict=True)
    whole = jnp.stack([factor * jnp.sum(weights * outside * term) for factor, term in parts])
    if seen is None:
        return whole
    rows = jnp.stack(terms, axis=1)
    weighted = rows.T * (weights * seen)
    no_ellipse = 0.5 * outside - rows @ whole
    return whole + jnp.linalg.solve(weighted @ rows, weighted @ no_ellipse)


def mismatch_covariance(ellipse: Ellipse, covariance: Float[Array, "5 5"]) -> Float[Array, "5 5"]:
    """Covariance of `ellipse_mismatch`'s terms.

    Args:
        ellipse: measured, px.
        covariance: covariance of (centre u, centre v, semi-major, semi-minor in px; angle in rad).
    """
    a, b = ellipse.semi_major, ellipse.semi_minor
    c, s = jnp.cos(ellipse.angle), jnp.sin(ellipse.angle)
    zero = jnp.zeros(())
    jacobian = jnp.array(
        [
            [c / a, s / a, zero, zero, zero],
            [-s / b, c / b, zero, zero, zero],
            [zero, zero, 0.5 / a, 0.5 / b, zero],
            [zero, zero, 0.5 / a, -0.5 / b, zero],
            [zero, zero, zero, zero, 0.5 * (a / b - b / a)],
        ]
    )
    relative = jacobian @ covariance @ jacobian.T
    # A circle's angle has no effect on sin 2t, but noise changes it about as much as cos 2t.
    sine = jnp.maximum(relative[4, 4], _LEAST_SINE * relative[3, 3])
    return relative.at[4, 4].set(sine)
