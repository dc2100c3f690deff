"""From a frame to a reading: the spot, its distance, the age of the robot's pose.

Recordings (`offline`), the rig's node (`estimator.rig`) and the console give their frames to a
`Reader`; each mode is one.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np

from eyespot.estimator.detector.literal import LiteralSettings
from eyespot.estimator.detector.settings import SubpixelSettings
from eyespot.estimator.detector.tracking import TrackState, measure, outlines_of
from eyespot.estimator.distance.budget import AT_REST, Budget, Budgets, ToolMotion
from eyespot.estimator.distance.range import Range
from eyespot.estimator.distance.ranger import Ranger
from eyespot.estimator.ghost import GhostWatch
from eyespot.estimator.run import frame_bugs
from eyespot.estimator.sources.source import Frame
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import Pose, PoseTrack, Quaternion, Vector, turned
from eyespot.formats.spot import NoSpot, Reason, Spot
from eyespot.formats.stated import Stated

if TYPE_CHECKING:
    from eyespot.estimator.pixels.tracker import PixelRanger
    from eyespot.formats.calibration import Calibration
    from eyespot.formats.microscope import MicroscopeFile

_NO_POSES = PoseTrack(())
_VELOCITY_SPAN_S = 0.05  # a velocity is taken from ten of the rig's poses, half of a frame
_ROBOT_MM = 0.005  # standard deviation of a place by the robot, against another one


class Reading(NamedTuple):
    """What was measured in a frame.

    Attributes:
        range: its distance; None without a calibration, or where there is none. The mode pixels may
            find one where no spot could be measured.
        pose_age_s: age of the robot's pose at the frame's time; NaN where none was known.
    """

    mode: str
    result: Spot | NoSpot
    range: Range | None = None
    pose_age_s: float = math.nan
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
    def interval_mm(self) -> tuple[float, float]:
        """The 95 % interval of the distance: the budget's, else 1.96 sigma on either side."""
        half = 1.96 * self.sigma_distance_mm
        stated = self.distance_mm - half, self.distance_mm + half
        return self.budget.interval_mm if self.budget else stated

    @property
    def doubt(self) -> str:
        """A `Reason` for no distance or a doubtful one, or for no spot; empty if all is well."""
        reason = self.range.flag if self.range else None
        if isinstance(self.result, NoSpot) and self.range is None:
            reason = self.result.reason
        return reason.value if reason else ""


Found = tuple[Range | None, Budget | None]
S = TypeVar("S", bound=LiteralSettings | SubpixelSettings)
R = TypeVar("R", bound="Ranger | PixelRanger | None")


def _pose_at(time_s: float, poses: PoseTrack) -> tuple[Pose | None, float]:
    """The robot's newest pose at a time, and its age, s; None and NaN where there is none."""
    return poses.at(time_s) or (None, math.nan)


