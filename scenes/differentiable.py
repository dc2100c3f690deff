"""Photons through the glue lens onto the film, as a function of the lens and its pose.

Import after `load_mitsuba`.

What makes its derivatives right: a photon's place on the film and its power are smooth in every
parameter, and nothing is decided by comparing a parameter with a random number. Photons are drawn
where they pass the aperture, so that none is lost at the rim; the cap splits their power by
Fresnel's equations instead of reflecting some of them, and the part that leaves falls to zero
before total reflection sets in; the film takes a photon by a tent over its four nearest pixels. An
occluder would break the rule, because which photons it hides is a comparison; scenes with one are
refused.
"""

# Mitsuba's stubs describe no variant's types; the tracer is left to its tests.
# mypy: no-check-untyped-defs

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

import optics
from scenes import build
from scenes.motion import frame_times, trajectory
from scenes.settings import Scene, SceneError

LENS = (
    "core_radius",
    "glue_length",
    "aperture_radius",
    "sag",
    "glue_index",
    "numerical_aperture",
)
"""What can be free of the lens, as `optics.GlueLens` names it."""

POSE = ("tip_x", "tip_y", "tip_z", "axis_x", "axis_y", "axis_z")
"""What can be free of the pose, eye frame: mm; the axis is a direction of any length."""

_BORDER_PX = 1  # pixels of the film's edge lack the light of photons just beyond it
_PASS = 1 << 18  # photons at a time; their graph takes about 1 kB each
_GRAZING = 1e-8  # squared cosine at which a ray leaves along the cap; its power is zero there


class _OnFilm(NamedTuple):
    """Photons shared out to the four pixels about each: numbers of pixels, light for them."""

    pixels: list[Any]
    light: list[Any]


