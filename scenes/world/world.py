"""World: derives the wall, microscope, light, motion and truth of a scene, each once."""

from __future__ import annotations

import functools
import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from eyespot import optics
from eyespot.formats.kept_arrays import kept_arrays
from eyespot.optics.viewing.projection import PathCamera
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.scene_keys import OutsideWindow, SceneError
from eyespot.scenes.walls.picture import wall_colour, wall_spread
from eyespot.scenes.world.geometry import (
    SceneGeometry,
    circle_across,
    colour_cameras,
    scene_pencils,
    scene_reflections,
)
from eyespot.scenes.world.motion import Poses, Trajectory, frame_times, trajectory

_LEAST_POWER = 1e-3
"""Of the mean: a swing of the power does not switch the source off."""


class Moment(NamedTuple):
    """What [unrest] moves, at one time.

    Attributes:
        view_px: shift of the image, x and y.
        turn: rotation vector of the eyeball around its centre, rad.
        power: of the source, relative to its mean.
    """

    view_px: np.ndarray
    turn: np.ndarray
    power: float


class UnrestPath:
    """What [unrest] moves, by frame and time."""

    def __init__(self, scene: Scene, *, frames: int) -> None:
        settings = scene.unrest
        shake, swing = (np.random.default_rng([settings.seed, own]) for own in (1, 2))
        self._shake = settings.shake_px * shake.standard_normal((frames, 2))
        self._power = np.maximum(
            1.0 + settings.power_swing * swing.standard_normal(frames), _LEAST_POWER
        )
        x, y = settings.drift_mm_s
        # Rows of an image run downwards.
        self._drift = np.array([x, -y]) / scene.microscope.scale_mm_px
        self._rate = np.array([math.radians(w) for w in settings.rotation_deg_s])

    def at(self, frame: int, time: float) -> Moment:
        """The state at a time of a frame's exposure, s."""
        view = self._shake[frame] + time * self._drift
        return Moment(view, time * self._rate, float(self._power[frame]))

    def during(self, frame: int, times: np.ndarray) -> list[Moment]:
        """The states at several times of a frame's exposure, s."""
        return [self.at(frame, time) for time in times]

    def views(self, times: np.ndarray) -> np.ndarray:
        """Shifts of the image at the middles of all frames' exposures, n x 2, px."""
        return self._shake + times[:, None] * self._drift


class LensLight(NamedTuple):
    """Light of a lens in a medium.

    Attributes:
        table: vector irradiance per unit power in the core.
        transmitted: fraction of that power that leaves the cap.
    """

    table: optics.IrradianceTable
    transmitted: float


@functools.lru_cache(maxsize=4)
def lens_light(lens: str, medium_index: float) -> LensLight:
    """Light of a lens, computed once and then read from the user's cache folder.

    Args:
        lens: preset name or path of a lens file.
    """
    glass = optics.load_lens(lens)
    names = ("values", "medium_index", "contact_radius", "slope")

    def compute() -> dict[str, Any]:
        table = optics.irradiance_table(glass, medium_index=medium_index)
        transmitted = optics.transmitted_power(glass, medium_index=medium_index)
        kept = {name: getattr(table, name) for name in names} | {"transmitted": transmitted}
        return {name: np.asarray(value) for name, value in kept.items()}

    numbers = {name: x if x is None else float(x) for name, x in vars(glass).items()}
    inputs = sorted(numbers.items()), medium_index
    with_power = (*names, "transmitted")
    kept = kept_arrays("lens_light", with_power, compute, inputs=inputs, code=optics.LIGHT_CODE)
    table = optics.IrradianceTable(**{name: kept[name] for name in names})
    return LensLight(table, float(kept["transmitted"]))


_CALIBRATED_RANGE_MM = (0.5, 6.0)
"""Distances over which the effective cone of a lens is fitted; as in the paper's trials."""


class Cone(NamedTuple):
    """Cone of light of the source: half-angle in rad, apex offset b in mm."""

    half_angle: float
    apex_offset: float


