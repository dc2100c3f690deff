"""Reads a source frame by frame in a thread of its own, and takes the operator's commands.

The thread measures and publishes; nobody that looks at the results can delay it.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Full, Queue

import cv2
import numpy as np

from eyespot.estimator.image import outline_px, rgb_8bit
from eyespot.estimator.run.offline import record_of
from eyespot.estimator.run.overlay import RIG_RATE_HZ
from eyespot.estimator.run.reader import Reader, Reading
from eyespot.estimator.sources.ros import write_bag
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.camera_sheet import Response
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.poses import Pose, PoseTrack
from eyespot.formats.spot import Spot
from eyespot.formats.spots import spots_stream
from eyespot.formats.whole_files import refuse_existing

Write = Callable[[Frame, Reading, float, PoseTrack], None]

_BEFORE_S = 0.1  # a velocity needs poses before the frame
_AFTER_S = 0.01  # a pose after the last frame; less than the time between two frames
_LATER_S = 1.0  # by so much a clock that begins at 0 is set forward: ROS reads 0 as no time
_MAX_WAITING_FRAMES = 100  # frames; 90 MB of 640x480 RGB, ten seconds of the rig's camera


@contextmanager
def recorder(path: Path) -> Iterator[Write]:
    """Record until the block ends; the file gets its name then, whole or not at all.

    Args:
        path: `NAME.csv` for spots, `NAME.bag` for a ROS 1 bag with the frames.

    Yields:
        A function that takes a frame, its reading, the time of its arrival, s since 1970, and the
        robot's poses that are known then; a bag gets those of its time. It does not wait for the
        disk if it records frames; InputError and OSError say what fails.

    Raises:
        InputError: the file exists, or has another suffix.
        OSError: it cannot be written.
    """
    if path.suffix == ".csv":
        with spots_stream(path) as write:
            yield lambda frame, reading, *_: write(record_of(frame, reading))
    elif path.suffix == ".bag":
        with _bag_stream(path) as write:
            yield write
    else:
        raise InputError(f"{path}: a recording is named .csv (spots) or .bag (frames).")


@contextmanager
def _bag_stream(path: Path) -> Iterator[Write]:
    """Writes each frame between the poses before and after it, in the order of time."""
    refuse_existing(path)
    waiting: Queue[list[Frame | Pose] | None] = Queue(_MAX_WAITING_FRAMES)
    faults: list[InputError | OSError] = []
    written_s = offset_s = math.nan

    def work() -> None:
        try:
            write_bag(path, frames=(one for several in iter(waiting.get, None) for one in several))
        except (InputError, OSError) as error:
            faults.append(error)

    def write(frame: Frame, _: Reading, arrived_s: float, poses: PoseTrack) -> None:
        nonlocal written_s, offset_s
        if faults:
            raise faults[0]
        time_s = arrived_s if math.isnan(frame.time_s) else frame.time_s
        if math.isnan(offset_s):
            offset_s = _LATER_S if time_s < _LATER_S else 0.0
            written_s = time_s - _BEFORE_S
        before = poses.between(written_s, time_s)
        after = poses.between(max(written_s, time_s), time_s + _AFTER_S)
        messages: list[Frame | Pose] = [*before, replace(frame, time_s=time_s), *after]
        try:
            waiting.put_nowait([replace(one, time_s=one.time_s + offset_s) for one in messages])
        except Full as error:
            raise OSError(f"{path}: the disk is slower than the camera.") from error
        written_s = max(written_s, after[-1].time_s if after else time_s)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield write
    finally:
        if thread.is_alive():
            waiting.put(None)
        thread.join()
    if faults:
        raise faults[0]


COURSE_S = 30.0
"""How much of the past the session remembers, s."""

_RETRY_S = 1.0  # after a live source was lost
_JPEG_QUALITY = 85


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A frame and what was measured in it.

    Attributes:
        number: place of the frame in its source, from 0.
        expected_px: where the spot was expected, (x, y) px; None if it was searched.
    """

    version: int
    number: int
    frame: Frame
    reading: Reading
    expected_px: tuple[float, float] | None
    arrived_s: float
    response: Response = field(default_factory=Response)

    def jpeg(self) -> bytes:
        """The frame as JPEG."""
        picture = cv2.cvtColor(rgb_8bit(self.frame.image, self.response), cv2.COLOR_RGB2BGR)
        _, content = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        return content.tobytes()


@dataclass(frozen=True)
class CoursePoint:
    """A point of the course; NaN where nothing was measured.

    Attributes:
        time_s: of the frame, or of its arrival if the frame has no time.
        radius_px: semi-minor axis.
        robot_mm: how far the robot says that the tip has withdrawn along the tool since the first
            pose that was used.
    """

    time_s: float
    distance_mm: float
    sigma_mm: float
    radius_px: float
    robot_mm: float = math.nan


