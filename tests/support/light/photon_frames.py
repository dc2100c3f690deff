"""Photographs of a withdrawal, photon by photon: what an electron counts, nothing smears.

A photon leaves the core, is refracted or lost, and hits the wall at X. The wall scatters it by
Lambert's law, so the chance that a pixel's electrons come of it is the same for all directions of
incidence, and proportional to |d(u, v)/dA|, the pixels per area of the wall, seen at X. Each photon
is kept with that chance. So each pixel's count is an exact Poisson number with the mean that its
irradiance gives, without rings, planes or samples of a pixel. Every frame has photons of its own,
which makes all counts independent.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from eyespot.calibration.pixels.data import BareFibre, Footage
from eyespot.estimator.camera_noise import CameraNoise
from eyespot.formats.camera_sheet import CameraSheet, Response
from eyespot.formats.stack import StackWriter
from eyespot.scenes import load_scene
from tests.support.drawn.drawn_sets import labels_of
from tests.support.drawn.made_up import a_footage, a_microscope, microscope_content
from tests.support.light.photon_stacks import (
    INDEX,
    TUBE,
    Poses,
    Recording,
    perpendiculars,
    poses,
    principal_point,
    seen_wall,
    steady_light,
)
from tests.support.light.photons import BATCH, photons

_METERED = 1 << 18
"""Photons that set a frame's exposure: some 1,000 in the squares of 3 x 3 pixels that they fill."""
_STILL_S = 0.045  # before and after a frame's time; frames are 0.1 s apart
_MARGIN = 1.001  # of the largest chance over that at the pixels' centres


class Frames(NamedTuple):
    images: np.ndarray  # 8 bit, frames x height x width x channels
    exposure_s: np.ndarray  # of each frame
    principal_point: np.ndarray  # px
    where: Poses


