"""The scene's geometry as `optics` objects: wall, microscope, and the distances of a trial."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

import optics
from scenes.settings import MEDIA, Scene, SceneError

_CALIBRATED_RANGE_MM = (0.5, 6.0)
"""Distances over which a lens's effective cone is regressed: those of the paper's trials."""


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


def microscope(scene: Scene) -> optics.Microscope:
    """The microscope, its window shifted so that the spot's centre lies in the middle."""
    settings = scene.microscope
    camera = optics.microscope(
        scale=settings.scale_mm_px,
        pinhole_height=settings.pinhole_height_mm,
        eye_radius=scene.phantom.radius_mm,
    )
    spot = wall(scene).frame_at(
        eccentricity=scene.spot.eccentricity_mm, azimuth=math.radians(scene.spot.azimuth_deg)
    )
    return camera.centred_on(spot.origin, width=settings.width_px, height=settings.height_px)


def lens_table(scene: Scene) -> optics.IrradianceTable | None:
    """Vector irradiance of the glue lens in its medium, per unit power; None for the cone."""
    if scene.source.kind == "cone":
        return None
    return _lens_table(scene.source.lens, MEDIA[scene.source.medium])


@functools.lru_cache(maxsize=4)
def _lens_table(lens: str, medium_index: float) -> optics.IrradianceTable:
    # Seconds of quadrature that all trials of a run share.
    return optics.irradiance_table(optics.load_lens(lens), medium_index=medium_index)


def cone(scene: Scene, table: optics.IrradianceTable | None) -> Cone:
    """The source's cone: as given, or the lens's effective one (`optics.effective_cone`)."""
    if table is None:
        k, b = scene.source.cone_k, scene.source.cone_apex_offset_mm
        return Cone(math.atan(1.0 / k), b)
    nearest, farthest = _CALIBRATED_RANGE_MM
    effective = optics.effective_cone(table, from_distance=nearest, to_distance=farthest)
    return Cone(float(effective.half_angle), float(effective.b))


def distances(scene: Scene) -> np.ndarray:
    """d = |SO| at each moment, mm."""
    withdrawal = scene.withdrawal
    start = withdrawal.start_mm
    if isinstance(start, str):
        start = float(
            optics.contact_distance(
                wall(scene),
                incidence=math.radians(scene.spot.incidence_deg),
                rim_radius=scene.instrument.fibre_diameter_mm / 2,
            )
        )
    return start + np.linspace(0.0, withdrawal.travel_mm, withdrawal.frames)


def check_window(scene: Scene, contour: np.ndarray) -> None:
    """Refuse a scene whose spot leaves the window.

    Args:
        scene: the scene.
        contour: image points of the largest spot, n x 2, px.

    Raises:
        SceneError: naming how far it reaches and what to change.
    """
    width, height = scene.microscope.width_px, scene.microscope.height_px
    low, high = contour.min(axis=0), contour.max(axis=0)
    room = (width - 1, height - 1)
    if not np.isfinite(contour).all() or (low < 0).any() or (high > room).any():
        raise SceneError(
            f"the spot leaves the {width} x {height} px window: it reaches from "
            f"({low[0]:.0f}, {low[1]:.0f}) to ({high[0]:.0f}, {high[1]:.0f}) px at the largest "
            "distance. Lower withdrawal.travel_mm, or raise microscope.width_px and height_px or "
            "scale_mm_px."
        )
