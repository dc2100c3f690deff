"""What two sources state of one thing, compared at the accuracy that both state.

Statistics of residuals are blind to a rig that is not as its file says: a robot whose travel is 2 %
long makes a cone that is 2 % too slender, and every spot fits it. Only a second source of the same
quantity shows it. Each function here makes one such comparison, of numbers; `disagreements` says
which of them contradict.
"""

import math
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from eyespot.estimator.distance.withdrawal import (
    BORESIGHT_SIGMA,
    MOST_ASIDE_MM,
    MOST_ASKEW_DEG,
    straight_line,
)
from eyespot.formats.calibration import CONE_MODELS, Calibration
from eyespot.formats.poses import RobotKeys, Vector, turned
from eyespot.formats.spot import Spot

if TYPE_CHECKING:
    from eyespot.formats.microscope import MicroscopeFile

TESTS = {
    "travel": "the robot's travel against the distances",
    "standstill": "a robot that stands still against the distances",
    "contact": "the light at the tip's face against the fibre",
    "touch": "the distance in the first frame, as stated and as the spots show it",
    "tolerance": "what the rig file states to a tolerance against the images (five numbers)",
    "frame": "the robot's directions against the eye (two angles)",
    "beam": "the tool's axis and motion against the way of the spot in the image (two angles)",
    "recordings": "the parameters of two recordings of one beam that are fitted apart",
    "ghost": "the light beside the spot against that of one spot",
}
"""What is compared in a recording."""
FALSE_ALARMS = 1e-3
"""Part of the recordings with a rig as stated in which at least one test contradicts."""
_COMPARISONS = len(TESTS) + 2 + 4  # frame and beam have two angles; five tolerances are stated
CONTRADICTION_SIGMAS = NormalDist().inv_cdf(1.0 - FALSE_ALARMS / (2.0 * _COMPARISONS))
"""Difference, in standard deviations, from which a test contradicts (Bonferroni): 3.99."""


class Compared(NamedTuple):
    """One comparison.

    Attributes:
        key: of `TESTS`.
        sigmas: the difference over its standard deviation, by both sources.
        says: what disagrees, by how much, and what would cause it, in a sentence or two.
    """

    key: str
    sigmas: float
    says: str


def disagreements(found: Iterable[Compared]) -> list[str]:
    """What the comparisons say whose difference is larger than chance allows."""
    return [
        one.says + (f" ({abs(one.sigmas):.1f} σ)" if math.isfinite(one.sigmas) else "")
        for one in found
        if abs(one.sigmas) > CONTRADICTION_SIGMAS
    ]


NOTED_SIGMAS = 2.0
"""Difference, in standard deviations, from which a report mentions it; of six priors that a rig
states, one is beyond it in a quarter of good recordings."""


def hints(found: Iterable[Compared]) -> list[str]:
    """What the light at the tip says against the fibre, where chance seldom does and yet may."""
    return [
        f"{one.says} ({one.sigmas:.1f} σ; a contradiction from {CONTRADICTION_SIGMAS:.1f} σ on)."
        for one in found
        if one.key == "contact" and NOTED_SIGMAS < abs(one.sigmas) <= CONTRADICTION_SIGMAS
    ]


FIBRE_SIGMA = 0.025 / math.sqrt(3.0)
"""Relative standard deviation of a fibre's radius of which only the nominal diameter is known. Data
sheets allow ±2 to ±2.5 % (400 ± 8 µm, 425 ± 10 µm), which are limits (GUM 2008, 4.3.7)."""


def contact(
    radius_mm: float,
    sigma_mm: float,
    *,
    core_mm: float | None,
    core_sigma: float,
    fibre_mm: float,
    where: str,
) -> Compared:
    """The radius of the light at the tip's face, by a fit, against the core or the fibre.

    Where the recording began later than at contact, by D, the light seems to leave the tip with
    D tan(half_angle) too much of a radius.

    Args:
        core_mm: radius of the core, as stated; None: it is at most the fibre's.
        core_sigma: relative.
        fibre_mm: radius of the fibre.
    """
    stated = fibre_mm if core_mm is None else core_mm
    share = FIBRE_SIGMA if core_mm is None else core_sigma
    off = radius_mm - stated
    if core_mm is None:
        off = max(off, 0.0)  # a core may be much thinner than its fibre
    sigmas = off / math.hypot(sigma_mm, share * stated)
    what = "fibre is at most" if core_mm is None else "core is"
    late = (
        "later than the distance stated for its first frame" if off > 0 else "earlier than stated"
    )
    says = (
        f"{where}: the light leaves the tip with a radius of {radius_mm:.3f} ± {sigma_mm:.2g} mm, "
        f"but the {what} {stated:.3f} mm. The recording begins {late} (state robot.touch = "
        "'free'), or the microscope's scale, the fibre or the core is not as stated"
    )
    return Compared("contact", sigmas, says)


