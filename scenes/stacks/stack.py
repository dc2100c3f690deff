"""From a scene to a labelled stack on disk, and from a stack to one exposed anew."""

from __future__ import annotations

import importlib.metadata
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import optics
from estimator.files import FrameLabels, Stack, StackWriter, fingerprint, read_stack
from scenes.camera import FixedPatterns, after_jpeg, expose, fixed_patterns, metered_exposure
from scenes.description import Scene, SceneError
from scenes.rendering import LinearFrame, Renderer
from scenes.world import geometry, labels, motion, photometry

# Frames that wait for noise and encoding; more would only use memory.
_QUEUE = 4
_ANEW = ("camera", "exposures", "seed")
"""Parts of a scene that no rendering depends on."""
_TAKEN = ("file_name", "mask_file_name", "exposure", "exposure_s", "saturated_fraction", "seed")
"""Labels that a photograph gives, not the scene's geometry."""


def render_stack(
    scene: Scene,
    out: Path,
    *,
    variant: str = "llvm_ad_rgb",
    progress: Callable[[], None] = lambda: None,
) -> Stack:
    """Render a scene into a stack folder with all labels.

    A run that was stopped at any moment goes on where it was when the same scene is given the same
    folder; the stack is then the same, byte for byte, as if it had not been stopped.

    Args:
        scene: the scene.
        out: the stack's folder; must not exist. It appears under its name once it is whole.
        variant: of Mitsuba.
        progress: called after each frame.

    Returns:
        The stack.

    Raises:
        SceneError: the scene cannot be.
        StackError: `out` exists, or another process is writing it.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """
    with StackWriter(Path(out)) as writer:
        renderer = Renderer(scene, variant=variant)
        camera = _Camera.of(scene, renderer.table, wall_colour=renderer.wall_colour)
        writer.describe(
            stack={
                "scene": _dump(scene),
                "cone": geometry.cone(scene, renderer.table)._asdict(),
                "wall_colour": renderer.wall_colour.tolist(),
                "files": _files(scene),
                "run": {
                    "variant": variant,
                    "versions": _versions(),
                    "approximations": scene.approximations,
                },
            },
            microscope=_microscope_file(scene, camera.paper_exposure_s),
            kinematics=motion.kinematics(scene, renderer.moments.motion),
        )
        _render_frames(renderer, camera, writer, progress)
    return read_stack(out)


def expose_again(stack: Stack, scene: Scene, out: Path) -> Stack:
    """Take the photographs of a stack again with another camera, exposure or noise.

    Nothing is rendered: the noise-free frames that the stack has kept are exposed. The blur of a
    moving tip stays that of the exposure it was rendered with, and `metered` meters on it; where
    the tip hardly moved, the new stack is that which `render_stack` makes of the scene.

    Args:
        stack: rendered with `exposures.keep_linear`.
        scene: the stack's scene, but for `camera`, `exposures` and `seed`.
        out: the new stack's folder; must not exist.

    Returns:
        The new stack.

    Raises:
        SceneError: the scene differs elsewhere, or wants a kind of exposure that the stack lacks.
        StackError: `out` exists, or the stack has no linear frames.
    """
    _check_anew(stack, scene)
    camera = _Camera.of(
        scene,
        geometry.lens_table(scene),
        wall_colour=np.array(stack.description["wall_colour"]),
    )
    with StackWriter(Path(out)) as writer:
        writer.describe(
            stack={**stack.description, "scene": _dump(scene)},
            microscope=_microscope_file(scene, camera.paper_exposure_s),
            kinematics=np.loadtxt(stack.folder / "kinematics.csv", delimiter=",", skiprows=1),
        )
        for order, kind in enumerate(scene.exposures.kinds):
            for row in stack.exposed(kind):
                light, mask = stack.linear(row), stack.mask(row) > 0
                kept = {name: value for name, value in asdict(row).items() if name not in _TAKEN}
                camera.photograph(
                    writer,
                    light,
                    order=order,
                    exposure_s=camera.exposure_s(kind, light, mask),
                    mask=mask,
                    labels={**kept, "seed": scene.seed},
                )
    return read_stack(out)


class _Camera(NamedTuple):
    """A scene's camera: its sensor's fixed patterns, and its two ways to choose an exposure."""

    scene: Scene
    patterns: FixedPatterns
    paper_exposure_s: float

    @classmethod
    def of(
        cls, scene: Scene, table: optics.IrradianceTable | None, *, wall_colour: np.ndarray
    ) -> _Camera:
        shape = scene.camera.sensor_shape(
            height=scene.microscope.height_px, width=scene.microscope.width_px
        )
        patterns = fixed_patterns(settings=scene.camera, shape=shape, seed=scene.seed)
        paper = photometry.paper_exposure(scene, table, wall_colour=wall_colour)
        return cls(scene, patterns, paper)

    def exposure_s(self, kind: str, light: np.ndarray, mask: np.ndarray) -> float:
        """Duration of an exposure; `metered` depends on the light within the mask.

        No exposure outlasts the time between two frames; a metered one is dark then.
        """
        if kind == "paper":
            return self.paper_exposure_s
        gain = metered_exposure(
            light,
            settings=self.scene.camera,
            peak_fraction=self.scene.exposures.metered_peak,
            # A spot that is wholly hidden leaves nothing but the frame to meter on.
            mask=mask if mask.any() else None,
        )
        wanted = gain / self.scene.exposures.sensitivity_mm2_sr_mj
        return min(wanted, motion.longest_exposure(self.scene))

    def photograph(
        self,
        writer: StackWriter,
        light: np.ndarray,
        *,
        order: int,
        exposure_s: float,
        mask: np.ndarray,
        labels: dict[str, Any],
    ) -> None:
        """Expose one frame in the order-th way and write it with its labels."""
        frame, exposures = labels["frame"], self.scene.exposures
        image = expose(
            light,
            exposure=exposure_s * exposures.sensitivity_mm2_sr_mj,
            settings=self.scene.camera,
            rng=np.random.default_rng([self.scene.seed, frame, order]),
            patterns=self.patterns,
        )
        saturated = np.any(image[mask] >= self.scene.camera.full_scale_dn, axis=-1)
        if quality := self.scene.camera.jpeg_quality:
            image = after_jpeg(image, quality=quality)
        row = FrameLabels(
            file_name=_file_name(self.scene, frame, order),
            mask_file_name=f"masks/{frame:06d}.png",
            exposure=exposures.kinds[order],
            exposure_s=exposure_s,
            saturated_fraction=float(saturated.mean()) if saturated.size else 0.0,
            **labels,
        )
        writer.add(
            image,
            row,
            np.uint8(255) * mask if order == 0 else None,
            light if exposures.keep_linear else None,
        )