class Reader(ABC, Generic[S, R]):
    """Reads the frames of one sequence in order in one of the modes; no frame ends the run.

    Args:
        eye_from_robot: unit quaternion that turns the poses' frame into the eye's; with it the
            beam's axis is known from the tool's +z, or from the beam's direction in the tool's
            frame if the calibration contains it.
        start: (x, y) of the spot in the first frame, px; None finds it.
        size_px: (width, height) for which the microscope file is valid; None accepts any size.
        exposure_s: of all frames; None takes each frame's own.
    """

    mode: ClassVar[str]
    """The spots file's `mode`."""

    def __init__(
        self,
        settings: S,
        ranger: R,
        *,
        eye_from_robot: Quaternion | None = None,
        stated: Stated | None = None,
        start: tuple[float, float] | None = None,
        size_px: tuple[int, int] | None = None,
        exposure_s: float | None = None,
    ) -> None:
        self.settings = self._scaled = settings
        self._ranger, self._turn, self._stated = ranger, eye_from_robot, stated or Stated()
        self._beam_in_tool = (0.0, 0.0, 1.0)
        if ranger is not None:
            self._beam_in_tool = ranger.calibration.beam_in_tool
        self._start, self._size_px, self._exposure_s = start, size_px, exposure_s
        self._state = TrackState(at_px=start)
        self._shape: tuple[int, ...] | None = None

    def prepare(self) -> None:
        """Do now what some frame may need later, for a camera that does not wait."""
        if self._ranger is not None:
            import scipy.special  # noqa: F401 - of intervals: half a second, five of a rig's images

    @property
    def expected_px(self) -> tuple[float, float] | None:
        """Where the spot is looked for in the next frame, (x, y) px; None in the whole frame."""
        return self._state.at_px

    def forget(self) -> None:
        """Measure the next frame by itself: it does not follow the frames that were read."""
        if self._shape is not None:
            self._state = TrackState()

    def look_at(self, x_px: float, y_px: float) -> None:
        """Look for the spot at (x, y) px in the next frame, as for a start."""
        self.forget()
        self._start = (x_px, y_px)
        self._state = TrackState(at_px=self._start)

    def read(self, frame: Frame, *, poses: PoseTrack = _NO_POSES, name: str = "a frame") -> Reading:
        """Measure the next frame.

        A frame that meets a bug is a frame without a spot (`Reason.INTERNAL_ERROR`); the traceback
        is logged, and the next spot may be any near the last place.

        Args:
            frame: with an image as `measure` takes it; the settings' full scale counts before the
                frame's own.
            poses: the robot's, of some time round the frame's, on its clock.

        Raises:
            InputError: the image is not an image or not of the microscope's size, its full scale is
                not known, or the start lies outside of the first image.
        """
        self._check(frame.image)
        if self._shape not in (None, frame.image.shape):
            self.forget()
        self._shape = frame.image.shape
        if self._exposure_s is not None:
            frame = replace(frame, exposure_s=self._exposure_s)
        try:
            self._scale(frame)
            result, self._state = measure(frame.image, self._state, self._scaled)
            found, budget = self._distance(result, frame, poses)
            _, age_s = _pose_at(frame.time_s, poses)
            reading = Reading(self.mode, result, found, age_s, budget)
        except InputError:
            raise
        except Exception as error:
            frame_bugs.note(error, name)
            self._state = TrackState(at_px=self.expected_px)
            reading = Reading(self.mode, NoSpot(Reason.INTERNAL_ERROR))
        self._start = None
        return reading

    @abstractmethod
    def _distance(self, result: Spot | NoSpot, frame: Frame, poses: PoseTrack) -> Found:
        """The distance and what it is worth; None where there is none."""

    def _axis(self, pose: Pose | None) -> np.ndarray | None:
        """The beam's direction at a pose of the robot, eye frame; None if unknown."""
        if pose is None or self._turn is None:
            return None
        return np.array(turned(self.beam_of(pose), self._turn))

    def beam_of(self, pose: Pose) -> Vector:
        """The beam's direction at a pose of the robot, in the robot's frame."""
        return turned(self._beam_in_tool, pose.rotation)

    @property
    def calibration(self) -> "Calibration | None":
        """Of the beam; None without one."""
        return None if self._ranger is None else self._ranger.calibration

    def _motion(self, time_s: float, poses: PoseTrack) -> ToolMotion:
        """The tool's motion at a frame's pose, from the pose some time before."""
        pose, age_s = _pose_at(time_s, poses)
        if pose is None:
            return AT_REST
        before, _ = poses.at(pose.time_s - _VELOCITY_SPAN_S) or (pose, 0.0)
        span_s = pose.time_s - before.time_s
        if span_s <= 0:
            return AT_REST
        x, y, z = (np.subtract(pose.position_mm, before.position_mm) / span_s).tolist()
        velocity = (x, y, z) if self._turn is None else turned((x, y, z), self._turn)
        turn = math.acos(min(1.0, float(np.dot(pose.axis, before.axis)))) / span_s
        return ToolMotion(velocity_mm_s=velocity, turn_rad_s=turn, pose_age_s=age_s)

    def _scale(self, frame: Frame) -> None:
        """Take over the full scale of a frame."""
        known = self.settings.response.full_scale or frame.full_scale
        if known is None and frame.image.dtype.kind == "f" and frame.image.max() > 1:
            raise InputError(
                f"the image has floats up to {frame.image.max():g}, and its full scale is not "
                "known. State camera.full_scale of the rig file: 255 if the values were of 8 "
                "bits."
            )
        if known != self._scaled.response.full_scale:
            response = replace(self.settings.response, full_scale=known)
            self._scaled = replace(self.settings, response=response)

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


class _OutlineMode(Reader[S, Ranger | None]):
    """The distance from the spot's outline, by one of the models."""

    def _distance(self, result: Spot | NoSpot, frame: Frame, poses: PoseTrack) -> Found:
        if self._ranger is None or isinstance(result, NoSpot):
            return None, None
        pose, _ = _pose_at(frame.time_s, poses)
        axis = self._axis(pose)
        found = self._ranger.distance(
            result,
            axis=axis,
            axis_sigma_rad=math.radians(self._stated.axis_sigma_deg),
            frame=frame.image,
            exposure_s=None if math.isnan(frame.exposure_s) else frame.exposure_s,
        )
        motion = self._motion(frame.time_s, poses)
        return found, Budgets(self._ranger, self._stated).of(
            result, found, axis=axis, motion=motion
        )


