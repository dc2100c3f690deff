"""Stacks of frames whose light `photons` counted: own wall, own pinhole, own camera noise.

The light shares no code with `optics` or `scenes`. The frame is the eye's, in mm: the microscope's
pinhole is (0, 0, z_F), u = u0 + f X/(z_F - Z), v = v0 - f Y/(z_F - Z), integers are the pixels'
centres.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from skimage.measure import find_contours

from calibration.pixels.data import CameraNoise, Footage, Instrument
from estimator import StackWriter
from estimator.files.microscope import MicroscopeFile
from estimator.image import Response
from scenes import load_scene
from tests.drawn_sets import labels_of
from tests.photons import Drop, PhotonLight, counted_light

_PEAK_PX = 3.0
INDEX = {"air": 1.0, "vitreous": 1.336}
_TUBE = 0.25  # radius of the fibre's face, whose rim touches the wall first, mm


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
        full_well, read_noise: of the camera, electrons.
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
    full_well: float = 5000.0
    read_noise: float = 10.0
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


def _perpendiculars(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first = np.cross(axis, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _turned(axis: np.ndarray, by: tuple[float, float]) -> np.ndarray:
    first, second = _perpendiculars(axis)
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
            [
                np.sin(phi) * np.cos(own.azimuth),
                np.sin(phi) * np.sin(own.azimuth),
                -np.cos(phi),
            ]
        )
        spot = own.radius * outward
    first, second = _perpendiculars(outward)
    aside = np.cos(own.incidence_azimuth) * first + np.sin(own.incidence_azimuth) * second
    beam = np.cos(own.incidence) * outward + np.sin(own.incidence) * aside
    motion = _turned(beam, own.beam_off)
    # Where the rim of the face touches: on a plane a tan ι; in a sphere the deepest point of the
    # rim is on the wall.
    if own.wall == "plane":
        contact = _TUBE * np.tan(own.incidence)
    else:
        c, s, r = np.cos(own.incidence), np.sin(own.incidence), own.radius
        contact = r * c - np.sqrt(r**2 - (r * s + _TUBE) ** 2)
    touch = contact + own.touch_off
    tip = spot - touch * beam
    tips = tip - own.readings[:, None] * motion
    return Poses(tips, beam, _turned(motion, own.lean), float(touch), spot)


def _wall(recording: Recording, u: np.ndarray, v: np.ndarray, centre: np.ndarray) -> tuple:
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


def _principal_point(recording: Recording, where: Poses) -> np.ndarray:
    """Such that the spots of the first and the last frame lie around the middle of the frame."""
    own = recording
    f = (own.pinhole + own.radius) / own.scale
    x, y, z = where.spot
    image = np.array([f * x, -f * y]) / (own.pinhole - z)
    return np.array([(own.width - 1) / 2, (own.height - 1) / 2]) - image


@dataclass(frozen=True, eq=False)
class Frames:
    """Noise-free light of a recording, and what was used to make it.

    Attributes:
        radiance: mW/(mm² sr), frames x height x width.
        exposure_s: of each frame.
        principal_point: px.
        where: the poses.
    """

    radiance: np.ndarray
    exposure_s: np.ndarray
    principal_point: np.ndarray
    where: Poses


def reach_of(recording: Recording, part: float) -> float:
    """Radius that contains a part of the light at the largest distance, mm."""
    rings, wide = 4000, 4.0
    farthest = poses(recording).touch + recording.last
    light = counted_light(
        recording.drop,
        INDEX[recording.medium],
        nearest=farthest,
        farthest=2 * farthest,
        contact=wide * farthest,
        slope=0.0,
        count=1 << 16,
        planes=2,
        rings=rings,
    )
    inside = np.cumsum(light.rings[0, 2, 0] * (2 * np.arange(rings) + 1))
    return float(np.searchsorted(inside, part * inside[-1]) + 2) / rings * wide * farthest


def light_of(recording: Recording, *, count: int = 1 << 21, seed: int = 0) -> PhotonLight:
    """The drop's light at all distances and radii that the recording's frames show."""
    own, where = recording, poses(recording)
    half = 0.5 * own.scale * np.hypot(own.width, own.height)
    slack = half * np.tan(min(own.incidence + 0.1, 1.2)) + 0.3
    distances = where.touch + own.readings
    farthest = float(distances[-1] + slack)
    contact = own.drop.aperture + 0.1
    # Rings as far out as light is, or as a frame sees.
    reach = min(1.2 * reach_of(own, 1 - 1e-5), 1.3 * half / np.cos(own.incidence) + 0.2)
    return counted_light(
        own.drop,
        INDEX[own.medium],
        nearest=max(float(distances[0] - slack), 0.08),
        farthest=farthest,
        contact=contact,
        slope=max(reach - contact, 0.05) / farthest,
        count=count,
        seed=seed,
    )


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
    point, normal = _wall(own, u + du, v + dv, centre)
    across, offset = _perpendiculars(beam), point - tip
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
    point, normal = _wall(own, u, v, centre)
    sight = point - np.array([0.0, 0.0, own.pinhole])
    far = np.linalg.norm(sight, axis=-1)
    cosine = -np.sum(normal * sight, axis=-1) / far
    steady = own.illumination * cosine * ((own.pinhole + own.radius) / far) ** 2
    if own.wall == "eyeball":
        rho = own.reflectance
        steady += rho * own.power * transmitted / (4 * np.pi * own.radius**2 * (1 - rho))
    return np.asarray(steady)


def frames_of(recording: Recording, light: PhotonLight) -> Frames:
    """Noise-free frames of the wall in a drop's light."""
    own, where = recording, poses(recording)
    centre = _principal_point(own, where)
    steady = steady_light(own, light.transmitted, centre)
    images = []
    for tip in where.tips:
        direct = direct_light(own, light, tip, where.beam, centre)
        if own.spread:
            direct = ndimage.gaussian_filter(direct, own.spread / own.scale)
        images.append(own.reflectance / np.pi * (own.power * direct + steady))
    radiance = np.array(images)
    if own.texture:
        rng = np.random.default_rng(7)
        grain = ndimage.gaussian_filter(rng.standard_normal(radiance.shape[1:]), 2.0)
        radiance = radiance * (1 + own.texture * grain / grain.std())
    exposure = own.peak / (own.sensitivity * radiance.max(axis=(1, 2)))
    return Frames(radiance, exposure, centre, where)


