"""Images of spots on the retinas of many eyes, through viewing paths and through pinholes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

import optics
from optics.viewing import (
    Eye,
    PathCamera,
    ViewingLens,
    load_viewing_lens,
    path_camera,
    viewing_path,
)

SCALE_MM_PX = 0.0067
NOMINAL_RADIUS_MM = 12.0
"""Radius of the sphere that models assume where no eye is calibrated."""

CONE = {"half_angle": float(np.arctan(1 / 20.0)), "apex_offset": -5.117}
PINHOLE_ABOVE_MM = 200.0
_POINTS = 48  # of a contour: its ellipse is within 1e-6 px of 128 points
PATHS: dict[str, tuple[str, str]] = {
    "flat, phakic": ("flat", "phakic"),
    "flat, pseudophakic": ("flat", "pseudophakic"),
    "flat, aphakic": ("flat", "aphakic"),
    "wide-field 90 D, phakic": ("wide-field-90", "phakic"),
    "wide-field 130 D, phakic": ("wide-field-130", "phakic"),
}
"""Viewing lens and form of each path."""


class Spots(NamedTuple):
    """Spots on a retina; mm and rad, arrays of one shape.

    Attributes:
        eccentricity: c, mm.
        distance: d, mm.
        incidence: angle against the local normal, rad.
        incidence_azimuth: of the tilt, rad; as in `optics.beam_at_spot`.
    """

    eccentricity: Float[Array, "*batch"]
    distance: Float[Array, "*batch"]
    incidence: Float[Array, "*batch"]
    incidence_azimuth: Float[Array, "*batch"]


class Seen(NamedTuple):
    """The images of spots.

    Attributes:
        centre: of the ellipses, px.
        semi_axes: semi-minor and semi-major, px.
        angle: of the semi-major axis, rad.
        axis: unit vectors of the beams.
        visible: whether the whole contour is inside the pupil and the field.
    """

    centre: Float[Array, "*batch 2"]
    semi_axes: Float[Array, "*batch 2"]
    angle: Float[Array, "*batch"]
    axis: Float[Array, "*batch 3"]
    visible: Bool[Array, "*batch"]


class Pinhole(NamedTuple):
    """A pinhole over a sphere, which stands for a path and its retina.

    Attributes:
        scale: delta, mm/px at the pole.
        kappa: 1/(z_F + r), 1/mm; negative behind the retina.
        radius: r of the sphere, mm.
    """

    scale: Float[Array, "*batch"]
    kappa: Float[Array, "*batch"]
    radius: Float[Array, "*batch"]

    @property
    def wall(self) -> optics.Sphere:
        """The sphere."""
        return optics.Sphere(self.radius)

    @property
    def microscope(self) -> optics.Microscope:
        """The pinhole."""
        return optics.Microscope(
            scale=self.scale,
            inverse_working_distance=self.kappa,
            pole_height=-self.radius,
            principal_point=jnp.zeros(2),
            distortion=jnp.zeros(5),
        )


def grid(
    eccentricities: np.ndarray, distances: np.ndarray, tilts_deg: tuple[tuple[float, float], ...]
) -> Spots:
    """All combinations; tilts are pairs of incidence and its azimuth, degrees. n x m x k each."""
    c, d, tilt = np.meshgrid(eccentricities, distances, np.arange(len(tilts_deg)), indexing="ij")
    incidence, azimuth = np.radians(np.asarray(tilts_deg, float)).T
    return Spots(*map(jnp.asarray, (c, d, incidence[tilt], azimuth[tilt])))


def cameras(path: str, eyes: Eye, pupil_radius: Float[Array, ""]) -> PathCamera:
    """The cameras of one path into many eyes, with a leading axis."""
    lens, form = PATHS[path]
    return _cameras(load_viewing_lens(lens), form, eyes, pupil_radius)


@eqx.filter_jit
def _cameras(
    viewing_lens: ViewingLens, form: str, eyes: Eye, pupil_radius: Float[Array, ""]
) -> PathCamera:
    # Lenses of one structure differ in numbers only, and are compiled once.
    def camera(eye: Eye) -> PathCamera:
        found = viewing_path(
            eye,
            viewing_lens,
            form=form,
            pupil_radius=pupil_radius,
            pinhole_distance=PINHOLE_ABOVE_MM + viewing_lens.above_cornea,
        )
        # A robot's axes belong to an upright image, so a wide-field lens needs its inverter.
        return path_camera(found, scale=SCALE_MM_PX, upright=True)

    return jax.vmap(camera)(eyes)


@eqx.filter_jit
def spots_through(camera: PathCamera, semi_axes: Float[Array, "3"], spots: Spots) -> Seen:
    """Spots in a row, on one eye's own retina, seen through its path."""
    retina = optics.Ellipsoid(semi_axes)

    def one(spot: Spots) -> Seen:
        return image(camera, retina, spot, sees=camera.sees)

    return jax.vmap(one)(spots)


def image(
    camera: optics.Camera,
    wall: optics.Surface,
    spot: Spots,
    *,
    sees: Callable[[Float[Array, "n 3"]], Bool[Array, "n"]] = lambda _: jnp.ones((), bool),
) -> Seen:
    """One spot on a wall.

    Args:
        camera: by which it is seen.
        wall: on which it lies.
        sees: which points of the wall are not hidden.
    """
    beam = optics.beam_at_spot(
        wall,
        eccentricity=spot.eccentricity,
        distance=spot.distance,
        incidence=spot.incidence,
        incidence_azimuth=spot.incidence_azimuth,
        **CONE,
    )
    contour = optics.cone_contour(beam, wall, points=_POINTS).point
    ellipse = optics.ellipse_of_contour(camera.project(contour))
    axes = jnp.stack([ellipse.semi_minor, ellipse.semi_major])
    return Seen(ellipse.centre, axes, ellipse.angle, beam.axis, jnp.all(sees(contour)))


def in_batches(function: Callable[[Any], Any], items: PyTree, *, size: int) -> PyTree:
    """Results of a function that treats arrays with a leading axis item by item.

    All batches have one shape, whatever the number of items, so that it is compiled once. One batch
    is too small for several cores, so each core takes a batch of its own.

    Args:
        items: arrays with a leading axis of one length.
        size: items per batch; the last batch is filled up with its last item.
    """
    items = jax.tree.map(np.asarray, items)
    count = len(jax.tree.leaves(items)[0])

    def batch(first: int) -> Any:
        rows = np.minimum(np.arange(first, first + size), count - 1)
        return jax.tree.map(np.asarray, function(jax.tree.map(lambda leaf: leaf[rows], items)))

    first, *rest = range(0, count, size)
    with ThreadPoolExecutor() as pool:
        # The first batch runs alone, so that only one thread compiles.
        done = [batch(first), *pool.map(batch, rest)]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *done)
