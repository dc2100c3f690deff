"""The three sensors: which of them see their marks, and the distances that follow from marks.

All of them know the instrument's axis (from the robot), the wall's shape and their cameras, and
give the same quantity: d, the distance from the tip to the wall along the axis.
"""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import ConvexHull
from skimage.measure import points_in_poly

from eyespot import optics, scenes
from eyespot.optics.viewing import (
    ThinLens,
    ViewingPath,
    bare_path,
    load_eye,
    load_viewing_lens,
    path_camera,
    side_camera,
    viewing_path,
)
from eyespot.scenes import Scene
from eyespot.scenes.camera import CameraSensor
from eyespot.scenes.rendering.images import images_of
from eyespot.scenes.rendering.loaded_scene import radiance_along
from eyespot.scenes.world.world import World

# What the sensors look at: the instrument, the light guide, the wall, and the microscopes.

PATHS: dict[str, str | None] = {
    "pinhole": None,
    "flat contact lens": "flat",
    "wide-field 90 D": "wide-field-90",
}
"""Viewing lens of each path; behind a lens lies Navarro's phakic eye."""

EYE, WAVELENGTH_NM = "navarro", 550.0
RADIUS_MM = 12.0  # of Navarro's retina
PINHOLE_HEIGHT_MM = 200.0
SCALE_MM_PX = 0.0134  # the shadow of a tip at 6 mm lies 6 mm beside the spot
WIDTH_PX, HEIGHT_PX = 960, 720
CONVERGENCE_DEG = 5.5
"""Angle between the two lines of sight of a stereo microscope at the pole, without a viewing lens:
the middle of 5 to 6 degrees."""

CONE = {"half_angle": float(np.arctan(1 / 20.0)), "apex_offset": -5.117}
TOOL_GAUGE, TOOL_RADIUS_MM = 25, 0.255
TROCAR_POLAR_DEG = 48.0
TOOL_AZIMUTH_DEG, LAMP_AZIMUTH_DEG, SPOT_AZIMUTH_DEG = 30.0, 150.0, 270.0
"""The trocars lie at two and ten o'clock; the spot moves away from both."""
LAMP_ABOVE_MM = 15.0  # of the light guide's end, from the pole along its trocar
LAMP_RADIUS_MM = 0.25  # of the light guide's end


Numbers = Any
"""NumPy's outside of compiled functions, JAX's inside; several places have a leading axis."""


class InstrumentPlace(NamedTuple):
    """An instrument at the wall, and the light guide that makes its shadow; mm, eye frame.

    c, d = |SO|, the tip S, the instrument's unit vector from its trocar to O, the spot O, the light
    guide's end, and its unit vector.
    """

    eccentricity: Numbers
    distance: Numbers
    tip: Numbers
    axis: Numbers
    spot: Numbers
    lamp: Numbers
    lamp_axis: Numbers


class Views(NamedTuple):
    """The microscopes of one path, each with the pole in the middle of its image.

    The one in the centre, on the eye's axis, sees the spot and the shadow; the others are the pair.
    """

    centre: optics.Camera
    left: optics.Camera
    right: optics.Camera


def place(*, eccentricity: float, distance: float) -> InstrumentPlace:
    """The instrument through its trocar, d from O at c (mm); the light guide through the other."""
    azimuth = math.radians(SPOT_AZIMUTH_DEG)
    wall = optics.Sphere(RADIUS_MM)
    spot = np.asarray(wall.frame_at(eccentricity=eccentricity, azimuth=azimuth).origin)
    axis = _unit(spot - _trocar(TOOL_AZIMUTH_DEG))
    pole = np.array([0.0, 0.0, -RADIUS_MM])
    lamp_axis = _unit(pole - _trocar(LAMP_AZIMUTH_DEG))
    return InstrumentPlace(
        np.asarray(eccentricity),
        np.asarray(distance),
        spot - distance * axis,
        axis,
        spot,
        pole - LAMP_ABOVE_MM * lamp_axis,
        lamp_axis,
    )


