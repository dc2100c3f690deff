"""From a spot to the distance between tip and wall, with its standard deviation."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from eyespot.estimator.detector.ellipse_rays import AffineEllipse
from eyespot.estimator.detector.shape import spot_shape
from eyespot.estimator.distance.cone_range import (
    UNKNOWN_SIGMA_PX,
    AreaDistances,
    ConePoses,
    calibrated_view,
    unblurred,
)
from eyespot.estimator.distance.lens_range import distance_from_lens, lens_curve
from eyespot.estimator.distance.range import Range
from eyespot.formats.calibration import CONE_MODELS, MODELS, Calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.spot import Spot

Numbers = float | np.ndarray

_TWO_DISTANCES_SIGMAS = 3.0  # standard deviations between two distances that count as two
_DIFFERENCE_STEP = 1e-6  # of central differences
_UNIT_TOLERANCE = 1e-3  # robots round the length of a unit vector


class Ranger:
    """Turns spots into distances with one model and one calibration.

    - planar: d = delta k e1' + b (Zhou et al. 2020, eq. 6).
    - small_plane: the paper's model of the eyeball (eq. 10).
    - corrected: with the right first-order factor for the pinhole's height, or for the viewing
      path that the microscope file describes.
    - stereographic: exact for a pinhole on the sphere (z_F = r) and a square beam.
    - exact: tip and axis of the cone that leaves the spot's ellipse on the wall. Loads JAX.
    - area: the exact spot with the ellipse's centre and area, for the robot's axis. Loads JAX.
    - lens: by size, shape and brightness against the light of a glue lens. Loads JAX.

    The closed forms are of the wall that they were derived for; exact, area and lens take the
    microscope's.
    """

    def __init__(
        self,
        calibration: Calibration,
        microscope: MicroscopeFile,
        *,
        model: str | None = None,
        eccentricity_mm: float | None = None,
        scale_sigma: float = 0.0,
    ) -> None:
        """Check that calibration, microscope and model fit each other, and prepare the model.

        `exact` is compiled once a process, for some 10 s; `lens` traces its lens, for some 20 s.

        Args:
            calibration: goes before the microscope, see `calibrated_view`.
            microscope: the spots lie in its undistorted image.
            model: one of `MODELS`; by default the calibration's. All models of a cone share k
                (or half_angle) and b.
            eccentricity_mm: c of the spots, which all but planar and exact need; by default, where
                the pinhole sees each spot's centre on the sphere.

        Raises:
            InputError: unknown model, a model that does not fit calibration or microscope, or an
                impossible lens.
        """
        own = calibration.values
        self.calibration = calibration
        self.microscope = view = calibrated_view(microscope, own)
        through_path = view.viewing_path is not None
        self._path: Any = (view.ideal_microscope(), view.wall()) if through_path else None
        self.model = calibration.model if model is None else model
        self.eccentricity_mm = eccentricity_mm
        self._scale_sigma = 0.0 if "scale" in own else scale_sigma
        self._check()
        if self.model == "exact":
            self._poses = ConePoses(
                view, half_angle=float(np.arctan(1 / _slope(own))), apex_offset=own["b"]
            )
        elif self.model == "area":
            self._areas = AreaDistances(calibration, microscope)
        elif self.model == "lens":
            curvature = 1.0 / view.eye_radius_mm if view.plane_normal is None else 0.0
            self._curve = lens_curve(calibration, wall_curvature=curvature)

    def distance(
        self,
        spot: Spot,
        *,
        axis: ArrayLike | None = None,
        axis_sigma_rad: float = math.radians(1.0),
        frame: np.ndarray | None = None,
        exposure_s: float | None = None,
    ) -> Range:
        """Distance of a spot. A model ignores arguments that it does not use.

        Args:
            spot: from `measure`, in the undistorted image.
            axis: of the beam, from the robot: unit vector from the tip towards the wall, eye frame;
                `exact` weighs it against the ellipse, `area` needs it.
            axis_sigma_rad: standard deviation of the axis across itself.
            frame: in which the spot was measured; `lens` reads the profile's shape from it.
            exposure_s: of the frame; `lens` with a calibrated `brightness` uses the peak's, too.

        Raises:
            InputError: the axis is not a unit vector, or the frame is not an image.
        """
        direction = None if axis is None else _unit(axis)
        if "half_angle" in self.calibration.values:  # k is of a line through half maxima
            spot = unblurred(spot)
        if self.model == "exact":
            found = self._exact(spot, direction, axis_sigma_rad)
        elif self.model == "area":
            found = self._area(spot, direction, axis_sigma_rad)
        elif self.model == "lens":
            found = self._lens(spot, frame, exposure_s)
        else:
            found = self._closed_form(self.model, spot, spot.covariance)
        if found.distance_mm > self._farthest_mm:
            return Range(distance_mm=math.nan, sigma_mm=math.nan)
        return found

    @property
    def _farthest_mm(self) -> float:
        """Distance beyond which the tip would not be in the eye, or not below the microscope."""
        view = self.microscope
        if view.plane_normal is None:
            return 2 * max((view.eye_radius_mm, *(view.retina_semi_axes_mm or ())))
        return abs(view.pinhole_height_mm + view.eye_radius_mm)

    def _check(self) -> None:
        model, c, radius = self.model, self.eccentricity_mm, self.microscope.eye_radius_mm
        if model not in MODELS:
            raise InputError(f"model must be one of {', '.join(MODELS)}; got {model!r}.")
        if (model in CONE_MODELS) != (self.calibration.model in CONE_MODELS):
            raise InputError(
                f"model {model!r} does not fit a calibration of the model "
                f"{self.calibration.model!r}: one is a cone, the other a lens. Leave model out, or "
                f"calibrate {model}."
            )
        if c is not None and not 0 <= c < radius:
            raise InputError(
                f"Ranger(eccentricity_mm=...) must lie in [0, {radius:g}), inside the eye; got {c} "
                "mm."
            )
        height = self.microscope.pinhole_height_mm
        if model == "stereographic" and not math.isclose(height, radius, rel_tol=1e-3):
            raise InputError(
                f"model 'stereographic' needs the pinhole on the sphere, at {radius:g} mm; "
                f"this microscope has it at {height:g} mm. Take model='corrected'."
            )

    def _closed_form(self, model: str, spot: Spot, spot_covariance: np.ndarray) -> Range:
        """Distance by a closed form, its sigma propagated by central differences."""
        from eyespot import optics

        names, values = zip(*self.calibration.values.items(), strict=True)
        base = np.array([spot.x_px, spot.y_px, spot.semi_minor_px, *values])
        steps = np.diag(_DIFFERENCE_STEP * np.maximum(np.abs(base), 1.0))
        # The first column is the spot itself; then each quantity a step up, and each a step down.
        varied = base[:, None] + np.hstack([np.zeros((base.size, 1)), steps, -steps])
        x, y, semi_minor, *calibrated = varied
        quantities = dict(zip(names, calibrated, strict=True))
        eye, line = self._eye(quantities), {"k": _slope(quantities), "b": quantities["b"]}
        # A spot larger than the sphere gives NaN, which is flagged.
        with np.errstate(invalid="ignore"):
            at_x, at_y, _ = self._on_wall(eye, x, y, plane=False)
            c = np.hypot(at_x, at_y) if self.eccentricity_mm is None else self.eccentricity_mm
            if model == "corrected" and self._path is not None:
                from eyespot.optics.viewing.projection import local_magnification

                camera, wall = self._path
                magnification = local_magnification(
                    camera, wall, eccentricity=c, azimuth=np.arctan2(at_y, at_x)
                )
                radius = eye["scale"] * semi_minor / np.asarray(magnification)[:, 1]
                found: Any = optics.sphere_distance(
                    spot_radius=radius, eye_radius=eye["eye_radius"], **line
                )
            else:
                found = optics.closed_form_distance(
                    model, semi_minor_px=semi_minor, eccentricity=c, **line, **eye
                )
        distances = np.asarray(found)
        up, down = distances[1:].reshape(2, -1)
        gradient = (up - down) / (2 * np.diag(steps))
        of_spot, of_calibration = gradient[:3], gradient[3:]
        measured = np.ix_((0, 1, 3), (0, 1, 3))
        variance = of_spot @ spot_covariance[measured] @ of_spot
        variance += of_calibration @ self.calibration.covariance @ of_calibration
        return Range(distance_mm=float(distances[0]), sigma_mm=float(np.sqrt(variance)))

    def _eye(self, calibrated: Mapping[str, Numbers]) -> dict[str, Numbers]:
        """Scale, radius and pinhole of the eye: the calibrated ones, else the microscope's."""
        microscope = self.microscope
        radius = calibrated.get("eye_radius", microscope.eye_radius_mm)
        own = 1.0 / (microscope.pinhole_height_mm + radius)
        return {
            "scale": calibrated.get("scale", microscope.scale_mm_px),
            "eye_radius": radius,
            "inverse_working_distance": calibrated.get("inverse_working_distance", own),
        }

    def _on_wall(
        self, eye: Mapping[str, Numbers], x: np.ndarray, y: np.ndarray, *, plane: bool
    ) -> np.ndarray:
        """Wall points that pixels see, (3, n), mm; NaN off the wall.

        With `plane` the wall may be the microscope's plane; else it is the eyeball.
        """
        from eyespot import optics

        u, v = self.microscope.principal_point_px
        seen: Any = {"right_px": x - u, "down_px": y - v, **eye}
        normal = self.microscope.plane_normal
        if plane and normal is not None:
            return np.asarray(optics.plane_point(**seen, normal=normal))
        if self._path is None:
            return np.asarray(optics.eyeball_point(**seen))
        from eyespot.optics.viewing.projection import wall_point

        # A line of sight is given by the offset in mm.
        own = eye["scale"] / self.microscope.scale_mm_px
        pixels = np.stack([u + own * (x - u), v + own * (y - v)], axis=-1)
        camera, wall = self._path
        return np.asarray(wall_point(camera, wall, pixels)).T

    def _area(self, spot: Spot, axis: np.ndarray | None, axis_sigma_rad: float) -> Range:
        """The distance along a known axis at which the spot has its centre and area."""
        x, y = np.array([spot.x_px]), np.array([spot.y_px])
        with np.errstate(invalid="ignore"):
            off = np.isnan(self._on_wall(self._eye({}), x, y, plane=True)).any()
        if axis is None or off:
            return Range(distance_mm=math.nan, sigma_mm=math.nan)
        return self._areas.of(spot, axis=axis, axis_sigma_rad=axis_sigma_rad)

    def _exact(self, spot: Spot, axis: np.ndarray | None, axis_sigma_rad: float) -> Range:
        """The pose whose cone leaves the spot's ellipse on the wall."""
        # The calibration's errors act on a tilted spot as on a square one, to a few percent.
        near = "corrected" if self.microscope.plane_normal is None else "planar"
        square = self._closed_form(near, spot, np.zeros((5, 5)))
        if math.isnan(square.distance_mm):
            return square
        poses, alike, of_image = self._poses.of(spot, axis=axis, axis_sigma_rad=axis_sigma_rad)
        distance, other = (pose.distance_mm for pose in poses)
        sigma = math.hypot(of_image, square.sigma_mm)
        apart = abs(other - distance) > _TWO_DISTANCES_SIGMAS * sigma
        return Range(
            distance_mm=distance,
            sigma_mm=sigma,
            others_mm=(other,) if alike and apart else (),
            poses=poses,
            sigma_image_mm=of_image,
        )

    def _lens(self, spot: Spot, frame: np.ndarray | None, exposure_s: float | None) -> Range:
        """The distance at which the lens makes a spot of this size, shape and brightness."""
        values, view = self.calibration.values, self.microscope
        shape = peak = None
        if frame is not None:
            shape = spot_shape(frame, spot, response=view.response, camera=view.camera())
        if shape is not None and exposure_s is not None and "brightness" in values:
            relative = self.calibration.sigma("brightness") / values["brightness"]
            peak = shape.peak / (values["brightness"] * exposure_s), relative
        # The spot's semi-axes on the wall, mm, to first order in its size: by a pixel's step along
        # u, and one along v; NaN off the wall.
        major = minor = math.nan
        x = spot.x_px + np.array([0.5, -0.5, 0.0, 0.0])
        y = spot.y_px + np.array([0.0, 0.0, 0.5, -0.5])
        with np.errstate(invalid="ignore"):
            points = self._on_wall(self._eye({}), x, y, plane=True)
        per_px = points[:, [0, 2]] - points[:, [1, 3]]
        if not np.isnan(per_px).any():
            ellipse = AffineEllipse.from_axes(*spot.ellipse)
            major, minor = np.linalg.svd(per_px @ ellipse.shape, compute_uv=False)
        sigma = spot.sigma_semi_minor_px
        known = sigma > 0
        found = distance_from_lens(
            self._curve,
            radius_mm=minor,
            relative_sigma=math.hypot(
                (sigma if known else UNKNOWN_SIGMA_PX) / spot.semi_minor_px, self._scale_sigma
            ),
            # As of a cone: within 2.5 degrees at 30, which the radius hardly feels.
            incidence=math.acos(minor / major),
            shape=shape,
            peak_irradiance=peak,
        )
        return found if known else replace(found, sigma_mm=math.nan)


def _unit(axis: ArrayLike) -> np.ndarray:
    vector = np.asarray(axis, float)
    length = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not abs(length - 1) < _UNIT_TOLERANCE:
        raise InputError(
            "Ranger.distance(axis=...) must be a unit vector from the tip towards the wall, (3,); "
            f"got {vector.tolist()}."
        )
    return vector / length


def _slope(values: Mapping[str, Numbers]) -> Numbers:
    """k = 1/tan(half_angle), from whichever of the two a calibration has."""
    return values["k"] if "k" in values else 1 / np.tan(values["half_angle"])
