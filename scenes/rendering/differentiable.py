"""Images by photons, with derivatives by the lens and its pose. Import after `load_mitsuba`.

The derivatives are correct because the position of each photon on the film and its power are smooth
functions of all parameters; no parameter is compared with a random number. `leave_cap` ensures
this for the lens. On the film, a quadratic spline spreads each photon over nine pixels. An
instrument in the beam would hide photons by a comparison, so scenes with one are refused.

`scenes.rendering.photons` traces the same lens as Mitsuba's glass, where random numbers decide
which photons the rim absorbs and the cap reflects. Here every photon is drawn so that it passes the
aperture and leaves the cap. Fresnel's equations give its power, which falls to zero where total
reflection begins. If photons were drawn on both sides of that edge, some would cross it when the
lens changes; the derivative of their power is unbounded there, and its variance does not converge.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.stats import qmc

from eyespot import optics
from eyespot.formats.inputs import InputError
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.scene_keys import SceneError
from eyespot.scenes.rendering import build
from eyespot.scenes.world.world import World

# Mitsuba's stubs lack the types of the variants.
# mypy: no-check-untyped-defs


_GRAZING_COSINE2 = 1e-8
"""Squared cosine at which a ray leaves along the cap; its power is zero there."""


def check_lens(values: dict[str, float]) -> None:
    """Refuse invalid values. Plain numbers, because this may run inside a JAX computation."""
    for name, low, high in (
        ("sag", 0.0, min(values["aperture_radius"], values["glue_length"])),
        ("numerical_aperture", 1e-6, values["glue_index"]),
        ("core_radius", 1e-6, math.inf),
        ("glue_index", 1.0, 4.0),
        ("power", 0.0, math.inf),
    ):
        if not low <= values[name] <= high:
            raise InputError(
                f"PhotonImage: {name} must lie in [{low:g}, {high:g}]; got {values[name]:g}. "
                "Start the fit nearer, or fit a transformed parameter that stays in this range."
            )


def leave_cap(values: dict[str, Any], *, launch: optics.GlueLens, medium_index: float, numbers):
    """Position, direction and power of each photon behind the cap, in the frame of the lens.

    Args:
        values: parameters by name.
        launch: lens with the Gaussian launch of the core, if any.
        medium_index: refractive index of the medium in front.
        numbers: uniform random numbers, two for the direction and two for the position.
    """
    index, sag, aperture = values["glue_index"], values["sag"], values["aperture_radius"]
    face, face_light = _filled(values["core_radius"], launch.launch_radius, 1)
    sine, sine_light = _filled(values["numerical_aperture"] / index, launch.launch_aperture, index)
    lateral = sine * mi.warp.square_to_uniform_disk_concentric(numbers[0])
    forward = dr.sqrt(1 - dr.squared_norm(lateral))
    # Light of this direction passes the plane of the rim inside three shapes: the shifted disc of
    # the core, the disc of the aperture, and the ellipse from which it can leave the cap (the sine
    # of incidence on a sphere is the ray's distance from its centre over its radius). The position
    # is drawn inside all three, first along the line of their centres, then across it.
    across = dr.norm(lateral)
    moved = (values["glue_length"] - sag) * across / forward
    # The cap is k|P|^2/2 + P_z = 0 with the curvature k; this includes a flat end (k = 0).
    curvature = 2 * sag / (aperture**2 + sag**2)
    bend = dr.maximum(curvature, 1e-6)
    critical = medium_index / index
    aslant = (1 - curvature * sag) * across
    first = (aslant - critical) / (bend * forward)
    last = (aslant + critical) / (bend * forward)
    first = dr.maximum(first, dr.maximum(moved - face, -aperture))
    last = dr.minimum(last, dr.minimum(moved + face, aperture))
    width = dr.maximum(last - first, 0)
    along = first + width * numbers[1].x
    half = dr.minimum(face**2 - dr.square(along - moved), aperture**2 - dr.square(along))
    ahead = bend * forward * along - aslant
    half = dr.minimum(half, (critical - ahead) * (critical + ahead) / dr.square(bend))
    half = dr.sqrt(dr.maximum(half, 1e-12))
    aside = half * (2 * numbers[1].y - 1)
    unit = lateral / dr.maximum(across, 1e-12)
    power = values["power"] * width * 2 * half / (dr.pi * face**2)
    power *= face_light(dr.square(along - moved) + dr.square(aside))
    power *= sine_light(dr.square(across))

    heading = mi.Vector3f(lateral.x, lateral.y, forward)
    rim = mi.Vector3f(
        along * unit.x - aside * unit.y, along * unit.y + aside * unit.x, -sag + 0 * along
    )
    depth = 0.5 * curvature * (aperture**2 - dr.square(along) - dr.square(aside))
    steepness = 0.5 * (curvature * dr.dot(rim, heading) + forward)
    path = depth / (steepness + dr.sqrt(dr.square(steepness) + 0.5 * curvature * depth))
    place = rim + path * heading
    normal = curvature * place + mi.Vector3f(0, 0, 1)

    # Snell and Fresnel for unpolarised light (Born and Wolf, 1.5.2).
    ratio = index / medium_index
    cos_in = dr.dot(heading, normal)
    cos_squared = 1 - dr.square(ratio) * (1 - dr.square(cos_in))
    cos_out = dr.sqrt(dr.maximum(cos_squared, _GRAZING_COSINE2))
    out = dr.normalize(ratio * heading + (cos_out - ratio * cos_in) * normal)
    passed = 2 * ratio * cos_in * cos_out / dr.square(ratio * cos_in + cos_out)
    passed += 2 * ratio * cos_in * cos_out / dr.square(cos_in + ratio * cos_out)
    return place, out, power * passed & (cos_squared > _GRAZING_COSINE2)


def _filled(limit: Any, waist: Any, index: Any):
    """Radius of a disc of light, and a function that gives its radiance relative to the mean.

    The light is uniform, or Gaussian with that 1/e^2 waist (see `optics.GlueLens`).
    """
    if waist is None:
        return limit, lambda squared: 1
    waist = float(waist) / index
    extent = dr.minimum(limit, 2.6 * waist)
    edge = 2 * dr.square(extent / waist)
    return extent, lambda squared: dr.exp(-2 * squared / waist**2) * edge / (1 - dr.exp(-edge))


LENS = ("core_radius", "glue_length", "aperture_radius", "sag", "glue_index", "numerical_aperture")
"""Parameters of the lens that can be free, named as in `optics.GlueLens`."""

POSE = ("tip_x", "tip_y", "tip_z", "axis_x", "axis_y", "axis_z")
"""Parameters of the pose that can be free, eye frame; the tip in mm, the axis of any length."""

_BORDER_PX = 1  # pixels at the film's edge lack the light of photons just outside
_PHOTONS_PER_PASS = 1 << 18  # photons per pass; the graph needs about 1 kB per photon


class PhotonImage:
    """Direct light of the lens on the wall, seen by the microscope, with derivatives.

    The image equals that of `photon_image` except that a pixel is a quadratic
    spline three pixels wide instead of a box, and that light reflected by the cap is lost (under
    0.5 % of it would come out later). A seed fixes the random numbers of all photons, so the image
    is a smooth function of the parameters. The photons are a scrambled Sobol sequence, which has
    less noise than independent ones.

    Its methods take the p values of the free parameters in the order of `free`. They raise an
    InputError, which names the value, if no lens has these.

    Args:
        scene: a scene with a lens as source, and without instruments in view.
        free: names of the free parameters, from `LENS`, `POSE` and "power"; the others keep the
            scene's values.
        photons: number of photons that leave the core.
        frame: frame of the scene's motion that gives the pose.
        seed: random seed; different seeds give independent noise.

    Attributes:
        free: names of the free parameters.
        start: the scene's values of these parameters.
        shape: H, W, 3 of the image.

    Raises:
        SceneError: an instrument or tool is visible, or the source has no lens.
        InputError: a name in `free` is unknown.
    """

    def __init__(
        self, scene: Scene, *, free: Sequence[str], photons: int, frame: int = 0, seed: int = 0
    ) -> None:
        _refuse_occluders(scene)
        known = (*LENS, *POSE, "power")
        if unknown := [name for name in free if name not in known]:
            raise InputError(
                f"PhotonImage(free=...) does not know {', '.join(unknown)}. "
                f"Choose from {', '.join(known)}."
            )
        self._launch, world = optics.load_lens(scene.source.lens), World(scene)
        pose = world.motion.at(world.times[frame : frame + 1])
        self._values = {name: float(getattr(self._launch, name)) for name in LENS}
        self._values |= zip(POSE, map(float, (*pose.tip[0], *pose.axis[0])), strict=True)
        self._values["power"] = scene.source.power_mw
        self._medium_index = optics.MEDIA[scene.source.medium]
        points = qmc.Sobol(4, rng=seed).random_base2(math.ceil(math.log2(photons)))[:photons]
        # Still below 1 after rounding to float32.
        self._numbers = np.minimum(points, 1 - 2**-24).astype(np.float32)
        self.free = tuple(free)
        self.start = np.array([self._values[name] for name in self.free])
        self.shape = (scene.microscope.height_px, scene.microscope.width_px, 3)
        self._wall, self._sensor = _wall_and_sensor(scene)

    def value(self, parameters: np.ndarray) -> np.ndarray:
        """Radiance, H x W x 3, mW/(mm2 sr)."""
        image = np.zeros(self.shape)
        for _, pixels, light in self._passes(parameters):
            image += self._splatted(pixels, light)
        return image

    def value_and_jacobian(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Radiance, and its derivatives in forward mode, H x W x 3 x p."""
        image, jacobian = np.zeros(self.shape), np.zeros((*self.shape, len(self.free)))
        for leaves, pixels, light in self._passes(parameters, derivatives=True):
            columns = []
            for leaf in leaves:
                dr.forward_from(leaf, flags=dr.ADFlag.ClearVertices)
                columns.append(dr.grad(light))
                dr.clear_grad(light)
            values = dr.detach(light)
            # One kernel for all of them, because they share the photons' paths.
            dr.eval(pixels, values, columns)
            image += self._splatted(pixels, values)
            for number, column in enumerate(columns):
                jacobian[..., number] += self._splatted(pixels, column)
        return image, jacobian

    def vjp(self, parameters: np.ndarray, cotangent: np.ndarray) -> np.ndarray:
        """The p derivatives of sum(cotangent * image), with a cotangent of H x W x 3.

        In reverse mode; its time does not depend on p.
        """
        border = [(_BORDER_PX, _BORDER_PX)] * 2 + [(0, 0)]
        weight = mi.Float(np.pad(cotangent, border).ravel().astype(np.float32))
        total = np.zeros(len(self.free))
        for leaves, pixels, light in self._passes(parameters, derivatives=True):
            product = mi.Float(0)
            for pixel, part in zip(pixels, light, strict=True):
                product += dr.dot(part, dr.gather(mi.Color3f, weight, pixel))
            dr.backward(product)
            total += [dr.sum(dr.grad(leaf))[0] for leaf in leaves]
        return total

    def _passes(self, parameters: np.ndarray, *, derivatives: bool = False):
        """The free parameters, pixels of the film and photons' light there, pass after pass."""
        values = self._values | dict(zip(self.free, parameters.tolist(), strict=True))
        check_lens(values)
        for numbers in np.array_split(
            self._numbers, math.ceil(len(self._numbers) / _PHOTONS_PER_PASS)
        ):
            size = len(numbers)
            # Values in memory (opaque) do not need a new kernel each time. With one copy per
            # photon, reverse mode does not sum over photons at every use of a parameter.
            copies = {name: dr.opaque(mi.Float, value, size) for name, value in values.items()}
            leaves = [copies[name] for name in self.free]
            if derivatives:
                dr.enable_grad(leaves)
            yield leaves, *self._on_film(copies, numbers)

    def _on_film(self, values: dict[str, Any], numbers: np.ndarray) -> tuple[list[Any], list[Any]]:
        """Photons spread over nine pixels each: indices of the pixels, and their light."""
        place, heading, power = leave_cap(
            values,
            launch=self._launch,
            medium_index=self._medium_index,
            numbers=(mi.Point2f(numbers.T[:2]), mi.Point2f(numbers.T[2:])),
        )
        frame = mi.Frame3f(dr.normalize(_vector(values, "axis")))
        tip = _vector(values, "tip")
        si = self._wall.ray_intersect(
            mi.Ray3f(mi.Point3f(tip + frame.to_world(place)), frame.to_world(heading)), power > 0
        )
        to_film, importance = self._sensor.sample_direction(si, mi.Point2f(0.5), si.is_valid())
        context = mi.BSDFContext(mi.TransportMode.Importance)
        reflected = si.bsdf().eval(context, si, si.to_local(to_film.d), si.is_valid())
        film = mi.ScalarVector2u(self._sensor.film().size())
        light = reflected * importance * power * (math.prod(film) / len(self._numbers))
        light = dr.select(to_film.pdf > 0, light, 0)
        nearest = dr.floor(to_film.uv)
        columns, rows = (_spline(to_film.uv[i] - nearest[i] - 0.5) for i in (0, 1))
        pixels, parts = [], []
        for (right, across), (down, along) in itertools.product(columns, rows):
            column, row = mi.Int(nearest.x) + right, mi.Int(nearest.y) + down
            inside = (column >= 0) & (column < film.x) & (row >= 0) & (row < film.y)
            pixels.append(mi.UInt32(dr.select(inside, row * film.x + column, 0)))
            parts.append(dr.select(inside, across * along * light, 0))
        return pixels, parts

    def _splatted(self, pixels: list[Any], light: list[Any]) -> np.ndarray:
        """The image of the photons, without the film's border."""
        height, width, channels = self.shape
        height, width = height + 2 * _BORDER_PX, width + 2 * _BORDER_PX
        film = dr.zeros(mi.Float, height * width * channels)
        for pixel, part in zip(pixels, light, strict=True):
            dr.scatter_add(film, part, pixel)
        inner = slice(_BORDER_PX, -_BORDER_PX)
        return np.array(film, dtype=float).reshape(height, width, channels)[inner, inner]