class LiteralMode(_OutlineMode[LiteralSettings]):
    """The paper's Algorithms 1 and 2."""

    mode = "literal"


class SubpixelMode(_OutlineMode[SubpixelSettings]):
    """The half-maximum contour; a sharp spot with a ghost has no distance."""

    mode = "subpixel"

    def __init__(self, settings: SubpixelSettings, ranger: Ranger | None, **about: Any) -> None:
        uneven = ranger is not None and ranger.model == "lens"
        super().__init__(replace(settings, uneven_top=uneven), ranger, **about)
        self.ghosts = GhostWatch()

    def forget(self) -> None:
        """Measure the next frame by itself."""
        super().forget()
        self.ghosts = GhostWatch()

    def _distance(self, result: Spot | NoSpot, frame: Frame, poses: PoseTrack) -> Found:
        if isinstance(result, Spot):
            self.ghosts.look(frame.image, result)
        found, budget = super()._distance(result, frame, poses)
        if found is None or self.ghosts.found is None:
            return found, budget
        return Range(distance_mm=math.nan, sigma_mm=math.nan, missing=Reason.GHOST), None


class PixelsMode(Reader[SubpixelSettings, "PixelRanger"]):
    """The pose from all pixels; the spot is looked for as in the sub-pixel mode."""

    mode = "pixels"

    def prepare(self) -> None:
        """Compile the light of a moving tip, too, which few recordings need."""
        self._ranger.compile()

    def forget(self) -> None:
        """Measure the next frame by itself, on a wall that is not known."""
        super().forget()
        if self._shape is not None:
            self._ranger.forget()

    def _distance(self, result: Spot | NoSpot, frame: Frame, poses: PoseTrack) -> Found:
        from eyespot.estimator.pixels.beam_on_cells import NODES, Sweep
        from eyespot.estimator.pixels.frame_model import Direction, RobotPose

        direction = sweep = robot = None
        pose, _ = _pose_at(frame.time_s, poses)
        axis, turn = self._axis(pose), self._turn
        if axis is not None and turn is not None:
            direction = Direction(axis, math.radians(self._stated.axis_sigma_deg))
            exposure_s = 0.0 if math.isnan(frame.exposure_s) else frame.exposure_s
            places = [poses.interpolated(frame.time_s + n * exposure_s) for n in (0.0, *NODES)]
            known = [place for place in places if place is not None]
            if len(known) == len(places):
                tips = np.array([turned(place.position_mm, turn) for place in known])
                axes = np.array([self._axis(place) for place in known])
                sweep = Sweep(tips[1:] - tips[0], axes[1:] - axes[0])
                speed = math.hypot(*self._motion(frame.time_s, poses).velocity_mm_s)
                sigma_mm = _ROBOT_MM + speed * self._stated.clock_sigma_s
                robot = RobotPose(tips[0], axes[0], sigma_mm)
        found = self._ranger.distance(
            outlines_of(frame.image, result, self._scaled),
            frame=frame.image,
            direction=direction,
            sweep=sweep,
            robot=robot,
        )
        # Bright things that are no spots have no distance, and no doubt about one.
        if not (result or found.poses):
            return None, None
        return found, Budgets(self._ranger, self._stated).of(result, found, axis=axis)


_MAX_RATE_HZ = 12.0  # pixels takes 72 ms a frame on two cores


def best_mode(
    beam: "Calibration | None",
    microscope: "MicroscopeFile | None",
    *,
    asked: str = "",
    rate_hz: float | None = None,
) -> tuple[str, str]:
    """The mode `auto`: pixels where an outline is not enough and the camera permits it.

    A cone has a sharp edge, and its outline measures distances as well as all pixels do.

    Args:
        asked: option that only the models of outlines have; empty if there is none.
        rate_hz: of a camera; None for a recording, which waits.

    Returns:
        The name of the mode, and why in a sentence or two; empty if nothing was to choose.
    """
    if beam is None or microscope is None:
        return "subpixel", ""
    if beam.model != "lens":
        return "subpixel", "Mode subpixel, because a cone's outline is as good as all its pixels."
    several = "behind a lens one outline may belong to several distances."
    hindrance = (
        f"{asked} is one of outlines"
        if asked
        else "the rig file lacks the camera's noise"
        if microscope.noise is None
        else "the microscope has distortion"
        if microscope.camera() is not None
        else f"the mode pixels reads {_MAX_RATE_HZ:g} frames a second, and the camera has "
        f"{rate_hz:g}"
        if rate_hz is not None and rate_hz > _MAX_RATE_HZ
        else ""
    )
    if hindrance:
        return "subpixel", f"Mode subpixel, because {hindrance}. B{several[1:]}"
    return "pixels", f"Mode pixels, because {several}"
