"""Stacks rendered to disk, one image in memory, and a preview."""

import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from eyespot import optics
from eyespot.formats.camera_sheet import CameraSheet
from eyespot.formats.inputs import InputError
from eyespot.formats.manifest import fingerprint
from eyespot.formats.stack import FrameLabels, Stack, StackWriter, read_stack
from eyespot.formats.whole_files import require_space, written_whole
from eyespot.optics.viewing.projection import PathCamera
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.rendering.render import Renderer, images_of
from eyespot.scenes.sensor import CameraSensor
from eyespot.scenes.stacks.bound import Bounds
from eyespot.scenes.walls.picture import wall_colour
from eyespot.scenes.world.exposure import paper_exposure
from eyespot.scenes.world.labels import spot_labels
from eyespot.scenes.world.motion import frame_count, kinematics, longest_exposure
from eyespot.scenes.world.world import World


def metered_time(scene: Scene, camera: CameraSensor, light: np.ndarray, mask: np.ndarray) -> float:
    """Exposure time of a `metered` frame by the light within the mask, s.

    It is never longer than the time between two frames, even if the frame is then dark.
    """
    return min(camera.metered_s(light, mask), longest_exposure(scene))


_ROUGH_PX = 128
"""Pixels across a drawn wall of which only the mean colour is needed; it is that of the full
picture to 0.03 % (seeds 1 and 2)."""

# Frames that may wait for noise and encoding. More would only use memory.
_QUEUE = 4
_LINEAR_BYTES = 4  # float32, not compressed
_PACKAGES = ("eyespot", "mitsuba", "drjit", "jax", "numpy")  # whose versions a stack states


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
        out: the stack's folder; it must not exist. It appears once the stack is complete.
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
        paper_s = paper_exposure(world)
        writer.describe(
            stack={
                "scene": scene.model_dump(mode="json", by_alias=True),
                "cone": world.cone._asdict(),
                "wall_colour": world.wall_colour.tolist(),
                "files": _files(scene),
                "run": {
                    "variant": variant,
                    "versions": {name: version(name) for name in _PACKAGES},
                    "approximations": scene.approximations,
                },
            },
            microscope=microscope_file(world, paper_s),
            kinematics=kinematics(scene, world.motion),
            touch=_stated_touch(world),
        )
        _render_frames(renderer, paper_s, writer, progress)
    return read_stack(out)


def _render_frames(
    renderer: Renderer, paper_s: float, writer: StackWriter, progress: Callable[[], None]
) -> None:
    """Render and meter the missing frames on this thread; photograph and encode them on another."""
    scene, kinds = renderer.scene, renderer.scene.exposures.kinds
    camera = CameraSensor(scene)
    bounds = Bounds(renderer) if scene.exposures.bound else None

    def names(frame: int) -> list[str]:
        return [f"frames/{frame * len(kinds) + order:06d}.png" for order in range(len(kinds))]

    def photograph(
        frame: int,
        mask: np.ndarray,
        visible_fraction: float,
        exposed: list[tuple[np.ndarray, float, dict[str, float]]],
    ) -> None:
        """Write the image of each exposure: its light, its time and the labels of its bound."""
        spot = spot_labels(renderer.world, frame) | {"visible_fraction": visible_fraction}
        for order, (light, duration, bound) in enumerate(exposed):
            raw = camera.raw(light, exposure_s=duration, noise_seed=[scene.seed, frame, order])
            saturated = np.any(raw[mask] >= scene.camera.full_scale_dn, axis=-1)
            labels = FrameLabels(
                file_name=names(frame)[order],
                mask_file_name=f"masks/{frame:06d}.png",
                exposure=kinds[order],
                exposure_s=duration,
                saturated_fraction=float(saturated.mean()) if saturated.size else 0.0,
                **(spot | bound),
            )
            writer.add(
                camera.written(raw),
                labels,
                np.uint8(255) * mask if order == 0 else None,
                light if scene.exposures.keep_linear else None,
            )

    writing: list[Future[None]] = []
    with ThreadPoolExecutor(max_workers=2) as pool:
        for frame in range(renderer.world.times.size):
            if not all(map(writer.has, names(frame))):
                sharp = renderer.render(frame)
                mask = renderer.mask(frame, sharp)
                exposed = []
                for kind in kinds:
                    duration = paper_s
                    if kind == "metered":
                        duration = metered_time(scene, camera, sharp.radiance, mask)
                    light = renderer.exposed(frame, sharp, exposure_s=duration)
                    bound = {} if bounds is None else bounds.labels(frame, light, duration)
                    exposed.append((light.radiance, duration, bound))
                seen = sharp.visible_fraction
                writing.append(pool.submit(photograph, frame, mask, seen, exposed))
                if len(writing) > _QUEUE:
                    writing[-_QUEUE - 1].result()
            progress()
        for future in writing:
            future.result()


def _files(scene: Scene) -> dict[str, dict[str, Any]]:
    """Fingerprints of the files that a scene refers to; they decide whether a run can continue."""
    image = scene.phantom.wall_image if scene.phantom.wall == "image" else ""
    data = (scene.source.lens, scene.viewing.eye, scene.viewing.lens)
    own = [name for name in data if name.endswith(".toml")]
    poses = getattr(scene.motion, "file", "")
    return {name: fingerprint(Path(name)) for name in (image, *own, poses) if name}


