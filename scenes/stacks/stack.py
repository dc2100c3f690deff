"""Renders a scene into a labelled stack."""

from __future__ import annotations

import importlib.metadata
import math
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import optics
from estimator.files import Stack, StackWriter, fingerprint, read_stack, require_space
from optics.viewing import PathCamera
from scenes.description import CameraSettings, Scene
from scenes.rendering import LinearFrame, Renderer
from scenes.stacks.bound import Bounds
from scenes.stacks.photography import Photography, file_name
from scenes.world import World, frame_count, kinematics, paper_exposure, spot_labels

# Frames that may wait for noise and encoding. More would only use memory.
_QUEUE = 4
_LINEAR_BYTES = 4  # float32, not compressed


def render_stack(
    scene: Scene,
    out: Path,
    *,
    variant: str = "llvm_ad_rgb",
    progress: Callable[[], None] = lambda: None,
) -> Stack:
    """Render a scene into a stack folder with all labels.

    A run that was stopped can be continued: call this with the same scene and folder. The stack is
    then byte for byte the same as without the stop.

    Args:
        scene: the scene.
        out: the stack's folder; it must not exist. It appears once the stack is complete.
        variant: Mitsuba's variant.
        progress: called after each frame.

    Returns:
        The stack.

    Raises:
        SceneError: the scene is impossible.
        InputError: `out` exists, or its disk has too little space.
        BeingWrittenError: another process is writing `out`.
        OSError: the disk is full or cannot be written; finished frames are kept.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """
    writer = StackWriter(Path(out))
    if not writer.has_begun:
        require_space(writer.folder, least_bytes(scene))
    with writer:
        renderer = Renderer(scene, variant=variant)
        world = renderer.world
        photography = Photography(world)
        writer.describe(
            stack={
                "scene": dumped(scene),
                "cone": world.cone._asdict(),
                "wall_colour": world.wall_colour.tolist(),
                "files": _files(scene),
                "run": {
                    "variant": variant,
                    "versions": _versions(),
                    "approximations": scene.approximations,
                },
            },
            microscope=microscope_file(world, photography.paper_exposure_s),
            kinematics=kinematics(scene, world.motion),
        )
        _render_frames(renderer, photography, writer, progress)
    return read_stack(out)


class _Metered(NamedTuple):
    """A frame with its exposure times, in the order of exposures.kinds."""

    frame: int
    sharp: LinearFrame
    mask: np.ndarray
    durations: list[float]


class _Exposed(NamedTuple):
    """The light during one exposure of a frame, its time, and the labels of its bound."""

    light: np.ndarray
    exposure_s: float
    bound: dict[str, float]


def _render_frames(
    renderer: Renderer, photography: Photography, writer: StackWriter, progress: Callable[[], None]
) -> None:
    """Render the missing frames on this thread; meter, expose and encode on others.

    A frame is metered while the next one is rendered. Then its sub-frames (motion blur) follow.
    """
    scene = renderer.scene
    bounds = Bounds(renderer) if scene.exposures.bound else None
    metering: deque[Future[_Metered]] = deque()
    writing: deque[Future[None]] = deque()
    with ThreadPoolExecutor(max_workers=2) as pool:

        def finish_one() -> None:
            metered = metering.popleft().result()
            lights = [
                renderer.exposed(metered.frame, metered.sharp, exposure_s=duration)
                for duration in metered.durations
            ]
            bound = [
                bounds.labels(
                    metered.frame,
                    light.radiance,
                    exposure_s=duration,
                    sub_frames=light.sub_frames,
                )
                if bounds
                else {}
                for light, duration in zip(lights, metered.durations, strict=True)
            ]
            exposed = [
                _Exposed(light.radiance, duration, own)
                for light, duration, own in zip(lights, metered.durations, bound, strict=True)
            ]
            writing.append(
                pool.submit(_photograph, renderer, photography, writer, metered, exposed)
            )
            if len(writing) > _QUEUE:
                writing.popleft().result()

        for frame in range(renderer.world.times.size):
            orders = range(len(scene.exposures.kinds))
            if not all(writer.has(file_name(renderer.world, frame, order)) for order in orders):
                sharp = renderer.render(frame)
                metering.append(pool.submit(_meter, renderer, photography, frame, sharp))
                if len(metering) > 1:
                    finish_one()
            progress()
        while metering:
            finish_one()
        for future in writing:
            future.result()


def _meter(
    renderer: Renderer, photography: Photography, frame: int, sharp: LinearFrame
) -> _Metered:
    mask = renderer.mask(frame, sharp)
    kinds = renderer.scene.exposures.kinds
    durations = [photography.exposure_s(kind, sharp.radiance, mask) for kind in kinds]
    return _Metered(frame, sharp, mask, durations)


def _photograph(
    renderer: Renderer,
    photography: Photography,
    writer: StackWriter,
    metered: _Metered,
    exposures: list[_Exposed],
) -> None:
    spot = spot_labels(renderer.world, metered.frame)
    spot["visible_fraction"] = metered.sharp.visible_fraction
    for order, exposed in enumerate(exposures):
        photography.write(
            writer,
            exposed.light,
            order=order,
            exposure_s=exposed.exposure_s,
            mask=metered.mask,
            labels=spot | exposed.bound,
        )


