"""Measures the images of the rig: parameters, poses and images in, outputs out.

Nothing here needs ROS: a message is any object with its fields, which ROS 1 and ROS 2 name alike.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple

from pydantic import Field

from eyespot.estimator.distance.consistency import TipWay, disagreements
from eyespot.estimator.distance.range import TipPose, WallMemory
from eyespot.estimator.run import frame_bugs
from eyespot.estimator.run.offline import go_on
from eyespot.estimator.run.options import Options
from eyespot.estimator.run.reader import Reading
from eyespot.estimator.sources.ros import IMAGE_TOPIC, frame_of_message
from eyespot.estimator.sources.source import Frame
from eyespot.estimator.viewer import recording_of
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import POSE_TOPIC, Pose, PoseTrack, RobotKeys, pose_of_message
from eyespot.formats.spot import NoSpot, Reason, Spot

WAY_FRAMES = 300
"""Images with a distance after which the robot's travel is compared with the distances, and counts
anew: half a minute at 10 Hz, in which a slow withdrawal of 0.1 mm/s is three times as long as one
must be that shows something."""
POSES_KEPT = 400  # two seconds at the robot's 200 Hz; images reach the node sooner


class RecentPoses:
    """Takes poses in one thread, and gives them in any other.

    Args:
        robot: see `pose_of_message`.
    """

    def __init__(self, robot: RobotKeys | None = None) -> None:
        self._robot = robot
        self._poses: tuple[Pose, ...] = ()

    def take(self, message: Any, received_s: float) -> None:
        """Remember a pose.

        Args:
            message: see `pose_of_message`.
            received_s: when it arrived, s.

        Raises:
            InputError: its rotation is no unit quaternion, or a number is not finite.
        """
        pose = pose_of_message(message, received_s, self._robot)
        # Poses arrive in another thread. A tuple is replaced as a whole, never half changed.
        kept = self._poses[1 - POSES_KEPT :]
        # A recording that begins anew sets the clock back; the older poses lie in its future.
        self._poses = (pose,) if kept and pose.time_s < kept[-1].time_s else (*kept, pose)

    def track(self) -> PoseTrack:
        """The poses that are known now."""
        return PoseTrack(self._poses)


class Parameters(Options):
    """Parameters of the node: the options, and names of topics, where ~ is the node's own.

    Attributes:
        image_topic: `sensor_msgs/Image`, or CompressedImage if it ends in /compressed.
        pose_topic: `geometry_msgs/Transform`, mm.
        spot_topic: `geometry_msgs/PointStamped`.
        axes_topic: `geometry_msgs/Vector3Stamped`.
        range_topic: `sensor_msgs/Range`.
        beam_topic: `geometry_msgs/PoseWithCovarianceStamped`, in the mode pixels.
        status_topic: `diagnostic_msgs/DiagnosticArray`.
    """

    image_topic: str = IMAGE_TOPIC
    pose_topic: str = POSE_TOPIC
    spot_topic: str = "~/spot"
    axes_topic: str = "~/axes"
    range_topic: str = "~/range"
    beam_topic: str = "~/beam"
    status_topic: str = "~/status"
    rerun: str | None = Field(
        None, description="A recording for the viewer rerun: a file NAME.rrd, or live."
    )


Show = Callable[[Frame, Reading], None]


class RigOutput(NamedTuple):
    """A reading in the form of the messages.

    Attributes:
        centre: x and y, px, and 1; NaN, NaN, 0 where there is no spot.
        axes: semi-major and semi-minor axis, px, and the former's angle, rad; NaN without a spot.
        distance_m: from the tip to the wall along the beam; NaN where there is none.
        sigma_m: standard deviation of the distance; NaN where there is none.
        doubt: see `Reading.doubt`; of an image that cannot be measured the reason; or what the
            robot's last travel and the distances say that cannot both be.
        level: of `DiagnosticStatus`; an error if the image could not be measured, or met a bug.
        beam: tip and axis with their covariance; None but in the mode pixels.
        details: the rest, named and written as in the spots file, and the number of images that
            were measured and that were skipped.
    """

    centre: tuple[float, float, float]
    axes: tuple[float, float, float]
    distance_m: float
    sigma_m: float
    doubt: str
    level: Literal["OK", "WARN", "ERROR"]
    beam: TipPose | None
    details: dict[str, str]


class ImageReader:
    """Measures images in the order of arrival, with the last spot and the latest poses.

    Args:
        show: gets every image that was measured, with its reading.

    Raises:
        InputError: parameters or files are wrong, alone or together.
        OSError: a file cannot be read.
    """

    def __init__(self, parameters: Parameters, show: Show | None = None) -> None:
        rig = parameters.own_rig()
        self._reader = parameters.model_copy(
            update={"calibration": parameters.calibration or rig.calibration_file}
        ).reader(rig)
        self._reader.prepare()
        self._show = show
        self.poses = RecentPoses(rig.robot)
        self._robot, self._view = rig.robot, rig.view
        self._way, self._disagreement = TipWay(), ""
        self._number: int | None = None  # the publisher's, of the last image
        self._measured = 0
        self._skipped = 0

    def output(self, message: Any, time_s: float, number: int) -> RigOutput:
        """Measure an image; one that cannot be measured gives an output that says why.

        Args:
            number: that the publisher gave to the image; it counts up by one.
        """
        if self._number is not None and number > self._number:
            self._skipped += number - self._number - 1
        self._number = number
        self._measured += 1
        name = f"image {number}"
        failed = NoSpot(Reason.INTERNAL_ERROR)
        reading, fault = Reading(self._reader.mode, failed), ""
        try:
            image, full_scale = frame_of_message(message)
            frame = Frame(index=number, time_s=time_s, image=image, full_scale=full_scale)
            poses = self.poses.track()
            reading = self._reader.read(frame, poses=poses, name=name)
            self._compare(reading, poses.interpolated(time_s))
            if self._show is not None:
                self._show(frame, reading)
        except InputError as error:
            fault = f"{error}"
        except Exception as error:
            frame_bugs.note(error, name)
        counts = {"images": str(self._measured), "skipped_images": str(self._skipped)}
        return _output(reading, fault, counts, self._disagreement)

    def _compare(self, reading: Reading, pose: Pose | None) -> None:
        """Note what the robot's travel and the distances of the last images say of each other."""
        if self._reader.calibration is None:
            return
        go_on(self._way, self._reader, reading, pose)
        if self._way.frames >= WAY_FRAMES:
            found = self._way.compared(self._robot, self._view, self._reader.calibration)
            self._way, self._disagreement = TipWay(), "; ".join(disagreements(found))


