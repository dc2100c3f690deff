"""Makes the budgets of distances: how far each cause moves a distance, and the model's error.

The distance is computed again by exact geometry for a known direction of the beam, in NumPy. Where
it differs from the reading, the model in use is wrong at this place, distance and tilt, and the
difference is the correction. Its derivatives say what the errors of each quantity do.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from eyespot.estimator.detector import tuning
from eyespot.estimator.distance.range import Range
from eyespot.estimator.distance.ranger import Ranger
from eyespot.formats.calibration import BEAM, QUANTITIES
from eyespot.formats.spot import NoSpot, Spot
from eyespot.formats.stated import Stated

if TYPE_CHECKING:
    from eyespot.estimator.pixels.tracker import PixelRanger


class Cause(Enum):
    """What makes a distance uncertain."""

    IMAGE = "image"
    CALIBRATION = "calibration"
    SCALE = "scale"
    ROBOT = "robot"
    TILT = "tilt"
    EYE_RADIUS = "eye_radius"
    SHAPE = "shape"
    LAYER = "layer"
    VIEWING = "viewing"
    TOUCH = "touch"
    CLOCK = "clock"

    @property
    def meaning(self) -> str:
        """The cause in words."""
        return _MEANINGS[self]

    @property
    def kind(self) -> str:
        """Type of evaluation: A from repeated observations, B from what was stated.

        What a fit follows of its priors, such as the touch, is a part of its own, of type B, if the
        calibration file has it; the rest of an older file contains both.
        """
        return {Cause.IMAGE: "A", Cause.CALIBRATION: "A, B"}.get(self, "B")


_MEANINGS = {
    Cause.IMAGE: "image noise and texture",
    Cause.CALIBRATION: "calibration",
    Cause.SCALE: "microscope's scale",
    Cause.ROBOT: "robot's scale",
    Cause.TILT: "model at this tilt",
    Cause.EYE_RADIUS: "eye radius",
    Cause.SHAPE: "eye's shape",
    Cause.LAYER: "clear layer",
    Cause.VIEWING: "viewing path",
    Cause.TOUCH: "touch",
    Cause.CLOCK: "pose age and clock",
}


class Part(NamedTuple):
    """The part of one cause.

    Attributes:
        sigma_mm: its standard uncertainty, as part of the distance.
        source: the quantity that the part comes from, or most of it.
        source_sigma: standard uncertainty of that quantity; NaN if it is no single number.
    """

    cause: Cause
    sigma_mm: float
    freedom: float = math.inf
    source: str = ""
    source_sigma: float = math.nan
    unit: str = ""

    @property
    def remedy(self) -> str:
        """What halves it."""
        if self.source and math.isnan(self.source_sigma):
            return f"Know {self.source} twice as well."
        remedy = _TOUCH_REMEDY if self.source == "b" else _REMEDIES[self.cause]
        return remedy.format(
            source=self.source, half=f"{self.source_sigma / 2:.3g} {self.unit}".strip()
        )


_TOUCH_REMEDY = (
    "Know b to ± {half}: measure the touch better (--prior touch=MEAN,SIGMA), or fit more "
    "withdrawals; more frames of the same ones do not help where the touch decides."
)
_REMEDIES = {
    Cause.IMAGE: "Average four readings: of a tip at rest if the noise counts, of several places "
    "if the wall's texture does.",
    Cause.CALIBRATION: "Know {source} to ± {half}: four times as many frames in the fit, or a "
    "better prior.",
    Cause.SCALE: "Know {source} to ± {half}, or calibrate with this microscope and zoom, and name "
    "them (microscope.id).",
    Cause.TILT: "Know {source} to ± {half}, or take the model exact or area.",
    Cause.EYE_RADIUS: "Know the eye's radius to ± {half}, or calibrate in the eye (`eyespot fit "
    "--model eye`).",
    Cause.SHAPE: "Calibrate in the eye (`eyespot fit --model eye`), or stay nearer to the axis.",
    Cause.LAYER: "Know the layer's thickness to ± {half} (wall.clear_layer_sigma_mm).",
    Cause.VIEWING: "Know {source} to ± {half}, or calibrate farther out in the eye (`eyespot fit "
    "--model eye`).",
    Cause.TOUCH: "Know the tip's distance at contact to ± {half}.",
    Cause.CLOCK: "Know {source} to ± {half}, or move at half the speed.",
}


@dataclass(frozen=True, kw_only=True)
class Budget:
    """What a distance is worth.

    Attributes:
        reading_mm: the distance by the model in use.
        correction_mm: to be added to it: minus the model's error at this c, d and tilt.
        parts: by cause; those that are known to be zero are left out.
        left_out: what is not assessed, in words.
        layer_mm: length of the beam in a clear layer over the wall, and its standard uncertainty.

    Example:
        >>> touch, noise = Part(Cause.TOUCH, 0.02), Part(Cause.IMAGE, 0.002, freedom=187)
        >>> budget = Budget(reading_mm=2.38, correction_mm=0.34, parts=(touch, noise))
        >>> low, high = budget.interval_mm
        >>> f"{low:.3f} to {high:.3f} mm, mostly by {budget.largest.cause.value}"
        '2.681 to 2.759 mm, mostly by touch'
    """

    reading_mm: float
    correction_mm: float = 0.0
    parts: tuple[Part, ...]
    left_out: tuple[str, ...] = ()
    layer_mm: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Leave out what is zero; NaN, an unknown part, stays."""
        counting = tuple(part for part in self.parts if part.sigma_mm != 0)
        object.__setattr__(self, "parts", counting)

    @property
    def corrected_mm(self) -> float:
        """The best estimate of the distance."""
        return self.reading_mm + self.correction_mm

    @property
    def surface(self) -> "Budget":
        """The budget of the distance to the clear layer's surface, which a tool would touch."""
        thick, sigma = self.layer_mm
        layer = Part(Cause.LAYER, sigma, source_sigma=sigma, unit="mm")
        shorter = replace(self, reading_mm=self.reading_mm - thick, layer_mm=(0.0, 0.0))
        return replace(shorter, parts=(*self.parts, layer))

    @property
    def sigma_mm(self) -> float:
        """Combined standard uncertainty: the root of the parts' squares (GUM 5.1.2)."""
        return math.hypot(*(part.sigma_mm for part in self.parts))

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom (Welch-Satterthwaite, GUM G.4.1)."""
        spread = sum(part.sigma_mm**4 / part.freedom for part in self.parts)
        return self.sigma_mm**4 / spread if spread > 0 else math.inf

    @property
    def coverage_factor(self) -> float:
        """Student's factor of the 95 % interval (GUM G.3.2)."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, 0.975))

    @property
    def interval_mm(self) -> tuple[float, float]:
        """The 95 % interval of the distance, about the corrected one."""
        half = self.coverage_factor * self.sigma_mm
        return self.corrected_mm - half, self.corrected_mm + half

    @property
    def largest(self) -> Part | None:
        """The part that counts most; None if there is none."""
        # An unknown part may be the largest.
        unknown = (part for part in self.parts if math.isnan(part.sigma_mm))
        known = max(self.parts, key=lambda part: part.sigma_mm, default=None)
        return next(unknown, known)


