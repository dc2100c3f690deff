"""The parts of a scene at rest, as `optics` objects: wall, position of [spot], microscope."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

import optics
from optics.viewing import PathCamera, Pencils
from scenes.description import Scene
from scenes.world.reflections import Reflections
from scenes.world.view import SceneCamera, bare_camera, scene_pencils, scene_reflections

_RIM_POINTS = 64


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
    def wall(self) -> optics.Surface:
        """The phantom's wall."""
        phantom = self.scene.phantom
        radius = phantom.radius_mm
        tilt, towards = math.radians(phantom.tilt_deg), math.radians(phantom.tilt_azimuth_deg)
        if phantom.kind == "plane":
            return optics.pole_plane(eye_radius=radius, tilt=tilt, tilt_azimuth=towards)
        if phantom.stretched:
            x, y = phantom.stretch
            semi_axes = radius * np.array([x, y, 1.0])
            return optics.Ellipsoid(
                semi_axes, shift=phantom.shift_mm, tilt=tilt, tilt_azimuth=towards
            )
        return optics.Sphere(radius)

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
        """d = |SO| at which the rim of the tip touches the wall at [spot], mm.

        An ideal cone may be wider there than the fibre; then its edge is the rim, since no light
        reaches a point of the wall behind the tip.
        """
        source = self.scene.source
        rim = self.scene.instrument.fibre_diameter_mm / 2
        if source.kind == "cone":
            rim = max(rim, -source.cone_apex_offset_mm / source.cone_k)
        incidence = math.radians(self.scene.spot.incidence_deg)
        if isinstance(self.wall, optics.Ellipsoid):
            return self._contact_with_ellipsoid(rim)
        return float(optics.contact_distance(self.wall, incidence=incidence, rim_radius=rim))

    def _contact_with_ellipsoid(self, rim: float) -> float:
        """The first point of the rim that meets the wall when it moves along the axis."""
        spot, axis = self.aim
        points = spot + rim * circle_across(axis)
        behind = points - self.scene.phantom.radius_mm * axis
        hit = self.wall.intersect(behind, np.broadcast_to(axis, behind.shape))
        return self.scene.phantom.radius_mm - float(hit.distance.min())

    @cached_property
    def microscope(self) -> SceneCamera:
        """The microscope, with its window centred on [spot].

        Raises:
            SceneError: it sees nothing useful through [viewing].
        """
        settings = self.scene.microscope
        return bare_camera(self.scene, self.wall).centred_on(
            self.spot_frame.origin,
            width=settings.width_px,
            height=settings.height_px,
            offset=settings.window_offset_px,
        )

    @cached_property
    def pencils(self) -> Pencils | None:
        """Lines of sight through the microscope's pupil behind [viewing]; None for a pinhole."""
        camera = self.microscope
        if not isinstance(camera, PathCamera) or not self.scene.microscope.numerical_aperture:
            return None
        return scene_pencils(self.scene, camera, channel=1)

    @cached_property
    def reflections(self) -> Reflections | None:
        """Reflexes of the microscope's lamp; None if the scene shows none."""
        camera = self.microscope
        if not isinstance(camera, PathCamera) or not self.scene.viewing.reflexes:
            return None
        return scene_reflections(self.scene, camera, channel=1)

    @cached_property
    def brightest_reflex_px(self) -> np.ndarray:
        """Where the brightest reflex shows the lamp's centre, (x, y) px; NaN without one."""
        return np.full(2, np.nan) if self.reflections is None else self.reflections.brightest_px()

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


def circle_across(axis: np.ndarray) -> np.ndarray:
    """Unit vectors across axes, ... x 64 x 3: the directions to the points of a tip's rim."""
    angle = 2 * np.pi * np.arange(_RIM_POINTS) / _RIM_POINTS
    first, second = (np.asarray(v)[..., None, :] for v in optics.perpendicular_frame(axis))
    return np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
