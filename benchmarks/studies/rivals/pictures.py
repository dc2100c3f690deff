"""Rendered pictures: the instrument and its shadow under a light guide, by three microscopes."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import optics
import scenes
from benchmarks.studies.rivals.setup import (
    EYE,
    HEIGHT_PX,
    LAMP_RADIUS_MM,
    PATHS,
    PINHOLE_HEIGHT_MM,
    RADIUS_MM,
    SCALE_MM_PX,
    SPOT_AZIMUTH_DEG,
    TOOL_AZIMUTH_DEG,
    TOOL_GAUGE,
    TROCAR_POLAR_DEG,
    WAVELENGTH_NM,
    WIDTH_PX,
    Place,
    Views,
    centred,
)
from scenes import Scene
from scenes.camera import Camera
from scenes.rendering import images_of, radiance_along
from scenes.world import World

_LAMP_POINTS = 7  # that stand for the light guide's end; its penumbra then has seven steps
_GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))
_AT_ONCE = 1 << 18  # lines of sight
_SAMPLES = np.array([[0.25, 0.25], [0.75, 0.75]])  # of a pixel of the stereo pair
_GREY = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
_INSIDE = 0.999  # of the way up to the wall's upper half, where lines of sight start


class Pictures(NamedTuple):
    """Photographs of one place, H x W x 3, and the cameras whose windows are centred on O."""

    centre: np.ndarray
    left: np.ndarray
    right: np.ndarray
    seen: Views


def base_scene(scene: Scene, path: str, wall: str, *, eccentricity: float) -> Scene:
    """The study's scene through a path, with its window centred on O.

    Args:
        scene: the study's.
        path: name of the viewing path.
        eccentricity: c of O, mm.
    """
    lens = PATHS[path]
    eye = {
        "viewing.eye": EYE,
        "viewing.lens": lens,
        "viewing.upright": True,
        "viewing.wavelengths_nm": [WAVELENGTH_NM] * 3,
    }
    return scenes.changed(
        scene,
        {
            "phantom.wall": wall,
            "source.kind": "cone",
            "source.medium": "vitreous",
            "spot.eccentricity_mm": eccentricity,
            "spot.azimuth_deg": SPOT_AZIMUTH_DEG,
            "microscope.pinhole_height_mm": PINHOLE_HEIGHT_MM,
            "microscope.scale_mm_px": SCALE_MM_PX,
            "microscope.width_px": WIDTH_PX,
            "microscope.height_px": HEIGHT_PX,
            **({"phantom.radius_mm": RADIUS_MM} if lens is None else eye),
        },
    )


def pictures(scene: Scene, one: Place, seen: Views) -> Pictures:
    """Photographs under the light guide, by the microscope and by a stereo pair.

    Args:
        scene: `base_scene` of the place.
        one: of instrument and light guide.
    """
    lit = scenes.changed(
        scene,
        {
            "source.cone_k": 1.0,  # 45 degrees each way, as from a light guide
            "source.cone_apex_offset_mm": 0.0,
            "instrument.visible": False,
            "second_tool.visible": True,
            "second_tool.gauge": TOOL_GAUGE,
            "second_tool.tip_mm": one.tip.tolist(),
            "second_tool.trocar_azimuth_deg": TOOL_AZIMUTH_DEG,
            "second_tool.trocar_polar_deg": TROCAR_POLAR_DEG,
            "microscope.illumination_mw_mm2": 0.0,
        },
    )
    world = World(lit)
    images = images_of(world, variant="llvm_ad_rgb")
    own = Views(*(centred(camera, one.spot) for camera in seen))
    shots = [images.at(tip=lamp, axis=one.lamp_axis, seed=0)[0] for lamp in _lamp_points(one)]
    images.at(tip=one.lamp, axis=one.lamp_axis, seed=0)
    pair = [_by_other(world, images.mitsuba_scene, camera) for camera in own[1:]]
    everything = np.ones((HEIGHT_PX, WIDTH_PX), bool)
    taken = []
    for number, light in enumerate([np.mean(shots, axis=0), *pair]):
        # Each microscope has a sensor of its own; one pattern in both would look like texture.
        camera = Camera(lit, seed=lit.seed + number)
        exposure = camera.metered_s(light, everything)
        taken.append(camera.raw(light, exposure_s=exposure, noise_seed=[lit.seed, number]))
    return Pictures(taken[0], taken[1], taken[2], own)


def grey(photograph: np.ndarray) -> np.ndarray:
    """Brightness, H x W."""
    return photograph @ _GREY


def _lamp_points(one: Place) -> list[np.ndarray]:
    """Points evenly spread over the light guide's end (Vogel's spiral)."""
    first, second = map(np.asarray, optics.perpendicular_frame(one.lamp_axis))
    numbers = np.arange(_LAMP_POINTS)
    radii = LAMP_RADIUS_MM * np.sqrt((numbers + 0.5) / _LAMP_POINTS)
    return [
        one.lamp + r * (math.cos(a) * first + math.sin(a) * second)
        for r, a in zip(radii, _GOLDEN_RAD * numbers, strict=True)
    ]


def _by_other(world: World, mitsuba_scene: Any, camera: optics.Camera) -> np.ndarray:
    """Image of a loaded scene by a camera that is not the scene's, H x W x 3."""
    rows, columns = np.divmod(np.arange(HEIGHT_PX * WIDTH_PX), WIDTH_PX)
    corner = np.stack([columns, rows], axis=-1) - 0.5
    total = np.zeros((len(corner), 3))
    for sample in _SAMPLES:
        pixels = corner + sample
        for first in range(0, len(pixels), _AT_ONCE):
            part = pixels[first : first + _AT_ONCE]
            # All parts have one size, so that one compilation is valid for them.
            filled = np.pad(part, ((0, _AT_ONCE - len(part)), (0, 0)), mode="edge")
            lines = _lines(world.wall, camera, filled)
            start, direction, passed = (np.asarray(a)[: len(part)] for a in lines)
            light = radiance_along(mitsuba_scene, start=start, direction=direction)
            total[first : first + len(part)] += light * passed[:, None]
    return (total / len(_SAMPLES)).reshape(HEIGHT_PX, WIDTH_PX, 3)


@eqx.filter_jit
def _lines(wall: optics.Surface, camera: Any, pixels: Any) -> tuple[Any, Any, Any]:
    """Start and direction of lines of sight inside the eye, and the part of the light that passes.

    They start just below the wall's upper half, so that it does not block them.
    """
    at_pole, direction = camera.ray(pixels)
    middle = at_pole - (at_pole[:, 2:] / direction[:, 2:]) * direction
    up = wall.intersect(middle, -direction)
    start = middle - _INSIDE * up.distance[:, None] * direction
    passed = jnp.where(up.status == optics.HIT, camera.transmittance(pixels), 0.0)
    down = jnp.array([0.0, 0.0, -1.0])
    visible = (passed > 0)[:, None]
    return jnp.where(visible, start, down), jnp.where(visible, direction, down), passed