def _files(scene: Scene) -> dict[str, dict[str, Any]]:
    """Fingerprints of the files that a scene refers to; they decide whether a run can continue."""
    image = scene.phantom.wall_image if scene.phantom.wall == "image" else ""
    data = (scene.source.lens, scene.viewing.eye, scene.viewing.lens)
    own = [name for name in data if name.endswith(".toml")]
    poses = getattr(scene.motion, "file", "")
    return {name: fingerprint(Path(name)) for name in (image, *own, poses) if name}


def dumped(scene: Scene) -> dict[str, Any]:
    """The scene as JSON values."""
    return scene.model_dump(mode="json", by_alias=True)


def microscope_file(world: World, fixed_exposure_s: float) -> dict[str, object]:
    """Content of microscope.json; a telecentric microscope has no camera matrix."""
    scene, camera = world.scene, world.microscope
    settings = scene.microscope
    return {
        "width_px": settings.width_px,
        "height_px": settings.height_px,
        "camera_matrix": _camera_matrix(camera),
        "distortion": list(settings.distortion),
        "scale_mm_px": settings.scale_mm_px,
        "principal_point_px": np.asarray(camera.principal_point).tolist(),
        "pinhole_height_mm": _pinhole_height(scene, camera),
        "eye_radius_mm": scene.phantom.radius_mm,
        "response": scene.camera.response,
        "camera": _camera_sheet(scene.camera),
        "paper_exposure_s": fixed_exposure_s,
        "plane_normal": _plane_normal(world.wall),
        **_viewing_path(camera),
        **_retina(scene, world.wall),
    }


def _camera_sheet(camera: CameraSettings) -> dict[str, object]:
    """What the estimator may know of the camera: its data sheet."""
    names = ("full_well_e", "read_noise_e", "dark_signal_e", "black_level_dn", "bit_depth")
    sheet = camera.model_dump(include={*names, "prnu", "dsnu_e"})
    return sheet | {"bayer": camera.bayer != "none", "jpeg": camera.jpeg_quality > 0}


def _camera_matrix(camera: optics.Camera) -> list[list[float]] | None:
    if not isinstance(camera, optics.Microscope) or not camera.inverse_working_distance:
        return None
    matrix: list[list[float]] = np.asarray(camera.camera_matrix()).tolist()
    return matrix


def _pinhole_height(scene: Scene, camera: optics.Camera) -> float | None:
    """z_F, of a viewing path that of the paraxial pinhole; None if telecentric."""
    if isinstance(camera, PathCamera):
        return float(1.0 / camera.inverse_working_distance) - scene.phantom.radius_mm
    height = scene.microscope.pinhole_height_mm
    return height if math.isfinite(height) else None


def _viewing_path(camera: optics.Camera) -> dict[str, object]:
    if not isinstance(camera, PathCamera):
        return {}
    pupil = float(camera.pupil)
    return {
        "viewing_path": {
            "crossing": np.asarray(camera.crossing).tolist(),
            "steepness_per_mm": np.asarray(camera.steepness).tolist(),
            "transmittance": np.asarray(camera.passing).tolist(),
            "widest_mm": float(camera.widest),
            "pupil_mm": pupil if math.isfinite(pupil) else None,
            "orientation": float(camera.orientation),
        }
    }


def _retina(scene: Scene, wall: optics.Surface) -> dict[str, object]:
    if not isinstance(wall, optics.Ellipsoid):
        return {}
    phantom = scene.phantom
    placed = {
        "retina_tilt_deg": phantom.tilt_deg,
        "retina_tilt_azimuth_deg": phantom.tilt_azimuth_deg,
        "retina_shift_mm": list(phantom.shift_mm) if any(phantom.shift_mm) else None,
    }
    return {
        "retina_semi_axes_mm": np.asarray(wall.semi_axes).tolist(),
        **{key: value for key, value in placed.items() if value},
    }


def _plane_normal(wall: optics.Surface) -> list[float] | None:
    return np.asarray(wall.inward).tolist() if isinstance(wall, optics.Plane) else None


def _versions() -> dict[str, str]:
    packages = ("eyespot", "mitsuba", "drjit", "jax", "numpy")
    return {name: importlib.metadata.version(name) for name in packages}


def check_scene(scene: Scene) -> None:
    """Refuse a scene that `render_stack` would refuse, without rendering.

    Raises:
        SceneError: the tip touches the wall, the spot leaves the window, the fixed exposure
            is longer than a frame, or a file of the scene cannot be read.
    """
    world = World(scene)
    world.check()
    paper_exposure(world)


def least_bytes(scene: Scene) -> float:
    r"""Least size of a scene's stack on disk: that of the noise in its images.

    No lossless format makes Gaussian noise of $\sigma$ DN smaller than its entropy of
    $\log_2(\sigma \sqrt{2 \pi e})$ bits a sample (Shannon 1948). Half of it is counted, because
    dark and saturated pixels clip half of their noise or all of it.
    """
    camera, microscope = scene.camera, scene.microscope
    size = {"height": microscope.height_px, "width": microscope.width_px}
    sigma_dn = 0.0 if camera.jpeg_quality else camera.read_noise_e * camera.system_gain
    bits = max(math.log2(sigma_dn * math.sqrt(2 * math.pi * math.e)), 0.0) if sigma_dn else 0.0
    image = math.prod(camera.sensor_shape(**size)) * bits / 8 / 2
    linear = 3 * math.prod(size.values()) * _LINEAR_BYTES if scene.exposures.keep_linear else 0
    return frame_count(scene) * len(scene.exposures.kinds) * (image + linear)
