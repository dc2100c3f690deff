"""A viewing path as real dielectric surfaces in Mitsuba, seen by its own pinhole from outside.

Call after `scenes.load_mitsuba`. Nothing of `optics.viewing` is used but the numbers of a path's
elements: Mitsuba refracts, reflects and weighs the rays.
"""

from typing import Any

import mitsuba as mi
import numpy as np

from eyespot.optics import viewing

# Facets of 0.04 mm on surfaces of 6 mm and more lie within 0.04**2 / (8 * 6) = 3e-5 mm of them, and
# the normals are interpolated.
_RINGS, _SECTORS = 160, 720
_CORNEA_EDGE_MM, _LENS_EDGE_MM = 6.0, 4.3
_CORNEA_ENDS_MM = 1.0  # depth below which a surface belongs to the lens


def surfaces(path: viewing.ViewingPath) -> dict[str, Any]:
    """The refracting surfaces of a path, for a Mitsuba scene in the eye frame."""
    found: dict[str, Any] = {}
    front = 1.0
    for element in path.elements:
        if isinstance(element, viewing.Refracting):
            behind = float(element.medium.index)
            lens = float(element.surface.depth) > _CORNEA_ENDS_MM
            mesh = conic_mesh(
                element.surface,
                edge=_LENS_EDGE_MM if lens else _CORNEA_EDGE_MM,
                vertex=retinal_pole(path) + float(path.pole_depth - element.surface.depth),
                bsdf={"type": "dielectric", "int_ior": behind, "ext_ior": front},
            )
            found[f"surface_{len(found)}"] = mesh
            front = behind
    return found


def retinal_pole(path: viewing.ViewingPath) -> float:
    """Z of the pole, mm, eye frame."""
    return -float(path.retina_semi_axes[2])


def conic_mesh(
    surface: viewing.Conic, *, edge: float, vertex: float, bsdf: dict[str, Any]
) -> mi.Mesh:
    """A conic up to an edge (radius, mm), its vertex at Z mm; normals point to the microscope."""
    c, stretch = float(surface.curvature), 1.0 + float(surface.asphericity)
    radius, angle = np.meshgrid(
        edge * np.linspace(0.0, 1.0, _RINGS + 1)[1:],
        2 * np.pi * np.arange(_SECTORS) / _SECTORS,
        indexing="ij",
    )
    root = np.sqrt(1.0 - stretch * (c * radius) ** 2)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points = np.concatenate(
        [radius[..., None] * around, (vertex - c * radius**2 / (1.0 + root))[..., None]], axis=-1
    )
    normals = np.concatenate(
        [(c * radius / root)[..., None] * around, np.ones((*radius.shape, 1))], axis=-1
    )
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    here = np.arange(_RINGS * _SECTORS).reshape(_RINGS, _SECTORS)
    beside = np.roll(here, -1, axis=1)
    middle = np.full(_SECTORS, here.size)
    faces = np.concatenate(
        [
            np.stack([here[:-1], here[1:], beside[1:]], axis=-1).reshape(-1, 3),
            np.stack([here[:-1], beside[1:], beside[:-1]], axis=-1).reshape(-1, 3),
            np.stack([middle, here[0], beside[0]], axis=-1),
        ]
    )
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh("conic", here.size + 1, len(faces), has_vertex_normals=True, props=properties)
    parameters = mi.traverse(mesh)
    vertices = np.vstack([points.reshape(-1, 3), [[0.0, 0.0, vertex]]])
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["vertex_normals"] = (
        np.vstack([normals.reshape(-1, 3), [[0.0, 0.0, 1.0]]]).astype(np.float32).ravel()
    )
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def outside_camera(
    path: viewing.ViewingPath, camera: viewing.PathCamera, *, width: int, height: int, spp: int
) -> dict[str, Any]:
    """Mitsuba's pinhole at the microscope's, with the pixels of a path camera."""
    u0, v0 = np.asarray(camera.principal_point).tolist()
    distance = 1.0 / float(path.pinhole_closeness)
    mm_per_px = float(camera.scale) / abs(float(camera.magnification))  # on the cornea's vertex
    above = retinal_pole(path) + float(path.pole_depth) + distance
    return {
        "type": "perspective",
        "fov": 2 * np.degrees(np.arctan(width * mm_per_px / 2 / distance)),
        "fov_axis": "x",
        "principal_point_offset_x": 0.5 - (u0 + 0.5) / width,
        "principal_point_offset_y": 0.5 - (v0 + 0.5) / height,
        "far_clip": 1e4,
        "to_world": mi.ScalarTransform4f().look_at(
            origin=[0.0, 0.0, above], target=[0.0, 0.0, 0.0], up=[0.0, 1.0, 0.0]
        ),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "component_format": "float32",
            "pixel_format": "rgb",
        },
        "sampler": {"type": "independent", "sample_count": spp},
    }
