"""The scene's geometry as `optics` objects, and what a motion may not do in it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

import optics
from scenes.description import MicroscopeSettings, Scene, SceneError
from scenes.world.light_cache import lens_light

_CALIBRATED_RANGE_MM = (0.5, 6.0)
"""Distances over which a lens's effective cone is regressed: those of the paper's trials."""


_UNDISTORTED_PX = 1e-3
"""A fiftieth of what labels promise."""

_CONTACT_MM = 1e-6
"""Depth in the wall that is rounding."""


class Cone(NamedTuple):
    """Geometric cone of the source: half-angle in rad, apex offset b in mm."""

    half_angle: float
    apex_offset: float


def wall(scene: Scene) -> optics.Surface:
    """The phantom's wall."""
    phantom = scene.phantom
    if phantom.kind == "eyeball":
        return optics.Sphere(phantom.radius_mm)
    return optics.pole_plane(
        eye_radius=phantom.radius_mm,
        tilt=math.radians(phantom.tilt_deg),
        tilt_azimuth=math.radians(phantom.tilt_azimuth_deg),
    )


def wall_frame(scene: Scene) -> optics.WallFrame:
    """Frame of the wall at the place of [spot]."""
    return wall(scene).frame_at(
        eccentricity=scene.spot.eccentricity_mm, azimuth=math.radians(scene.spot.azimuth_deg)
    )


def microscope(scene: Scene) -> optics.Microscope:
    """The microscope, its window shifted to the place of [spot]."""
    settings = scene.microscope
    camera = optics.microscope(
        scale=settings.scale_mm_px,
        pinhole_height=settings.pinhole_height_mm,
        eye_radius=scene.phantom.radius_mm,
        distortion=settings.distortion,
    )
    spot = wall_frame(scene).origin
    return camera.centred_on(
        spot,
        width=settings.width_px,
        height=settings.height_px,
        offset=settings.window_offset_px,
    )


