"""From a frame to a reading: the spot, its distance, the age of the robot's pose.

Recordings (`offline`) and the rig's node (`estimator.rig`) use the same reader.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from estimator.detector.literal import LiteralSettings
from estimator.detector.settings import SubpixelSettings
from estimator.detector.tracking import TrackState, measure, outlines_of
from estimator.distance.budget import AT_REST, Budget, Budgets, ToolMotion
from estimator.distance.range import Range, RangeFlag
from estimator.distance.ranger import Ranger
from estimator.run import exit_codes
from formats.calibration import Calibration
from formats.inputs import InputError
from formats.poses import Pose, PoseTrack, Quaternion, turned
from formats.spots import NoSpot, Reason, Spot
from formats.stated import Stated

if TYPE_CHECKING:
    from estimator.pixels.tracker import PixelRanger

_NO_POSES = PoseTrack(())
_SPAN_S = 0.05
"""Of the poses that a velocity is taken from: ten of the rig's, half of a frame."""
_ROBOT_MM = 0.005  # standard deviation of a place by the robot, against another one


class Reading(NamedTuple):
    """What was measured in a frame.

    Attributes:
        result: the spot, or why there is none.
        range: its distance; None without a calibration, or where there is none. The mode pixels may
            find one where no spot could be measured.
        pose_age_s: age of the robot's pose at the frame's time; NaN where none was known.
        budget: what the distance is worth; None without one.
    """

    result: Spot | NoSpot
    range: Range | None
    pose_age_s: float
    budget: Budget | None = None

    @property
    def distance_mm(self) -> float:
        """From the tip to the wall along the beam; NaN where there is none."""
        return self.range.distance_mm if self.range else math.nan

    @property
    def sigma_distance_mm(self) -> float:
        """Standard deviation of the distance; NaN where there is none."""
        return self.range.sigma_mm if self.range else math.nan

    @property
    def doubt(self) -> str:
        """A `RangeFlag` of the distance, or a `Reason` for none; empty if all is well."""
        if isinstance(self.result, NoSpot) and self.range is None:
            return self.result.reason.value
        flag = self.range.flag if self.range else RangeFlag.NONE
        return "" if flag is RangeFlag.NONE else flag.value


