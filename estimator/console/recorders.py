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
from estimator.sources import Frame, write_messages
from optics import InputError

Write = Callable[[Frame, Reading, float, PoseTrack], None]

_BEFORE_S = 0.1  # a velocity needs poses before the frame
_AFTER_S = 0.01  # a pose after the last frame; less than the time between two frames
_LATER_S = 1.0  # by so much a clock that begins at 0 is set forward: ROS reads 0 as no time
_MOST_WAITING = 100  # frames; 90 MB of 640x480 RGB, ten seconds of the rig's camera


@contextmanager
def recorder(path: Path, mode: str) -> Iterator[Write]:
    """Record until the block ends; the file gets its name then, whole or not at all.

    Args:
        path: `NAME.csv` for spots, `NAME.bag` for a ROS 1 bag with the frames.
        mode: of the reader, for spots.

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
            yield lambda frame, reading, *_: write(record_of(frame, reading, mode))
    elif path.suffix == ".bag":
        with _bag_stream(path) as write_item:
            yield _with_poses(write_item)
    else:
        raise InputError(f"{path}: a recording is named .csv (spots) or .bag (frames).")


def _with_poses(write: Callable[[list[Frame | Pose]], None]) -> Write:
    """Writes each frame between the poses before and after it, in the order of time."""
    written_s = offset_s = math.nan

    def write_frame(frame: Frame, _: Reading, arrived_s: float, poses: PoseTrack) -> None:
        nonlocal written_s, offset_s
        time_s = arrived_s if math.isnan(frame.time_s) else frame.time_s
        if math.isnan(offset_s):
            offset_s = _LATER_S if time_s < _LATER_S else 0.0
            written_s = time_s - _BEFORE_S
        before = poses.between(written_s, time_s)
        after = poses.between(max(written_s, time_s), time_s + _AFTER_S)
        messages: list[Frame | Pose] = [*before, replace(frame, time_s=time_s), *after]
        write([replace(message, time_s=message.time_s + offset_s) for message in messages])
        written_s = max(written_s, after[-1].time_s if after else time_s)

    return write_frame


@contextmanager
def _bag_stream(path: Path) -> Iterator[Callable[[list[Frame | Pose]], None]]:
    refuse_existing(path)
    waiting: Queue[list[Frame | Pose] | None] = Queue(_MOST_WAITING)
    faults: list[InputError | OSError] = []

    def work() -> None:
        try:
            write_messages(path, (one for several in iter(waiting.get, None) for one in several))
        except (InputError, OSError) as error:
            faults.append(error)

    def write(messages: list[Frame | Pose]) -> None:
        if faults:
            raise faults[0]
        try:
            waiting.put_nowait(messages)
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