class View:
    """What the camera of a recording counts, frame by frame.

    The beam is a unit vector along the light, and the centre the principal point, px.
    """

    def __init__(
        self, recording: Recording, rng: np.random.Generator, beam: np.ndarray, centre: np.ndarray
    ) -> None:
        self.recording, self.rng = recording, rng
        self.beam, self.centre = beam, centre
        v, u = np.mgrid[: recording.height, : recording.width]
        points, _ = seen_wall(recording, u, v, self.centre)
        self.largest = _MARGIN * float(self._pixels_per_area(np.moveaxis(points, -1, 0)).max())
        parts = [
            photons(recording.drop, INDEX[recording.medium], rng.random((4, BATCH)))[-1]
            for _ in range(64)
        ]
        self.transmitted = sum(parts) / (64 * BATCH)

    def counted(self, tip: np.ndarray, number: int) -> np.ndarray:
        """Photons that each pixel counts of so many in the core, height x width."""
        own = self.recording
        counts = np.zeros(own.height * own.width, np.int64)
        for first in range(0, number, BATCH):
            place = self._pixels(tip, min(BATCH, number - first))
            counts += np.bincount(place, minlength=counts.size)
        return counts.reshape(own.height, own.width)

    def irradiance(self, tip: np.ndarray, number: int) -> np.ndarray:
        """Mean irradiance of the wall behind each pixel, 1/mm² per unit power in the core."""
        return self.counted(tip, number) * (self.largest / number)

    def electrons(self, tip: np.ndarray, exposure_s: float) -> np.ndarray:
        """Electrons, height x width x channels, of a wall with or without texture."""
        own = self.recording
        gain = 3 * own.full_well * own.sensitivity * exposure_s * own.reflectance / np.pi
        steady = steady_light(own, self.transmitted, self.centre)
        grain = self._grain()
        highest = float(grain.max())
        number = self.rng.poisson(gain * own.power * self.largest * highest)
        total = self.counted(tip, int(number)) + self.rng.poisson(gain * steady * highest)
        total = self.rng.binomial(total, grain / highest)
        red = self.rng.binomial(total, 1 / 3)
        green = self.rng.binomial(total - red, 1 / 2)
        return np.stack([red, green, total - red - green], axis=-1)

    def exposure_s(self, tip: np.ndarray) -> float:
        """Such that the brightest part of the spot has the recording's peak."""
        own = self.recording
        light = own.power * ndimage.uniform_filter(self.irradiance(tip, _METERED), 3)
        light += steady_light(own, self.transmitted, self.centre)
        return float(own.peak / (own.sensitivity * own.reflectance / np.pi * light.max()))

    def _grain(self) -> np.ndarray:
        """Relative reflectance behind each pixel."""
        own = self.recording
        if not own.texture:
            return np.ones((own.height, own.width))
        grain = np.random.default_rng(7).standard_normal((own.height, own.width))
        grain = ndimage.gaussian_filter(grain, 2.0)
        return np.maximum(1 + own.texture * grain / grain.std(), 0.0)

    def _pixels_per_area(self, point: np.ndarray) -> np.ndarray:
        """|d(u, v)/dA| of wall points, px²/mm²: f² n (F - X)/(z_F - Z)³; 0 if it is not seen."""
        own = self.recording
        depth = own.pinhole - point[2]
        towards = depth
        if own.wall == "eyeball":
            towards = own.radius - own.pinhole / own.radius * point[2]
        f = (own.pinhole + own.radius) / own.scale
        return np.asarray(np.where(towards > 0, f**2 * towards / depth**3, 0.0))

    def _pixels(self, tip: np.ndarray, number: int) -> np.ndarray:
        """Flat indices of the pixels that count photons, of so many in the core."""
        own, rng = self.recording, self.rng
        even = rng.random((4, number), dtype=np.float32)
        x, y, slope_x, slope_y, weight, _ = photons(own.drop, INDEX[own.medium], even)
        kept = rng.random(weight.size, dtype=np.float32) < weight
        first, second = (way.astype(np.float32) for way in perpendiculars(self.beam))
        beam = self.beam.astype(np.float32)[:, None]
        start = (
            tip.astype(np.float32)[:, None] + np.outer(first, x[kept]) + np.outer(second, y[kept])
        )
        way = beam + np.outer(first, slope_x[kept]) + np.outer(second, slope_y[kept])
        point = self._spread(self._hit(start, way))
        depth = own.pinhole - point[2]
        f = (own.pinhole + own.radius) / own.scale
        u = np.floor(self.centre[0] + 0.5 + f * point[0] / depth).astype(np.int64)
        v = np.floor(self.centre[1] + 0.5 - f * point[1] / depth).astype(np.int64)
        chance = self._pixels_per_area(point) / self.largest
        kept = (u >= 0) & (u < own.width) & (v >= 0) & (v < own.height)
        kept &= rng.random(u.size, dtype=np.float32) < chance
        return v[kept] * own.width + u[kept]

    def _hit(self, start: np.ndarray, way: np.ndarray) -> np.ndarray:
        """Where photons meet the wall, 3 x n; those that never do are left out."""
        own = self.recording
        if own.wall == "plane":
            down = way[2] < 0
            start, way = start[:, down], way[:, down]
            return start - (start[2] + own.radius) / way[2] * way
        a = np.sum(way**2, axis=0)
        b = np.sum(way * start, axis=0)
        c = np.sum(start**2, axis=0) - np.float32(own.radius**2)
        return start + (np.sqrt(b**2 - a * c) - b) / a * way

    def _spread(self, point: np.ndarray) -> np.ndarray:
        """Points moved along the wall by a Gaussian spread of the light in it."""
        own = self.recording
        if not own.spread:
            return point
        aside = own.spread * self.rng.standard_normal((2, point.shape[1]), dtype=np.float32)
        if own.wall == "plane":
            return point + np.concatenate([aside, np.zeros_like(aside[:1])])
        normal = -point / own.radius
        first = np.cross(normal.T, [0.0, 1.0, 0.0]).T
        first /= np.linalg.norm(first, axis=0)
        second = np.cross(normal.T, first.T).T
        moved = point + aside[0] * first + aside[1] * second
        return moved * (own.radius / np.linalg.norm(moved, axis=0))


