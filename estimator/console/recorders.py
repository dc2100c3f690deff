"""What the operator records: a spots file, or a bag with the frames."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from queue import Full, Queue

from estimator.files import Pose, PoseTrack, refuse_existing, spots_stream
from estimator.run import Reading, record_of
from estimator.sources import Frame, write_bag
from optics import InputError

Write = Callable[[Frame, Reading, float], None]

_BEFORE_S = 0.1  # a velocity needs poses before the frame
_EARLIEST_S = 1e-9  # ROS reads 0 as no time
_MOST_WAITING = 100  # frames; 90 MB of 640x480 RGB, ten seconds of the rig's camera


@contextmanager
def recorder(path: Path, mode: str, poses: PoseTrack) -> Iterator[Write]:
    """Record until the block ends; the file gets its name then, whole or not at all.

    Args:
        path: `NAME.csv` for spots, `NAME.bag` for a ROS 1 bag with the frames.
        mode: of the reader, for spots.
        poses: of the robot, on the clock of the frames; a bag gets those of its time.

    Yields:
        A function that takes a frame, its reading, and the time of its arrival, s since 1970. It
        does not wait for the disk if it records frames; InputError and OSError say what fails.

    Raises:
        InputError: the file exists, or has another suffix.
        OSError: it cannot be written.
    """
    if path.suffix == ".csv":
        with spots_stream(path) as write:
            yield lambda frame, reading, _: write(record_of(frame, reading, mode))
    elif path.suffix == ".bag":
        with _bag_stream(path, poses) as write_frame:
            yield lambda frame, _, arrived_s: write_frame(_timed(frame, arrived_s))
    else:
        raise InputError(f"{path}: a recording is named .csv (spots) or .bag (frames).")


def _timed(frame: Frame, arrived_s: float) -> Frame:
    """A frame with a time that a bag can contain: its own, or else that of its arrival."""
    time_s = arrived_s if math.isnan(frame.time_s) else max(frame.time_s, _EARLIEST_S)
    return replace(frame, time_s=time_s)


class _Clock:
    """The time of the frames that were recorded so far."""

    def __init__(self) -> None:
        self._first = self._last = math.nan
        self._ended = False

    def of(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """The frames, whose times are noted."""
        for frame in frames:
            if math.isnan(self._first):
                self._first = frame.time_s
            self._last = frame.time_s
            yield frame
        self._ended = True

    def during(self, poses: PoseTrack) -> Iterator[Pose]:
        """Poses from a moment before the first frame to the last one. Ask for a frame first."""
        for pose in poses:
            if self._ended and not pose.time_s <= self._last:
                return
            if pose.time_s >= max(self._first - _BEFORE_S, _EARLIEST_S):
                yield pose


@contextmanager
def _bag_stream(path: Path, poses: PoseTrack) -> Iterator[Callable[[Frame], None]]:
    refuse_existing(path)
    waiting: Queue[Frame | None] = Queue(_MOST_WAITING)
    clock = _Clock()
    faults: list[InputError | OSError] = []

    def work() -> None:
        try:
            frames = clock.of(iter(waiting.get, None))
            write_bag(path, frames=frames, poses=clock.during(poses))
        except (InputError, OSError) as error:
            faults.append(error)

    def write(frame: Frame) -> None:
        if faults:
            raise faults[0]
        try:
            waiting.put_nowait(frame)
        except Full as error:
            raise OSError(f"{path}: the disk is slower than the camera.") from error

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
