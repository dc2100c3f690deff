"""The parts of a scene at rest, as `optics` objects: wall, position of [spot], microscope."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from eyespot import optics
from eyespot.optics.lines import directions_across, generator_angles
from eyespot.optics.viewing.path import ViewingPath, viewing_path
from eyespot.optics.viewing.pencil import Pencils, focal_depth, pencils
from eyespot.optics.viewing.projection import PathCamera, path_camera
from eyespot.optics.viewing.reflex import Reflex, reflexes
from eyespot.optics.viewing.schematic_eye import load_eye, load_viewing_lens
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.scene_keys import SceneError

_PLACES = 400


class Reflections(NamedTuple):
    """Reflexes of a round lamp in the pinhole's plane at every surface of the path.

    Attributes:
        radiance: of the lamp, even, in the unit of the images, mW/(mm2 sr).
    """

    scene: Scene
    camera: PathCamera
    radiance: float
    reflexes: tuple[Reflex, ...]

    def image(self, view_px: np.ndarray) -> np.ndarray:
        """Radiance of all reflexes, H x W, in an image that is shifted by (x, y) px."""
        microscope = self.scene.microscope
        height, width = microscope.height_px, microscope.width_px
        v, u = np.mgrid[:height, :width]
        aim = self.camera.aim(np.stack([u, v], axis=-1) - view_px)
        light = np.zeros((height, width))
        for reflex in self.reflexes:
            place, part = (np.asarray(a) for a in (reflex.place(aim), reflex.part(aim)))
            inside = self.scene.viewing.lamp_radius_mm - np.linalg.norm(
                place - np.array(self.scene.viewing.lamp_mm), axis=-1
            )
            # The edge is as wide as a pixel.
            down, right = np.gradient(inside)
            light += part * np.clip(inside / np.maximum(np.hypot(down, right), 1e-9) + 0.5, 0, 1)
        middle = np.array([width, height]) / 2
        corner = np.sum(((np.stack([u, v], axis=-1) + 0.5 - middle) / np.hypot(*middle)) ** 2, -1)
        return self.radiance * (1 - microscope.vignetting * corner) * light

    def brightest_px(self) -> np.ndarray:
        """Where the brightest reflex shows the lamp's centre, (x, y) px; NaN outside the window."""
        lamp = np.array(self.scene.viewing.lamp_mm)
        away = float(np.linalg.norm(lamp))
        outward = lamp / away if away else np.array([1.0, 0.0])
        microscope = self.scene.microscope
        last = np.array([microscope.width_px - 1, microscope.height_px - 1])
        best, found = 0.0, np.full(2, np.nan)
        for reflex in self.reflexes:
            aim = _aim_at(reflex, away)
            if aim is None:
                continue
            part = float(reflex.part(aim * outward))
            offset = aim * outward * float(self.camera.px_per_aim) * [1.0, -1.0]
            at = np.asarray(self.camera.principal_point) + offset
            if part > best and np.all((at >= -0.5) & (at <= last + 0.5)):
                best, found = part, at
        return found


def _aim_at(reflex: Reflex, away: float) -> float | None:
    """Signed distance t at which a line of sight returns to a distance from the axis, mm."""

    def missed(t: float) -> float:
        return float(reflex.place(np.array([t, 0.0]))[0]) - away

    places = np.linspace(-1.0, 1.0, _PLACES) * float(reflex.widest)
    returned = np.asarray(reflex.place(np.stack([places, 0.0 * places], axis=-1)))[:, 0] - away
    crossed = np.flatnonzero(returned[:-1] * returned[1:] <= 0.0)
    if not crossed.size:
        return None
    nearest = crossed[np.argmin(np.abs(places[crossed]))]
    return float(brentq(missed, places[nearest], places[nearest + 1]))


SceneCamera = optics.Microscope | PathCamera

_SMALLEST_FIELD_MM = 0.5
"""Half the width of the smallest field that is worth a look: a spot is as wide."""