class PhotonImage:
    """Direct light of the lens on the wall, seen by the microscope, with derivatives.

    The image is that of `scenes.photons.photon_image` but for two things: the pixel is a tent two
    pixels wide instead of a box, and light that the cap throws back is lost (under 0.5 % of it
    comes out later). One seed's photons are the same for all parameters, so that the image is a
    smooth function of them; its noise is that of `photons`.

    Args:
        scene: whose source is a lens and whose view nothing obstructs.
        free: names of the parameters, of `LENS`, `POSE` and "power"; the others stay as in the
            scene.
        photons: leaving the core.
        frame: of the scene's motion, for the pose.
        seed: other seeds give independent noise.

    Attributes:
        free: names of the parameters.
        start: the scene's own values of them.
        shape: H, W, 3 of the image.

    Raises:
        SceneError: an instrument or tool may hide photons, or the source has no lens.
        ValueError: a name in `free` is unknown.
    """

    def __init__(
        self, scene: Scene, *, free: Sequence[str], photons: int, frame: int = 0, seed: int = 0
    ) -> None:
        _refuse_occluders(scene)
        known = (*LENS, *POSE, "power")
        if unknown := [name for name in free if name not in known]:
            raise ValueError(
                f"PhotonImage(free=...) names {', '.join(unknown)}; choose from {', '.join(known)}."
            )
        self._values, self._launch = _parameters(scene, frame)
        self._medium_index = optics.MEDIA[scene.source.medium]
        self._photons, self._seed = photons, seed
        self.free = tuple(free)
        self.start = np.array([self._values[name] for name in self.free])
        self.shape = (scene.microscope.height_px, scene.microscope.width_px, 3)
        self._wall, self._sensor = _wall_and_sensor(scene)

    def value(self, parameters: np.ndarray) -> np.ndarray:
        """Radiance, H x W x 3, mW/(mm2 sr).

        Args:
            parameters: of `free`, in its order.

        Raises:
            ValueError: they describe no lens; the message names the value.
        """
        image = np.zeros(self.shape)
        for _, photons in self._passes(parameters):
            image += self._splatted(photons.pixels, photons.light)
        return image

    def value_and_jacobian(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Radiance, and its derivatives in forward mode, H x W x 3 x p.

        Args:
            parameters: of `free`, in its order.

        Raises:
            ValueError: they describe no lens; the message names the value.
        """
        image, jacobian = np.zeros(self.shape), np.zeros((*self.shape, len(self.free)))
        for leaves, photons in self._passes(parameters, derivatives=True):
            columns = []
            for leaf in leaves:
                dr.forward_from(leaf, flags=dr.ADFlag.ClearVertices)
                columns.append(dr.grad(photons.light))
                dr.clear_grad(photons.light)
            light = dr.detach(photons.light)
            # One kernel for all: they share the photons' paths.
            dr.eval(photons.pixels, light, columns)
            image += self._splatted(photons.pixels, light)
            for number, column in enumerate(columns):
                jacobian[..., number] += self._splatted(photons.pixels, column)
        return image, jacobian

    def vjp(self, parameters: np.ndarray, cotangent: np.ndarray) -> np.ndarray:
        """Derivatives of sum(cotangent * image) in reverse mode, one pass for any number of them.

        Args:
            parameters: p of them, of `free` in its order.
            cotangent: H x W x 3.

        Returns:
            p derivatives.

        Raises:
            ValueError: they describe no lens; the message names the value.
        """
        border = [(_BORDER_PX, _BORDER_PX)] * 2 + [(0, 0)]
        weight = mi.Float(np.pad(cotangent, border).ravel().astype(np.float32))
        total = np.zeros(len(self.free))
        for leaves, photons in self._passes(parameters, derivatives=True):
            product = mi.Float(0)
            for pixel, light in zip(photons.pixels, photons.light, strict=True):
                product += dr.dot(light, dr.gather(mi.Color3f, weight, pixel))
            dr.backward(product)
            total += [dr.sum(dr.grad(leaf))[0] for leaf in leaves]
        return total

    def _passes(self, parameters: np.ndarray, *, derivatives: bool = False):
        """The free parameters and the photons that follow them, so many photons at a time."""
        values = self._values | dict(zip(self.free, parameters.tolist(), strict=True))
        _check_lens(values)
        count = math.ceil(self._photons / _PASS)
        for number in range(count):
            size = self._photons * (number + 1) // count - self._photons * number // count
            # In memory, or every new value would be a new kernel; for each photon, or reverse mode
            # would sum over the photons wherever a parameter is used.
            copies = {name: dr.opaque(mi.Float, value, size) for name, value in values.items()}
            leaves = [copies[name] for name in self.free]
            if derivatives:
                dr.enable_grad(leaves)
            yield leaves, self._photons_on_film(copies, size, seed=self._seed * count + number)

    def _photons_on_film(self, values: dict[str, Any], size: int, *, seed: int) -> _OnFilm:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, size)
        place, heading, power = _leave_cap(
            values,
            launch=self._launch,
            medium_index=self._medium_index,
            numbers=(sampler.next_2d(), sampler.next_2d()),
        )
        frame = mi.Frame3f(dr.normalize(_vector(values, "axis")))
        tip = _vector(values, "tip")
        si = self._wall.ray_intersect(
            mi.Ray3f(mi.Point3f(tip + frame.to_world(place)), frame.to_world(heading)), power > 0
        )
        to_film, importance = self._sensor.sample_direction(si, sampler.next_2d(), si.is_valid())
        context = mi.BSDFContext(mi.TransportMode.Importance)
        reflected = si.bsdf().eval(context, si, si.to_local(to_film.d), si.is_valid())
        film = mi.ScalarVector2u(self._sensor.film().size())
        light = reflected * importance * power * (math.prod(film) / self._photons)
        light = dr.select(to_film.pdf > 0, light, 0)
        nearest = dr.floor(to_film.uv)
        columns, rows = (_spline(to_film.uv[i] - nearest[i] - 0.5) for i in (0, 1))
        pixels, parts = [], []
        for (right, across), (down, along) in itertools.product(columns, rows):
            column, row = mi.Int(nearest.x) + right, mi.Int(nearest.y) + down
            inside = (column >= 0) & (column < film.x) & (row >= 0) & (row < film.y)
            pixels.append(mi.UInt32(dr.select(inside, row * film.x + column, 0)))
            parts.append(dr.select(inside, across * along * light, 0))
        return _OnFilm(pixels, parts)

    def _splatted(self, pixels: list[Any], light: list[Any]) -> np.ndarray:
        """The image that photons make, without the film's border."""
        height, width, channels = self.shape
        height, width = height + 2 * _BORDER_PX, width + 2 * _BORDER_PX
        film = dr.zeros(mi.Float, height * width * channels)
        for pixel, part in zip(pixels, light, strict=True):
            dr.scatter_add(film, part, pixel)
        inner = slice(_BORDER_PX, -_BORDER_PX)
        return np.array(film, dtype=float).reshape(height, width, channels)[inner, inner]


def _spline(offset):
    """Shares of the pixels before, about and behind a place, by its offset from the centre, px.

    The quadratic B-spline: smooth, and its shares add up to 1.
    """
    return (
        (-1, 0.5 * dr.square(0.5 - offset)),
        (0, 0.75 - dr.square(offset)),
        (1, 0.5 * dr.square(0.5 + offset)),
    )


def _refuse_occluders(scene: Scene) -> None:
    for key, visible in (
        ("instrument", scene.instrument.visible),
        ("second_tool", scene.second_tool.visible),
    ):
        if visible:
            raise SceneError(
                f"PhotonImage: {key}.visible = true would hide photons, and derivatives do not "
                f"see the shadow's edge move (up to 20 % off). Set {key}.visible to false."
            )
    if scene.source.kind == "cone":
        raise SceneError(
            "PhotonImage: source.kind 'cone' has no glass that photons could pass. Set it to "
            "'photons' or 'lens'."
        )


def _parameters(scene: Scene, frame: int) -> tuple[dict[str, float], optics.GlueLens]:
    """The scene's values of all that can be free, and its lens."""
    lens = optics.load_lens(scene.source.lens)
    motion = trajectory(scene)
    pose = motion.at(frame_times(scene, motion)[frame : frame + 1])
    values = {name: float(getattr(lens, name)) for name in LENS}
    values |= zip(POSE, map(float, (*pose.tip[0], *pose.axis[0])), strict=True)
    return values | {"power": scene.source.power_mw}, lens


def _wall_and_sensor(scene: Scene) -> tuple[Any, Any]:
    """The wall as a Mitsuba scene of its own, and the microscope with a border round its window."""
    film = {
        "width_px": scene.microscope.width_px + 2 * _BORDER_PX,
        "height_px": scene.microscope.height_px + 2 * _BORDER_PX,
    }
    bare = scene.model_copy(
        update={
            # The lens itself is not needed, nor its table, which takes seconds.
            "source": scene.source.model_copy(update={"kind": "cone"}),
            "microscope": scene.microscope.model_copy(update=film),
        }
    )
    content = build.mitsuba_dict(bare, table=None, uniform=np.zeros(3))
    return mi.load_dict({"type": "scene", "wall": content["wall"]}), mi.load_dict(content["sensor"])


def _check_lens(values: dict[str, float]) -> None:
    """Refuse what is no lens, in plain numbers: `optics` would call JAX, perhaps inside of it."""
    for name, low, high in (
        ("sag", 0.0, min(values["aperture_radius"], values["glue_length"])),
        ("numerical_aperture", 1e-6, values["glue_index"]),
        ("core_radius", 1e-6, math.inf),
        ("glue_index", 1.0, 4.0),
        ("power", 0.0, math.inf),
    ):
        if not low <= values[name] <= high:
            raise ValueError(
                f"PhotonImage: {name} must lie in [{low:g}, {high:g}]; got {values[name]:g}. "
                "Start a fit nearer, or fit a function of the parameter that keeps it there."
            )


def _vector(values: dict[str, Any], name: str):
    return mi.Vector3f(*(values[f"{name}_{axis}"] for axis in "xyz"))


def _leave_cap(values: dict[str, Any], *, launch: optics.GlueLens, medium_index: float, numbers):
    """Light behind the cap in the lens's frame: place, direction and power of each photon.

    Args:
        values: parameters by name.
        launch: the lens whose Gaussian launch, if any, the core has.
        medium_index: of the medium in front.
        numbers: uniform ones, two for the direction and two for the place.
    """
    index, sag, aperture = values["glue_index"], values["sag"], values["aperture_radius"]
    face, face_light = _filled(values["core_radius"], launch.launch_radius, 1)
    sine, sine_light = _filled(values["numerical_aperture"] / index, launch.launch_aperture, index)
    lateral = sine * mi.warp.square_to_uniform_disk_concentric(numbers[0])
    forward = dr.sqrt(1 - dr.squared_norm(lateral))
    # Where light of this direction passes the rim's plane: in the core's disc, moved, and in the
    # aperture's. Along the line of their centres, then across it.
    across = dr.norm(lateral)
    moved = (values["glue_length"] - sag) * across / forward
    first, last = dr.maximum(moved - face, -aperture), dr.minimum(moved + face, aperture)
    width = dr.maximum(last - first, 0)
    along = first + width * numbers[1].x
    half = dr.minimum(face**2 - dr.square(along - moved), aperture**2 - dr.square(along))
    half = dr.sqrt(dr.maximum(half, 1e-12))
    aside = half * (2 * numbers[1].y - 1)
    unit = lateral / dr.maximum(across, 1e-12)
    power = values["power"] * width * 2 * half / (dr.pi * face**2)
    power *= face_light(dr.square(along - moved) + dr.square(aside))
    power *= sine_light(dr.square(across))

    # The cap is k|P|^2/2 + P_z = 0 with the curvature k, which also holds for a flat end.
    curvature = 2 * sag / (aperture**2 + sag**2)
    heading = mi.Vector3f(lateral.x, lateral.y, forward)
    rim = mi.Vector3f(
        along * unit.x - aside * unit.y, along * unit.y + aside * unit.x, -sag + 0 * along
    )
    depth = 0.5 * curvature * (aperture**2 - dr.square(along) - dr.square(aside))
    steepness = 0.5 * (curvature * dr.dot(rim, heading) + forward)
    path = depth / (steepness + dr.sqrt(dr.square(steepness) + 0.5 * curvature * depth))
    place = rim + path * heading
    normal = curvature * place + mi.Vector3f(0, 0, 1)

    # Snell and Fresnel for unpolarised light, as Born and Wolf have them (1.5.2).
    ratio = index / medium_index
    cos_in = dr.dot(heading, normal)
    cos_squared = 1 - dr.square(ratio) * (1 - dr.square(cos_in))
    cos_out = dr.sqrt(dr.maximum(cos_squared, _GRAZING))
    out = dr.normalize(ratio * heading + (cos_out - ratio * cos_in) * normal)
    passed = 2 * ratio * cos_in * cos_out / dr.square(ratio * cos_in + cos_out)
    passed += 2 * ratio * cos_in * cos_out / dr.square(cos_in + ratio * cos_out)
    return place, out, power * passed & (cos_squared > _GRAZING)


def _filled(limit: Any, waist: Any, index: Any):
    """Radius of a disc that light fills, and its radiance there over the mean.

    Uniform, or after a Gaussian launch of that 1/e^2 waist, as `optics.GlueLens` says.
    """
    if waist is None:
        return limit, lambda squared: 1
    waist = float(waist) / index
    extent = dr.minimum(limit, 2.6 * waist)
    edge = 2 * dr.square(extent / waist)
    return extent, lambda squared: dr.exp(-2 * squared / waist**2) * edge / (1 - dr.exp(-edge))