_OF_STATED = {
    "scale": (Cause.SCALE, "the scale at the calibration (microscope.scale_sigma)"),
    "robot_scale": (Cause.ROBOT, "the robot's scale (robot.scale_sigma)"),
    "clock_offset": (Cause.CLOCK, "the clocks' offset at the calibration (robot.clock_sigma_s)"),
    "eye_radius": (Cause.EYE_RADIUS, "the radius at the calibration (wall.radius_sigma_mm)"),
    "inverse_working_distance": (
        Cause.VIEWING,
        "the pinhole at the calibration (microscope.pinhole_height_sigma_mm)",
    ),
    "touch": (Cause.TOUCH, "the distance at the calibration's contact (robot.touch_sigma_mm)"),
    "core_radius": (Cause.TOUCH, "the core's radius (instrument.core_radius_sigma)"),
}
"""Cause of what a calibration follows of what a rig states, and the source in words."""


def _by_cause(parts: Iterable[Part]) -> tuple[Part, ...]:
    """The parts of each cause as one, which has the source of the largest."""
    found: dict[Cause, list[Part]] = {}
    for part in parts:
        found.setdefault(part.cause, []).append(part)
    return tuple(
        max(own, key=lambda part: part.sigma_mm)._replace(
            sigma_mm=math.hypot(*(part.sigma_mm for part in own))
        )
        for own in found.values()
    )


_ELLIPSE = 5  # parameters that a spot's profiles are fitted with
_AZIMUTHS = 6  # over which a direction that nobody states is averaged
_GAUSS = 0.5 / math.sqrt(3)  # nodes of a uniform interval, from its middle, in its width


class ToolMotion(NamedTuple):
    """How the tool moved at a frame's time, by the robot's poses; 0 if that is not known.

    Attributes:
        velocity_mm_s: of the tip, in the eye's frame; if the beam's axis is not known, in any
            frame, and its length counts.
        turn_rad_s: of the tool's axis.
        pose_age_s: of the pose that the axis was taken from.
    """

    velocity_mm_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_rad_s: float = 0.0
    pose_age_s: float = 0.0