def colour_cameras(scene: Scene, wall: optics.Surface) -> tuple[PathCamera, ...]:
    """Cameras for red, green and blue, each with the principal point (0, 0).

    Raises:
        SceneError: the pinhole lies too low, or the microscope sees nothing useful.
    """
    green = _through_the_eye(scene, wall, channel=1)
    red, blue = (_through_the_eye(scene, wall, channel=k) for k in (0, 2))
    # One sensor: a pixel sees the same angle in all colours.
    return red.on_sensor_of(green), green, blue.on_sensor_of(green)


def scene_pencils(scene: Scene, camera: PathCamera, *, channel: int) -> Pencils:
    """Lines of sight through the microscope's pupil about those of one colour's camera."""
    # One microscope for all colours, focused in green.
    depth = focal_depth(_path(scene, channel=1), focus=scene.microscope.focus_mm)
    return pencils(_path(scene, channel=channel), camera, depth=depth)


def scene_reflections(scene: Scene, camera: PathCamera, *, channel: int) -> Reflections:
    """Reflexes of the lamp that gives the coaxial light on the retina, seen by a colour's camera.

    A lamp of radiance L, radius rho and distance D gives the irradiance L pi (rho/D)^2 in front of
    the path, and 1/a^2 of it behind, where a is the path's magnification. Images hold the radiance
    inside the eye, which is that in air times the squared index.
    """
    path = _path(scene, channel=channel)
    distance = 1.0 / float(path.pinhole_closeness)
    in_front = scene.microscope.illumination_mw_mm2 * float(camera.magnification) ** 2
    in_front /= float(camera.transmittance(camera.principal_point))
    lamp = in_front / (math.pi * (scene.viewing.lamp_radius_mm / distance) ** 2)
    return Reflections(scene, camera, lamp * float(path.medium_index) ** 2, reflexes(path))


def _path(scene: Scene, *, channel: int) -> ViewingPath:
    """The viewing path of a colour.

    Raises:
        SceneError: the microscope's pinhole lies below the viewing lens or the cornea.
    """
    viewing, height = scene.viewing, scene.microscope.pinhole_height_mm
    eye = load_eye(
        viewing.eye,
        wavelength_nm=viewing.wavelengths_nm[channel],
        refraction_d=viewing.refraction_d,
    )
    lens = None if viewing.lens == "none" else load_viewing_lens(viewing.lens)
    medium = scene.source.medium
    cornea = float(eye.axial_length) - scene.phantom.radius_mm
    highest = cornea - (0.0 if lens is None else float(lens.depth))
    if not height > highest:
        raise SceneError(
            f"microscope.pinhole_height_mm must lie above the viewing lens and the cornea, at "
            f"{highest:.1f} mm; got {height:g} mm. Set it to 200, as of a real microscope, or to "
            "inf."
        )
    return viewing_path(
        eye,
        lens,
        form=viewing.form,
        fill_index=None if medium == "vitreous" else optics.MEDIA[medium],
        pupil_radius=viewing.pupil_mm / 2,
        pinhole_distance=height - cornea,
    )


def _through_the_eye(scene: Scene, wall: optics.Surface, *, channel: int) -> PathCamera:
    viewing, medium = scene.viewing, scene.source.medium
    path = _path(scene, channel=channel)
    camera = path_camera(path, scale=scene.microscope.scale_mm_px, upright=viewing.upright)
    field = float(camera.field(wall))
    if not field > _SMALLEST_FIELD_MM:
        why, lens = "", "set viewing.lens to wide-field-90"
        if viewing.lens == "none":
            why = ": the fundus lies near infinity"
            lens = "set viewing.lens to flat (biconcave in air) or to wide-field-90"
        raise SceneError(
            f"through viewing.lens {viewing.lens!r} and the {viewing.form} eye {viewing.eye!r} "
            f"filled with {medium}, with a pupil of {viewing.pupil_mm:g} mm, the microscope sees "
            f"only c <= {field:.2f} mm{why}. Raise viewing.pupil_mm, or {lens}."
        )
    return camera


_RIM_POINTS = 64