def _stated_touch(world: World) -> tuple[float, float] | None:
    """First distance that the rig states, and its standard uncertainty, mm, if [rig_errors] has it.

    A distance below 0, where no tip can be, is stated as 0.
    """
    errors = world.scene.rig_errors
    if not errors.touch_mm:
        return None
    first = float(world.truth.distance[0])
    return max(first + errors.drawn().touch_mm, 0.0), errors.touch_mm


def microscope_file(world: World, fixed_exposure_s: float) -> dict[str, object]:
    """Content of microscope.json, with the errors of [rig_errors].

    A telecentric microscope has no camera matrix.
    """
    scene, camera, wall = world.scene, world.microscope, world.wall
    settings, phantom, wrong = scene.microscope, scene.phantom, scene.rig_errors.drawn()
    scale_mm_px = settings.scale_mm_px * (1 + wrong.scale)
    radius_mm = phantom.radius_mm + wrong.eye_radius_mm
    # What the estimator may know of the camera: its data sheet.
    sheet = scene.camera.model_dump(include={*CameraSheet.model_fields})
    sheet |= {"bayer": scene.camera.bayer != "none", "jpeg": scene.camera.jpeg_quality > 0}
    height: float | None = None
    matrix: list[list[float]] | None = None
    if isinstance(camera, PathCamera):  # the paraxial pinhole
        height = float(1.0 / camera.inverse_working_distance) - phantom.radius_mm
    elif math.isfinite(settings.pinhole_height_mm):
        height = settings.pinhole_height_mm + wrong.pinhole_height_mm
        stated = optics.microscope(
            scale=scale_mm_px,
            pinhole_height=height,
            eye_radius=radius_mm,
            distortion=settings.distortion,
        )
        stated = replace(stated, principal_point=camera.principal_point)
        matrix = np.asarray(stated.camera_matrix()).tolist()
    content: dict[str, object] = {
        "width_px": settings.width_px,
        "height_px": settings.height_px,
        "camera_matrix": matrix,
        "distortion": list(settings.distortion),
        "scale_mm_px": scale_mm_px,
        "principal_point_px": np.asarray(camera.principal_point).tolist(),
        "pinhole_height_mm": height,
        "eye_radius_mm": radius_mm,
        "response": scene.camera.response,
        "camera": sheet,
        "paper_exposure_s": fixed_exposure_s,
        "plane_normal": wall.inward.tolist() if isinstance(wall, optics.Plane) else None,
    }
    if isinstance(camera, PathCamera):
        pupil = float(camera.pupil)
        content["viewing_path"] = {
            "crossing": np.asarray(camera.crossing).tolist(),
            "steepness_per_mm": np.asarray(camera.steepness).tolist(),
            "transmittance": np.asarray(camera.passing).tolist(),
            "widest_mm": float(camera.widest),
            "pupil_mm": pupil if math.isfinite(pupil) else None,
            "orientation": float(camera.orientation),
        }
    if isinstance(wall, optics.Ellipsoid):
        content["retina_semi_axes_mm"] = np.asarray(wall.semi_axes).tolist()
        placed = {
            "retina_tilt_deg": phantom.tilt_deg,
            "retina_tilt_azimuth_deg": phantom.tilt_azimuth_deg,
            "retina_shift_mm": list(phantom.shift_mm) if any(phantom.shift_mm) else None,
        }
        content |= {key: value for key, value in placed.items() if value}
    return content


def check_scene(scene: Scene) -> None:
    """Refuse a scene that `render_stack` would refuse, without rendering.

    Raises:
        SceneError: the tip touches the wall, the spot leaves the window, the fixed exposure
            is longer than a frame, or a file of the scene cannot be read.
    """
    world = World(scene)
    world.check()
    needs_colour = "paper" in scene.exposures.kinds or scene.phantom.wall == "image"
    if needs_colour and scene.phantom.wall in ("printed paper", "retina"):
        world.wall_colour = wall_colour(scene.phantom, pixels=_ROUGH_PX)
    if needs_colour:
        paper_exposure(world)


def noise_bytes(scene: Scene, *, level: float = 0.0) -> float:
    r"""Entropy of the noise in one image of a scene, bytes.

    Gaussian noise of $\sigma$ DN has $\log_2(\sigma \sqrt{2 \pi e})$ bits a sample (Shannon 1948).

    Args:
        level: mean light of the image over full scale, whose shot noise is added to the camera's.
    """
    camera, microscope = scene.camera, scene.microscope
    size = {"height": microscope.height_px, "width": microscope.width_px}
    variance_e2 = camera.read_noise_e**2 + level * camera.full_well_e
    sigma_dn = math.sqrt(variance_e2) * camera.system_gain
    bits = max(math.log2(sigma_dn * math.sqrt(2 * math.pi * math.e)), 0.0) if sigma_dn else 0.0
    return math.prod(camera.sensor_shape(**size)) * bits / 8