class _Metered(NamedTuple):
    """A frame whose exposures are chosen: their durations, in the order of their kinds."""

    frame: int
    sharp: LinearFrame
    mask: np.ndarray
    durations: list[float]


def _render_frames(
    renderer: Renderer, camera: _Camera, writer: StackWriter, progress: Callable[[], None]
) -> None:
    """Render what is missing on this thread; meter, expose and encode beside it.

    A frame is metered while the next one is rendered; then its sub-frames take their turn.
    """
    scene = renderer.scene
    metering: deque[Future[_Metered]] = deque()
    writing: deque[Future[None]] = deque()
    with ThreadPoolExecutor(max_workers=2) as pool:

        def finish_one() -> None:
            metered = metering.popleft().result()
            lights = [
                renderer.exposed(metered.frame, metered.sharp, exposure_s=duration).radiance
                for duration in metered.durations
            ]
            writing.append(pool.submit(_photograph, renderer, camera, writer, metered, lights))
            if len(writing) > _QUEUE:
                writing.popleft().result()

        for frame in range(renderer.moments.times.size):
            orders = range(len(scene.exposures.kinds))
            if not all(writer.has(_file_name(scene, frame, order)) for order in orders):
                sharp = renderer.render(frame)
                metering.append(pool.submit(_meter, renderer, camera, frame, sharp))
                if len(metering) > 1:
                    finish_one()
            progress()
        while metering:
            finish_one()
        for future in writing:
            future.result()


def _meter(renderer: Renderer, camera: _Camera, frame: int, sharp: LinearFrame) -> _Metered:
    mask = renderer.mask(frame, sharp)
    kinds = renderer.scene.exposures.kinds
    durations = [camera.exposure_s(kind, sharp.radiance, mask) for kind in kinds]
    return _Metered(frame, sharp, mask, durations)


def _photograph(
    renderer: Renderer,
    camera: _Camera,
    writer: StackWriter,
    metered: _Metered,
    lights: list[np.ndarray],
) -> None:
    spot = labels.spot_labels(renderer.scene, renderer.moments, metered.frame)
    spot["visible_fraction"] = metered.sharp.visible_fraction
    for order, (light, duration) in enumerate(zip(lights, metered.durations, strict=True)):
        camera.photograph(
            writer, light, order=order, exposure_s=duration, mask=metered.mask, labels=spot
        )


def _check_anew(stack: Stack, scene: Scene) -> None:
    was, now = stack.description["scene"], _dump(scene)
    for name in now:
        if name not in _ANEW and now[name] != was.get(name):
            raise SceneError(
                f"{stack.folder} was rendered with another [{name}]; only {', '.join(_ANEW)} can "
                "change without rendering. Render the scene."
            )
    if missing := set(scene.exposures.kinds) - {row.exposure for row in stack.labels}:
        raise SceneError(
            f"{stack.folder} holds no frames of exposure {missing.pop()!r}. Take it out of "
            "exposures.kinds, or render the scene."
        )


def _file_name(scene: Scene, frame: int, order: int) -> str:
    return f"frames/{frame * len(scene.exposures.kinds) + order:06d}.png"


def _files(scene: Scene) -> dict[str, dict[str, Any]]:
    """Fingerprints of the files that a scene names: with another content it is another scene."""
    image = scene.phantom.wall_image if scene.phantom.wall == "image" else ""
    lens = scene.source.lens if scene.source.lens.endswith(".toml") else ""
    poses = getattr(scene.motion, "file", "")
    return {name: fingerprint(Path(name)) for name in (image, lens, poses) if name}


def _dump(scene: Scene) -> dict[str, Any]:
    return scene.model_dump(mode="json", by_alias=True)


def _microscope_file(scene: Scene, fixed_exposure_s: float) -> dict[str, object]:
    """Content of microscope.json; a telecentric microscope has no camera matrix."""
    settings = scene.microscope
    camera = geometry.microscope(scene)
    telecentric = float(camera.inverse_working_distance) == 0.0
    return {
        "width_px": settings.width_px,
        "height_px": settings.height_px,
        "camera_matrix": None if telecentric else np.asarray(camera.camera_matrix()).tolist(),
        "distortion": np.asarray(camera.distortion).tolist(),
        "scale_mm_px": settings.scale_mm_px,
        "principal_point_px": np.asarray(camera.principal_point).tolist(),
        "pinhole_height_mm": None if telecentric else settings.pinhole_height_mm,
        "eye_radius_mm": scene.phantom.radius_mm,
        "response": scene.camera.response,
        "paper_exposure_s": fixed_exposure_s,
    }


def _versions() -> dict[str, str]:
    packages = ("eyespot", "mitsuba", "drjit", "jax", "numpy")
    return {name: importlib.metadata.version(name) for name in packages}
