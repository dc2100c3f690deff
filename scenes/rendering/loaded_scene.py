"""A scene that is loaded into Mitsuba: its images at any pose of the tip, and its radiance.

Import after `load_mitsuba`. Pixels and places within pixels lie on a regular grid.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from eyespot.scenes.description.scene import Scene
from eyespot.scenes.rendering.build import mitsuba_dict, rigid_transform
from eyespot.scenes.rendering.reach import Reach
from eyespot.scenes.world.exposure import uniform_irradiance
from eyespot.scenes.world.motion import DOWN, PARKED_MM, Poses
from eyespot.scenes.world.world import Moment, World


class Images:
    """One scene, loaded once into Mitsuba. Only pixels that the tip can change are rendered again.

    Attributes:
        mitsuba_scene: the scene as it is loaded.
        random: whether light is sampled randomly, so that all pixels differ between images.
    """

    def __init__(self, world: World, *, variant: str) -> None:
        self.world, scene = world, world.scene
        uniform = uniform_irradiance(world)
        self.mitsuba_scene = mi.load_dict(mitsuba_dict(world, uniform=uniform))
        self._parameters = mi.traverse(self.mitsuba_scene)
        self._unsettle = _unsettler(world, self.mitsuba_scene, uniform=uniform)
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
        self._pixels = pixel_means(self.mitsuba_scene, samples=samples, smooth=smooth)
        self._reach = None
        if self._still and self._in_arrays:
            self.place(tip=PARKED_MM, axis=DOWN)
            self._unlit = self._whole_image(seed=0)
            self._reach = Reach(world, self.mitsuba_scene, wall=self._unlit[1])

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
        ((radiance, wall),) = self._each(Poses(tip[None], axis[None]), [moment], [seed])
        return radiance, wall

    def mean(self, poses: Poses, moments: Sequence[Moment], seeds: Sequence[int]) -> np.ndarray:
        """Mean radiance of the images of some poses, see `at`."""
        total = np.zeros(1)
        for radiance, _ in self._each(poses, moments, seeds):
            total = total + radiance
        return total / np.float32(len(seeds))

    def _each(
        self, poses: Poses, moments: Sequence[Moment | None], seeds: Sequence[int]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """The image of each pose."""
        placed = pose_values(self.world.scene, poses)
        reached = [] if self._reach is None else self._reach.pixels(poses)
        for number, (moment, seed) in enumerate(zip(moments, seeds, strict=True)):
            self._bring_into(placed[number], moment)
            if reached:
                radiance, wall = (part.copy() for part in self._unlit)
                pixels = reached[number]
                radiance.reshape(-1, 3)[pixels], wall.reshape(-1)[pixels] = self._pixels(pixels)
            else:
                radiance, wall = self._whole_image(seed)
            reflexes = self._reflexes
            if moment is not None and self._shifts:
                reflexes = self._reflexes_at(moment.view_px)
            yield (radiance if reflexes is None else radiance + reflexes), wall

    def place(self, *, tip: np.ndarray, axis: np.ndarray, moment: Moment | None = None) -> None:
        """Bring the loaded scene into the state of one pose; see `at`."""
        (values,) = pose_values(self.world.scene, Poses(tip[None], axis[None]))
        self._bring_into(values, moment)

    def _bring_into(self, values: dict[str, Any], moment: Moment | None) -> None:
        self._parameters.update(values)
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
        image = np.array(mi.render(self.mitsuba_scene, seed=mi.UInt32(seed)))
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


def pose_values(scene: Scene, poses: Poses) -> list[dict[str, Any]]:
    """Values of a loaded scene's parameters at each of some poses."""
    values: list[dict[str, Any]] = [
        {"source.tip": mi.Point3f(tip), "source.axis": mi.Vector3f(axis)}
        for tip, axis in zip(*poses, strict=True)
    ]
    if scene.instrument.visible:
        for own, place in zip(values, rigid_transform(*poses), strict=True):
            own["instrument.to_world"] = mi.Transform4f(place)
    return values


def _unsettler(
    world: World, mitsuba_scene: Any, *, uniform: np.ndarray
) -> Callable[[Moment], None]:
    """Function that brings a loaded scene into the state of a moment.

    Args:
        uniform: indirect irradiance per colour channel at the source's mean power, mW/mm2.
    """
    unrest, microscope = world.scene.unrest, world.scene.microscope
    parameters = mi.traverse(mitsuba_scene)
    ambient = 0.0 if microscope.light == "coaxial" else microscope.illumination_mw_mm2
    centre = np.asarray(world.microscope.principal_point) + 0.5
    sensors = [
        name for name in ("sensor", "photon_camera") if f"{name}.principal_point" in parameters
    ]
    mean_power = float(np.array(parameters["source.power"]).item())
    # A mesh has no transform, and does not turn.
    at_rest = np.array(parameters["wall.to_world"].matrix, float) if unrest.turns else np.eye(4)

    def unsettle(moment: Moment) -> None:
        values: dict[str, Any] = {}
        if unrest.shifts:
            for name in sensors:
                values[f"{name}.principal_point"] = _opaque(mi.Vector2f(centre + moment.view_px))
        if unrest.turns:
            turned = np.eye(4)
            turned[:3, :3] = Rotation.from_rotvec(moment.turn).as_matrix()
            values["wall.to_world"] = mi.Transform4f(turned @ at_rest.reshape(4, 4))
        if unrest.power_swing:
            values["source.power"] = _opaque(mi.Float(moment.power * mean_power))
            light = moment.power * uniform + ambient
            values["integrator.uniform"] = _opaque(mi.Color3f(light))
        with _no_warnings():
            parameters.update(values)

    return unsettle