class World(SceneGeometry):
    """A scene's wall, microscope, light, motion and truth.

    A part that is already known can be set before it is first used: `world.light = ...`.
    """

    @cached_property
    def wall_colour(self) -> np.ndarray:
        """Mean linear reflectance of the wall per colour channel."""
        return wall_colour(self.scene.phantom)

    @cached_property
    def wall_spread(self) -> np.ndarray | None:
        """L of the light's spread in the wall for each colour channel, mm; None without spread."""
        return wall_spread(self.scene.phantom)

    @cached_property
    def light(self) -> LensLight | None:
        """Light of the glue lens in its medium, per unit power; None for the ideal cone."""
        source = self.scene.source
        return None if source.kind == "cone" else lens_light(source.lens, self.medium_index)

    @property
    def medium_index(self) -> float:
        """Refractive index of the medium between tip and wall."""
        return float(optics.MEDIA[self.scene.source.medium])

    @property
    def table(self) -> optics.IrradianceTable | None:
        """Vector irradiance of the glue lens, per unit power; None for the ideal cone."""
        return None if self.light is None else self.light.table

    @cached_property
    def cone(self) -> Cone:
        """The ideal cone, or the effective cone of the lens (`optics.effective_cone`)."""
        if self.table is None:
            source = self.scene.source
            return Cone(math.atan(1.0 / source.cone_k), source.cone_apex_offset_mm)
        nearest, farthest = _CALIBRATED_RANGE_MM
        effective = optics.effective_cone(self.table, from_distance=nearest, to_distance=farthest)
        return Cone(float(effective.half_angle), float(effective.b))

    @cached_property
    def motion(self) -> Trajectory:
        """The motion of the tip.

        Raises:
            SceneError: the motion is impossible; the message names the key to change.
        """
        return trajectory(self)

    @cached_property
    def times(self) -> np.ndarray:
        """Middle of each frame's exposure, s.

        Raises:
            SceneError: the tip enters the wall or leaves the eye; the message gives the time.
        """
        times = frame_times(self.scene, self.motion)
        # The tip must stay out of the wall between frames, too.
        often = np.arange(0.0, times.max(), 1 / self.scene.clocks.kinematics_hz)
        both = np.union1d(often, times)
        _check_poses(self, both, self.motion.at(both))
        return times

    @cached_property
    def unrest(self) -> UnrestPath:
        """What else moves: the view, the eyeball, the source's power."""
        return UnrestPath(self.scene, frames=self.times.size)

    @cached_property
    def truth(self) -> optics.SpotTruth:
        """The true pose and spot in the middle of every frame's exposure.

        Raises:
            SceneError: as for `times`; or a part of the spot has no light, or is not in the window.
        """
        truth = optics.spot_truth(
            self.wall,
            self.microscope,
            self.table,
            **self.motion.at(self.times)._asdict(),
            half_angle=self.cone.half_angle,
            apex_offset=self.cone.apex_offset,
        )
        views = self.unrest.views(self.times)
        truth = truth._replace(
            cone=_shifted(truth.cone, views),
            half_max=_shifted(truth.half_max, views),
            contour_px=np.asarray(truth.contour_px) + views[:, None],
        )
        _check_spots(self, truth)
        return truth

    @cached_property
    def colours(self) -> tuple[World, ...]:
        """This world as red, green and blue see it, if [viewing] gives each its lines of sight."""
        if not self.scene.viewing.through_an_eye or self.scene.viewing.colours == "green":
            return (self,)
        return self._seen_in(0), self, self._seen_in(2)

    def _seen_in(self, channel: int) -> World:
        """The same world with the microscope of another colour, on the same sensor."""
        assert isinstance(self.microscope, PathCamera)
        other = World(self.scene)
        other.light, other.unrest, other.wall_colour = self.light, self.unrest, self.wall_colour
        camera = colour_cameras(self.scene, self.wall)[channel]
        other.microscope = camera.on_sensor_of(self.microscope)
        if self.pencils is not None:
            other.pencils = scene_pencils(self.scene, other.microscope, channel=channel)
        if self.reflections is not None:
            other.reflections = scene_reflections(self.scene, other.microscope, channel=channel)
        return other

    @cached_property
    def colour_shifts(self) -> np.ndarray | None:
        """Centres of the spots in red and blue against green, 2 x n x 2, px; None by a pinhole."""
        if not self.scene.viewing.through_an_eye:
            return None
        cameras = colour_cameras(self.scene, self.wall)
        red, green, blue = (np.asarray(one.project(self.truth.origin)) for one in cameras)
        return np.stack([red - green, blue - green])

    @cached_property
    def spread_spots(self) -> optics.SpreadSpot | None:
        """The true spots on a wall that spreads light, in green; None without spread."""
        if self.wall_spread is None:
            return None
        spots = optics.spread_spots(
            self.wall, self.microscope, self.table, self.truth.beam, self.wall_spread[1]
        )
        views = self.unrest.views(self.times)
        return spots._replace(
            cone=_shifted(spots.cone, views), half_max=_shifted(spots.half_max, views)
        )

    def check(self) -> None:
        """Refuse an impossible scene by deriving its truth.

        Raises:
            SceneError: as for `truth`.
        """
        _ = self.truth

    @cached_property
    def speed(self) -> np.ndarray:
        """Speed of the tip in the middle of every frame's exposure, mm/s."""
        return self.motion.speed(self.times)