class Reader:
    """Reads the frames of one sequence in order, and follows the spot from frame to frame.

    Args:
        settings: whose type selects the mode.
        start: (x, y) of the spot in the first frame, px; None finds it.
        size_px: (width, height) for which the microscope file is valid; None accepts any size.
        ranger: computes the distances of spots; None for none.
        exposure_s: of all frames; None takes each frame's own.
        eye_from_robot: unit quaternion that turns the poses' frame into the eye's; with it the
            models `exact` and `area` take the beam's axis from the tool's +z, or from the beam's
            direction in the tool's frame if the calibration contains it.
        stated: uncertainties that neither spot nor calibration contains.
        pixel_ranger: finds poses by all pixels, in the ranger's place; makes the mode pixels.
    """

    def __init__(
        self,
        settings: LiteralSettings | SubpixelSettings,
        *,
        start: tuple[float, float] | None = None,
        size_px: tuple[int, int] | None = None,
        ranger: Ranger | None = None,
        exposure_s: float | None = None,
        eye_from_robot: Quaternion | None = None,
        stated: Stated | None = None,
        pixel_ranger: PixelRanger | None = None,
    ) -> None:
        self.settings = self._settings = settings
        self._start = start
        self._size_px = size_px
        self._ranger = ranger
        self._exposure_s = exposure_s
        self._eye_from_robot = eye_from_robot
        self._axis_sigma_rad = math.radians((stated or Stated()).axis_sigma_deg)
        self._clock_sigma_s = (stated or Stated()).clock_sigma_s
        self._budgets = Budgets(ranger, stated or Stated()) if ranger else None
        self._pixel_ranger = pixel_ranger
        self._state = TrackState(at_px=start)
        self._shape: tuple[int, ...] | None = None

    def forget(self) -> None:
        """Measure the next frame by itself: it does not follow the frames that were read."""
        if self._shape is not None:
            self._state = TrackState()
        if self._pixel_ranger is not None:
            self._pixel_ranger.forget()

    def look_at(self, x_px: float, y_px: float) -> None:
        """Look for the spot at (x, y) px in the next frame, as for a start."""
        self.forget()
        self._start = (x_px, y_px)
        self._state = TrackState(at_px=self._start)

    @property
    def expected_px(self) -> tuple[float, float] | None:
        """Where the spot is looked for in the next frame, (x, y) px; None in the whole frame."""
        return self._state.at_px

    @property
    def mode(self) -> str:
        """The spots file's `mode`."""
        if self._pixel_ranger is not None:
            return "pixels"
        return "literal" if isinstance(self.settings, LiteralSettings) else "subpixel"

    def read(
        self,
        image: np.ndarray,
        *,
        time_s: float = math.nan,
        exposure_s: float = math.nan,
        full_scale: float | None = None,
        poses: PoseTrack = _NO_POSES,
        name: str = "a frame",
    ) -> Reading:
        """Measure the next frame.

        A frame that meets a bug is a frame without a spot (`Reason.INTERNAL_ERROR`); the traceback
        is logged, and the next spot may be any near the last place.

        Args:
            image: as `measure` takes it.
            time_s: of the frame, on the poses' clock.
            exposure_s: of the frame; NaN if unknown.
            full_scale: at which the source says that its values end; the settings' counts before.
            name: of the frame, for the log.

        Raises:
            InputError: the image is not an image or not of the microscope's size, its full scale is
                not known, or the start lies outside of the first image.
        """
        self._check(image)
        self._settings = self._scaled(image, full_scale)
        if self._shape not in (None, image.shape):
            self.forget()
        self._shape = image.shape
        try:
            reading = self._reading(image, time_s, exposure_s, poses)
        except InputError:
            raise
        except Exception as error:
            exit_codes.note(error, name)
            self._state = TrackState(at_px=self._state.at_px)
            reading = Reading(NoSpot(Reason.INTERNAL_ERROR), None, math.nan)
        self._start = None
        return reading

    def _reading(
        self,
        image: np.ndarray,
        time_s: float,
        exposure_s: float,
        poses: PoseTrack,
    ) -> Reading:
        result, self._state = measure(image, self._state, self._settings)
        pose, age_s = poses.at(time_s) or (None, math.nan)
        own = None if math.isnan(exposure_s) else exposure_s
        if self._pixel_ranger is not None:
            times = time_s, self._exposure_s or own or 0.0
            found = self._by_pixels(self._pixel_ranger, result, image, pose, poses, times)
            return Reading(result, found, age_s)
        if self._ranger is None or self._budgets is None or isinstance(result, NoSpot):
            return Reading(result, None, age_s)
        axis = None
        if pose is not None and self._eye_from_robot is not None:
            axis = self._beam_axis(pose, self._ranger.calibration)
        distance = self._ranger.distance(
            result,
            axis=axis,
            axis_sigma_rad=self._axis_sigma_rad,
            frame=image,
            exposure_s=self._exposure_s or own,
        )
        motion = AT_REST if pose is None else self._motion(pose, poses, age_s)
        budget = self._budgets.of(result, distance, axis=axis, motion=motion)
        return Reading(result, distance, age_s, budget)

    def _by_pixels(
        self,
        ranger: PixelRanger,
        result: Spot | NoSpot,
        image: np.ndarray,
        pose: Pose | None,
        poses: PoseTrack,
        times: tuple[float, float],
    ) -> Range | None:
        """The pose by all pixels; `times` are the frame's and its exposure, s.

        None if no spot was measured and no pose was found either.
        """
        from estimator.pixels.beam import NODES, Sweep
        from estimator.pixels.frame_model import RobotPose

        axis = sweep = robot = None
        if self._eye_from_robot is not None and pose is not None:
            axis = self._beam_axis(pose, ranger.calibration)
            places = [poses.interpolated(times[0] + node * times[1]) for node in (0.0, *NODES)]
            known = [place for place in places if place is not None]
            if len(known) == len(places):
                turn = self._eye_from_robot
                tips = np.array([turned(place.position_mm, turn) for place in known])
                axes = np.stack([self._beam_axis(place, ranger.calibration) for place in known])
                sweep = Sweep(tips[1:] - tips[0], axes[1:] - axes[0])
                speed = math.hypot(*self._motion(pose, poses, 0.0).velocity_mm_s)
                robot = RobotPose(tips[0], axes[0], _ROBOT_MM + speed * self._clock_sigma_s)
        assert isinstance(self._settings, SubpixelSettings), "the mode pixels follows its spots"
        outlines = outlines_of(image, result, self._settings)
        found = ranger.distance(
            outlines,
            frame=image,
            axis=axis,
            axis_sigma_rad=self._axis_sigma_rad,
            sweep=sweep,
            robot=robot,
        )
        return found if result or found.poses else None

    def _beam_axis(self, pose: Pose, calibration: Calibration) -> np.ndarray:
        """The beam's direction at a pose of the robot, eye frame."""
        assert self._eye_from_robot is not None
        return np.array(
            turned(turned(calibration.beam_in_tool, pose.rotation), self._eye_from_robot)
        )

    def _motion(self, pose: Pose, poses: PoseTrack, age_s: float) -> ToolMotion:
        """The tool's motion at a pose, from the pose some time before."""
        before, _ = poses.at(pose.time_s - _SPAN_S) or (pose, 0.0)
        span_s = pose.time_s - before.time_s
        if span_s <= 0:
            return AT_REST
        moved = np.subtract(pose.position_mm, before.position_mm) / span_s
        x, y, z = moved.tolist()
        velocity = (x, y, z)
        if self._eye_from_robot is not None:
            velocity = turned(velocity, self._eye_from_robot)
        turn = math.acos(min(1.0, float(np.dot(pose.axis, before.axis)))) / span_s
        return ToolMotion(velocity_mm_s=velocity, turn_rad_s=turn, pose_age_s=age_s)

    def _scaled(
        self, image: np.ndarray, full_scale: float | None
    ) -> LiteralSettings | SubpixelSettings:
        """The settings with the full scale of an image."""
        known = self.settings.response.full_scale or full_scale
        if known is None and image.dtype.kind == "f" and image.max() > 1:
            raise InputError(
                f"the image has floats up to {image.max():g}, and its full scale is not known. "
                "Give full_scale (--full-scale 255 if the values were of 8 bits), or write it into "
                "the microscope file."
            )
        if known == self._settings.response.full_scale:
            return self._settings
        return replace(self.settings, response=replace(self.settings.response, full_scale=known))

    def _check(self, image: np.ndarray) -> None:
        height, width = image.shape[:2]
        if self._size_px is not None and self._size_px != (width, height):
            made_for = "x".join(map(str, self._size_px))
            raise InputError(
                f"the image is {width}x{height} px, but the microscope file is made for {made_for}"
                " px. Calibrate the microscope at the images' size."
            )
        x, y = self._start or (0.0, 0.0)
        if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
            raise InputError(
                f"the start ({x:g}, {y:g}) px lies outside of the image of {width}x{height} px."
                " Give x to the right and y down, from 0, or auto."
            )
