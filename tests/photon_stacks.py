"""A withdrawal's geometry, wall and pinhole, and noise-free images of light that `photons` counted.

It shares no code with `optics` or `scenes`. The frame is the eye's, in mm: the microscope's pinhole
is (0, 0, z_F), u = u0 + f X/(z_F - Z), v = v0 - f Y/(z_F - Z), integers are the pixels' centres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from skimage.measure import find_contours

from tests.photons import Drop, PhotonLight

_PEAK_PX = 0.8
"""Smoothing of a spot before its peak is taken. On an oblique wall the peak is at the light's edge;
3 px would lower it by 1 %, and with it the level of the contour."""
INDEX = {"air": 1.0, "vitreous": 1.336}
TUBE = 0.25  # radius of the fibre's face, whose rim touches the wall first, mm


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A withdrawal, its eye, microscope and camera.

    Attributes:
        drop: the lens.
        medium: "air" or "vitreous".
        wall: "plane", perpendicular to the microscope's axis, or "eyeball", closed and matt.
        eccentricity, azimuth: place of the first frame's spot, mm from the axis, and rad.
        incidence, incidence_azimuth: of the beam in the first frame, rad.
        beam_off: direction of the beam relative to the motion, rad, along two perpendiculars.
        lean: direction of the motion relative to what the robot reports, rad, likewise.
        touch_off: first distance minus that at which the face's rim touches, mm.
        first, last: readings of the first and the last frame from contact, mm.
        frames: number of frames.
        width, height: of the frames, px.
        scale: mm/px at the pole.
        pinhole: z_F, mm.
        radius: of the eye, mm.
        reflectance: of the wall.
        power: in the core, mW.
        illumination: by the microscope at the pole, mW/mm².
        full_well, read_noise: of the camera, electrons in each of three channels.
        black: level of a dark pixel, of 255.
        peak: brightest mean pixel of a frame over full scale.
        spread: sigma of light in the wall, mm.
        texture: contrast of the wall, standard deviation over mean.
    """

    drop: Drop
    medium: str = "air"
    wall: str = "plane"
    eccentricity: float = 0.0
    azimuth: float = 0.0
    incidence: float = 0.5
    incidence_azimuth: float = 1.5
    beam_off: tuple[float, float] = (0.0, 0.0)
    lean: tuple[float, float] = (0.0, 0.0)
    touch_off: float = 0.0
    first: float = 0.8
    last: float = 5.0
    frames: int = 24
    width: int = 160
    height: int = 120
    scale: float = 0.02
    pinhole: float = 200.0
    radius: float = 11.5
    reflectance: float = 0.5
    power: float = 1.0
    illumination: float = 0.02
    full_well: float = 500.0
    read_noise: float = 3.0
    black: float = 4.0
    peak: float = 0.7
    spread: float = 0.0
    texture: float = 0.0

    @property
    def sensitivity(self) -> float:
        """Full wells per radiance and second; a number of the camera, the same for all stacks."""
        return 200.0

    @property
    def brightness(self) -> float:
        """What a lens's calibration file calls so."""
        share = 1 - self.black / 255
        return share * self.sensitivity * self.power * self.reflectance / np.pi

    @property
    def readings(self) -> np.ndarray:
        """Distance of each frame's tip from the first along the motion, mm."""
        return np.linspace(self.first, self.last, self.frames)


@dataclass(frozen=True, eq=False)
class Poses:
    """Where the tip is and where it looks.

    Attributes:
        tips: mm, frames x 3.
        beam: unit vector along the light.
        reported: unit vector that the robot reports for its motion.
        touch: true first distance, tip to wall along the beam, at reading 0, mm.
        spot: the point on the wall at reading 0.
    """

    tips: np.ndarray
    beam: np.ndarray
    reported: np.ndarray
    touch: float
    spot: np.ndarray


def perpendiculars(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first = np.cross(axis, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _turned(axis: np.ndarray, by: tuple[float, float]) -> np.ndarray:
    first, second = perpendiculars(axis)
    way = axis + by[0] * first + by[1] * second
    return way / np.linalg.norm(way)


def poses(recording: Recording) -> Poses:
    """Poses of a recording's frames."""
    own = recording
    if own.wall == "plane":
        outward = np.array([0.0, 0.0, -1.0])
        spot = own.eccentricity * np.array([np.cos(own.azimuth), np.sin(own.azimuth), 0.0])
        spot[2] = -own.radius
    else:
        phi = np.arcsin(own.eccentricity / own.radius)
        outward = np.array(
            [np.sin(phi) * np.cos(own.azimuth), np.sin(phi) * np.sin(own.azimuth), -np.cos(phi)]
        )
        spot = own.radius * outward
    first, second = perpendiculars(outward)
    aside = np.cos(own.incidence_azimuth) * first + np.sin(own.incidence_azimuth) * second
    beam = np.cos(own.incidence) * outward + np.sin(own.incidence) * aside
    motion = _turned(beam, own.beam_off)
    # Where the rim of the face touches: on a plane a tan ι; in a sphere the deepest point of the
    # rim is on the wall.
    if own.wall == "plane":
        contact = TUBE * np.tan(own.incidence)
    else:
        c, s, r = np.cos(own.incidence), np.sin(own.incidence), own.radius
        contact = r * c - np.sqrt(r**2 - (r * s + TUBE) ** 2)
    touch = contact + own.touch_off
    tip = spot - touch * beam
    tips = tip - own.readings[:, None] * motion
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


def direct_light(
    recording: Recording,
    light: PhotonLight,
    tip: np.ndarray,
    beam: np.ndarray,
    centre: np.ndarray,
    *,
    samples: int = 4,
) -> np.ndarray:
    """Irradiance of the wall behind each pixel, 1/mm² per unit power in the core.

    Args:
        recording: for its wall and microscope.
        light: of the lens.
        tip: mm.
        beam: unit vector from the tip towards the wall.
        centre: principal point, px.
        samples: of a pixel, each way.
    """
    own = recording
    sub = (np.arange(samples) + 0.5) / samples - 0.5
    v, u, dv, du = np.meshgrid(np.arange(own.height), np.arange(own.width), sub, sub, indexing="ij")
    point, normal = seen_wall(own, u + du, v + dv, centre)
    across, offset = perpendiculars(beam), point - tip
    s = offset @ beam
    in_front = s > light.nearest
    flow = light.irradiance(
        offset @ across[0], offset @ across[1], np.where(in_front, s, light.nearest)
    )
    onto = sum(part * (normal @ way) for part, way in zip(flow, (*across, beam), strict=True))
    return np.asarray(np.where(in_front, -onto, 0.0).mean(axis=(2, 3)))


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
