"""Spots, calibrations and microscopes made up for tests: what a test does not name is plain."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from eyespot.estimator.camera_noise import CameraNoise
from eyespot.formats.calibration import Calibration
from eyespot.formats.camera_sheet import CameraSheet, Response
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.spot import Spot

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from eyespot.calibration.pixels.data import Footage
    from eyespot.optics import GlueLens
    from eyespot.optics.wall_light.lens_flux import Grid, LensTable

CONE = {"k": 20.0, "b": -5.117}
"""The cone that default scenes have."""
DOME = {"core_radius": 0.25, "glue_length": 0.12, "aperture_radius": 0.25, "sag": 0.12}
DOME |= {"glue_index": 1.49, "numerical_aperture": 0.2}
"""The lens of the preset dome."""


def a_spot(*ellipse: float, covariance: np.ndarray | None = None, **changed: float) -> Spot:
    """A clean one; an ellipse without an angle has 0."""
    names = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad")
    given: dict[str, Any] = dict(zip(names, map(float, (*ellipse, 0.0)), strict=False))
    given |= {"edge_width_px": 0.5, "coverage": 1.0, "inlier_fraction": 1.0, "saturated": 0.0}
    given |= {"covariance": np.eye(5) if covariance is None else covariance}
    return Spot(**given | changed)


def a_calibration(
    values: Mapping[str, float] = CONE, *, covariance: np.ndarray | None = None, **changed: Any
) -> Calibration:
    """Of a planar cone in air, without errors."""
    plain: dict[str, Any] = {"model": "planar", "medium": "air", "medium_index": 1.0}
    exact = np.zeros((len(values), len(values)))
    return Calibration.of(
        values=values,
        covariance=exact if covariance is None else covariance,
        fitted_on="made up for a test",
        data_sha256="0" * 64,
        software="test",
        **plain | changed,
    )


def a_microscope(**changed: Any) -> MicroscopeFile:
    """A pinhole on the sphere, centred."""
    given: dict[str, Any] = {
        "width_px": 640,
        "height_px": 480,
        "camera_matrix": None,
        "distortion": (0.0,) * 5,
        "scale_mm_px": 0.0067,
        "principal_point_px": (320.0, 240.0),
        "pinhole_height_mm": 11.5,
        "eye_radius_mm": 11.5,
        "curve": "linear",
    }
    return MicroscopeFile(**given | changed)


def microscope_content(
    size_px: tuple[int, int] = (640, 480),
    *,
    scale_mm_px: float = 0.0067,
    pinhole_height_mm: float | None = None,
    **keys: Any,
) -> dict[str, Any]:
    """Content of a microscope file, telecentric without a pinhole; by default of a centred one."""
    centre = [(side - 1) / 2 for side in size_px]
    content: dict[str, Any] = {
        "width_px": size_px[0],
        "height_px": size_px[1],
        "camera_matrix": None,
        "distortion": [0.0] * 5,
        "scale_mm_px": scale_mm_px,
        "principal_point_px": centre,
        "pinhole_height_mm": pinhole_height_mm,
        "eye_radius_mm": 11.5,
        "response": "linear",
    } | keys
    if pinhole_height_mm is not None:
        focal = (pinhole_height_mm + content["eye_radius_mm"]) / scale_mm_px
        u, v = content["principal_point_px"]
        content["camera_matrix"] = [[focal, 0.0, u], [0.0, focal, v], [0.0, 0.0, 1.0]]
    return content


def a_microscope_file(folder: Path, *size_px: tuple[int, int], **keys: Any) -> Path:
    """microscope.json with `microscope_content`."""
    path = folder / "microscope.json"
    path.write_text(json.dumps({"schema": 1} | microscope_content(*size_px, **keys)))
    return path


def a_lens(**changed: float) -> GlueLens:
    from eyespot import optics  # late, as it loads JAX

    return optics.glue_lens(**DOME | changed)


def a_lens_table(values: ArrayLike, grid: Grid) -> LensTable:
    """Of a lens without parameters: rows of its light."""
    import jax.numpy as jnp  # late, as it loads JAX

    from eyespot.optics.wall_light.lens_flux import LensTable

    return LensTable(jnp.asarray(values)[None], jnp.ones(1), jnp.zeros(0), grid)


def an_opencv_file(path: Path, **content: Any) -> Path:
    """What OpenCV writes of a camera: YAML, XML or JSON by the path's ending."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in content.items():
        storage.write(name, value)
    storage.release()
    return path


def a_footage(**changed: Any) -> Footage:
    """A disc on a plane in three frames of 48 x 48 pixels, none of which is usable."""
    from eyespot.calibration.pixels.data import BareFibre, Footage  # late, as it loads JAX

    sheet = CameraSheet(full_well_e=5000.0, read_noise_e=10.0, black_level_dn=0.0, bit_depth=8)
    v, u = np.mgrid[:48, :48] - 23.5
    given: dict[str, Any] = {
        "light": np.stack([np.where(np.hypot(u, v) < 8, 0.5, 0.01).astype(np.float32)] * 3),
        "clear": np.zeros((3, 48, 48), bool),
        "exposure_s": np.full(3, 0.01),
        "readings": np.array([1.0, 2.0, 3.0]),
        "motion": np.array([0.0, 0.0, -1.0]),
        "axis": np.array([0.0, 0.0, -1.0]),
        "noise": CameraNoise(sheet, Response()),
        "microscope": a_microscope(
            width_px=48,
            height_px=48,
            scale_mm_px=0.04,
            principal_point_px=(23.5, 23.5),
            pinhole_height_mm=200.0,
        ),
        "instrument": BareFibre(0.25, 6.0),
        "in_view": False,
        "kind": "plane",
        "medium_index": 1.0,
    }
    return Footage(**given | changed)