def _shifted(ellipse: optics.Ellipse, views: np.ndarray) -> optics.Ellipse:
    """Ellipses in images that are shifted by n x 2 px."""
    return ellipse._replace(centre=np.asarray(ellipse.centre) + views)


_UNDISTORTED_PX = 1e-3
"""Largest error of projection that is accepted: a fiftieth of the labels' accuracy."""

_CONTACT_MM = 1e-6
"""Depth in the wall that counts as rounding error."""


def _check_poses(geometry: SceneGeometry, times: np.ndarray, poses: Poses) -> None:
    """Refuse a motion in which the tip, or a visible fibre's rim, enters the wall."""
    instrument, wall, (tip, axis) = geometry.scene.instrument, geometry.surface, poses
    rim = instrument.fibre_diameter_mm / 2 if instrument.visible else 0.0
    if isinstance(wall, optics.Sphere):
        ahead = np.sum(tip * axis, axis=1)
        aside = np.linalg.norm(tip - ahead[:, None] * axis, axis=1)
        clearance = float(wall.radius) - np.hypot(ahead, aside + rim)
        leaving = ahead < 0
    elif isinstance(wall, optics.Ellipsoid):
        # To first order, from the square of the unit sphere's radius and its growth per mm.
        turn, semi_axes = np.asarray(wall.turn), np.asarray(wall.semi_axes)
        points = tip[:, None] + rim * circle_across(axis) - np.asarray(wall.centre)
        own = points @ turn / semi_axes
        growth = 2 * np.linalg.norm(own / semi_axes, axis=-1)
        beyond = 1 - np.sum(own * own, axis=-1)
        clearance = np.min(beyond / np.maximum(growth, 1e-9), axis=1)
        leaving = np.sum(tip * axis, axis=1) < 0
    else:
        inward = np.asarray(wall.inward)
        square = axis @ inward
        clearance = (tip - np.asarray(wall.point)) @ inward - rim * np.sqrt(1 - square**2)
        leaving = np.zeros(len(tip), bool)
        if np.any(square >= 0):
            time = times[np.argmax(square >= 0)]
            raise SceneError(
                f"at {time:.3f} s the beam points away from the plane. Change its axis."
            )
    if np.any(clearance < -_CONTACT_MM):
        first = int(np.argmax(clearance < -_CONTACT_MM))
        place = ", ".join(f"{x:.3f}" for x in tip[first])
        where = f"at {times[first]:.3f} s the tip, at ({place}) mm,"
        if leaving[first]:
            raise SceneError(f"{where} leaves the eye. Shorten the path in [motion].")
        raise SceneError(
            f"{where} is {-clearance[first]:.3f} mm deep in the wall. Raise the distance "
            "in [motion]."
        )