@contextmanager
def _no_warnings() -> Iterator[None]:
    """Mitsuba warns of a shear above 1e-6, which float32 leaves in a rotation times 11.5 mm."""
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        mi.set_log_level(level)


def _opaque(value: Any) -> Any:
    """The value as data, so that Mitsuba does not compile a kernel for each."""
    dr.make_opaque(value)
    return value


def radiance_along(mitsuba_scene: Any, *, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Radiance that arrives along lines of sight, as the scene's own camera would see it.

    Args:
        mitsuba_scene: a scene with `SpotIntegrator`, as `Images.mitsuba_scene` is.
        start: where the lines start, inside the eyeball, n x 3, mm.
        direction: unit vectors away from the camera, n x 3.

    Returns:
        n x 3, mW/(mm2 sr).
    """
    point, towards = (np.ascontiguousarray(a.T, dtype=np.float32) for a in (start, direction))
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(point), mi.Vector3f(towards)))
    sampler = mitsuba_scene.sensors()[0].sampler()
    light, _, _ = mitsuba_scene.integrator().sample(mitsuba_scene, sampler, ray)
    colours = dr.ravel(light)
    dr.eval(colours)
    return np.array(colours).reshape(-1, 3)


def _seen_at(mitsuba_scene: Any, place: Any) -> tuple[Any, Any]:
    """Radiance at places of the image, px, and 1 where the wall is seen."""
    sensor = mitsuba_scene.sensors()[0]
    on_film = mi.Point2f(place / mi.Vector2f(sensor.film().size()))
    ray, part = sensor.sample_ray(0.0, 0.5, on_film, mi.Point2f(0.5))
    light, _, seen = mitsuba_scene.integrator().sample(mitsuba_scene, sensor.sampler(), ray)
    return light * part, seen[0]


def pixel_means(
    mitsuba_scene: Any, *, samples: int, smooth: bool
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Function of n pixels' indices: means of radiance over them, by samples on a square grid.

    On an even grid the values are those of `mi.render` with a box filter and a stratified sampler
    without jitter. The squares that its n x n samples stand for lie within the pixel, so it suits
    light that each sample has the mean of over its square. For light at points, its samples lack
    1/n² of the variance of places within the pixel, and the image seems that much sharper. Farther
    apart by a factor of (1 - 1/n²)^-1/2 they give the mean of any polynomial of the third degree;
    two by two are Gauss and Legendre's.

    Args:
        mitsuba_scene: a scene with `SpotIntegrator`.
        samples: samples per pixel, rounded up to a square as in Mitsuba's sampler.
        smooth: whether the samples are spread like that.

    Returns:
        The function. It takes indices that count along rows from the top left, and gives the
        radiance, n x 3, and the fraction of each pixel that shows the wall, n.
    """
    side = math.isqrt(samples - 1) + 1
    apart = 1 / math.sqrt(side**2 - 1) if smooth and side > 1 else 1 / side

    # So Python traces the plugins once for all poses, which is a fifth of a pose's time. Numbers of
    # the plugins that no pose changes are constants of the recording, which serves one scene.
    recorded = dr.freeze(_means)

    def means(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        radiance, wall = recorded(mitsuba_scene, mi.UInt32(pixels), side, apart)
        return np.array(radiance).T, np.array(wall)

    return means


@dr.syntax
def _means(mitsuba_scene: Any, index: Any, side: int, apart: float) -> tuple[Any, Any]:
    """Mean radiance of pixels by side x side samples, and the mean of where the wall is seen."""
    width = mitsuba_scene.sensors()[0].film().size()[0]
    middle = mi.Vector2f(index % width, index // width) + 0.5
    wall = mi.Float(index) * 0
    radiance, sample = mi.Color3f(wall), mi.UInt32(0)
    while sample < side * side:
        place = middle + apart * (mi.Vector2f(sample % side, sample // side) + 0.5 - side / 2)
        light, seen = _seen_at(mitsuba_scene, place)
        radiance += light
        wall += seen
        sample += 1
    return radiance / side**2, wall / side**2


def fine_image(
    mitsuba_scene: Any, window: tuple[int, int, int, int], *, factor: int
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance at several places of each pixel of a window.

    Args:
        mitsuba_scene: a scene with `SpotIntegrator`.
        window: top, bottom, left and right, px.
        factor: places along a side of a pixel.

    Returns:
        Radiance, rows x columns x 3, and 1 where the wall is seen, rows x columns; both float32.
    """
    top, bottom, left, right = window
    rows, columns = (bottom - top) * factor, (right - left) * factor
    index, corner = dr.arange(mi.UInt32, rows * columns), mi.Vector2f(left, top)
    # As data, so that every window uses the same kernel.
    side = mi.UInt32(columns)
    dr.make_opaque(side, corner)
    place = (mi.Vector2f(index % side, index // side) + 0.5) / factor + corner
    light, seen = _seen_at(mitsuba_scene, place)
    colours, wall = dr.ravel(light), mi.Float(seen)
    dr.eval(colours, wall)
    return np.array(colours).reshape(rows, columns, 3), np.array(wall).reshape(rows, columns)


@contextmanager
def more_even_light(mitsuba_scene: Any, added: float) -> Iterator[None]:
    """Add irradiance from all sides to every surface within a block."""
    parameters = mi.traverse(mitsuba_scene)
    even = mi.Color3f(parameters["integrator.uniform"])
    more = even + added
    dr.make_opaque(even, more)
    parameters["integrator.uniform"] = more
    parameters.update()
    try:
        yield
    finally:
        parameters["integrator.uniform"] = even
        parameters.update()