def least_bytes(scene: Scene) -> float:
    """Least size of a scene's stack on disk: no lossless file is smaller than its noise's entropy.

    Half of that is counted, because dark and saturated pixels clip half of their noise or all of
    it; none of it after a JPEG.
    """
    noise = 0.0 if scene.camera.jpeg_quality else noise_bytes(scene) / 2
    pixels = scene.microscope.width_px * scene.microscope.height_px
    linear = 3 * pixels * _LINEAR_BYTES if scene.exposures.keep_linear else 0
    return frame_count(scene) * len(scene.exposures.kinds) * (noise + linear)


def render_image(
    scene: Scene, *, frame: int = 0, exposure: str | None = None, variant: str = "llvm_ad_rgb"
) -> np.ndarray:
    """One image, as `render_stack` writes it.

    Args:
        exposure: one of the scene's `exposures.kinds`; None: the first of them.

    Returns:
        H x W x 3 (R, G, B), uint8 or uint16.

    Raises:
        InputError: the scene has no such frame or exposure.
        SceneError: the tip touches the wall, or the spot leaves the window.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """
    kinds = scene.exposures.kinds
    kind = kinds[0] if exposure is None else exposure
    if kind not in kinds:
        raise InputError(f"exposure = {kind!r} is none of the scene's: {', '.join(kinds)}.")
    renderer = Renderer(scene, variant=variant)
    count = renderer.world.times.size
    if not 0 <= frame < count:
        raise InputError(f"frame = {frame} is not in the scene: it has 0 to {count - 1}.")
    camera, sharp = CameraSensor(scene), renderer.render(frame)
    if kind == "metered":
        duration = metered_time(scene, camera, sharp.radiance, renderer.mask(frame, sharp))
    else:
        duration = paper_exposure(renderer.world)
    light = renderer.exposed(frame, sharp, exposure_s=duration).radiance
    seed = [scene.seed, frame, kinds.index(kind)]
    return camera.written(camera.raw(light, exposure_s=duration, noise_seed=seed))


class LiveCamera:
    """A scene's camera while something else moves the tip, such as a simulated robot.

    Args:
        scene: its motion is not used, but must be possible.

    Raises:
        SceneError: the scene is impossible.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """

    def __init__(self, scene: Scene, *, variant: str = "llvm_ad_rgb") -> None:
        self._images = Renderer(scene, variant=variant).images
        self._camera, self._seed = CameraSensor(scene), scene.seed

    def image(
        self, tips: np.ndarray, axes: np.ndarray, *, exposure_s: float, frame: int
    ) -> np.ndarray:
        """An image while the tip moves.

        Args:
            tips: at the beginning, middle and end of the exposure, 3 x 3, mm, eye frame. The light
                is their mean by Simpson's rule.
            axes: of the beam, likewise; unit vectors from the tip towards the wall.
            frame: number of the image, for its noise.

        Returns:
            H x W x 3 (R, G, B), uint8 or uint16, before JPEG.
        """
        light = sum(
            share * self._images.at(tip=tip, axis=axis, seed=frame)[0]
            for share, tip, axis in zip((1 / 6, 2 / 3, 1 / 6), tips, axes, strict=True)
        )
        seed = [self._seed, frame]
        return self._camera.raw(np.asarray(light), exposure_s=exposure_s, noise_seed=seed)


def write_preview(scene: Scene, path: Path, *, variant: str = "llvm_ad_rgb") -> None:
    """Render `preview` into a PNG file, which must not exist."""
    with written_whole(path) as partial:
        image = preview(scene, variant=variant)
        _, encoded = cv2.imencode(".png", image[..., ::-1])
        partial.write_bytes(encoded.tobytes())


def preview(scene: Scene, *, variant: str = "llvm_ad_rgb") -> np.ndarray:
    """The frame in the middle of the motion at half of its size, with one sample per pixel.

    It has the metered exposure and the sensor's noise, but no motion blur and no JPEG. The spot may
    leave the window, unlike in a stack.

    Returns:
        H/2 x W/2 x 3 (R, G, B), uint8 or uint16.

    Raises:
        SceneError: the tip touches the wall.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """
    world = World(scene)
    (tip,), (axis,) = world.motion.at(world.times[[world.times.size // 2]])
    large = scene.microscope
    # The same field of view with fewer pixels; even numbers, as a Bayer mosaic needs.
    width, height = (max(16, size // 4 * 2) for size in (large.width_px, large.height_px))
    scale = large.scale_mm_px * max(large.width_px / width, large.height_px / height)
    view = {
        "width_px": width,
        "height_px": height,
        "scale_mm_px": scale,
        "window_offset_px": tuple(large.scale_mm_px / scale * x for x in large.window_offset_px),
        "samples": 1,
    }
    small = scene.model_copy(update={"microscope": large.model_copy(update=view)})
    radiance, _ = images_of(World(small), variant=variant).at(tip=tip, axis=axis, seed=0)
    camera = CameraSensor(small)
    exposure_s = camera.metered_s(radiance, np.ones(radiance.shape[:2], bool))
    return camera.raw(radiance, exposure_s=exposure_s, noise_seed=[scene.seed])
