"""A withdrawal's geometry, wall and pinhole, and the half-maximum contour of a spot in its image.

It shares no code with `optics` or `scenes`. The frame is the eye's, in mm: the microscope's pinhole
is (0, 0, z_F), u = u0 + f X/(z_F - Z), v = v0 - f Y/(z_F - Z), integers are the pixels' centres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import ndimage
from skimage.measure import find_contours

from tests.support.light.photons import Drop

_PEAK_PX = 0.8
"""Smoothing of a spot before its peak is taken. On an oblique wall the peak is at the light's edge;
3 px would lower it by 1 %, and with it the level of the contour."""
INDEX = {"air": 1.0, "vitreous": 1.336}
TUBE = 0.25  # radius of the fibre's face, whose rim touches the wall first, mm


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A withdrawal, its eye, microscope and camera; mm, mW, rad."""

    drop: Drop
    medium: str = "air"  # or "vitreous"
    wall: str = "plane"  # perpendicular to the microscope's axis; or "eyeball", closed and matt
    eccentricity: float = 0.0  # of the first frame's spot
    azimuth: float = 0.0
    incidence: float = 0.5  # of the beam in the first frame
    incidence_azimuth: float = 1.5
    beam_off: tuple[float, float] = (0.0, 0.0)  # from the motion, along two perpendiculars
    lean: tuple[float, float] = (0.0, 0.0)  # of the motion from what the robot reports, likewise
    touch_off: float = 0.0  # first distance minus that at which the face's rim touches
    first: float = 0.8  # reading of the first frame from contact
    last: float = 5.0
    frames: int = 24
    width: int = 160
    height: int = 120
    scale: float = 0.02  # mm/px at the pole
    pinhole: float = 200.0  # z_F
    radius: float = 11.5
    reflectance: float = 0.5
    power: float = 1.0  # in the core
    illumination: float = 0.02  # by the microscope at the pole, mW/mm²
    full_well: float = 500.0  # electrons in each of three channels
    read_noise: float = 3.0  # likewise
    black: float = 4.0  # level of a dark pixel, of 255
    peak: float = 0.7  # brightest mean pixel of a frame over full scale
    spread: float = 0.0  # sigma of light in the wall
    texture: float = 0.0  # contrast of the wall, standard deviation over mean
    sensitivity: ClassVar[float] = 200.0  # of the camera, full wells per radiance and second

    @property
    def brightness(self) -> float:
        """What a lens's calibration file calls so."""
        share = 1 - self.black / 255
        return share * self.sensitivity * self.power * self.reflectance / np.pi

    @property
    def readings(self) -> np.ndarray:
        """Distance of each frame's tip from the first along the motion, mm."""
        return np.linspace(self.first, self.last, self.frames)


class Poses(NamedTuple):
    """Where the tip is and where it looks."""

    tips: np.ndarray  # mm, frames x 3
    beam: np.ndarray  # unit vector along the light
    reported: np.ndarray  # unit vector that the robot reports for its motion
    touch: float  # true distance from tip to wall along the beam at reading 0, mm
    spot: np.ndarray  # the point on the wall at reading 0


def perpendiculars(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first = np.cross(axis, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _turned(axis: np.ndarray, by: tuple[float, float]) -> np.ndarray:
    first, second = perpendiculars(axis)
    way = axis + by[0] * first + by[1] * second
    return way / np.linalg.norm(way)


def poses(recording: Recording) -> Poses:
    own = recording
    spot = own.eccentricity * np.array([np.cos(own.azimuth), np.sin(own.azimuth), 0.0])
    # Where the rim of the face touches: on a plane a tan ι; in a sphere the deepest point of the
    # rim is on the wall.
    if own.wall == "plane":
        spot[2], outward = -own.radius, np.array([0.0, 0.0, -1.0])
        contact = TUBE * np.tan(own.incidence)
    else:
        spot[2] = -np.sqrt(own.radius**2 - own.eccentricity**2)
        outward = spot / own.radius
        c, s, r = np.cos(own.incidence), np.sin(own.incidence), own.radius
        contact = r * c - np.sqrt(r**2 - (r * s + TUBE) ** 2)
    first, second = perpendiculars(outward)
    aside = np.cos(own.incidence_azimuth) * first + np.sin(own.incidence_azimuth) * second
    beam = np.cos(own.incidence) * outward + np.sin(own.incidence) * aside
    motion = _turned(beam, own.beam_off)
    touch = contact + own.touch_off
    tips = spot - touch * beam - own.readings[:, None] * motion
    return Poses(tips, beam, _turned(motion, own.lean), float(touch), spot)


def seen_wall(recording: Recording, u: np.ndarray, v: np.ndarray, centre: np.ndarray) -> tuple:
    """Points on the wall behind image points, and its inward normals there."""
    own = recording
    f = (own.pinhole + own.radius) / own.scale
    sight = np.stack([(u - centre[0]) / f, -(v - centre[1]) / f, -np.ones(u.shape)], axis=-1)
    origin = np.array([0.0, 0.0, own.pinhole])
    if own.wall == "plane":
        point = origin + (own.pinhole + own.radius) * sight
        return point, np.broadcast_to([0.0, 0.0, 1.0], point.shape)
    a, b = np.sum(sight**2, axis=-1), sight @ origin
    far = (-b + np.sqrt(b**2 - a * (own.pinhole**2 - own.radius**2))) / a
    point = origin + far[..., None] * sight
    return point, -point / own.radius


def principal_point(recording: Recording, where: Poses) -> np.ndarray:
    """Such that the spots of the first and the last frame lie around the middle of the frame."""
    own = recording
    f = (own.pinhole + own.radius) / own.scale
    x, y, z = where.spot
    image = np.array([f * x, -f * y]) / (own.pinhole - z)
    return np.array([(own.width - 1) / 2, (own.height - 1) / 2]) - image


def steady_light(recording: Recording, transmitted: float, centre: np.ndarray) -> np.ndarray:
    """Irradiance behind each pixel by the microscope and by light that the eyeball scatters back.

    In a closed matt sphere the latter is uniform, rho Phi/(4 pi r² (1 - rho)).
    """
    own = recording
    v, u = np.mgrid[: own.height, : own.width]
    point, normal = seen_wall(own, u, v, centre)
    sight = point - np.array([0.0, 0.0, own.pinhole])
    far = np.linalg.norm(sight, axis=-1)
    cosine = -np.sum(normal * sight, axis=-1) / far
    steady = own.illumination * cosine * ((own.pinhole + own.radius) / far) ** 2
    if own.wall == "eyeball":
        rho = own.reflectance
        steady += rho * own.power * transmitted / (4 * np.pi * own.radius**2 * (1 - rho))
    return np.asarray(steady)


def half_maximum(image: np.ndarray) -> np.ndarray:
    """Contour (u, v) at half of a noise-free spot's peak, px."""
    # Few photons reach the middle of the spot, so its highest pixel is a mean with its neighbours.
    peak = ndimage.gaussian_filter(image, _PEAK_PX).max()
    contour = max(find_contours(image, 0.5 * peak), key=len)
    return np.asarray(contour[:-1, ::-1])