def beam_of(one: InstrumentPlace) -> optics.Beam:
    """The cone of light that leaves the instrument's tip."""
    return optics.Beam(tip=jnp.asarray(one.tip), axis=jnp.asarray(one.axis), **CONE)


def views(path: str) -> Views:
    """The microscopes that look through a path."""
    if (name := PATHS[path]) is None:
        bare = bare_path(eye_radius=RADIUS_MM, pinhole_height=PINHOLE_HEIGHT_MM)
        return _views(bare, bare=True, inverted=False)
    eye, lens = load_eye(EYE, wavelength_nm=WAVELENGTH_NM), load_viewing_lens(name)
    cornea = float(eye.axial_length) - RADIUS_MM
    seen = viewing_path(eye, lens, pinhole_distance=PINHOLE_HEIGHT_MM - cornea)
    return _views(seen, bare=False, inverted=isinstance(lens, ThinLens))


@eqx.filter_jit
def _views(seen: ViewingPath, *, bare: bool, inverted: bool) -> Views:
    half = math.tan(math.radians(CONVERGENCE_DEG / 2)) * (PINHOLE_HEIGHT_MM + RADIUS_MM)
    if bare:
        centre: optics.Camera = optics.microscope(
            scale=SCALE_MM_PX, pinhole_height=PINHOLE_HEIGHT_MM, eye_radius=RADIUS_MM
        )
    else:
        centre = path_camera(seen, scale=SCALE_MM_PX, upright=True)
    left, right = (
        side_camera(seen, aside=jnp.array([x, 0.0]), scale=SCALE_MM_PX, upright=True)
        # A stereo inverter turns both images, and exchanges them; else near would look far.
        for x in ((half, -half) if inverted else (-half, half))
    )
    up = jnp.array([0.0, 0.0, 1.0])
    every = centre, left, right
    return Views(*(centred(camera, camera.pole_height * up, (0.0, 0.0)) for camera in every))


project = eqx.filter_jit(lambda camera, points: camera.project(points))


