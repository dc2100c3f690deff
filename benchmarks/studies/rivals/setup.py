"""What the sensors look at: the instrument, the light guide, the wall, and the microscopes."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import optics
from optics.viewing import (
    ViewingPath,
    WideFieldLens,
    bare_path,
    load_eye,
    load_viewing_lens,
    path_camera,
    side_camera,
    viewing_path,
)

PATHS: dict[str, str | None] = {
    "pinhole": None,
    "flat contact lens": "flat",
    "wide-field 90 D": "wide-field-90",
}
"""Viewing lens of each path; behind a lens lies Navarro's phakic eye."""

EYE, WAVELENGTH_NM = "navarro", 550.0
RADIUS_MM = 12.0  # of Navarro's retina
PINHOLE_HEIGHT_MM = 200.0
SCALE_MM_PX = 0.0134  # the shadow of a tip at 6 mm lies 6 mm beside the spot
WIDTH_PX, HEIGHT_PX = 960, 720
CONVERGENCE_DEG = 5.5
"""Angle between the two lines of sight of a stereo microscope at the pole, without a viewing lens:
the middle of 5 to 6 degrees."""

CONE = {"half_angle": float(np.arctan(1 / 20.0)), "apex_offset": -5.117}
TOOL_GAUGE, TOOL_RADIUS_MM = 25, 0.255
TROCAR_POLAR_DEG = 48.0
TOOL_AZIMUTH_DEG, LAMP_AZIMUTH_DEG, SPOT_AZIMUTH_DEG = 30.0, 150.0, 270.0
"""The trocars lie at two and ten o'clock; the spot moves away from both."""
LAMP_ABOVE_MM = 15.0  # of the light guide's end, from the pole along its trocar
LAMP_RADIUS_MM = 0.25  # of the light guide's end


Numbers = Any
"""NumPy's outside of compiled functions, JAX's inside; several places have a leading axis."""


class Place(NamedTuple):
    """An instrument at the wall, and the light guide that makes its shadow; mm, eye frame.

    Attributes:
        eccentricity: c, mm.
        distance: d = |SO|, mm.
        tip: S, 3.
        axis: unit vector of the instrument, from its trocar to O, 3.
        spot: O, 3.
        lamp: end of the light guide, 3.
        lamp_axis: unit vector of the light guide, 3.
    """

    eccentricity: Numbers
    distance: Numbers
    tip: Numbers
    axis: Numbers
    spot: Numbers
    lamp: Numbers
    lamp_axis: Numbers


class Views(NamedTuple):
    """The microscopes of one path, each with the pole in the middle of its image.

    Attributes:
        centre: on the eye's axis; it sees the spot and the shadow.
        left: half of the stereo pair.
        right: the other half.
    """

    centre: optics.Camera
    left: optics.Camera
    right: optics.Camera


def place(*, eccentricity: float, distance: float) -> Place:
    """The instrument through its trocar, the light guide through the other one.

    Args:
        eccentricity: c of the point O that the instrument points to, mm.
        distance: d from its tip to O, mm.
    """
    azimuth = math.radians(SPOT_AZIMUTH_DEG)
    wall = optics.Sphere(RADIUS_MM)
    spot = np.asarray(wall.frame_at(eccentricity=eccentricity, azimuth=azimuth).origin)
    axis = _unit(spot - _trocar(TOOL_AZIMUTH_DEG))
    pole = np.array([0.0, 0.0, -RADIUS_MM])
    lamp_axis = _unit(pole - _trocar(LAMP_AZIMUTH_DEG))
    return Place(
        np.asarray(eccentricity),
        np.asarray(distance),
        spot - distance * axis,
        axis,
        spot,
        pole - LAMP_ABOVE_MM * lamp_axis,
        lamp_axis,
    )


def beam_of(one: Place) -> optics.Beam:
    """The cone of light that leaves the instrument's tip."""
    return optics.Beam(tip=jnp.asarray(one.tip), axis=jnp.asarray(one.axis), **CONE)


def views(path: str) -> Views:
    """The microscopes that look through a path."""
    lens = PATHS[path]
    inverted = lens is not None and isinstance(load_viewing_lens(lens), WideFieldLens)
    return _views(_through(lens), bare=lens is None, inverted=inverted)


@eqx.filter_jit
def _views(seen: ViewingPath, *, bare: bool, inverted: bool) -> Views:
    half = math.tan(math.radians(CONVERGENCE_DEG / 2)) * (PINHOLE_HEIGHT_MM + RADIUS_MM)
    if bare:
        centre: optics.Camera = optics.microscope(
            scale=SCALE_MM_PX, pinhole_height=PINHOLE_HEIGHT_MM, eye_radius=RADIUS_MM
        )
    else:
        centre = path_camera(seen, scale=SCALE_MM_PX, upright=True)
    left, right = (
        side_camera(seen, aside=jnp.array([x, 0.0]), scale=SCALE_MM_PX, upright=True)
        # A stereo inverter turns both images, and exchanges them; else near would look far.
        for x in ((half, -half) if inverted else (-half, half))
    )
    return Views(*(_centred_on_pole(camera) for camera in (centre, left, right)))


project = eqx.filter_jit(lambda camera, points: camera.project(points))
"""Image of points by a camera, compiled."""


def centred(camera: optics.Camera, point: np.ndarray) -> optics.Camera:
    """The camera with its window centred on a point."""
    middle = np.array([(WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2])
    shift = middle - np.asarray(project(camera, point[None]))[0]
    return eqx.tree_at(lambda c: c.principal_point, camera, camera.principal_point + shift)


def _centred_on_pole(camera: optics.Camera) -> optics.Camera:
    """The camera with the retinal pole at pixel (0, 0)."""
    pole = jnp.stack([jnp.zeros(()), jnp.zeros(()), camera.pole_height])
    shift = camera.project(pole)
    return eqx.tree_at(lambda c: c.principal_point, camera, camera.principal_point - shift)


def _through(lens: str | None) -> ViewingPath:
    if lens is None:
        return bare_path(eye_radius=RADIUS_MM, pinhole_height=PINHOLE_HEIGHT_MM)
    eye = load_eye(EYE, wavelength_nm=WAVELENGTH_NM)
    cornea = float(eye.axial_length) - RADIUS_MM
    return viewing_path(eye, load_viewing_lens(lens), pinhole_distance=PINHOLE_HEIGHT_MM - cornea)


def _trocar(azimuth_deg: float) -> np.ndarray:
    azimuth, polar = math.radians(azimuth_deg), math.radians(TROCAR_POLAR_DEG)
    across = math.sin(polar)
    return RADIUS_MM * np.array(
        [across * math.cos(azimuth), across * math.sin(azimuth), math.cos(polar)]
    )


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