AT_REST = ToolMotion()


SHAPE_ON_AXIS, SHAPE_PER_MM = 0.0055, 0.0024
"""Part of a spot's size by which a healthy eye's retina differs from the sphere on which the spot
is read: on the axis, and per mm of c; their squares add.

Root mean square of 600 spots at each c from 0 to 5 mm: ellipsoids with the semi-axes' spread of
`eye_population.toml` (Rozema et al. 2016), tilted by 8 degrees and shifted by 0.5 mm in any
direction, incidence 0 to 30 degrees, d 0.5 to 5 mm, read by area on a sphere of 11.5 mm. They were
0.54, 0.61, 0.70, 0.80, 1.01, 1.38 % of d - b with k = 20, b = -5.117 mm, which gave the numbers,
and 0.57, 0.62, 0.72, 0.86, 1.07, 1.55 % with k = 7, b = -0.5 mm."""
_ANY_SLOPE = 10.0  # 1/tan(half-angle), on which the relative size of a spot does not depend


class Budgets:
    """Makes the budgets of the distances of one ranger, in two milliseconds each.

    Args:
        stated: uncertainties of what neither spot nor calibration contains.
    """

    def __init__(self, ranger: "Ranger | PixelRanger", stated: Stated) -> None:
        from eyespot.optics.cone_view import ConeView

        values, view = ranger.calibration.values, ranger.microscope
        self._stated = stated
        self._calibration, self._view = ranger.calibration, view
        self._model = ranger.model if isinstance(ranger, Ranger) else "pixels"
        self._by_area = self._model in ("area", "pixels")
        # What moves the wall in the image moves the spot of a lens as that of a cone from the tip.
        k, b = _ANY_SLOPE, 0.0
        if ranger.calibration.model != "lens":
            k = values["k"] if "k" in values else 1 / math.tan(values["half_angle"])
            b = values["b"]
        self._eye = ConeView(
            k=np.array([k]),
            b=np.array([b]),
            scale=view.scale_mm_px,
            eye_radius=view.eye_radius_mm,
            inverse_working_distance=view.inverse_working_distance,
            normal=view.plane_normal,
        )

    @property
    def _is_inexact(self) -> bool:
        """Whether microscope or wall are stated to a tolerance."""
        own = self._stated
        sizes = own.shape, own.size_per_mm, own.scale_sigma
        return any((*sizes, own.eye_radius_sigma_mm, own.inverse_working_distance_sigma))

    # A line of sight or a generator that misses the wall gives NaN.
    @np.errstate(invalid="ignore", divide="ignore")
    def of(
        self,
        spot: Spot | NoSpot,
        found: Range,
        *,
        axis: np.ndarray | None = None,
        motion: ToolMotion = AT_REST,
    ) -> Budget | None:
        """The budget of a distance; None if there is no distance, or nothing explains the spot.

        Args:
            axis: of the beam, by the robot: unit vector from the tip towards the wall, eye frame.
        """
        if math.isnan(found.distance_mm):
            return None
        if self._model in ("lens", "pixels"):
            return self._of_light(spot, found, axis, motion)
        assert isinstance(spot, Spot)  # which these models read
        told = axis is not None
        if found.poses:
            axis = found.poses[0].axis
        axes, weights = self._directions(spot, axis)
        if axes is None:
            return None
        size = spot.semi_minor_px
        if self._by_area:
            size = math.sqrt(spot.semi_major_px * size)
        distances, points = self._eye.distance_of(
            at_px=np.tile(self._at_px(spot), (len(axes), 1)),
            size_px=np.full(len(axes), size),
            axis=axes,
            by_area=self._by_area,
        )
        mean = float(weights @ distances)
        if math.isnan(mean):
            return None
        middle = int(np.argmin(np.abs(distances - mean)))
        slopes = self._eye.slopes_of(
            axis=axes[middle],
            point=points[middle],
            distance=distances[middle],
            by_area=self._by_area,
        )
        # How fast the distance changes while the tip moves over a wall at rest, mm/s.
        velocity = np.array(motion.velocity_mm_s)
        speed = float(np.linalg.norm(velocity))
        if told:
            normal = self._eye.outward(points[middle][None])[0]
            speed = abs(float(normal @ velocity / (normal @ axes[middle])))
        known = axis is not None
        spread = 0.0 if known else math.sqrt(weights @ (distances - mean) ** 2)
        exact = self._model in ("exact", "area")
        unknown = self._view.viewing_path is not None and not exact
        turned = slopes["tilt"] if known and self._model != "exact" else 0.0
        parts = self._parts(spot, found, slopes, spread, known=known)
        return Budget(
            reading_mm=found.distance_mm,
            correction_mm=0.0 if exact or unknown else mean - found.distance_mm,
            parts=_by_cause((*parts, self._of_clock(motion, speed, turned))),
            left_out=("the model's error through this viewing path",) if unknown else (),
            layer_mm=self._layer(points, axes),
        )

    def _of_light(
        self, spot: Spot | NoSpot, found: Range, axis: np.ndarray | None, motion: ToolMotion
    ) -> Budget:
        """The budget of a distance by all pixels, or by the curve of a lens.

        It contains the calibration's errors, and by the curve those of the scale.
        """
        speed = float(np.linalg.norm(motion.velocity_mm_s))
        by_pixels = self._model == "pixels"
        freedom = _freedom(spot) if isinstance(spot, Spot) and not by_pixels else math.inf
        parts = [Part(Cause.IMAGE, found.sigma_mm, freedom)]
        if not by_pixels:  # whose distance is that of the frame's own time
            parts.append(self._of_clock(motion, speed, 0.0))
        if found.poses:
            best = found.poses[0]
            axis, point = best.axis, best.tip_mm + best.distance_mm * best.axis
        else:
            point = self._eye.wall_point(self._at_px(spot))[0] if spot else np.full(3, np.nan)
            axis = self._eye.outward(point[None])[0] if axis is None else axis
        if self._is_inexact:
            slopes = self._eye.slopes_of(
                axis=axis, point=point, distance=found.distance_mm, by_area=True
            )
            parts += self._of_view(found, slopes, point, scale=by_pixels)
        return Budget(
            reading_mm=found.distance_mm,
            parts=_by_cause(parts),
            left_out=("the calibration's own part (it is in that of the image)",),
            layer_mm=self._layer(point[None], axis[None]),
        )

    def _layer(self, points: np.ndarray, axes: np.ndarray) -> tuple[float, float]:
        """Length of the beam in the clear layer, mean over its axes, and its uncertainty, mm."""
        thick, sigma = self._stated.clear_layer_mm, self._stated.clear_layer_sigma_mm
        if not (thick or sigma):
            return 0.0, 0.0
        length = float(np.mean(1 / np.einsum("nk,nk->n", self._eye.outward(points), axes)))
        return thick * length, sigma * length

    def _at_px(self, spot: Spot) -> np.ndarray:
        return np.array([[spot.x_px, spot.y_px]]) - self._view.principal_point_px

    def _directions(
        self, spot: Spot, axis: np.ndarray | None
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """The beam's axis, or several that stand for all that it may be, and their weights."""
        if axis is not None:
            return np.asarray(axis)[None], np.ones(1)
        normal = self._eye.outward(self._eye.wall_point(self._at_px(spot)))[0]
        if np.isnan(normal).any():
            return None, np.ones(0)
        low, high = np.radians(self._stated.incidence_deg)
        tilts = (low + high) / 2 + (high - low) * np.array([-_GAUSS, _GAUSS])
        turns = 2 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
        tilt, turn = (grid.ravel()[:, None] for grid in np.meshgrid(tilts, turns))
        first, second = np.linalg.svd(normal[None])[2][1:]
        lean = np.cos(turn) * first + np.sin(turn) * second
        axes = np.cos(tilt) * normal + np.sin(tilt) * lean
        return axes, np.full(len(axes), 1 / len(axes))

    def _parts(
        self, spot: Spot, found: Range, slopes: dict[str, float], spread: float, *, known: bool
    ) -> list[Part]:
        stated, model = self._stated, self._model
        parts = [self._of_image(spot, found, slopes), *self._of_calibration(slopes)]
        # The model exact weighs the axis against the ellipse: it is in the image's part.
        if model != "exact" and known:
            sigma = stated.axis_sigma_deg
            moved, source = slopes["tilt"] * math.radians(sigma), "the beam's axis"
            parts.append(Part(Cause.TILT, moved, math.inf, source, sigma, "deg"))
        elif model != "exact":
            low, high = stated.incidence_deg
            source = "the beam's axis by the robot's poses, or its incidence"
            parts.append(Part(Cause.TILT, spread, math.inf, source, (high - low) / 2, "deg"))
        point = self._eye.wall_point(self._at_px(spot))[0]
        parts += self._of_view(found, slopes, point, scale=True)
        moved = abs(slopes["b"]) * stated.touch_sigma_mm
        parts.append(Part(Cause.TOUCH, moved, source_sigma=stated.touch_sigma_mm, unit="mm"))
        return parts

    def _of_image(self, spot: Spot, found: Range, slopes: dict[str, float]) -> Part:
        if self._model == "exact":
            sigma = found.sigma_image_mm
        else:
            by_axes = np.array([0.0, slopes["size"]])
            if self._by_area:
                axes = np.array([spot.semi_major_px, spot.semi_minor_px])
                by_axes = slopes["size"] * math.sqrt(axes.prod()) / 2 / axes
            gradient = np.array([slopes["x"], slopes["y"], *by_axes])
            sigma = math.sqrt(gradient @ spot.covariance[:4, :4] @ gradient)
        return Part(Cause.IMAGE, sigma, _freedom(spot))

    def _of_calibration(self, slopes: dict[str, float]) -> list[Part]:
        """The part of the fit's data, and one for all that it follows of what its rig stated."""
        calibration = self._calibration
        k = float(self._eye.k[0])
        # dk/d(half_angle) = -1/sin^2; a boresight's error turns the axis, one way or the other.
        of = slopes | {"half_angle": -(1 + k * k) * slopes["k"]}
        boresight = 0.0 if self._model == "exact" else slopes["tilt"] / math.sqrt(2)
        of |= dict.fromkeys(BEAM, boresight)
        gradient = np.array([of.get(name, 0.0) for name in calibration.values])
        variance = float(gradient @ calibration.covariance @ gradient)
        stated = []
        for name, rows in calibration.stated.items():
            moved = float(np.linalg.norm(rows @ gradient))
            variance -= moved**2
            cause, source = _OF_STATED.get(name, (Cause.CALIBRATION, name))
            stated.append(Part(cause, moved, source=source))
        sigmas = np.sqrt(np.diag(calibration.covariance))
        most = int(np.argmax(np.abs(gradient) * sigmas))
        name = list(calibration.values)[most]
        of_data = Part(
            Cause.CALIBRATION,
            math.sqrt(max(variance, 0.0)),
            self._stated.calibration_freedom or math.inf,
            name,
            float(sigmas[most]),
            QUANTITIES[name].unit.removeprefix("1"),
        )
        return [of_data, *stated]

    def _of_view(
        self, found: Range, slopes: dict[str, float], point: np.ndarray, *, scale: bool
    ) -> list[Part]:
        """The parts of what the microscope and the wall are not as stated.

        Args:
            point: where the beam meets the wall, mm.
            scale: whether that of the scale is not in another part.
        """
        stated, values, parts = self._stated, self._calibration.values, []
        c, apart = float(np.hypot(*point[:2])), found.distance_mm - float(self._eye.b[0])
        if scale and "scale" not in values:
            moved = abs(slopes["scale"]) * self._eye.scale * stated.scale_sigma
            parts.append(Part(Cause.SCALE, moved, math.inf, "the scale", stated.scale_sigma))
        if self._eye.normal is None:
            sigma = stated.eye_radius_sigma_mm
            if "eye_radius" not in values:
                moved = abs(slopes["eye_radius"]) * sigma
                parts.append(Part(Cause.EYE_RADIUS, moved, source_sigma=sigma, unit="mm"))
            shape = stated.shape * math.hypot(SHAPE_ON_AXIS, SHAPE_PER_MM * c)
            parts.append(Part(Cause.SHAPE, apart * shape))
        sigma = stated.inverse_working_distance_sigma
        if "inverse_working_distance" in values:
            sigma = 0.0
        of_pinhole = slopes["inverse_working_distance"] * sigma
        of_size = stated.size_per_mm * c * apart
        source = "1/(z_F + r)", sigma, "1/mm"
        if abs(of_pinhole) < of_size:
            source = "the size of spots per mm of c", stated.size_per_mm, ""
        parts.append(Part(Cause.VIEWING, math.hypot(of_pinhole, of_size), math.inf, *source))
        return parts

    def _of_clock(self, motion: ToolMotion, speed: float, tilt: float) -> Part:
        late = self._stated.clock_sigma_s
        # The axis turned by so much in one direction, which is half of the square in each of two.
        turned = motion.turn_rad_s * math.hypot(motion.pose_age_s, late) / math.sqrt(2)
        moved = math.hypot(speed * late, tilt * turned)
        return Part(Cause.CLOCK, moved, math.inf, "the clocks' offset", late, "s")


def _freedom(spot: Spot) -> float:
    """Degrees of freedom of a spot: profiles that agree, without the ellipse's parameters."""
    agree = tuning.RAYS * spot.coverage * spot.inlier_fraction
    return max(agree - _ELLIPSE, 1.0) if math.isfinite(agree) else math.inf
