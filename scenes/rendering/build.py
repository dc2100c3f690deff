"""The Mitsuba dictionary of a scene.

Import after `load_mitsuba`. A stretched eyeball is a mesh, because Mitsuba's sphere cannot be
stretched.
"""

import json
import math
from typing import Any

import cv2
import mitsuba as mi
import numpy as np
from jaxtyping import ArrayLike

import eyespot.scenes.rendering.plugins  # noqa: F401
from eyespot import optics
from eyespot.formats.inputs import InputError
from eyespot.optics.viewing.projection import PathCamera, coaxial_falloff
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.scene_keys import GAUGE_DIAMETER_MM, Phantom
from eyespot.scenes.walls.picture import PICTURE_MM, PICTURE_PX, wall_picture
from eyespot.scenes.world.world import World

_RINGS, _SECTORS = 400, 800
"""Facets of 0.1 mm lie within 0.1^2 / (8 r) = 1e-4 mm of the wall for r = 12 mm, which moves a
spot's contour by less than 1e-3 px."""


def ellipsoid_mesh(wall: optics.Ellipsoid, surface: dict[str, Any]) -> Any:
    """The wall of a material `surface` seen from inside, with the ellipsoid's own normals.

    The picture is laid round the pole: its x and y are the direction from the pole and the
    distance on a sphere of the same pole, as on a spherical eyeball.
    """
    polar = np.pi * np.arange(1, _RINGS) / _RINGS
    azimuth = 2 * np.pi * np.arange(_SECTORS) / _SECTORS
    around = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    rings = np.empty((_RINGS - 1, _SECTORS, 3))
    rings[..., :2] = np.sin(polar)[:, None, None] * around
    rings[..., 2] = -np.cos(polar)[:, None]
    unit = np.vstack([rings.reshape(-1, 3), [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
    semi_axes, turn = np.asarray(wall.semi_axes), np.asarray(wall.turn)
    points = (semi_axes * unit) @ turn.T + np.asarray(wall.centre)
    inward = (-unit / semi_axes) @ turn.T
    radius = float(semi_axes[2])
    distance = radius * np.arctan2(np.hypot(*points.T[:2]), -(points[:, 2]))
    direction = points[:, :2] / np.maximum(np.hypot(*points.T[:2]), 1e-12)[:, None]
    place = 0.5 + distance[:, None] * direction / PICTURE_MM
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(surface)
    faces = _faces()
    mesh = mi.Mesh(
        "wall",
        len(points),
        len(faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = points.astype(np.float32).ravel()
    normals = inward / np.linalg.norm(inward, axis=-1, keepdims=True)
    parameters["vertex_normals"] = normals.astype(np.float32).ravel()
    parameters["vertex_texcoords"] = place.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    mesh.set_id("wall")
    return mesh


def _faces() -> np.ndarray:
    """Triangles of the rings and, at the end, of the two poles; they face inwards."""
    here = np.arange((_RINGS - 1) * _SECTORS).reshape(_RINGS - 1, _SECTORS)
    beside = np.roll(here, -1, axis=1)
    below, above = np.full(_SECTORS, here.size), np.full(_SECTORS, here.size + 1)
    corners = (
        (here[:-1], beside[:-1], beside[1:]),
        (here[:-1], beside[1:], here[1:]),
        (below, beside[0], here[0]),
        (above, here[-1], beside[-1]),
    )
    return np.concatenate([np.stack(c, axis=-1).reshape(-1, 3) for c in corners])


_COATS = {"wet": (optics.MEDIA["water"], 0.05), "glossy": (1.5, 0.2)}
"""Refractive index, and Beckmann's roughness (an assumption)."""


def wall(world: World) -> Any:
    """The wall, as `mi.load_dict` takes it in a scene. Call it after `load_mitsuba`."""
    scene = world.scene
    if scene.phantom.wall == "uniform":
        reflectance = {"type": "rgb", "value": scene.phantom.reflectance}
    else:
        round_wall = scene.phantom.kind == "eyeball" and not scene.phantom.stretched
        texture = (_on_sphere if round_wall else wall_picture)(scene.phantom)
        reflectance = {
            "type": "bitmap",
            # Row 0 of the map is at +Y, but Mitsuba puts row 0 at v = 0.
            "bitmap": mi.Bitmap(np.ascontiguousarray(texture[::-1], dtype=np.float32)),
            "raw": True,
            "wrap_mode": "clamp",
        }
    surface = _surface(scene, reflectance)
    if scene.phantom.kind == "plane":
        pole = world.wall.frame_at(eccentricity=0.0, azimuth=0.0)
        place = rigid_transform(np.asarray(pole.origin), -np.asarray(pole.outward))
        half = np.diag([PICTURE_MM / 2, PICTURE_MM / 2, 1.0, 1.0])
        to_world = mi.ScalarTransform4f(place @ half)
        return {"type": "rectangle", "to_world": to_world, "bsdf": surface}
    if isinstance(world.wall, optics.Ellipsoid):
        return ellipsoid_mesh(world.wall, surface)
    if "bitmap" in reflectance:
        # From (longitude/2pi, colatitude/pi) to the coordinates of the texture.
        extent = PICTURE_MM / scene.phantom.radius_mm
        scale_u, scale_v = 2 * math.pi / extent, math.pi / extent
        reflectance["to_uv"] = mi.ScalarTransform3f(
            [
                [scale_u, 0.0, 0.5 - 0.5 * scale_u],
                [0.0, scale_v, 0.5 - 0.5 * scale_v],
                [0.0, 0.0, 1.0],
            ]
        )
    return {
        "type": "sphere",
        "radius": scene.phantom.radius_mm,
        "flip_normals": True,
        "to_world": mi.ScalarTransform4f(_EQUATOR_AT_POLE),
        "bsdf": surface,
    }


def _surface(scene: Scene, reflectance: dict[str, Any]) -> dict[str, Any]:
    medium = optics.MEDIA[scene.source.medium]
    index, roughness = _COATS.get(scene.phantom.coat, (medium, 0.0))
    if index == medium:  # no coat, or water on a wall under water
        return {"type": "diffuse", "reflectance": reflectance}
    return {
        "type": "roughplastic",
        "diffuse_reflectance": reflectance,
        "int_ior": index,
        "ext_ior": medium,
        "alpha": roughness,
    }


# Textures on Mitsuba's sphere are distorted at its z axis and have a seam at +x. The sphere is
# turned so that its -x axis points to the retinal pole and its -z axis along Y. So the centre of
# the map lies on the retina.
_EQUATOR_AT_POLE = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def _on_sphere(phantom: Phantom) -> np.ndarray:
    """The picture, mapped from azimuthal-equidistant coordinates to longitude and latitude."""
    texture, radius = wall_picture(phantom), phantom.radius_mm
    half = 0.5 * PICTURE_MM / radius
    centres = half * ((np.arange(PICTURE_PX) + 0.5) / PICTURE_PX * 2 - 1)
    longitude, latitude = centres, -centres[:, None]
    x = np.cos(latitude) * np.sin(longitude)
    y = np.sin(latitude)
    aside = np.hypot(x, y)
    arc = np.arctan2(aside, np.cos(latitude) * np.cos(longitude))
    stretch = radius * arc / np.maximum(aside, 1e-12)
    # From mm to pixels of the picture, whose rows point downwards.
    per_mm, middle = PICTURE_PX / PICTURE_MM, (PICTURE_PX - 1) / 2
    columns, rows = middle + per_mm * x * stretch, middle - per_mm * y * stretch
    return np.asarray(
        cv2.remap(
            texture,
            columns.astype(np.float32),
            rows.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
    )


_SHAFT_MM = 40.0
_NEAR_MM = 0.01
_FIBRE_REFLECTANCE, _SHAFT_REFLECTANCE = 0.15, 0.3
# The end face lies this far behind the plane of the tip, so that it does not block its own beam
# (the margin of Mitsuba's float32 intersections is about 1 um at 11 mm).
_FACE_GAP_MM = 0.003
_OUTERMOST = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
"""The middle of the microscope's pupil and four places of its edge."""


def mitsuba_dict(world: World, *, uniform: np.ndarray) -> dict[str, Any]:
    """The scene as `mi.load_dict` reads it.

    Args:
        uniform: indirect irradiance per colour channel, mW/mm2.
    """
    scene = world.scene
    photons = scene.source.kind == "photons"
    on_a_grid = {
        "type": "stratified",
        "sample_count": scene.microscope.samples,
        # Traced light needs random numbers within the strata.
        "jitter": scene.phantom.indirect == "traced",
    }
    at_random = {"type": "independent", "sample_count": scene.source.photons_per_pixel}
    eyeball = scene.phantom.kind == "eyeball"
    spread = np.zeros(3) if world.wall_spread is None else world.wall_spread
    coaxial = scene.microscope.light == "coaxial"
    # Ambient light is equal from all sides, like the light that the eyeball scatters back.
    ambient = 0.0 if coaxial else scene.microscope.illumination_mw_mm2
    # The pinhole that coaxial light comes from; or how it thins out behind a viewing path.
    falloff: dict[str, Any] = {"pinhole_height": scene.microscope.pinhole_height_mm}
    if isinstance(world.microscope, PathCamera):
        coefficients, furthest = coaxial_falloff(world.microscope, world.wall)
        falloff = {"falloff": json.dumps(coefficients.tolist()), "falloff_scale": furthest}
    bounces = 0
    if scene.phantom.indirect == "traced":
        # So many that less than 0.1 % of the indirect light is missing.
        bounces = math.ceil(math.log(1e-3) / math.log(max(world.wall_colour.max(), 1e-3)))
    r, pupil = scene.phantom.radius_mm, scene.phantom.pupil_radius_mm
    return {
        "type": "scene",
        "wall": wall(world),
        **(_instrument(scene) if scene.instrument.visible else {}),
        **(_second_tool(scene) if scene.second_tool.visible else {}),
        "source": _source(world),
        "sensor": _sensor(world, on_a_grid),
        # A second sensor collects photons; here a sample is a photon.
        **({"photon_camera": _sensor(world, at_random)} if photons else {}),
        "integrator": {
            "type": "eyespot_spot",
            # With photons, direct light comes from a separate pass.
            "direct": not photons,
            "bounces": bounces,
            "uniform": mi.ScalarColor3f(uniform + ambient),
            "coaxial": scene.microscope.illumination_mw_mm2 if coaxial else 0.0,
            **falloff,
            "pole_height": -r,
            # Above it the eyeball is open.
            "pupil_height": math.sqrt(r * r - pupil * pupil) if pupil else math.inf,
            "wall_curvature": 1 / r if eyeball else 0.0,
            **{f"spread_{colour}": float(s) for colour, s in zip("rgb", spread, strict=True)},
        },
    }


def rigid_transform(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Rigid transforms, * x 4 x 4, that map the origin to `origin` and +z to `direction`, * x 3."""
    matrix = np.zeros((*direction.shape[:-1], 4, 4))
    columns = *optics.perpendicular_frame(direction), direction, origin
    matrix[..., :3, :] = np.stack(columns, axis=-1)
    matrix[..., 3, 3] = 1.0
    return matrix


def _source(world: World) -> dict[str, Any]:
    scene, table = world.scene, world.table
    common = {
        "tip": mi.ScalarPoint3f(0, 0, 0),
        "axis": mi.ScalarVector3f(0, 0, 1),
        "power": scene.source.power_mw,
    }
    if table is None:
        # Width on the wall of the square of the image that a camera ray stands for, mm.
        middle = np.asarray(world.microscope.principal_point)
        point, direction = world.microscope.ray(middle + np.array([[-0.5, 0.0], [0.5, 0.0]]))
        (left, right) = np.asarray(world.wall.intersect(point, direction).point)
        a_side = math.isqrt(scene.microscope.samples - 1) + 1
        return {
            "type": "eyespot_cone",
            **common,
            "half_angle": world.cone.half_angle,
            "apex_offset": world.cone.apex_offset,
            "sample_width": float(np.linalg.norm(right - left)) / a_side,
        }
    return {
        "type": "eyespot_lens",
        **common,
        "values": mi.TensorXf(np.asarray(table.values, dtype=np.float32)),
        "contact_radius": float(table.contact_radius),
        "slope": float(table.slope),
        "nearest": float(table.nearest),
        "farthest": float(table.farthest),
        "lens": scene.source.lens,
        "medium_index": world.medium_index,
    }


def _instrument(scene: Scene) -> dict[str, Any]:
    """The instrument in the tip's frame (+z is the beam's axis), and one instance that moves.

    Its transform is rigid. A float32 matrix that also scales a cylinder would have more shear than
    Mitsuba accepts (1e-6).
    """
    fibre = scene.instrument.fibre_diameter_mm / 2
    shaft = GAUGE_DIAMETER_MM[scene.instrument.gauge] / 2
    end = -scene.instrument.fibre_length_mm
    return {
        "instrument_shapes": _rods(
            ("fibre", fibre, end, -_FACE_GAP_MM, _FIBRE_REFLECTANCE),
            ("shaft", shaft, end - _SHAFT_MM, end, _SHAFT_REFLECTANCE),
        ),
        "instrument": {"type": "instance", "shapes": {"type": "ref", "id": "instrument_shapes"}},
    }


def _second_tool(scene: Scene) -> dict[str, Any]:
    """A shaft from the tip towards the trocar."""
    tool = scene.second_tool
    polar, azimuth = math.radians(tool.trocar_polar_deg), math.radians(tool.trocar_azimuth_deg)
    across = math.sin(polar)
    trocar = scene.phantom.radius_mm * np.array(
        [across * math.cos(azimuth), across * math.sin(azimuth), math.cos(polar)]
    )
    inwards = np.array(tool.tip_mm) - trocar
    place = rigid_transform(np.array(tool.tip_mm), inwards / np.linalg.norm(inwards))
    radius = GAUGE_DIAMETER_MM[tool.gauge] / 2
    return {
        "tool_shapes": _rods(("tool", radius, -_SHAFT_MM, 0.0, _SHAFT_REFLECTANCE)),
        "tool": {
            "type": "instance",
            "to_world": mi.ScalarTransform4f(place),
            "shapes": {"type": "ref", "id": "tool_shapes"},
        },
    }


def _rods(*rods: tuple[str, float, float, float, float]) -> dict[str, Any]:
    """Matt rods along z, each with name, radius, back and front in mm, and reflectance."""
    shapes: dict[str, Any] = {"type": "shapegroup"}
    for name, radius, back, front, reflectance in rods:
        matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}}
        twosided = {"type": "twosided", "bsdf": matt}
        place = np.diag([radius, radius, 1.0, 1.0])
        place[2, 3] = front
        shapes[f"{name}_side"] = {
            "type": "cylinder",
            "p0": [0.0, 0.0, back],
            "p1": [0.0, 0.0, front],
            "radius": radius,
            "bsdf": twosided,
        }
        shapes[f"{name}_face"] = {
            "type": "disk",
            "to_world": mi.ScalarTransform4f(place),
            "bsdf": twosided,
        }
    return shapes


def _sensor(world: World, sampler: dict[str, Any]) -> dict[str, Any]:
    scene, camera = world.scene, world.microscope
    # Mitsuba's pixel i covers [i, i + 1), so its centre is at i + 0.5.
    u0, v0 = np.asarray(camera.principal_point) + 0.5
    common = {
        "film": {
            "type": "hdrfilm",
            "width": scene.microscope.width_px,
            "height": scene.microscope.height_px,
            "rfilter": {"type": "box"},
            "component_format": "float32",
            "pixel_format": "rgb",
        },
        "sampler": sampler,
        "pole_height": -scene.phantom.radius_mm,
        "principal_point": mi.ScalarPoint2f(u0, v0),
        "entry_height": _inside_the_eye(world),
        "vignetting": scene.microscope.vignetting,
        "aperture_slope": _aperture_slope(scene),
    }
    if isinstance(camera, PathCamera):
        cone = world.pencils
        return {
            "type": "eyespot_path",
            **common,
            "series": _as_text(camera.crossing, camera.steepness, camera.passing),
            "px_per_aim": float(camera.px_per_aim),
            "widest": float(camera.widest),
            "pupil": min(float(camera.pupil), float(camera.widest)),
            **({"pencils": _as_text(*cone.across, *cone.along)} if cone else {}),
        }
    names = ("k1", "k2", "p1", "p2", "k3")
    return {
        "type": "eyespot_microscope",
        **common,
        "scale": scene.microscope.scale_mm_px,
        "inverse_working_distance": float(camera.inverse_working_distance),
        "focus_height": scene.microscope.focus_mm - scene.phantom.radius_mm,
        **dict(zip(names, scene.microscope.distortion, strict=True)),
    }


def _as_text(*series: ArrayLike) -> str:
    """Chebyshev series, without the terms at the end that do not show in 32-bit numbers.

    As text, because Mitsuba tries to read a list or an array as a colour.
    """
    shown = []
    for terms in map(np.asarray, series):
        rest = np.cumsum(np.abs(terms[::-1]))[::-1]
        first = rest > np.finfo(np.float32).eps / 2 * rest[0]
        shown.append(terms[: max(np.count_nonzero(first), 1)].tolist())
    return json.dumps(shown)


def _aperture_slope(scene: Scene) -> float:
    return math.tan(math.asin(scene.microscope.numerical_aperture))


def _inside_the_eye(world: World) -> float:
    """Height at which every line of sight of the window is inside the eyeball.

    Rays start there, so that the upper half of the wall does not block them.
    """
    scene = world.scene
    settings, r = scene.microscope, scene.phantom.radius_mm
    # Lines of sight that meet in a pinhole above the wall start below it.
    above = -r < settings.pinhole_height_mm < math.inf and not scene.viewing.through_an_eye
    highest = settings.pinhole_height_mm if above else 3 * r
    if scene.phantom.kind == "plane":
        return highest
    if scene.phantom.stretched or scene.viewing.through_an_eye:
        return _entry_of_window(world)
    borders = np.concatenate([world.window_border - view for view in _extreme_views(world)])
    point, direction = (np.asarray(a) for a in world.microscope.ray(borders))
    if slope := _aperture_slope(scene):
        # The outermost lines of sight of a thin lens; they cross the central ones at the focus.
        aside = np.pad(slope * _OUTERMOST, [(0, 0), (0, 1)])
        below = (settings.focus_mm - r - point[:, 2:]) / direction[:, 2:]
        point, direction = point + below * direction, direction / -direction[:, 2:]
        direction = (direction + aside[:, None]).reshape(-1, 3)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        point = np.tile(point, (len(aside), 1))
    along = -np.sum(point * direction, axis=-1)
    chord = along**2 + r**2 - np.sum(point * point, axis=-1)
    if chord.min() <= 0:
        raise InputError(
            f"the window of {settings.width_px} x {settings.height_px} px looks past the eyeball "
            f"of radius {r:g} mm. Lower spot.eccentricity_mm or the window's size."
        )
    entry = point[:, 2] + (along - np.sqrt(chord)) * direction[:, 2]
    return min(float(entry.min()) - 1e-3 * r, highest - _NEAR_MM)


def _extreme_views(world: World) -> np.ndarray:
    """Shifts of the image between which all others lie, px."""
    if not world.scene.unrest.shifts:
        return np.zeros((1, 2))
    views = world.unrest.views(world.times)
    (left, top), (right, bottom) = views.min(axis=0), views.max(axis=0)
    return np.array([[left, top], [left, bottom], [right, top], [right, bottom]])


def _entry_of_window(world: World) -> float:
    """The lowest height at which the window's lines of sight enter the eyeball, less a margin.

    Lines outside the field of a viewing path do not count.
    """
    wall, camera, settings = world.wall, world.microscope, world.scene.microscope
    grid = world.window_grid(65).reshape(-1, 2)
    pixels = np.concatenate([grid - view for view in _extreme_views(world)])
    point, direction = camera.ray(pixels)
    inside = wall.intersect(point, direction)
    seen = inside.status != optics.MISS  # the lines begin below the wall
    if isinstance(camera, PathCamera):
        seen &= camera.sees(inside.point)
    if not seen.any():
        raise InputError(
            f"the window of {settings.width_px} x {settings.height_px} px looks past the eyeball. "
            "Lower spot.eccentricity_mm or microscope.window_offset_px."
        )
    if world.pencils is not None:
        aside = _aperture_slope(world.scene) * _OUTERMOST
        point, direction = world.pencils.ray(pixels[seen], aside[:, None])
        inside = wall.intersect(point, direction)
        seen = inside.status != optics.MISS
    entry = wall.intersect(inside.point[seen], -direction[seen]).point[..., 2]
    return float(entry.min()) - 1e-3 * world.scene.phantom.radius_mm