def against_prior(
    key: str,
    name: str,
    value: float,
    sigma: float,
    mean: float,
    prior_sigma: float,
    *,
    cause: str,
    considered: float = 0.0,
) -> Compared:
    """A fitted value against the prior that took part in the fit.

    The difference of the two has the variance of the prior less that of the result. Where the data
    add too little to the prior for that, or a misfit has enlarged the result's error beyond it, the
    whole variance of the prior counts.

    Args:
        considered: part of `sigma` by errors of what the fit took as stated. It moves the result
            away from the prior, so its variance adds to that of the difference.
    """
    added = prior_sigma**2 - sigma**2 + 2.0 * considered**2
    if not added > (_LEAST_ADDED * prior_sigma) ** 2:
        added = prior_sigma**2
    says = (
        f"{name} is {mean:.4g} ± {prior_sigma:.2g} as stated, but {value:.4g} ± {sigma:.2g} by the "
        f"images. {cause}"
    )
    return Compared(key, (value - mean) / math.sqrt(added), says)


_LEAST_ADDED = 0.3
"""Least part of a prior's standard deviation that the data must take away from it to be compared
with it alone; with less, rounding of the two variances is as large as their difference."""

_FEWEST_FRAMES, _LEAST_TRAVEL_MM = 5, 1.0
"""Of a withdrawal that shows how true distances are."""
_LEAST_WAY_MM = 0.1
"""Way of a tip below which no distance can change by `_STILL_MM`, however the beam leans."""
_STILL_MM = 0.5
"""Change of the distances while the robot reports no motion at all that is not an eye's: breath and
pulse move a retina by some tenths of a millimetre."""
_COMMON_TO_BOTH = frozenset({"image", "calibration", "touch", "clock"})
"""Causes of a budget that do not change the slope of distances against travel, or are counted by
themselves."""
_ROW = 10


@dataclass
class TipWay:
    """The tip's way by the robot, and the distances read, of a run's frames without doubt.

    It grows by 80 bytes a frame.
    """

    rows: "array[float]" = field(default_factory=lambda: array("d"))
    near: tuple[float, Mapping[str, float]] = (math.inf, {})
    far: tuple[float, Mapping[str, float]] = (-math.inf, {})

    @property
    def frames(self) -> int:
        """Number of frames that were taken."""
        return len(self.rows) // _ROW

    def add(
        self,
        *,
        position_mm: Vector,
        axis: Vector,
        spot: Spot | None,
        distance_mm: float,
        sigma_mm: float,
        parts_mm: Mapping[str, float],
    ) -> None:
        """Take a frame.

        Args:
            position_mm: of the tip, in the robot's frame.
            axis: of the beam, in the robot's frame.
            sigma_mm: standard deviation of the distance by the image alone; NaN if unknown.
            parts_mm: of its budget, by cause.
        """
        at = (spot.x_px, spot.y_px) if spot else (math.nan, math.nan)
        self.rows.extend((*position_mm, *axis, *at, distance_mm, sigma_mm))
        if distance_mm < self.near[0]:
            self.near = distance_mm, parts_mm
        if distance_mm > self.far[0]:
            self.far = distance_mm, parts_mm

    def compared(
        self, robot: RobotKeys, view: "MicroscopeFile | None", calibration: Calibration
    ) -> list[Compared]:
        """What robot and distances say of each other; empty if the motion does not show it.

        That is so unless it is a withdrawal: straight, along the beam, of `_LEAST_TRAVEL_MM`.
        """
        rows = np.reshape(self.rows, (-1, _ROW))
        if len(rows) < _FEWEST_FRAMES:
            return []
        place, axis, at_px, distance, sigma = np.split(rows, (3, 6, 8, 9), axis=1)
        distance, sigma = distance[:, 0], sigma[:, 0]
        gone = place[0] - place
        length = float(np.linalg.norm(gone, axis=1).max())
        if length < _LEAST_WAY_MM:
            return self._standstill(distance, length)
        towards = axis.mean(axis=0) / np.linalg.norm(axis.mean(axis=0))
        along = gone @ towards
        aside = np.linalg.norm(gone - np.outer(along, towards), axis=1)
        if np.ptp(along) < _LEAST_TRAVEL_MM or aside.max() > max(
            MOST_ASIDE_MM, math.sin(math.radians(MOST_ASKEW_DEG)) * length
        ):
            return []
        motion, travel, beside = straight_line(place, towards)
        if beside > MOST_ASIDE_MM:
            return []
        seen, askew = _tip_by_spots(distance, at_px, motion, towards, robot, view)
        slope, scatter, freedom = slope_of(travel, seen, sigma)
        common = math.hypot(askew, robot.scale_sigma, self._common(calibration))
        sigmas = _normal_sigmas(slope - 1.0, scatter, freedom, common)
        moved, read = float(np.ptp(travel)), float(slope * np.ptp(travel))
        says = (
            f"The tip withdrew by {moved:.2f} mm by the robot, by {read:.2f} mm by the distances "
            f"({100 * (slope - 1):+.2f} ± {100 * math.hypot(scatter, common):.2g} %). One of "
            "calibration, microscope's scale, robot's scale and clocks is not as stated, or the "
            "spot has a ghost"
        )
        return [Compared("travel", sigmas, says)]

    def _standstill(self, distance: np.ndarray, length: float) -> list[Compared]:
        # Of a robot at rest whose poses jitter, a tenth of the distances may be wrong.
        shares = (0.1, 0.9) if length else (0.0, 1.0)
        changed = float(np.ptp(np.quantile(distance, shares)))
        moved = (
            f"The robot moves by {length:.2g} mm" if length else "All poses of the robot are equal"
        )
        says = (
            f"{moved}, but the distances change by {changed:.2f} mm. The robot's file has stopped "
            "or is in another unit (robot.unit), or another column or topic has the positions"
        )
        return [Compared("standstill", math.inf if changed > _STILL_MM else 0.0, says)]

    def _common(self, calibration: Calibration) -> float:
        """Standard deviation of the slope by what is alike in all frames."""
        (near_mm, near), (far_mm, far) = self.near, self.far
        span = far_mm - near_mm
        slopes = [
            (far.get(cause, 0.0) - near.get(cause, 0.0)) / span
            for cause in {*near, *far} - _COMMON_TO_BOTH
        ]
        if calibration.model in CONE_MODELS:  # distances grow with k = 1/tan(half_angle)
            angle, _, covariance = calibration.cone
            slopes.append(2.0 * math.sqrt(covariance[0, 0]) / math.sin(2.0 * angle))
        else:  # a lens's errors count in each distance, and may change sign on the way
            slopes += [far.get("image", 0.0) / span, near.get("image", 0.0) / span]
        return math.hypot(*(slope for slope in slopes if math.isfinite(slope)))