def photographed(recording: Recording, rng: np.random.Generator) -> Frames:
    """8-bit frames with three channels: electrons, read noise, black level, rounding."""
    own, where = recording, poses(recording)
    centre = principal_point(own, where)
    view = View(own, rng, where.beam, centre)
    images, exposures = [], []
    for tip in where.tips:
        exposures.append(view.exposure_s(tip))
        electrons = view.electrons(tip, exposures[-1])
        electrons = electrons + own.read_noise * rng.standard_normal(electrons.shape)
        level = own.black + (255 - own.black) * electrons / own.full_well
        images.append(np.clip(np.rint(level), 0, 255).astype(np.uint8))
    return Frames(np.array(images), np.array(exposures), centre, where)


def widened(recording: Recording, part: float, rng: np.random.Generator) -> Recording:
    """The recording with pixels as large that a part of its last frame's light fills a third."""
    own, where = recording, poses(recording)
    farthest = where.touch + own.last
    x, y, slope_x, slope_y, weight, _ = photons(
        own.drop, INDEX[own.medium], rng.random((4, 4 * BATCH))
    )
    radius = np.hypot(x + farthest * slope_x, y + farthest * slope_y)
    order = np.argsort(radius)
    inside = np.cumsum(weight[order])
    wide = radius[order][np.searchsorted(inside, part * inside[-1])]
    return replace(own, scale=float(np.clip(3 * wide / own.height, 0.012, 0.05)))


def _sheet_of(recording: Recording) -> CameraSheet:
    return CameraSheet(
        full_well_e=recording.full_well,
        read_noise_e=recording.read_noise,
        black_level_dn=recording.black,
        bit_depth=8,
    )


def footage_of(recording: Recording, frames: Frames) -> Footage:
    """What `footage_of` reads from a folder with these images."""
    own, images = recording, frames.images
    noise = CameraNoise(_sheet_of(own), Response())
    return a_footage(
        light=np.stack([noise.light(image) for image in images]).astype(np.float32),
        clear=np.all((images > 0) & (images < 255), axis=-1),
        exposure_s=frames.exposure_s,
        readings=own.readings,
        motion=frames.where.reported,
        axis=frames.where.reported,
        noise=noise,
        microscope=a_microscope(
            width_px=own.width,
            height_px=own.height,
            scale_mm_px=own.scale,
            principal_point_px=tuple(frames.principal_point.tolist()),
            pinhole_height_mm=own.pinhole,
            eye_radius_mm=own.radius,
        ),
        instrument=BareFibre(TUBE, 6.0),
        kind=own.wall,
        medium_index=INDEX[own.medium],
    )


def write_photons(folder: Path, recording: Recording, frames: Frames) -> Path:
    """The frames as a stack on disk, as a user's: no label says what a fit may not know."""
    own, where = recording, frames.where
    noise = _sheet_of(own).model_dump(exclude_unset=True)
    changes = (
        f"phantom.kind={own.wall}",
        "phantom.wall=uniform",
        f"source.medium={own.medium}",
        *(f"camera.{name}={value}" for name, value in noise.items()),
        f"instrument.fibre_diameter_mm={2 * TUBE}",
        "instrument.visible=false",
    )
    times = np.arange(own.frames) / 10
    with StackWriter(folder) as writer:
        writer.describe(
            stack={"scene": load_scene(None, list(changes)).model_dump(mode="json")},
            microscope=microscope_content(
                (own.width, own.height),
                scale_mm_px=own.scale,
                pinhole_height_mm=own.pinhole,
                principal_point_px=frames.principal_point.tolist(),
                eye_radius_mm=own.radius,
                paper_exposure_s=None,
                camera=noise,
            ),
            # The photons are those of a moment: the robot stands still while a frame is exposed.
            kinematics=np.array(
                [
                    [time + moment, *(-reading * where.reported), *where.reported]
                    for time, reading in zip(times, own.readings, strict=True)
                    for moment in (-_STILL_S, _STILL_S)
                ]
            ),
        )
        for number, image in enumerate(frames.images):
            labels = labels_of(
                number,
                time_s=float(times[number]),
                exposure_s=float(frames.exposure_s[number]),
                medium=own.medium,
            )
            writer.add(image, labels, np.zeros(image.shape[:2], np.uint8))
    return folder
