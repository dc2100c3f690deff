"""The parts of a scene at rest, as `optics` objects: wall, position of [spot], microscope."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

import optics
from scenes.description import Scene


class Aim(NamedTuple):
    """Where the beam is aimed.

    Attributes:
        spot: O, the point on the wall that [spot] describes, mm.
        axis: unit vector of the beam there, from the tip towards the wall.
    """

    spot: np.ndarray
    axis: np.ndarray


class Geometry:
    """The wall, the aim and the microscope of a scene, each derived once.

    Args:
        scene: the scene.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @cached_property
    def wall(self) -> optics.Sphere | optics.Plane:
        """The phantom's wall."""
        phantom = self.scene.phantom
        if phantom.kind == "eyeball":
            return optics.Sphere(phantom.radius_mm)
        return optics.pole_plane(
            eye_radius=phantom.radius_mm,
            tilt=math.radians(phantom.tilt_deg),
            tilt_azimuth=math.radians(phantom.tilt_azimuth_deg),
        )

    @cached_property
    def spot_frame(self) -> optics.WallFrame:
        """Frame of the wall at [spot]."""
        spot = self.scene.spot
        return self.wall.frame_at(
            eccentricity=spot.eccentricity_mm, azimuth=math.radians(spot.azimuth_deg)
        )

    @cached_property
    def aim(self) -> Aim:
        """The point of [spot] on the wall, and the direction of the beam."""
        spot = self.scene.spot
        beam = optics.beam_at_spot(
            self.wall,
            eccentricity=spot.eccentricity_mm,
            azimuth=math.radians(spot.azimuth_deg),
            incidence=math.radians(spot.incidence_deg),
            incidence_azimuth=math.radians(spot.incidence_azimuth_deg),
            distance=0.0,
            half_angle=0.0,
            apex_offset=0.0,
        )
        return Aim(np.asarray(beam.tip), np.asarray(beam.axis))

    @cached_property
    def contact_distance(self) -> float:
        """d = |SO| at which the rim of the fibre touches the wall at [spot], mm."""
        contact = optics.contact_distance(
            self.wall,
            incidence=math.radians(self.scene.spot.incidence_deg),
            rim_radius=self.scene.instrument.fibre_diameter_mm / 2,
        )
        return float(contact)

    @cached_property
    def microscope(self) -> optics.Microscope:
        """The microscope, with its window centred on [spot]."""
        settings = self.scene.microscope
        camera = optics.microscope(
            scale=settings.scale_mm_px,
            pinhole_height=settings.pinhole_height_mm,
            eye_radius=self.scene.phantom.radius_mm,
            distortion=settings.distortion,
        )
        return camera.centred_on(
            self.spot_frame.origin,
            width=settings.width_px,
            height=settings.height_px,
            offset=settings.window_offset_px,
        )

    @cached_property
    def window_border(self) -> np.ndarray:
        """Points along the edge of the microscope's window, n x 2, px."""
        settings = self.scene.microscope
        u = np.linspace(-0.5, settings.width_px - 0.5, 33)
        v = np.linspace(-0.5, settings.height_px - 0.5, 33)
        level, upright = np.ones_like(u), np.ones_like(v)
        return np.concatenate(
            [np.stack([u, end * level], axis=1) for end in (v[0], v[-1])]
            + [np.stack([end * upright, v], axis=1) for end in (u[0], u[-1])]
        )