def _check_spots(world: World, truth: optics.SpotTruth) -> None:
    """Refuse a scene in which a part of a spot has no light, is hidden, or leaves the window.

    No light is behind the tip. A spot may leave the window if window_offset_px is set.
    """
    times, tip, axis = world.times, np.asarray(truth.beam.tip), np.asarray(truth.beam.axis)
    contours, contours_px = np.asarray(truth.contour), np.asarray(truth.contour_px)
    ahead = np.sum((contours - tip[:, None]) * axis[:, None], axis=-1).min(axis=1)
    if not np.all(ahead > -_CONTACT_MM):
        first = int(np.argmax(ahead <= -_CONTACT_MM))
        raise SceneError(
            f"at {times[first]:.3f} s a part of the spot's edge lies {-ahead[first]:.3f} mm behind "
            "the tip, where there is no light. Raise the distance in [motion]."
        )
    camera, settings = world.microscope, world.scene.microscope
    if isinstance(camera, PathCamera) and not np.all(seen := np.asarray(camera.sees(contours))):
        first = int(np.argmin(seen.all(axis=1)))
        reach = np.hypot(contours[first, :, 0], contours[first, :, 1]).max()
        viewing = world.scene.viewing
        hides, remedy = f"a pupil of {viewing.pupil_mm:g} mm", "raise viewing.pupil_mm"
        if camera.widest < camera.pupil:
            # Lines of sight farther out miss a surface, or are reflected totally.
            hides, remedy = "the path, whose surfaces end there,", "choose another viewing.lens"
        raise SceneError(
            f"at {times[first]:.3f} s a part of the spot is hidden: {hides} shows c <= "
            f"{float(camera.field(world.wall)):.2f} mm through viewing.lens {viewing.lens!r}, "
            f"and the spot reaches {reach:.2f} mm. Lower spot.eccentricity_mm, or {remedy}."
        )
    if isinstance(camera, optics.Microscope) and any(settings.distortion):
        edge = world.window_border
        point, _ = camera.ray(edge)
        error = np.abs(np.asarray(camera.project(point)) - edge).max()
        # `not <` includes NaN: where the image is folded, the inverse does not converge.
        if not error < _UNDISTORTED_PX:
            raise SceneError(
                f"microscope.distortion = {list(settings.distortion)} folds the image within the "
                "window. Lower it, or spot.eccentricity_mm, or raise pinhole_height_mm."
            )
    width, height = settings.width_px, settings.height_px
    # False for NaN, too.
    inside = (contours_px >= 0) & (contours_px <= (width - 1, height - 1))
    if not inside.all() and not any(settings.window_offset_px):
        first = int(np.argmin(inside.all(axis=(1, 2))))
        low, high = contours_px[first].min(axis=0), contours_px[first].max(axis=0)
        centre = np.array([width - 1, height - 1]) / 2
        halves = np.abs(contours_px - centre).max(axis=(0, 1)) + 0.5
        # Cameras' windows are multiples of 16; a pixel of margin is for rounding.
        wide, tall = (16 * math.ceil(2 * (half + 1) / 16) for half in halves)
        needed = max(wide, width), max(tall, height)
        raise OutsideWindow(
            f"at {times[first]:.3f} s the spot leaves the {width} x {height} px window: it reaches "
            f"from ({low[0]:.0f}, {low[1]:.0f}) to ({high[0]:.0f}, {high[1]:.0f}) px. Shorten the "
            f"path in [motion], raise microscope.scale_mm_px, or set width_px = {needed[0]} and "
            f"height_px = {needed[1]}.",
            needed,
        )
