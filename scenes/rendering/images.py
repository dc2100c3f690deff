"""Noise-free images of a scene, for any pose of the tip."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.scene_keys import SceneError
from eyespot.scenes.machine.variant import load_mitsuba
from eyespot.scenes.world.exposure import uniform_irradiance
from eyespot.scenes.world.motion import Poses
from eyespot.scenes.world.world import Moment, World

# Far below the eye and pointing away: the tip is not visible, and its beam lights nothing.
PARKED_MM, DOWN = np.array([0.0, 0.0, -1e3]), np.array([0.0, 0.0, -1.0])


def variant_for(scene: Scene, variant: str) -> Any:
    """Mitsuba in a variant that renders a scene in time.

    Raises:
        SceneError: the scene is too slow for a scalar variant.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """
    source, phantom = scene.source.kind, scene.phantom
    more = source != "cone" or phantom.indirect == "traced" or phantom.spread != "none"
    if variant.startswith("scalar") and more:
        # Scalar variants run our emitters in Python, ray by ray: a minute per frame at least.
        raise SceneError(
            f"the variant {variant} renders only source.kind 'cone' without traced or spread "
            f"light; got {source!r} with phantom.indirect {phantom.indirect!r} and "
            f"spread {phantom.spread!r}. Use llvm_ad_rgb; `eyespot doctor` checks what it needs."
        )
    return load_mitsuba(variant)


class Images:
    """One scene, loaded once into Mitsuba. Only pixels that the tip can change are rendered again.

    Attributes:
        mitsuba_scene: the scene as it is loaded.
        random: whether light is sampled randomly, so that all pixels differ between images.

    Raises:
        SceneError: the scene is too slow for a scalar variant.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """

    def __init__(self, world: World, *, variant: str) -> None:
        scene = world.scene
        self._mi = variant_for(scene, variant)
        # Mitsuba's plugins need the variant.
        from eyespot.scenes.rendering import build, loaded_scene, reach

        self.world = world
        uniform = uniform_irradiance(world)
        content = build.mitsuba_dict(world, uniform=uniform)
        self.mitsuba_scene = self._mi.load_dict(content)
        self._move = build.mover(scene, self.mitsuba_scene)
        self._unsettle = reach.unsettler(world, self.mitsuba_scene, uniform=uniform)
        self._still, self._shifts = scene.unrest.still, scene.unrest.shifts
        self._reflexes = self._reflexes_at(np.zeros(2))
        self.random = (
            scene.source.kind == "photons"
            or scene.phantom.indirect == "traced"
            or scene.microscope.numerical_aperture > 0
        )
        # Scalar variants cannot render arrays of pixels.
        self._in_arrays = not (self.random or variant.startswith("scalar"))
        # A cone has a sharp edge, and each sample of it the mean over a square.
        smooth, samples = scene.source.kind == "lens", scene.microscope.samples
        self._pixels = loaded_scene.pixel_means(self.mitsuba_scene, samples=samples, smooth=smooth)
        self._reach = None
        if self._still and self._in_arrays:
            self._move(PARKED_MM, DOWN)
            self._unlit = self._whole_image(seed=0)
            self._reach = reach.Reach(world, self.mitsuba_scene, wall=self._unlit[1])

    @property
    def by_colour(self) -> list["Images"]:
        """Images for each set of lines of sight: these alone."""
        return [self]

    def at(
        self, *, tip: np.ndarray, axis: np.ndarray, seed: int, moment: Moment | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Image of one pose.

        Args:
            tip: mm, eye frame.
            axis: unit vector from the tip towards the wall.
            seed: random seed of light that is sampled randomly.
            moment: what [unrest] moves; None: nothing.

        Returns:
            Radiance, H x W x 3, mW/(mm2 sr), and the fraction of each pixel that shows the wall.
        """
        self.place(tip=tip, axis=axis, moment=moment)
        if self._reach is None:
            radiance, wall = self._whole_image(seed)
        else:
            radiance, wall = (part.copy() for part in self._unlit)
            pixels = self._reach.pixels(tip=tip, axis=axis)
            radiance.reshape(-1, 3)[pixels], wall.reshape(-1)[pixels] = self._pixels(pixels)
        reflexes = self._reflexes
        if moment is not None and self._shifts:
            reflexes = self._reflexes_at(moment.view_px)
        return (radiance if reflexes is None else radiance + reflexes), wall

    def mean(self, poses: Poses, moments: Sequence[Moment], seeds: Sequence[int]) -> np.ndarray:
        """Mean radiance of the images of some poses, see `at`."""
        total = np.zeros(1)
        for tip, axis, moment, seed in zip(*poses, moments, seeds, strict=True):
            total = total + self.at(tip=tip, axis=axis, seed=seed, moment=moment)[0]
        return total / np.float32(len(seeds))

    def place(self, *, tip: np.ndarray, axis: np.ndarray, moment: Moment | None = None) -> None:
        """Bring the loaded scene into the state of one pose; see `at`."""
        self._move(tip, axis)
        if moment is not None and not self._still:
            self._unsettle(moment)

    def _reflexes_at(self, view_px: np.ndarray) -> np.ndarray | None:
        """Light of the lamp's reflexes in an image that is shifted by (x, y) px, H x W x 1."""
        if self.world.reflections is None:
            return None
        return self.world.reflections.image(view_px)[..., None].astype(np.float32)

    def _whole_image(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        if self._in_arrays:
            view = self.world.scene.microscope
            shape = view.height_px, view.width_px
            radiance, seen = self._pixels(np.arange(math.prod(shape), dtype=np.uint32))
            return radiance.reshape(*shape, 3), seen.reshape(shape)
        image = np.array(self._mi.render(self.mitsuba_scene, seed=seed))
        if self.world.scene.source.kind == "photons":
            from eyespot.scenes.rendering.photons import photon_image

            image[..., :3] += photon_image(
                self.mitsuba_scene,
                photons_per_pixel=self.world.scene.source.photons_per_pixel,
                seed=seed,
            )
        return image[..., :3], image[..., 3]


class ColourImages:
    """Images of a scene in which each colour has its own lines of sight, rendered apart.

    The attributes are those of `Images`, `mitsuba_scene` as green sees it.

    Args:
        colours: the scene as red, green and blue see it (`World.colours`).
    """

    def __init__(self, colours: Sequence[World], *, variant: str) -> None:
        self.by_colour = [Images(world, variant=variant) for world in colours]
        self.mitsuba_scene, self.random = self.by_colour[1].mitsuba_scene, self.by_colour[1].random

    def at(
        self, *, tip: np.ndarray, axis: np.ndarray, seed: int, moment: Moment | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Image of one pose, as `Images.at`; the wall's fraction of a pixel is green's."""
        seen = [own.at(tip=tip, axis=axis, seed=seed, moment=moment) for own in self.by_colour]
        radiance = np.stack([image[..., k] for k, (image, _) in enumerate(seen)], axis=-1)
        return radiance, seen[1][1]

    def mean(self, poses: Poses, moments: Sequence[Moment], seeds: Sequence[int]) -> np.ndarray:
        """Mean radiance of the images of some poses, as `Images.mean`."""
        seen = [own.mean(poses, moments, seeds) for own in self.by_colour]
        return np.stack([image[..., k] for k, image in enumerate(seen)], axis=-1)


def images_of(world: World, *, variant: str) -> Images | ColourImages:
    """Images of a scene in the colours that [viewing] asks for."""
    if len(world.colours) == 1:
        return Images(world, variant=variant)
    return ColourImages(world.colours, variant=variant)