def slope_of(
    travel: np.ndarray, distance: np.ndarray, sigma: np.ndarray
) -> tuple[float, float, float]:
    """Slope of distances against travel, its standard deviation by their scatter, and its freedom.

    Neighbouring frames show the same piece of wall, whose texture pulls them alike; so the scatter
    counts (1 + r)/(1 - r) times with r the correlation of neighbouring residuals, and the degrees
    of freedom as much less often.

    Args:
        sigma: of the distances by their images; NaN if unknown. What the residuals show counts if
            it is more.
    """
    known = np.isfinite(sigma).all() and (sigma > 0).all()
    weight = 1.0 / sigma if known else np.ones_like(distance)
    basis = weight[:, None] * np.stack([travel - travel.mean(), np.ones_like(travel)], axis=1)
    line = np.linalg.lstsq(basis, weight * distance, rcond=None)[0]
    left = weight * distance - basis @ line
    freedom = max(travel.size - 2.0, 1.0)
    variance = float(left @ left) / freedom
    alike = float(left[1:] @ left[:-1] / max(left @ left, 1e-300))
    alike = min(max(alike, 0.0), _MOST_ALIKE)
    fewer = (1.0 + alike) / (1.0 - alike)
    growth = max(variance, 1.0) if known else variance
    error = math.sqrt(growth * fewer * np.linalg.inv(basis.T @ basis)[0, 0])
    return float(line[0]), error, max(freedom / fewer, 1.0)


_MOST_ALIKE = 0.9


def _tip_by_spots(
    distance: np.ndarray,
    at_px: np.ndarray,
    motion: np.ndarray,
    axis: np.ndarray,
    robot: RobotKeys,
    view: "MicroscopeFile | None",
) -> tuple[np.ndarray, float]:
    """The tip's way along the motion by spots and distances, and what is not known of its slope.

    A beam that points beside the motion by an angle e, at the incidence i, makes distances that
    grow by e tan(i) more or less than the tip moves; the spot then wanders over the wall, which
    shows how much. Where the eye's frame is not known, that part is uncertain instead.
    """
    turn = robot.eye_from_robot
    if view is None or turn is None or view.viewing_path is not None or np.isnan(at_px).any():
        return distance, BORESIGHT_SIGMA * math.tan(math.radians(robot.incidence_deg[1]))
    in_eye = [np.array(turned((v[0], v[1], v[2]), turn)) for v in (motion, axis)]
    wall, pinhole = view.wall(), view.ideal_microscope()
    points = np.asarray(wall.intersect(*pinhole.ray(at_px)).point)
    tips = points - distance[:, None] * in_eye[1]
    return (tips[0] - tips) @ in_eye[0], 0.0


def _normal_sigmas(difference: float, scatter: float, freedom: float, common: float) -> float:
    """A difference in standard deviations of a normal distribution.

    The scatter is estimated with some degrees of freedom, the common part is stated
    (Welch-Satterthwaite, GUM G.4.1).
    """
    from scipy import stats

    sigma = math.hypot(scatter, common)
    if not sigma > 0:
        return math.inf if difference else 0.0
    effective = freedom * (sigma / scatter) ** 4 if scatter > 0 else math.inf
    chance = float(stats.t.sf(abs(difference) / sigma, min(effective, 1e9)))
    return float(math.copysign(stats.norm.isf(max(chance, 1e-300)), difference))