def centred(
    camera: optics.Camera,
    point: Numbers,
    at: tuple[float, float] = ((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2),
) -> optics.Camera:
    """The camera that shows a point at a pixel, by default in the middle of its window."""
    shift = jnp.array(at) - project(camera, point[None])[0]
    return eqx.tree_at(lambda c: c.principal_point, camera, camera.principal_point + shift)


def _trocar(azimuth_deg: float) -> np.ndarray:
    azimuth, polar = math.radians(azimuth_deg), math.radians(TROCAR_POLAR_DEG)
    across = math.sin(polar)
    return RADIUS_MM * np.array(
        [across * math.cos(azimuth), across * math.sin(azimuth), math.cos(polar)]
    )


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


# Marks in a picture: the tip, its shadow, and the height of the wall in a stereo pair.
#
# The labels help: they say where to look (within `REACH_PX`), and how the outline runs there. The
# place is measured from the picture. A network would have to find all of it.

REACH_PX = 12.0  # largest error of a mark: it is searched for within this distance of the label

_COARSE_STEP_PX, _STEP_PX = 2.0, 1.0
"""The coarse one is as wide as an edge. With steps of a pixel the parabola does not see that the
image is interpolated linearly."""
_SMOOTH_PX = 1.5  # the standard deviation at which noise and the steps of a penumbra vanish
_BACK_MM = 1.0  # length of the instrument whose outline is used
_BACK_LEFT_OUT = 0.3  # share of that length: the instrument does not end at its back
_SHAFT_MM = 8.0  # length of the instrument that may hide the wall near O

_PATCH_MM, _PATCH_POINTS = 3.0, 41  # side of the wall's part around O that is matched
_HEIGHTS_MM = np.linspace(-1.5, 1.5, 31)
_COARSE_PX = 8.0  # brightness that changes more slowly is no texture
_MARGIN_PX = 2 * _COARSE_PX  # so far an edge changes the texture beside it
_LEAST_CORRELATION = 0.3
_FEWEST = 100  # points of the wall that both images must show


Outline = tuple[np.ndarray, np.ndarray]
"""Part of an outline, px: points and outward unit normals, n x 2."""


def outline(one: InstrumentPlace, camera: optics.Camera, *, shadow: bool = False) -> Outline:
    """Outline of the instrument's end in the image, or of its shadow."""
    front, back = (_rim(one, behind) for behind in (0.0, _BACK_MM))
    if shadow:
        front, back = (np.asarray(shadow_of(rim, one.lamp)) for rim in (front, back))
    ends = [np.asarray(project(camera, rim)) for rim in (front, back)]
    corners = _hull(np.concatenate(ends))
    edges = np.roll(corners, -1, axis=0) - corners
    counts = np.maximum(1, np.linalg.norm(edges, axis=1).round()).astype(int)
    steps = np.concatenate([(np.arange(count) + 0.5) / count for count in counts])
    points = np.repeat(corners, counts, axis=0) + steps[:, None] * np.repeat(edges, counts, axis=0)
    # Corners run such that the outside is on this side.
    outward = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
    normals = np.repeat(outward / np.linalg.norm(edges, axis=1, keepdims=True), counts, axis=0)
    along = ends[0].mean(axis=0) - ends[1].mean(axis=0)
    kept = (points - ends[1].mean(axis=0)) @ along > _BACK_LEFT_OUT * (along @ along)
    return points[kept], normals[kept]


def found_shift(image: np.ndarray, outline: Outline, *, dark: bool) -> np.ndarray:
    """Shift of a labelled outline at which the grey image, H x W, is steepest across it, px.

    `dark`: the inside is known to be darker than the outside.
    """
    points, normals = outline
    down, right = np.gradient(gaussian_filter(image, _SMOOTH_PX))

    def steepness(shift: np.ndarray) -> float:
        at = (points + shift).T[::-1]
        along_x, along_y = (
            map_coordinates(slope, at, order=1, mode="nearest") for slope in (right, down)
        )
        across = along_x * normals[:, 0] + along_y * normals[:, 1]
        return float(np.mean(across if dark else np.abs(across)))

    # On a coarse grid, then on a fine one, then by parabolas.
    found = np.zeros(2)
    for reach, step in ((REACH_PX, _COARSE_STEP_PX), (_COARSE_STEP_PX, _STEP_PX)):
        steps = np.arange(-reach, reach + step / 2, step)
        scores = np.array([[steepness(found + np.array([x, y])) for x in steps] for y in steps])
        row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
        found = found + np.array([steps[column], steps[row]])
    for axis, (line, place) in enumerate(((scores[row], column), (scores[:, column], row))):
        if 0 < place < len(steps) - 1:
            found[axis] += _STEP_PX * _vertex(*line[place - 1 : place + 2])
    return found


def wall_height(
    left: np.ndarray, right: np.ndarray, one: InstrumentPlace, seen: Views
) -> float | None:
    """Height of the wall near O above the place where it is thought to be, mm; None if no texture.

    Every height is tried: the wall's points are looked up in both grey images, and the height at
    which the two agree best is the answer. The instrument hides a part of the wall.
    """
    textures = [
        gaussian_filter(image, _SMOOTH_PX) - gaussian_filter(image, _COARSE_PX)
        for image in (left, right)
    ]
    first, second = map(np.asarray, optics.perpendicular_frame(one.spot / RADIUS_MM))
    side = np.linspace(-_PATCH_MM / 2, _PATCH_MM / 2, _PATCH_POINTS)
    a, b = (grid.ravel()[:, None] for grid in np.meshgrid(side, side))
    towards = one.spot + a * first + b * second
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    # Corners of the instrument's whole outline, with a margin; the iris's edge has one, too.
    margin = _MARGIN_PX * SCALE_MM_PX
    ends = np.concatenate([_rim(one, behind, margin=margin) for behind in (-margin, _SHAFT_MM)])
    shafts = [_hull(np.asarray(project(camera, ends))) for camera in seen[1:]]
    beside = _MARGIN_PX * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])[:, None]
    correlations = []
    for height in _HEIGHTS_MM:
        pixels = [
            np.asarray(project(camera, (RADIUS_MM - height) * towards)) for camera in seen[1:]
        ]
        bare = [
            ~points_in_poly(places, shaft)
            & np.all(np.asarray(_transmittance(camera, places[None] + beside)) > 0, axis=0)
            for places, shaft, camera in zip(pixels, shafts, seen[1:], strict=True)
        ]
        values = [
            map_coordinates(texture, places.T[::-1], order=1, mode="nearest")[bare[0] & bare[1]]
            for texture, places in zip(textures, pixels, strict=True)
        ]
        correlations.append(float(np.corrcoef(*values)[0, 1]) if values[0].size > _FEWEST else -1.0)
    best = int(np.argmax(correlations))
    if not correlations[best] >= _LEAST_CORRELATION or not 0 < best < len(_HEIGHTS_MM) - 1:
        return None
    step = _HEIGHTS_MM[1] - _HEIGHTS_MM[0]
    return float(_HEIGHTS_MM[best] + step * _vertex(*correlations[best - 1 : best + 2]))