class SceneGeometry:
    """The wall, the aim and the microscope of a scene, each derived once."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @cached_property
    def wall(self) -> optics.Surface:
        """The phantom's wall, which sends the light back."""
        return self._wall(0.0)

    @cached_property
    def surface(self) -> optics.Surface:
        """What a tip touches: the surface of the clear layer over the wall, or the wall itself."""
        return self._wall(self.scene.phantom.clear_layer_mm)

    def _wall(self, layer: float) -> optics.Surface:
        """The surface of a layer over the wall (mm); of an ellipsoid with as much off each axis."""
        phantom = self.scene.phantom
        radius = phantom.radius_mm
        tilt, towards = math.radians(phantom.tilt_deg), math.radians(phantom.tilt_azimuth_deg)
        if phantom.kind == "plane":
            pole = radius - layer / math.cos(tilt)
            return optics.pole_plane(eye_radius=pole, tilt=tilt, tilt_azimuth=towards)
        if phantom.stretched:
            x, y = phantom.stretch
            semi_axes = radius * np.array([x, y, 1.0]) - layer
            return optics.Ellipsoid(
                semi_axes, shift=phantom.shift_mm, tilt=tilt, tilt_azimuth=towards
            )
        return optics.Sphere(radius - layer)

    @cached_property
    def spot_frame(self) -> optics.WallFrame:
        """Frame of the wall at [spot]."""
        spot = self.scene.spot
        return self.wall.frame_at(
            eccentricity=spot.eccentricity_mm, azimuth=math.radians(spot.azimuth_deg)
        )

    @cached_property
    def aim(self) -> tuple[np.ndarray, np.ndarray]:
        """The point of [spot] on the wall, mm, and the beam's unit vector towards it."""
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
        return np.asarray(beam.tip), np.asarray(beam.axis)

    @property
    def tip_radius(self) -> float:
        """Radius of the tip's rim, mm."""
        source, fibre = self.scene.source, self.scene.instrument.fibre_diameter_mm
        if source.kind != "cone":
            return fibre / 2
        return optics.tip_radius(
            fibre_diameter=fibre,
            half_angle=math.atan(1.0 / source.cone_k),
            apex_offset=source.cone_apex_offset_mm,
        )

    @cached_property
    def contact_distance(self) -> float:
        """d = |SO| at which the rim of the tip touches the wall or its layer at [spot], mm."""
        rim, layer = self.tip_radius, self.scene.phantom.clear_layer_mm
        if layer or isinstance(self.wall, optics.Ellipsoid):
            # The first point of the rim that meets the wall when it moves along the axis.
            spot, axis = self.aim
            radius = self.scene.phantom.radius_mm
            behind = spot + rim * circle_across(axis) - radius * axis
            hit = self.surface.intersect(behind, np.broadcast_to(axis, behind.shape))
            return radius - float(hit.distance.min())
        incidence = math.radians(self.scene.spot.incidence_deg)
        return float(optics.contact_distance(self.wall, incidence=incidence, rim_radius=rim))

    @cached_property
    def microscope(self) -> SceneCamera:
        """The microscope, with its window centred on [spot].

        Raises:
            SceneError: it sees nothing useful through [viewing], or its pinhole lies too low.
        """
        settings = self.scene.microscope
        camera: SceneCamera = (
            _through_the_eye(self.scene, self.wall, channel=1)
            if self.scene.viewing.through_an_eye
            else optics.microscope(
                scale=settings.scale_mm_px,
                pinhole_height=settings.pinhole_height_mm,
                eye_radius=self.scene.phantom.radius_mm,
                distortion=settings.distortion,
            )
        )
        return camera.centred_on(
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

    def window_grid(self, count: int) -> np.ndarray:
        """Points of the microscope's window from edge to edge, count x count x 2, px."""
        sizes = self.scene.microscope.width_px, self.scene.microscope.height_px
        u, v = (np.linspace(-0.5, size - 0.5, count) for size in sizes)
        return np.stack(np.meshgrid(u, v), axis=-1)

    @cached_property
    def window_border(self) -> np.ndarray:
        """Points along the edge of the microscope's window, n x 2, px."""
        grid = self.window_grid(33)
        return np.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]])


def circle_across(axis: np.ndarray) -> np.ndarray:
    """Unit vectors across axes, ... x 64 x 3: the directions to the points of a tip's rim."""
    return np.asarray(directions_across(axis[..., None, :], generator_angles(_RIM_POINTS)))
