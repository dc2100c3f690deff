"""From a scene to linear frames, and from those to a labelled stack on disk."""

from __future__ import annotations

import functools
import importlib.metadata
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from estimator import FrameLabels, Stack, StackWriter, read_stack
from scenes import geometry, labels, photometry
from scenes.exposure import FixedPatterns, expose, fixed_patterns, metered_exposure
from scenes.settings import Scene
from scenes.variant import load_mitsuba

# Frames that wait for exposure and encoding; more would only use memory.
_QUEUE = 4


class LinearFrame(NamedTuple):
    """A noise-free frame.

    Attributes:
        radiance: H x W x 3, mW/(mm2 sr).
        wall: H x W, part of each pixel in which the wall is seen.
        visible_fraction: part of the half-maximum contour that the camera sees.
    """

    radiance: np.ndarray
    wall: np.ndarray
    visible_fraction: float


class Renderer:
    """One scene, loaded once into Mitsuba; frames are rendered by moving the tip.

    Args:
        scene: the scene.
        variant: of Mitsuba.

    Attributes:
        scene: as given.
        table: vector irradiance of the lens, or None for the cone.
        truth: of every moment.
        wall_colour: mean reflectance of the wall per channel.
        mitsuba_scene: for other integrators on the same scene.

    Raises:
        SceneError: the spot leaves the window.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """

    def __init__(self, scene: Scene, *, variant: str = "llvm_ad_rgb") -> None:
        self._mi = load_mitsuba(variant)
        from scenes import build  # its plugins need the variant

        self.scene = scene
        self.table = geometry.lens_table(scene)
        self.truth = labels.truth(scene, self.table)
        self.wall_colour = build.wall_colour(scene)
        uniform = photometry.uniform_irradiance(scene, wall_colour=self.wall_colour)
        content = build.mitsuba_dict(scene, table=self.table, uniform=uniform)
        self.mitsuba_scene = self._mi.load_dict(content)
        self._parameters = self._mi.traverse(self.mitsuba_scene)
        self._place = functools.partial(build.pose_parameters, scene)

    def render(self, frame: int) -> LinearFrame:
        """Linear frame of one moment."""
        tip, axis = self.truth.beam.tip[frame], self.truth.beam.axis[frame]
        apex = tip + self.truth.beam.apex_offset[frame] * axis
        for name, value in self._place(tip=tip, axis=axis, apex=apex).items():
            self._parameters[name] = value
        self._parameters.update()
        image = np.asarray(self._mi.render(self.mitsuba_scene, seed=0))
        return LinearFrame(image[..., :3], image[..., 3], self._visible_fraction(frame))

    def mask(self, frame: int, linear: LinearFrame) -> np.ndarray:
        """Pixels whose centre lies inside the half-maximum contour and sees the wall."""
        from skimage.draw import polygon2mask

        contour = np.asarray(self.truth.contour_px[frame])[:, ::-1]
        return polygon2mask(linear.wall.shape, contour) & (linear.wall > 0.5)

    def _visible_fraction(self, frame: int) -> float:
        mi = self._mi
        contour = np.asarray(self.truth.contour_px[frame])
        # Mitsuba's pixel i spans [i, i + 1), the contour's pixel centres are integers.
        size = np.array([self.scene.microscope.width_px, self.scene.microscope.height_px])
        u, v = ((contour + 0.5) / size).T
        inside = (u > 0) & (u < 1) & (v > 0) & (v < 1)
        ray, _ = self.mitsuba_scene.sensors()[0].sample_ray(
            0.0, 0.5, mi.Point2f(mi.Float(u), mi.Float(v)), mi.Point2f(0.5)
        )
        wall = next(s for s in self.mitsuba_scene.shapes() if s.id() == "wall")
        seen = np.asarray(self.mitsuba_scene.ray_intersect(ray).shape == mi.ShapePtr(wall))
        return float(np.mean(inside & seen))


def render_stack(
    scene: Scene,
    out: Path,
    *,
    variant: str = "llvm_ad_rgb",
    progress: Callable[[], None] = lambda: None,
) -> Stack:
    """Render a scene into a stack folder with all labels.

    Args:
        scene: the scene.
        out: the stack's folder; must not exist. It appears under its name once it is whole.
        variant: of Mitsuba.
        progress: called after each moment.

    Returns:
        The stack.

    Raises:
        SceneError: the scene cannot be.
        StackError: `out` exists.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """
    with StackWriter(Path(out)) as writer:
        renderer = Renderer(scene, variant=variant)
        fixed = photometry.paper_exposure(scene, renderer.table, wall_colour=renderer.wall_colour)
        writer.describe(
            stack={
                "scene": scene.model_dump(mode="json", by_alias=True),
                "cone": geometry.cone(scene, renderer.table)._asdict(),
                "run": {"variant": variant, "versions": _versions()},
            },
            microscope=_microscope_file(scene, fixed),
        )
        size = (scene.microscope.height_px, scene.microscope.width_px, 3)
        patterns = fixed_patterns(settings=scene.camera, shape=size, seed=scene.seed)
        with ThreadPoolExecutor(max_workers=2) as pool:
            waiting: list[Future[None]] = []
            for frame in range(scene.withdrawal.frames):
                linear = renderer.render(frame)
                waiting.append(
                    pool.submit(_expose_and_write, writer, renderer, frame, linear, fixed, patterns)
                )
                if len(waiting) > _QUEUE:
                    waiting.pop(0).result()
                progress()
            for future in waiting:
                future.result()
    return read_stack(out)


def _expose_and_write(
    writer: StackWriter,
    renderer: Renderer,
    frame: int,
    linear: LinearFrame,
    fixed: float,
    patterns: FixedPatterns,
) -> None:
    scene = renderer.scene
    mask = renderer.mask(frame, linear)
    spot = labels.spot_labels(scene, renderer.truth, frame)
    sensitivity = scene.exposures.sensitivity_mm2_sr_mj
    for order, kind in enumerate(scene.exposures.kinds):
        gain = fixed * sensitivity
        if kind == "metered":
            gain = metered_exposure(
                linear.radiance,
                settings=scene.camera,
                peak_fraction=scene.exposures.metered_peak,
                # A spot that is wholly hidden leaves nothing but the frame to meter on.
                mask=mask if mask.any() else None,
            )
        rng = np.random.default_rng([scene.seed, frame, order])
        image = expose(
            linear.radiance, exposure=gain, settings=scene.camera, rng=rng, patterns=patterns
        )
        saturated = np.any(image >= scene.camera.full_scale_dn, axis=-1)[mask]
        number = frame * len(scene.exposures.kinds) + order
        row = FrameLabels(
            file_name=f"frames/{number:06d}.png",
            mask_file_name=f"masks/{frame:06d}.png",
            exposure=kind,
            exposure_s=gain / sensitivity,
            visible_fraction=linear.visible_fraction,
            saturated_fraction=float(saturated.mean()) if saturated.size else 0.0,
            **spot,
        )
        writer.add(image, row, np.uint8(255) * mask if order == 0 else None)


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