def _spline(offset):
    """Weights of the previous, the own and the next pixel, for an offset from the pixel centre, px.

    This is the quadratic B-spline; the weights are smooth and sum to 1.
    """
    return (
        (-1, 0.5 * dr.square(0.5 - offset)),
        (0, 0.75 - dr.square(offset)),
        (1, 0.5 * dr.square(0.5 + offset)),
    )


def _refuse_occluders(scene: Scene) -> None:
    for key in ("instrument", "second_tool"):
        if getattr(scene, key).visible:
            raise SceneError(
                f"PhotonImage: {key}.visible = true would hide photons, and derivatives would not "
                f"include the moving edge of its shadow (errors up to 20 %). Set {key}.visible to "
                "false."
            )
    if scene.source.kind == "cone":
        raise SceneError(
            "PhotonImage: source.kind 'cone' has no lens for photons. Set it to 'photons' or "
            "'lens'."
        )


def _wall_and_sensor(scene: Scene) -> tuple[Any, Any]:
    """A Mitsuba scene with the wall alone, and the microscope with a border around its window."""
    film = {
        "width_px": scene.microscope.width_px + 2 * _BORDER_PX,
        "height_px": scene.microscope.height_px + 2 * _BORDER_PX,
    }
    bare = scene.model_copy(
        update={
            # The lens is not needed, and its table takes seconds to compute.
            "source": scene.source.model_copy(update={"kind": "cone"}),
            "microscope": scene.microscope.model_copy(update=film),
        }
    )
    content = build.mitsuba_dict(World(bare), uniform=np.zeros(3))
    return mi.load_dict({"type": "scene", "wall": content["wall"]}), mi.load_dict(content["sensor"])


def _vector(values: dict[str, Any], name: str):
    return mi.Vector3f(*(values[f"{name}_{axis}"] for axis in "xyz"))
