"""Linear frames of a scene: sharp ones, and the mean over an exposure (motion blur)."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.scene_keys import SceneError
from eyespot.scenes.machine.variant import load_mitsuba
from eyespot.scenes.world.motion import DOWN, PARKED_MM
from eyespot.scenes.world.world import Moment, World

if TYPE_CHECKING:
    from eyespot.scenes.rendering.loaded_scene import ColourImages, Images

_LEAST_REFLECTANCE = 1e-3  # darker places give no light to measure
_ALL_SIDES = np.pi  # irradiance with which radiance equals reflectance


def load_variant_for(scene: Scene, variant: str) -> None:
    """Load Mitsuba in a variant that renders a scene in time.

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
    load_mitsuba(variant)


def images_of(world: World, *, variant: str) -> "Images | ColourImages":
    """Images of a scene, for any pose of the tip, in the colours that [viewing] asks for.

    Raises:
        SceneError: the scene is too slow for a scalar variant.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """
    load_variant_for(world.scene, variant)
    # Mitsuba's plugins need the variant.
    from eyespot.scenes.rendering.loaded_scene import ColourImages, Images

    if len(world.colours) == 1:
        return Images(world, variant=variant)
    return ColourImages(world.colours, variant=variant)


class ImageWindow(NamedTuple):
    """A part of an image: rows [top, bottom) and columns [left, right)."""

    top: int
    bottom: int
    left: int
    right: int


class FineWall(NamedTuple):
    """The wall without the beam, at `factor` x `factor` places of each pixel of a window.

    Attributes:
        unlit: radiance without the beam, rows x columns x 3.
        reflectance: of the wall, rows x columns x 3.
        factor: number of places along a side of a pixel.
    """

    unlit: np.ndarray
    reflectance: np.ndarray
    window: ImageWindow
    factor: int

    def part(self, window: ImageWindow) -> "FineWall":
        """The same in a part of the window."""
        rows = slice(*(self.factor * (row - self.window.top) for row in window[:2]))
        columns = slice(*(self.factor * (column - self.window.left) for column in window[2:]))
        return FineWall(
            self.unlit[rows, columns], self.reflectance[rows, columns], window, self.factor
        )


# A contour that moves by less than 0.25 px is blurred by 0.25 px / sqrt(12) = 0.07 px, which is
# negligible beside the 0.3 px of the pixel itself. The image of the tip, which is not measured, may
# move by a pixel. Where it moves faster in one half of the exposure, its mean place is not that in
# the middle: off by a quarter of the difference, if it starts within the exposure.
_STILL_SPOT_PX, _STILL_TIP_PX, _STEADY_PX = 0.25, 1.0, 0.01
# Largest change between iterations, in standard deviations of the noise. Where a sharp edge passes,
# going from n to 3n sub-frames changes a pixel by up to 1/(3n) of its light.
_SETTLED = 2.0
# Enough for a sharp edge in a well-exposed frame; over-exposed frames might never converge.
_MOST_SUB_FRAMES = 81


class LinearFrame(NamedTuple):
    """A noise-free frame.

    Attributes:
        radiance: H x W x 3, mW/(mm2 sr).
        wall: H x W, fraction of each pixel that shows the wall.
        visible_fraction: visible fraction of the half-maximum contour.
    """

    radiance: np.ndarray
    wall: np.ndarray
    visible_fraction: float


class Exposed(NamedTuple):
    """Light during an exposure: the mean of sub-frames, H x W x 3, mW/(mm2 sr)."""

    radiance: np.ndarray
    sub_frames: int