def _rim(one: InstrumentPlace, behind: float, *, margin: float = 0.0) -> np.ndarray:
    """Points of the instrument's circumference at a distance behind its tip, 32 x 3, mm."""
    angle = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)[:, None]
    first, second = map(np.asarray, optics.perpendicular_frame(one.axis))
    circle = np.cos(angle) * first + np.sin(angle) * second
    return one.tip - behind * one.axis + (TOOL_RADIUS_MM + margin) * circle


_transmittance = eqx.filter_jit(lambda camera, pixels: camera.transmittance(pixels))


def _hull(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull, counter-clockwise in x and y."""
    return points[ConvexHull(points).vertices]


def _vertex(before: float, middle: float, after: float) -> float:
    """Place of a parabola's top through three values one step apart, in steps from the middle."""
    bend = before - 2 * middle + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0


# Rendered pictures: the instrument and its shadow under a light guide, by three microscopes.

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
    """The study's scene through a path, with its window centred on O at c (mm)."""
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


def pictures(scene: Scene, one: InstrumentPlace, seen: Views) -> Pictures:
    """Photographs under the light guide, by the microscope and by a stereo pair."""
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
    # Points evenly spread over the light guide's end (Vogel's spiral).
    first, second = map(np.asarray, optics.perpendicular_frame(one.lamp_axis))
    shots = []
    for number in range(_LAMP_POINTS):
        r, a = LAMP_RADIUS_MM * math.sqrt((number + 0.5) / _LAMP_POINTS), _GOLDEN_RAD * number
        lamp = one.lamp + r * (math.cos(a) * first + math.sin(a) * second)
        shots.append(images.at(tip=lamp, axis=one.lamp_axis, seed=0)[0])
    images.at(tip=one.lamp, axis=one.lamp_axis, seed=0)
    pair = [_by_other(world, images.mitsuba_scene, camera) for camera in own[1:]]
    everything = np.ones((HEIGHT_PX, WIDTH_PX), bool)
    taken = []
    for number, light in enumerate([np.mean(shots, axis=0), *pair]):
        # Each microscope has a sensor of its own; one pattern in both would look like texture.
        camera = CameraSensor(lit, seed=lit.seed + number)
        exposure = camera.metered_s(light, everything)
        taken.append(camera.raw(light, exposure_s=exposure, noise_seed=[lit.seed, number]))
    return Pictures(taken[0], taken[1], taken[2], own)


def grey(photograph: np.ndarray) -> np.ndarray:
    """Brightness, H x W."""
    return photograph @ _GREY


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
            lines = _lines_of_sight(world.wall, camera, filled)
            start, direction, passed = (np.asarray(a)[: len(part)] for a in lines)
            light = radiance_along(mitsuba_scene, start=start, direction=direction)
            total[first : first + len(part)] += light * passed[:, None]
    return (total / len(_SAMPLES)).reshape(HEIGHT_PX, WIDTH_PX, 3)


@eqx.filter_jit
def _lines_of_sight(wall: optics.Surface, camera: Any, pixels: Any) -> tuple[Any, Any, Any]:
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


WALL = optics.Sphere(RADIUS_MM)
_EDGE = 32  # points of a spot's edge that must be in view
_SHAFT = 200  # points of the shaft's axis

CONTOUR_PX, MARK_PX, WALL_PX = 0.05, 1.0, 0.1
"""Stated noise: of each of 128 points of the spot's edge (as in the study of poses), of a tip or
a shadow's tip in x and y (an assumption), and of the wall's texture matched in a pair (an
assumption)."""


class Sensor(StrEnum):
    """What the distance is read from."""

    SPOT = "spot"
    SHADOW = "shadow"
    STEREO = "stereo"


class Wrong(StrEnum):
    """One thing that a sensor takes as known and that is wrong."""

    PATH = "the path is taken for a pinhole"
    LAMP = "the light guide is 1 mm elsewhere"
    AXIS = "the axis is 1° off"
    RADIUS = "the eye's radius is 0.5 mm larger"


class ReadingOutcome(StrEnum):
    """What became of a reading."""

    READ = "read"
    OUT_OF_VIEW = "out of view"  # a mark lies outside the window, or the iris hides it
    HIDDEN = "hidden"  # the instrument hides its tip's shadow, or too much of the spot
    NO_SPOT = "no spot"  # the estimator found none; spots.csv has the reason
    NO_TEXTURE = "no texture"  # the two images of the wall cannot be matched


class Known(NamedTuple):
    """What the sensors take as known; a wrong assumption is a wrong value here.

    The cameras; the radius of the wall's sphere, whose pole is at the cameras' pole height, mm; the
    light guide's end, mm; and the instrument's unit vector.
    """

    views: Views
    radius: Numbers
    lamp: Numbers
    axis: Numbers


class Marks(NamedTuple):
    """What is measured in the images, px.

    In the central image the spot's edge, n x 2, the tip and its shadow; in the pair the tip, and a
    point of the wall near O, 2 x 2.
    """

    contour: Numbers
    tip: Numbers
    shadow: Numbers
    tip_pair: Numbers
    wall_pair: Numbers


def marks_of(place: InstrumentPlace, views: Views, *, points: int) -> Marks:
    """The true marks."""
    contour = optics.cone_contour(beam_of(place), WALL, points=points).point
    shadow = shadow_of(place.tip, place.lamp)
    # Each camera projects all of its points at once: the compilation of a path takes seconds.
    central = views.centre.project(jnp.concatenate([contour, jnp.stack([place.tip, shadow])]))
    both = jnp.stack([place.tip, place.spot])
    pair = jnp.stack([camera.project(both) for camera in (views.left, views.right)])
    return Marks(central[:-2], central[-2], central[-1], pair[:, 0], pair[:, 1])


def shadow_of(point: Numbers, lamp: Numbers) -> Numbers:
    """Where the shadow of points falls on the wall, from a lamp without extent, mm."""
    towards = point - lamp
    towards = towards / jnp.linalg.norm(towards, axis=-1, keepdims=True)
    return WALL.intersect(point, towards).point


@eqx.filter_jit
def by_spot(ellipse: optics.Ellipse, known: Known) -> Numbers:
    """d by the exact spot with the ellipse's area, mm (`optics.distance_by_area`)."""
    return optics.distance_by_area(
        ellipse, optics.Sphere(known.radius), known.views.centre, axis=known.axis, **CONE
    )


@eqx.filter_jit
def by_shadow(tip: Numbers, shadow: Numbers, known: Known) -> Numbers:
    """d by the tip and its shadow in one image (px), mm.

    The shadow's line of sight meets the wall at a point; the line from there to the lamp and the
    tip's line of sight meet at the tip.
    """
    wall = optics.Sphere(known.radius)
    points, directions = known.views.centre.ray(jnp.stack([tip, shadow]))
    foot = wall.intersect(points[1], directions[1]).point
    by_both = nearest_point((points[0], directions[0]), (foot, known.lamp - foot))
    return distance_along(wall, by_both, known)


def by_stereo(tip_pair: Numbers, wall_pair: Numbers, known: Known) -> Numbers:
    """d by the tip and a point of the wall in a stereo pair (px), mm.

    The wall's point says how high the wall lies; the wall's curvature is known.
    """
    tip, wall = in_space(jnp.stack([tip_pair, wall_pair], axis=1), known.views)
    return distance_along(optics.Sphere(jnp.linalg.norm(wall)), tip, known)


@eqx.filter_jit
def in_space(pairs: Numbers, views: Views) -> Numbers:
    """The points that the left and the right image show at pixels, mm."""
    return nearest_point(views.left.ray(pairs[0]), views.right.ray(pairs[1]))


@eqx.filter_jit
def distance_along(wall: optics.Surface, tip: Numbers, known: Known) -> Numbers:
    """d from a tip to a wall along the instrument's axis, mm; negative behind the wall."""
    return wall.intersect(tip, known.axis).distance


def nearest_point(first: tuple[Numbers, Numbers], second: tuple[Numbers, Numbers]) -> Numbers:
    """The point halfway between two lines where they are nearest, mm.

    A line is a point and a direction of any length, each ... x 3.
    """
    (p, u), (q, v) = first, second
    u, v = (w / jnp.linalg.norm(w, axis=-1, keepdims=True) for w in (u, v))
    across, cosine = q - p, optics.dot(u, v)
    on_u, on_v = optics.dot(across, u), optics.dot(across, v)
    along_u = (on_u - cosine * on_v) / (1.0 - cosine**2)
    along_v = (cosine * on_u - on_v) / (1.0 - cosine**2)
    return (p + along_u[..., None] * u + q + along_v[..., None] * v) / 2.0


# Which sensors see their marks: the window, the iris, and the instrument in front.


_SEEN = ReadingOutcome.READ, ReadingOutcome.HIDDEN, ReadingOutcome.OUT_OF_VIEW


def outcomes_at(places: InstrumentPlace, seen: Views) -> dict[Sensor, list[ReadingOutcome]]:
    """Whether each sensor can see its marks, for places with a leading axis."""
    return {
        sensor: [_SEEN[n] for n in of.tolist()] for sensor, of in _outcomes(places, seen).items()
    }


@eqx.filter_jit
def _outcomes(places: InstrumentPlace, seen: Views) -> dict[Sensor, Any]:
    """Indices of `_SEEN`."""

    def at(one: InstrumentPlace) -> dict[Sensor, Any]:
        shadow = shadow_of(one.tip, one.lamp)
        edge = optics.cone_contour(beam_of(one), WALL, points=_EDGE).point
        marks = jnp.stack([one.spot, one.tip, shadow])
        by_centre = _in_view(seen.centre, jnp.concatenate([marks, edge]))
        in_pair = jnp.stack([_in_view(camera, marks[:2]) for camera in seen[1:]])
        hidden = _hides(one, seen.centre, shadow).astype(int)
        return {
            Sensor.SPOT: jnp.where(jnp.all(by_centre[3:]), 0, 2),
            Sensor.SHADOW: jnp.where(by_centre[1] & by_centre[2], hidden, 2),
            Sensor.STEREO: jnp.where(jnp.all(in_pair), 0, 2),
        }

    return jax.vmap(at)(places)


def _in_view(camera: Any, points: Any) -> Any:
    """Whether points are in the window, centred on the first one, and not behind the iris, n."""
    pixels = camera.project(points)
    inside = jnp.abs(pixels - pixels[0]) < jnp.array([WIDTH_PX, HEIGHT_PX]) / 2
    # The transmittance behind the iris is 0.
    passes = True if isinstance(camera, optics.Microscope) else camera.transmittance(pixels) > 0
    return jnp.all(inside, axis=-1) & passes


def _hides(one: InstrumentPlace, camera: optics.Camera, point: Any) -> Any:
    """Whether the instrument lies between the camera and a point of the wall."""
    _, down = camera.ray(camera.project(point))
    back = jnp.linspace(0.0, RADIUS_MM, _SHAFT)[:, None]
    shaft = one.tip - back * one.axis - point
    aside = shaft - (shaft @ down)[:, None] * down
    return jnp.any(jnp.linalg.norm(aside, axis=-1) < TOOL_RADIUS_MM)