def half_maximum(image: np.ndarray) -> np.ndarray:
    """Contour (u, v) at half of a noise-free spot's peak, px."""
    # Few photons reach the middle of the spot, so its highest pixel is a mean with its neighbours.
    peak = ndimage.gaussian_filter(image, _PEAK_PX).max()
    contour = max(find_contours(image, 0.5 * peak), key=len)
    return np.asarray(contour[:-1, ::-1])


def photographs(recording: Recording, frames: Frames, rng: np.random.Generator) -> np.ndarray:
    """8-bit frames with three channels: Poisson electrons, read noise, black level, rounding."""
    own = recording
    mean = own.sensitivity * frames.exposure_s[:, None, None] * frames.radiance * own.full_well
    shape = (*mean.shape, 3)
    electrons = rng.poisson(np.maximum(mean, 0)[..., None], shape).astype(float)
    electrons += own.read_noise * rng.standard_normal(shape)
    level = own.black + (255 - own.black) * electrons / own.full_well
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


def microscope_of(recording: Recording, frames: Frames) -> dict[str, Any]:
    """Content of microscope.json."""
    own, (u0, v0) = recording, frames.principal_point
    f = (own.pinhole + own.radius) / own.scale
    return {
        "width_px": own.width,
        "height_px": own.height,
        "camera_matrix": [[f, 0.0, float(u0)], [0.0, f, float(v0)], [0.0, 0.0, 1.0]],
        "distortion": [0.0] * 5,
        "scale_mm_px": own.scale,
        "principal_point_px": [float(u0), float(v0)],
        "pinhole_height_mm": own.pinhole,
        "eye_radius_mm": own.radius,
        "response": "linear",
        "paper_exposure_s": None,
    }


def footage_of(recording: Recording, frames: Frames, images: np.ndarray) -> Footage:
    """What `read_footage` reads from a folder with these images."""
    own = recording
    known = microscope_of(own, frames)
    file = MicroscopeFile(
        **known
        | {
            "camera_matrix": np.array(known["camera_matrix"]),
            "distortion": np.array(known["distortion"]),
            "principal_point_px": tuple(known["principal_point_px"]),
            "response": Response(),
        }
    )
    noise = CameraNoise(
        full_well_e=own.full_well,
        read_noise_e=own.read_noise,
        dark_signal_e=0.0,
        black=own.black / 255,
        full_scale=255,
        response=file.response,
    )
    return Footage(
        light=np.stack([noise.light(image) for image in images]).astype(np.float32),
        clear=np.all((images > 0) & (images < 255), axis=-1),
        exposure_s=frames.exposure_s,
        readings=own.readings,
        motion=frames.where.reported,
        axis=frames.where.reported,
        noise=noise,
        microscope=file,
        instrument=Instrument(_TUBE, 6.0),
        in_view=False,
        edge_variance=0.0,
        kind=own.wall,
        medium_index=INDEX[own.medium],
    )


def write_photons(folder: Path, recording: Recording, frames: Frames, images: np.ndarray) -> Path:
    """The images as a stack on disk, as a user's: no label says what a fit may not know."""
    own, where = recording, frames.where
    changes = (
        f"phantom.kind={own.wall}",
        "phantom.wall=uniform",
        f"source.medium={own.medium}",
        f"camera.full_well_e={own.full_well}",
        f"camera.read_noise_e={own.read_noise}",
        f"camera.black_level_dn={own.black}",
        f"instrument.fibre_diameter_mm={2 * _TUBE}",
        "instrument.visible=false",
    )
    times = np.arange(own.frames) / 10
    with StackWriter(folder) as writer:
        writer.describe(
            stack={"scene": load_scene(None, list(changes)).model_dump(mode="json")},
            microscope=microscope_of(own, frames),
            kinematics=np.array(
                [
                    [time, *(-reading * where.reported), *where.reported]
                    for time, reading in zip(times, own.readings, strict=True)
                ]
            ),
        )
        for number, image in enumerate(images):
            labels = labels_of(
                number,
                time_s=float(times[number]),
                exposure_s=float(frames.exposure_s[number]),
                medium=own.medium,
            )
            writer.add(image, labels, np.zeros(image.shape[:2], np.uint8))
    return folder