class Renderer:
    """One scene, loaded once into Mitsuba; frames are rendered by moving the tip.

    Attributes:
        images: gives images for any pose of the tip.

    Raises:
        SceneError: the tip touches the wall, or the spot leaves the window.
        RendererUnavailable: Mitsuba cannot run that variant here.
    """

    def __init__(self, scene: Scene, *, variant: str = "llvm_ad_rgb") -> None:
        load_variant_for(scene, variant)  # before JAX, which waits for ever in a forked process
        self.scene = scene
        self.world = World(scene)
        self.images = images_of(self.world, variant=variant)
        self.mitsuba_scene = self.images.mitsuba_scene
        self.world.check()

    def render(self, frame: int) -> LinearFrame:
        """Sharp linear frame at the middle of its exposure."""
        time = self.world.times[frame]
        (tip,), (axis,) = self.world.motion.at(np.array([time]))
        moment = self.world.unrest.at(frame, time)
        radiance, wall = self.images.at(tip=tip, axis=axis, seed=frame, moment=moment)
        column, row = np.rint(np.asarray(self.world.truth.contour_px)[frame]).astype(int).T
        height, width = wall.shape
        inside = (0 <= row) & (row < height) & (0 <= column) & (column < width)
        visible = float(np.sum(wall[row[inside], column[inside]]) / inside.size)
        return LinearFrame(radiance, wall, visible)

    def exposed(self, frame: int, sharp: LinearFrame, *, exposure_s: float) -> Exposed:
        """Light of a frame while the tip moves: the mean over sub-frames.

        Sub-frames lie at the middles of equal parts of the exposure. Each iteration splits every
        part in three, which reuses the old sub-frames, until no pixel changes by more than twice
        the noise of the camera. If spot and tip hardly move, the sharp frame is returned.

        Args:
            sharp: the frame rendered at the middle of the exposure.
        """
        exposed = Exposed(sharp.radiance, 1)
        spot_px, tip_px, uneven_px = self._shift(frame, exposure_s)
        if spot_px < _STILL_SPOT_PX and tip_px < _STILL_TIP_PX and uneven_px < _STEADY_PX:
            return exposed
        # Frames with random noise never converge: use about one sub-frame per pixel of motion.
        most = min(max(spot_px, tip_px) if self.images.random else math.inf, _MOST_SUB_FRAMES)
        camera, settled = self.scene.camera, False
        electrons = exposure_s * self.scene.exposures.sensitivity_mm2_sr_mj * camera.full_well_e
        fixed = camera.dark_signal_e + camera.dark_variance_e2
        while not settled:
            count = 3 * exposed.sub_frames
            added = [part for part in range(count) if part % 3 != 1]
            mean = exposed.radiance / 3
            mean += self.gathered(frame, exposure_s, count, added) * (len(added) / count)
            # In standard deviations of the temporal noise (EMVA 1288).
            noise = np.sqrt(mean * electrons + fixed)
            change = float(np.max(np.abs(mean - exposed.radiance) * electrons / noise))
            settled = change <= _SETTLED or count >= most
            exposed = Exposed(mean, count)
        return exposed

    def gathered(
        self, frame: int, exposure_s: float, count: int, parts: Sequence[int]
    ) -> np.ndarray:
        """Mean radiance at the middles of some of `count` equal parts of a frame's exposure."""
        times = exposure_s * ((np.array(parts) + 0.5) / count - 0.5) + self.world.times[frame]
        # Light that is sampled randomly needs a different seed in every sub-frame.
        seeds = [frame + (count + part) * self.world.times.size for part in parts]
        moments = self.world.unrest.during(frame, times)
        return self.images.mean(self.world.motion.at(times), moments, seeds)

    def _shift(self, frame: int, exposure_s: float) -> tuple[float, float, float]:
        """Motion of the spot's contour and of the tip's image during an exposure, px.

        Third how much the contour's differs between the exposure's halves.
        """
        times = self.world.times[frame] + exposure_s * np.array([-0.5, 0.0, 0.5])
        tip, axis = self.world.motion.at(times)
        scale, camera = self.scene.microscope.scale_mm_px, self.world.microscope
        tip_image = np.asarray(camera.project(tip))
        tip_px = np.linalg.norm(np.diff(tip_image, axis=0), axis=1)
        # O moves with the tip, and with the turning axis times d. The spot also changes its size.
        steps, turns, beam = np.diff(tip, axis=0), np.diff(axis, axis=0), axis[1]
        aside = steps + float(self.world.truth.distance[frame]) * turns
        across = np.linalg.norm(aside - (aside @ beam)[:, None] * beam, axis=1)
        moved = across / math.cos(float(self.world.truth.incidence[frame]))
        grown = np.abs(steps @ beam) * math.tan(float(self.world.truth.beam.half_angle[frame]))
        # Drift moves the image, and rotation the wall's picture.
        unrest = self.scene.unrest
        turning = self.scene.phantom.radius_mm * math.hypot(
            *map(math.radians, unrest.rotation_deg_s)
        )
        drift_px = exposure_s * ((math.hypot(*unrest.drift_mm_s) + turning) / scale)
        spot_px = (moved + grown) / scale
        return (
            float(np.sum(spot_px)) + drift_px,
            float(np.sum(tip_px)) + drift_px,
            float(np.ptp(spot_px)),
        )

    def fine_wall(self, frame: int, *, window: ImageWindow, factor: int) -> FineWall:
        """The wall in a part of a frame without the beam, finer than pixels.

        The reflectance follows from two images, of which one has even light from all sides added.

        Args:
            factor: places along a side of a pixel.
        """
        pose = PARKED_MM, DOWN, self.world.unrest.at(frame, self.world.times[frame])
        unlit, lit = (self._fine(window, factor, pose, added) for added in (0.0, _ALL_SIDES))
        return FineWall(unlit, lit - unlit, window, factor)

    def fine_light(
        self, frame: int, wall: FineWall, *, exposure_s: float, sub_frames: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Light of the beam on that wall during an exposure.

        Args:
            sub_frames: equal parts of the exposure; their middles are averaged.

        Returns:
            The light that the wall reflects divided by its reflectance, in the unit of radiance,
            and the reflectance, both rows x columns x 3; 0 where something else than the wall is
            seen.
        """
        places = (np.arange(sub_frames) + 0.5) / sub_frames - 0.5
        times = self.world.times[frame] + exposure_s * places
        usable = wall.reflectance > _LEAST_REFLECTANCE
        lit = np.zeros_like(wall.unlit)
        moments = self.world.unrest.during(frame, times)
        for pose in zip(*self.world.motion.at(times), moments, strict=True):
            seen = self._fine(wall.window, wall.factor, pose)
            usable &= ~np.isnan(seen)
            lit += seen
        reflectance = np.where(usable, wall.reflectance, np.float32(0.0))
        direct = np.where(usable, lit / sub_frames - wall.unlit, np.float32(0.0))
        return direct / np.where(usable, reflectance, np.float32(1.0)), reflectance

    def _fine(
        self,
        window: ImageWindow,
        factor: int,
        pose: tuple[np.ndarray, np.ndarray, Moment],
        added: float = 0.0,
    ) -> np.ndarray:
        """Radiance within pixels, with more even light; NaN where no wall is seen."""
        from eyespot.scenes.rendering import loaded_scene as loaded  # needs Mitsuba's variant

        tip, axis, moment = pose
        colours = []
        for images in self.images.by_colour:
            images.place(tip=tip, axis=axis, moment=moment)
            with loaded.more_even_light(images.mitsuba_scene, added):
                radiance, wall = loaded.fine_image(images.mitsuba_scene, window, factor=factor)
            colours.append(np.where(wall[..., None] > 0, radiance, np.float32(np.nan)))
        if len(colours) == 1:
            return colours[0]
        return np.stack([seen[..., k] for k, seen in enumerate(colours)], axis=-1)

    def mask(self, frame: int, linear: LinearFrame) -> np.ndarray:
        """Pixels whose centre lies inside the half-maximum contour and shows the wall."""
        from skimage.draw import polygon2mask

        contour = np.asarray(self.world.truth.contour_px)[frame, :, ::-1]
        return polygon2mask(linear.wall.shape, contour) & (linear.wall > 0.5)