@contextmanager
def opened_rig(parameters: Parameters) -> Iterator[ImageReader]:
    """The rig, and its recording, which is complete when the block ends.

    Raises:
        InputError: as `ImageReader`, or the recording cannot be made.
        OSError: a file cannot be read or written.
    """
    if parameters.rerun is None:
        yield ImageReader(parameters)
        return
    view = parameters.own_rig().view
    with recording_of(parameters.rerun, name="rig", microscope=view) as recording:
        yield ImageReader(parameters, recording.add_reading)


def _output(reading: Reading, fault: str, counts: dict[str, str], disagreement: str) -> RigOutput:
    spot, distance = reading.result, reading.range
    centre, axes = (math.nan, math.nan, 0.0), (math.nan, math.nan, math.nan)
    details = {"pose_age_s": reading.pose_age_s}
    if isinstance(spot, Spot):
        centre = (spot.x_px, spot.y_px, 1.0)
        axes = (spot.semi_major_px, spot.semi_minor_px, spot.angle_rad)
        for name in ("sigma_semi_minor_px", "edge_width_px", "coverage", "saturated"):
            details[name] = getattr(spot, name)
    if distance is not None:
        details["sigma_distance_mm"] = distance.sigma_mm
        details["distance_low_mm"], details["distance_high_mm"] = reading.interval_mm
        details |= {f"other_distance_{n}_mm": d for n, d in enumerate(distance.others_mm, 1)}
    largest = reading.budget.largest if reading.budget else None
    said = {"largest_cause": largest.cause.value} if largest else {}
    if distance is not None and distance.wall is not WallMemory.NONE:
        said["wall_memory"] = distance.wall.value
    best = distance.poses[0] if distance and distance.poses else None
    doubt = fault or reading.doubt or disagreement
    failed = fault or spot == NoSpot(Reason.INTERNAL_ERROR)
    return RigOutput(
        centre=centre,
        axes=axes,
        distance_m=reading.distance_mm / 1e3,
        sigma_m=reading.sigma_distance_mm / 1e3,
        doubt=doubt,
        level="ERROR" if failed else "WARN" if doubt else "OK",
        beam=best if best is not None and best.covariance is not None else None,
        details={name: repr(float(value)) for name, value in details.items()} | said | counts,
    )
