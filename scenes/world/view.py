"""The camera of a scene: a pinhole, or the microscope behind a lens and the eye's optics."""

from __future__ import annotations

import numpy as np

import optics
from optics.viewing import (
    PathCamera,
    Pencils,
    ViewingPath,
    focal_depth,
    load_eye,
    load_viewing_lens,
    path_camera,
    pencils,
    reflexes,
    viewing_path,
)
from scenes.description import Scene, SceneError
from scenes.world.reflections import Reflections

SceneCamera = optics.Microscope | PathCamera

_SMALLEST_FIELD_MM = 0.5
"""Half the width of the smallest field that is worth a look: a spot is as wide."""


def bare_camera(scene: Scene, wall: optics.Surface) -> SceneCamera:
    """The camera with the principal point (0, 0), seen in green.

    Raises:
        SceneError: the pinhole lies too low, or the microscope sees nothing useful.
    """
    settings = scene.microscope
    if scene.viewing.through_an_eye:
        return _through_the_eye(scene, wall, channel=1)
    return optics.microscope(
        scale=settings.scale_mm_px,
        pinhole_height=settings.pinhole_height_mm,
        eye_radius=scene.phantom.radius_mm,
        distortion=settings.distortion,
    )


def colour_cameras(scene: Scene, wall: optics.Surface) -> tuple[PathCamera, ...]:
    """Cameras for red, green and blue, each with the principal point (0, 0).

    Raises:
        SceneError: as for `bare_camera`.
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
    """Reflexes of the microscope's lamp, seen by one colour's camera."""
    path = _path(scene, channel=channel)
    return Reflections.of(scene, camera, path, reflexes(path))


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
    highest = cornea + (0.0 if lens is None else float(lens.above_cornea))
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


def colour_shifts(cameras: tuple[PathCamera, ...], points: np.ndarray) -> np.ndarray:
    """Where red and blue show points, relative to green, 2 x n x 2, px.

    Args:
        cameras: for red, green and blue.
        points: on the wall, n x 3, mm.
    """
    red, green, blue = (np.asarray(camera.project(points)) for camera in cameras)
    return np.stack([red - green, blue - green])