class Session:
    """A source that is read for an operator until `close`.

    Args:
        open_: opens the source; a live source is opened again after it was lost.
        poses: gives the robot's poses that are known now, on the clock of the source; None without.

    Raises:
        InputError: the source cannot be opened.
    """

    def __init__(
        self,
        open_: Callable[[], Source],
        reader: Reader,
        *,
        response: Response | None = None,
        poses: Callable[[], PoseTrack] | None = None,
    ) -> None:
        self.source, self.mode = open_(), reader.mode
        self._open, self._reader, self._response = open_, reader, response or Response()
        reader.prepare()
        self.has_poses = poses is not None
        self._poses = poses or (lambda: PoseTrack(()))
        self._home: Pose | None = None  # the first pose that was used
        self.view: View | None = None
        self.fault = ""
        """What is wrong with the source; empty if it is fine."""
        self.paused = self.at_end = False
        self.recording: Path | None = None
        self.recorded = 0
        self.recording_fault = ""
        """Why the last recording ended by itself; empty if it did not."""
        self._course: deque[CoursePoint] = deque()
        self._file, self._record = ExitStack(), threading.RLock()
        self._write: Write | None = None
        self._wake = threading.Condition()
        self._ended = False
        self._steps = 0
        self._seek: int | None = None
        self._place: tuple[float, float] | None = None
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and complete the recording."""
        self._command(_ended=True)
        self._thread.join()
        self.stop_recording()

    @property
    def course(self) -> list[CoursePoint]:
        """The last `COURSE_S`, in the order of time."""
        return list(self._course)

    def pause(self, paused: bool) -> None:
        """Stop before the next frame, or go on; a recording at its end begins anew."""
        again = {"_seek": 0} if self.at_end and not paused else {}
        self._command(paused=paused, **again)

    def step(self, frames: int) -> None:
        """Pause, and go on by some frames, or back in a recording."""
        at = self.view.number if self.view else 0
        if frames > 0:
            self._command(paused=True, _steps=self._steps + frames)
        elif not self.source.live:
            self._command(paused=True, _seek=max(at + frames, 0))

    def seek(self, number: int) -> None:
        """Show a frame of a recording, by its place from 0; the nearest, if it has no such one."""
        length = self.source.length
        self._command(_seek=max(number, 0) if length is None else min(max(number, 0), length - 1))

    def look_at(self, x_px: float, y_px: float) -> None:
        """Look for the spot at a place: in the next frame, or while paused in the one shown.

        The outer half of a pixel at the border belongs to the image, too.
        """
        if self.view is None or not (math.isfinite(x_px) and math.isfinite(y_px)):
            return
        height, width = self.view.frame.image.shape[:2]
        place = min(max(x_px, 0.0), width - 1.0), min(max(y_px, 0.0), height - 1.0)
        self._command(_place=place)

    def search(self) -> None:
        """Search the next frame as a whole."""
        self._reader.forget()

    def start_recording(self, path: Path) -> None:
        """Record all frames that are measured from now on, with `recorder` and its errors."""
        self.stop_recording()
        with self._record:
            self._write = self._file.enter_context(recorder(path))
            self.recording, self.recorded, self.recording_fault = path, 0, ""

    def stop_recording(self) -> None:
        """Complete the recording; what fails is in `recording_fault`."""
        with self._record:
            self._write = self.recording = None
            try:
                self._file.close()
            except (InputError, OSError) as error:
                self.recording_fault = f"{error}"

    def _command(self, **changes: object) -> None:
        with self._wake:
            for name, value in changes.items():
                setattr(self, name, value)
            self._wake.notify()

    def _run(self) -> None:
        """Read the source; after a fault wait, and open it again if it is live."""
        while not self._ended:
            try:
                self._read_source()
            except (InputError, OSError) as error:
                self.fault = f"{error}"
            with self._wake:
                if self.source.live:
                    self._wake.wait(_RETRY_S)
                else:
                    self.paused = self.at_end = True
                    self._wake.wait_for(lambda: self._ended or self._seek is not None)
            if self.source.live and not self._ended:
                try:
                    self.source = self._open()
                except InputError as error:
                    self.fault = f"{error}"

    def _read_source(self) -> None:
        frames, number, due = iter(self.source), 0, time.monotonic()
        period_s = 0.0 if self.source.live else 1 / (self.source.rate_hz or RIG_RATE_HZ)
        while True:
            with self._wake:
                self._wake.wait_for(
                    lambda: (
                        self._ended
                        or not self.paused
                        or self._steps > 0
                        or (self._seek, self._place) != (None, None)
                    )
                )
                if self._ended:
                    return
                seek, self._seek = self._seek, None
                place, self._place = self._place, None
                stays = self.paused and not self._steps and seek is None
                self._steps -= bool(self._steps)
            if place is not None:
                self._reader.look_at(*place)
                if stays and self.view is not None:
                    self._measure(self.view.frame, self.view.number)
                if stays:
                    continue
            if seek is not None:
                self.at_end = False
                frames, number = iter(self.source), seek
                for _ in range(seek):
                    if next(frames, None) is None:
                        break
                self._reader.forget()
                self._course.clear()
            frame = next(frames, None)
            if frame is None:
                return
            if self.source.unrelated:
                self._reader.forget()
            if frame.fault:
                self.fault = f"{self.source.name}, frame {frame.index}: {frame.fault}"
            else:
                self._measure(frame, number)
                self.fault = ""
            number += 1
            due = max(due + period_s, time.monotonic() - period_s)
            with self._wake:
                self._wake.wait_for(
                    lambda: self._ended or self._seek is not None, due - time.monotonic()
                )

    def _measure(self, frame: Frame, number: int) -> None:
        arrived_s, expected, poses = time.time(), self._reader.expected_px, self._poses()
        name = f"{self.source.name}, frame {frame.index}"
        reading = self._reader.read(frame, poses=poses, name=name)
        time_s = arrived_s if math.isnan(frame.time_s) else frame.time_s
        spot, robot_mm = reading.result, math.nan
        radius = spot.semi_minor_px if isinstance(spot, Spot) else math.nan
        if self._course and time_s < self._course[-1].time_s:
            self._course.clear()  # the clock was set back
        if known := poses.at(frame.time_s):
            self._home = home = self._home or known[0]
            moved = np.subtract(known[0].position_mm, home.position_mm)
            robot_mm = -float(moved @ np.array(home.axis))
        self._course.append(
            CoursePoint(time_s, reading.distance_mm, reading.sigma_distance_mm, radius, robot_mm)
        )
        while self._course[0].time_s < time_s - COURSE_S:
            self._course.popleft()
        with self._record:
            if self._write is not None:
                try:
                    self._write(frame, reading, arrived_s, poses)
                    self.recorded += 1
                except (InputError, OSError) as error:
                    # A disk that fails ends the recording, not the measurement.
                    self.stop_recording()
                    self.recording_fault = f"{error}"
        self.view = View(
            version=self.view.version + 1 if self.view else 0,
            number=number,
            frame=frame,
            reading=reading,
            expected_px=expected,
            arrived_s=arrived_s,
            response=self._response,
        )


_EXPECTED_PX = 14  # radius of the circle where the spot was expected


def svg_of(view: View, microscope: MicroscopeFile | None) -> str:
    """The contour, its centre, the tip if it is known, and where the spot was expected."""
    camera = microscope.camera() if microscope else None
    parts = []
    distance = view.reading.range
    if microscope and not microscope.viewing_path and distance and distance.poses:
        x, y = np.asarray(microscope.pinhole().project(distance.poses[0].tip_mm)).tolist()
        x, y = (value + 0.5 for value in (camera.distorted(x, y) if camera else (x, y)))
        parts.append(
            f'<path d="M{x - 7:.1f} {y - 7:.1f}l14 14m0 -14l-14 14" stroke="#ff5ecb"'
            ' stroke-width="2" vector-effect="non-scaling-stroke"/>'
        )
    if view.expected_px is not None:
        x, y = (value + 0.5 for value in view.expected_px)
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{_EXPECTED_PX}" fill="none" stroke="#4aa3ff"'
            ' stroke-width="1.5" stroke-dasharray="4 3" vector-effect="non-scaling-stroke"/>'
        )
    spot = view.reading.result
    if isinstance(spot, Spot):
        points, centre = outline_px(spot.ellipse, camera)
        corners = " ".join(f"{x + 0.5:.1f},{y + 0.5:.1f}" for x, y in points)
        x, y = centre + 0.5
        colour = "#ffb000" if view.reading.doubt else "#2bff5e"
        parts.append(
            f'<polygon points="{corners}" fill="none" stroke="{colour}" stroke-width="2"'
            ' vector-effect="non-scaling-stroke"/>'
            f'<path d="M{x - 6:.1f} {y:.1f}h12M{x:.1f} {y - 6:.1f}v12" stroke="{colour}"'
            ' stroke-width="1.5" vector-effect="non-scaling-stroke"/>'
        )
    return "".join(parts)
