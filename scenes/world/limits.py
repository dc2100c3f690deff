"""Checks of a scene: the tip stays out of the wall, the whole spot is lit and in the window."""

from __future__ import annotations

import numpy as np

import optics
from optics.viewing.camera import PathCamera
from scenes.description.settings import SceneError
from scenes.world.geometry import SceneGeometry, circle_across

_UNDISTORTED_PX = 1e-3
"""Largest error of projection that is accepted: a fiftieth of the labels' accuracy."""

_CONTACT_MM = 1e-6
"""Depth in the wall that counts as rounding error."""


def check_poses(
    geometry: SceneGeometry, *, times: np.ndarray, tip: np.ndarray, axis: np.ndarray
) -> None:
    """Refuse a motion that enters the wall.

    The rim of a visible fibre may touch the wall but not enter it. Without a visible instrument,
    only the tip is checked.

    Args:
        times: n times, s.
        tip: n x 3, mm.
        axis: n x 3, unit vectors.

    Raises:
        SceneError: the wall is entered; the message gives the first time and what to change.
    """
    instrument = geometry.scene.instrument
    rim = instrument.fibre_diameter_mm / 2 if instrument.visible else 0.0
    wall = geometry.wall
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


def check_spots(
    geometry: SceneGeometry,
    *,
    times: np.ndarray,
    contours: np.ndarray,
    contours_px: np.ndarray,
    tip: np.ndarray,
    axis: np.ndarray,
) -> None:
    """Refuse a scene in which a part of a spot has no light, is hidden, or leaves the window.

    No light is behind the tip. The iris, or a lens's edge, may hide a part. A spot may leave the
    window if window_offset_px is set.

    Args:
        times: n times, s.
        contours: points of the spots' contours on the wall, n x points x 3, mm.
        contours_px: their images, n x points x 2, px.
        tip: n x 3, mm.
        axis: n x 3, unit vectors.

    Raises:
        SceneError: that is so; the message gives the first time and what to change. Or the
            distortion folds the image.
    """
    ahead = np.sum((contours - tip[:, None]) * axis[:, None], axis=-1).min(axis=1)
    if not np.all(ahead > -_CONTACT_MM):
        first = int(np.argmax(ahead <= -_CONTACT_MM))
        raise SceneError(
            f"at {times[first]:.3f} s a part of the spot's edge lies {-ahead[first]:.3f} mm behind "
            "the tip, where there is no light. Raise the distance in [motion]."
        )
    camera, settings = geometry.microscope, geometry.scene.microscope
    if isinstance(camera, PathCamera) and not np.all(seen := np.asarray(camera.sees(contours))):
        first = int(np.argmin(seen.all(axis=1)))
        reach = np.hypot(contours[first, :, 0], contours[first, :, 1]).max()
        viewing = geometry.scene.viewing
        hides, remedy = f"a pupil of {viewing.pupil_mm:g} mm", "raise viewing.pupil_mm"
        if camera.widest < camera.pupil:
            # Lines of sight farther out miss a surface, or are reflected totally.
            hides, remedy = "the path, whose surfaces end there,", "choose another viewing.lens"
        raise SceneError(
            f"at {times[first]:.3f} s a part of the spot is hidden: {hides} shows c <= "
            f"{float(camera.field(geometry.wall)):.2f} mm through viewing.lens {viewing.lens!r}, "
            f"and the spot reaches {reach:.2f} mm. Lower spot.eccentricity_mm, or {remedy}."
        )
    if isinstance(camera, optics.Microscope) and any(settings.distortion):
        edge = geometry.window_border
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
        raise SceneError(
            f"at {times[first]:.3f} s the spot leaves the {width} x {height} px window: it reaches "
            f"from ({low[0]:.0f}, {low[1]:.0f}) to ({high[0]:.0f}, {high[1]:.0f}) px. Shorten the "
            "path in [motion], or raise microscope.width_px and height_px or scale_mm_px."
        )