def rigid_transform(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Rigid transform that takes the origin to `origin` and +z to `direction`."""
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(direction))
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2], matrix[:3, 3] = first, second, direction, origin
    return matrix


def border(settings: MicroscopeSettings) -> np.ndarray:
    """Points all round the window's edge, n x 2, px."""
    u = np.linspace(-0.5, settings.width_px - 0.5, 33)
    v = np.linspace(-0.5, settings.height_px - 0.5, 33)
    level, upright = np.ones_like(u), np.ones_like(v)
    return np.concatenate(
        [np.stack([u, end * level], axis=1) for end in (v[0], v[-1])]
        + [np.stack([end * upright, v], axis=1) for end in (u[0], u[-1])]
    )


def lens_table(scene: Scene) -> optics.IrradianceTable | None:
    """Vector irradiance of the glue lens in its medium, per unit power; None for the cone."""
    if scene.source.kind == "cone":
        return None
    return lens_light(scene.source.lens, optics.MEDIA[scene.source.medium]).table


def cone(scene: Scene, table: optics.IrradianceTable | None) -> Cone:
    """The source's cone: as given, or the lens's effective one (`optics.effective_cone`)."""
    if table is None:
        k, b = scene.source.cone_k, scene.source.cone_apex_offset_mm
        return Cone(math.atan(1.0 / k), b)
    nearest, farthest = _CALIBRATED_RANGE_MM
    effective = optics.effective_cone(table, from_distance=nearest, to_distance=farthest)
    return Cone(float(effective.half_angle), float(effective.b))


def contact_distance(scene: Scene) -> float:
    """d = |SO| at which the fibre's rim touches the wall at the place of [spot], mm."""
    contact = optics.contact_distance(
        wall(scene),
        incidence=math.radians(scene.spot.incidence_deg),
        rim_radius=scene.instrument.fibre_diameter_mm / 2,
    )
    return float(contact)


def check_poses(scene: Scene, *, times: np.ndarray, tip: np.ndarray, axis: np.ndarray) -> None:
    """Refuse a motion that is stopped by the wall.

    The fibre's rim may touch but not enter it; without a visible instrument that holds for the tip
    alone.

    Args:
        scene: the scene.
        times: n moments, s.
        tip: n x 3, mm.
        axis: n x 3, unit vectors.

    Raises:
        SceneError: naming the first moment at which it does, and what to change.
    """
    rim = scene.instrument.fibre_diameter_mm / 2 if scene.instrument.visible else 0.0
    surface = wall(scene)
    if isinstance(surface, optics.Sphere):
        ahead = np.sum(tip * axis, axis=1)
        aside = np.linalg.norm(tip - ahead[:, None] * axis, axis=1)
        clearance = float(surface.radius) - np.hypot(ahead, aside + rim)
        leaving = ahead < 0
    else:
        inward = np.asarray(surface.inward)
        square = axis @ inward
        clearance = (tip - np.asarray(surface.point)) @ inward - rim * np.sqrt(1 - square**2)
        leaving = np.zeros(len(tip), bool)
        if np.any(square >= 0):
            time = times[np.argmax(square >= 0)]
            raise SceneError(f"at {time:.3f} s the beam points away from the plane. Turn its axis.")
    if np.any(clearance < -_CONTACT_MM):
        first = int(np.argmax(clearance < -_CONTACT_MM))
        place = ", ".join(f"{x:.3f}" for x in tip[first])
        where = f"at {times[first]:.3f} s the tip, at ({place}) mm,"
        if leaving[first]:
            raise SceneError(f"{where} leaves the eye. Let [motion] withdraw or reach less far.")
        raise SceneError(
            f"{where} is {-clearance[first]:.3f} mm deep in the wall. Let [motion] keep more "
            "distance."
        )


def check_window(scene: Scene, *, times: np.ndarray, contours: np.ndarray) -> None:
    """Refuse a scene whose spot leaves a window that was not shifted to cut it.

    Args:
        scene: the scene.
        times: n moments, s.
        contours: image points of the spot's contour, n x points x 2, px.

    Raises:
        SceneError: naming the first moment, how far it reaches and what to change; or the lens's
            distortion folds the image.
    """
    _check_distortion(scene)
    width, height = scene.microscope.width_px, scene.microscope.height_px
    inside = (contours >= 0) & (contours <= (width - 1, height - 1))  # false for NaN too
    if inside.all() or any(scene.microscope.window_offset_px):
        return
    first = int(np.argmin(inside.all(axis=(1, 2))))
    low, high = contours[first].min(axis=0), contours[first].max(axis=0)
    raise SceneError(
        f"at {times[first]:.3f} s the spot leaves the {width} x {height} px window: it reaches "
        f"from ({low[0]:.0f}, {low[1]:.0f}) to ({high[0]:.0f}, {high[1]:.0f}) px. Lower the reach "
        "of [motion], or raise microscope.width_px and height_px or scale_mm_px."
    )


def _check_distortion(scene: Scene) -> None:
    """Refuse a lens that images two points at one place of the window, or none."""
    if not any(scene.microscope.distortion):
        return
    camera, edge = microscope(scene), border(scene.microscope)
    point, _ = camera.ray(edge)
    error = np.abs(np.asarray(camera.project(point)) - edge).max()
    # False for NaN too: where a lens folds the image, the steps of its inverse do not settle.
    if not error < _UNDISTORTED_PX:
        raise SceneError(
            f"microscope.distortion = {list(scene.microscope.distortion)} folds the image within "
            "the window. Lower it, or spot.eccentricity_mm, or raise pinhole_height_mm."
        )


def wall_shape(mitsuba_scene: Any) -> Any:
    """The one shape of a Mitsuba scene that the spot falls on."""
    return next(shape for shape in mitsuba_scene.shapes() if shape.id() == "wall")
