"""The working volume, a pose in it, and how far an estimate is from it."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

import optics
from calibration.spots import Tool, ToolPose

HALF_WIDTH_MM = 5.0
"""Half the side of the square around the microscope's axis in which O lies: 10 mm x 10 mm."""
NEAREST_MM, FARTHEST_MM = 0.5, 5.5
"""Distances from tip to wall along the beam: 5 mm of depth."""
INCIDENCE_DEG = (10.0, 30.0)
NOISE_PX = 0.05
"""Standard deviation across the contour of each of 128 points."""
LARGEST_C_MM = 5.0
"""Largest eccentricity of the rendered spots."""
PRIOR_DEG = 5.0
"""Standard deviation of the direction prior across the axis, as for a rough robot calibration."""

REPORTED = {1: (0.029, 0.124), 3: (0.025, 0.101)}
"""Mean errors of tip (mm) and axis (degrees) by number of spots: Zhou et al., "Theoretical error
analysis of spotlight-based instrument localization for retinal surgery", Robotica 2023; rendered
in Blender, with another light and eye."""


class Prior(StrEnum):
    """Prior knowledge of the axis."""

    ROUGH = "5 deg"
    NONE = "none"
    KNOWN = "axis known"

    @property
    def sigma_rad(self) -> float:
        """The solver's standard deviation of the prior across the axis, rad."""
        return {Prior.ROUGH: math.radians(PRIOR_DEG), Prior.NONE: 1e6, Prior.KNOWN: 1e-6}[self]


_MIRRORED_DEG = 2.0
"""An axis farther off than this, and nearer to the mirror image than to the truth, is mirrored."""

_FIBRE_MM, _SPLAY_DEG = 0.5, 10.0


def one_spot(half_angle: float, apex_offset: float) -> Tool:
    """A cone (rad, mm) along the tool's axis."""
    return Tool(half_angle, apex_offset, 1, 0.0, 0.0)


def three_spots(half_angle: float, apex_offset: float) -> Tool:
    """Three fibres that touch each other, splayed, with equal cones (rad, mm).

    The tool of Zhou et al. (2023) has three spotlights; more of it is not published. Here they are
    lit one after the other, so that spots neither overlap nor are confused.
    """
    circle = _FIBRE_MM / math.sqrt(3.0)
    return Tool(half_angle, apex_offset, 3, circle, math.radians(_SPLAY_DEG))


class Place(NamedTuple):
    """A pose of the working volume.

    Attributes:
        c_mm, d_mm, incidence_deg, azimuth_deg: the same by where the axis meets the wall.
        outward: wall's normal at O.
    """

    pose: ToolPose
    c_mm: float
    d_mm: float
    incidence_deg: float
    azimuth_deg: float
    outward: np.ndarray


def place_at(
    wall: optics.Sphere,
    *,
    c: float,
    around_deg: float,
    d: float,
    incidence_deg: float,
    azimuth_deg: float,
    roll: float = 0.0,
) -> Place:
    """The pose whose axis meets the wall there; arguments as of `optics.beam_at_spot`."""
    beam = optics.beam_at_spot(
        wall,
        eccentricity=c,
        azimuth=math.radians(around_deg),
        distance=d,
        incidence=math.radians(incidence_deg),
        incidence_azimuth=math.radians(azimuth_deg),
        half_angle=0.0,
        apex_offset=0.0,
    )
    tip, axis = np.asarray(beam.tip), np.asarray(beam.axis)
    outward = (tip + d * axis) / float(wall.radius)
    return Place(ToolPose(tip, axis, roll), c, d, incidence_deg, azimuth_deg, outward)


class Estimate(NamedTuple):
    """An estimated pose: tip (3,) and distance in mm, axis (3,), the distance's own sigma in mm."""

    tip: np.ndarray
    axis: np.ndarray
    distance: float
    sigma_distance: float


def pose_error(
    place: Place,
    found: Estimate,
    *,
    source: str,
    spots: int,
    prior: Prior,
    pinhole_height: float,
    noise_px: float,
    covariance: np.ndarray,
) -> dict[str, Any]:
    """Row of pose_error.csv; errors are estimate - truth, or lengths and angles between the two.

    `mirrored`: whether the solution has the reversed incidence. The bounds are the Cramér-Rao
    standard deviations of the same quantities for the row's noise. `sigma_distance_mm` is the
    standard deviation that the estimator reports.

    Args:
        place: the true pose.
        source: "analytic" or "rendered".
        pinhole_height: z_F, mm.
        noise_px: of the contour's points.
        covariance: the bound, of tip and axis or of the tip only.
    """
    true = np.asarray(place.pose.axis)
    return {
        "source": source,
        "spots": spots,
        "prior": prior,
        "z_f_mm": pinhole_height,
        "c_mm": place.c_mm,
        "d_mm": place.d_mm,
        "incidence_deg": place.incidence_deg,
        "azimuth_deg": place.azimuth_deg,
        "noise_px": noise_px,
        "mirrored": is_mirrored(found.axis, true, place.outward),
        "tip_error_mm": float(np.linalg.norm(found.tip - np.asarray(place.pose.tip))),
        "axis_error_deg": angle_deg(found.axis, true),
        "distance_error_mm": float(found.distance - place.d_mm),
        "tip_bound_mm": tip_bound(covariance),
        "axis_bound_deg": axis_bound_deg(covariance),
        "sigma_distance_mm": float(found.sigma_distance),
    }


def tip_bound(covariance: np.ndarray) -> float:
    """Standard deviation of the tip in three dimensions, mm."""
    return float(np.sqrt(np.trace(covariance[:3, :3])))


def axis_bound_deg(covariance: np.ndarray) -> float:
    """Standard deviation of the axis, both perpendiculars together; 0 if the axis is known."""
    return math.degrees(np.sqrt(np.trace(covariance[3:, 3:])))


def drawn_prior(axis: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A direction that is off by `PRIOR_DEG` (standard deviation) along each perpendicular."""
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(axis))
    off = np.radians(PRIOR_DEG) * rng.standard_normal(2)
    turned = axis + off[0] * first + off[1] * second
    return turned / np.linalg.norm(turned)


def angle_deg(axis: np.ndarray, other: np.ndarray) -> float:
    """Angle between unit vectors, accurate for small ones too."""
    sine = np.linalg.norm(np.cross(axis, other))
    return math.degrees(math.atan2(sine, float(np.dot(axis, other))))


def is_mirrored(found: np.ndarray, true: np.ndarray, outward: np.ndarray) -> bool:
    """Whether an axis is nearer to the true one's mirror image at the wall than to the true one."""
    mirror = 2.0 * np.dot(outward, true) * outward - true
    off = angle_deg(found, true)
    return off > _MIRRORED_DEG and angle_deg(found, mirror) < off
