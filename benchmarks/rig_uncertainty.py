"""What the uncertainties that a rig states do to each model's reading of an exact spot.

A model reads the spot of the true cone with what the rig believes. The bias is what it misses by
then; each uncertainty moves the reading by its derivative.
"""

import math
from collections.abc import Mapping
from itertools import product

import numpy as np
import pandas as pd

from eyespot import optics
from eyespot.benchmarks.model_error import Geometry, degrees, exact_spots, readings
from eyespot.formats.rig import Rig

UNTOLD = "exact, axis unknown"
READERS = (*optics.MODELS, UNTOLD)
"""The models; `exact` knows the beam's axis from the robot, or not."""

NOISE_PX = 0.05
"""Noise of a contour's point across it, px: an ideal cone's in sub-pixel mode, rounded up."""
_POINTS = 128
_SIZE_SIGMA_PX = NOISE_PX * math.sqrt(3 / _POINTS)
"""Of the semi-minor axis (docs/theory/bounds.md)."""
_NODES_DEG = 30.0


def uncertainties(
    rig: Rig, geometry: Geometry, cone: np.ndarray | None
) -> list[tuple[str, dict[str, float]]]:
    """Independent errors of what is believed: the cause, and one standard deviation of each field.

    Args:
        cone: covariance of half-angle (rad) and b (mm) by a calibration; it becomes the axes of its
            ellipse.
    """
    own, robot = rig.microscope, rig.robot
    kappa = 1.0 / (geometry.pinhole_height + geometry.eye_radius)
    found: list[tuple[str, dict[str, float]]] = [
        ("scale", {"scale": own.scale_sigma * geometry.scale}),
        ("eye radius", {"eye_radius": rig.wall.radius_sigma_mm}),
        ("pinhole", {"pinhole": own.pinhole_height_sigma_mm * kappa**2}),
    ]
    if "touch_sigma_mm" in robot.model_fields_set:
        found.append(("touch", {"apex_offset": robot.touch_sigma_mm}))
    if cone is None:
        core = rig.instrument.core_radius_sigma
        found.append(("cone", {"apex_offset": core * abs(geometry.apex_offset)}))
        return found
    values, vectors = np.linalg.eigh(cone)
    for value, vector in zip(values, vectors.T, strict=True):
        half_angle, b = (math.sqrt(max(value, 0.0)) * vector).tolist()
        found.append(("cone", {"half_angle": half_angle, "apex_offset": b}))
    return found


def believed(geometry: Geometry, moved: Mapping[str, float]) -> Geometry:
    """The geometry with some fields moved; `pinhole` is 1/(z_F + r), 1/mm."""
    changes = {
        name: getattr(geometry, name) + by for name, by in moved.items() if name != "pinhole"
    }
    made = geometry._replace(**changes)
    # The working distance is the microscope's, so that a wrong r leaves it as it is.
    kappa = 1.0 / (geometry.pinhole_height + geometry.eye_radius) + moved.get("pinhole", 0.0)
    return made._replace(pinhole_height=(1.0 / kappa if kappa else math.inf) - made.eye_radius)


def turned(geometry: Geometry, *, along: float, across: float) -> Geometry:
    """The geometry with its beam turned by small angles, rad: along its tilt, and across it."""
    tilt, azimuth = geometry.incidence + along, geometry.incidence_azimuth
    x, y = math.sin(tilt) * math.cos(across), math.sin(across)
    return geometry._replace(
        incidence=math.acos(math.cos(tilt) * math.cos(across)),
        incidence_azimuth=azimuth + (math.atan2(y, x) if across else 0.0),
    )


def errors_at(
    geometry: Geometry, rig: Rig, cone: np.ndarray | None, *, c: np.ndarray, d: np.ndarray
) -> pd.DataFrame:
    """Bias and standard deviations by cause, mm, of all `READERS` at one tilt of the beam.

    `cone` is as for `uncertainties`.
    """
    seen = exact_spots(geometry, c=c, d=d).semi_minor

    def read(own: Geometry, e: np.ndarray = seen, at: np.ndarray = c) -> np.ndarray:
        found = readings(own, optics.MODELS, c=at, semi_minor_px=e)
        return np.stack([*found.values(), _untold(own, rig, c=at, e=e)[0]])

    true = read(geometry)
    parts = {"image": np.abs(read(geometry, seen + _SIZE_SIGMA_PX) - true)}
    for cause, moved in uncertainties(rig, geometry, cone):
        if any(moved.values()):
            # A wrong scale also puts the spot at a wrong c.
            at = c * (1.0 + moved.get("scale", 0.0) / geometry.scale)
            size = np.abs(read(believed(geometry, moved), at=at) - true)
            parts[cause] = np.hypot(parts.get(cause, 0.0), size)
    sigma = math.radians(rig.robot.axis_sigma_deg)
    exact = np.asarray([model == "exact" for model in READERS])[:, None]
    leans = (turned(geometry, along=sigma, across=0.0), turned(geometry, along=0.0, across=sigma))
    moves = [readings(own, ("exact",), c=c, semi_minor_px=seen)["exact"] - d for own in leans]
    parts["axis"] = np.where(exact, np.hypot(*moves), 0.0)
    parts["axis"][-1] = _untold(geometry, rig, c=c, e=seen)[1]
    tables = [
        pd.DataFrame(
            {
                "model": model,
                "c_mm": c,
                "d_mm": d,
                "tilt_deg": degrees(geometry.incidence),
                "azimuth_deg": degrees(geometry.incidence_azimuth),
                "bias_mm": true[row] - d,
                **{f"{cause.replace(' ', '_')}_mm": part[row] for cause, part in parts.items()},
            }
        )
        for row, model in enumerate(READERS)
    ]
    return pd.concat(tables, ignore_index=True)


def _untold(
    geometry: Geometry, rig: Rig, *, c: np.ndarray, e: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and spread of the exact distance over all directions that the beam may have, mm."""
    low, high = np.radians(rig.robot.incidence_deg)
    # Two Gauss nodes of a uniform incidence; spots of opposite azimuths are mirrored.
    tilts = (low + high) / 2 + (high - low) / 2 * np.array([-1, 1]) / math.sqrt(3)
    azimuths = np.radians(np.arange(0.5 * _NODES_DEG, 180.0, _NODES_DEG))
    found = np.stack(
        [
            readings(
                geometry._replace(incidence=float(tilt), incidence_azimuth=float(azimuth)),
                ("exact",),
                c=c,
                semi_minor_px=e,
            )["exact"]
            for tilt, azimuth in product(tilts, azimuths)
        ]
    )
    return found.mean(axis=0), found.std(axis=0)
