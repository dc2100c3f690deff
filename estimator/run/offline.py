"""A whole source, read, measured and recorded; and the summary of the run by reason."""

import errno
import functools
import math
from array import array
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from importlib.metadata import version
from statistics import median
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from rich.console import Group
from rich.table import Table

from eyespot.estimator.distance.consistency import TipWay, disagreements
from eyespot.estimator.distance.range import WallMemory
from eyespot.estimator.recording import Recording
from eyespot.estimator.run.ctrl_c import finish_first
from eyespot.estimator.run.progress_bar import say
from eyespot.estimator.run.reader import Reader, Reading
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import Pose, PoseTrack
from eyespot.formats.spot import NoSpot, Reason
from eyespot.formats.spots import RecordedPose, SpotRecord

if TYPE_CHECKING:
    from eyespot.estimator.run.overlay import Draw


_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


class Ended(Enum):
    """How a run came to its end."""

    COMPLETE = "complete"
    INTERRUPTED = "interrupted"
    BROKEN = "broken"
    DISK_FULL = "disk_full"


@dataclass(kw_only=True)
class Tracking:
    """What a run has measured. Except for `records` it does not grow with the number of frames.

    Attributes:
        records: one a frame, in order; empty if they are written elsewhere.
        most_significant: of the spots that are too faint, see `NoSpot.significance`; None if no
            spot is.
        doubtful: number of spots without a distance or with a doubtful one, by `Reason`.
        wall_memory: number of frames by `WallMemory`, in the mode pixels.
        pose_ages_s: ages of the robot's poses, where there are poses (8 bytes a frame).
        over_bound: standard deviations of distances over their bounds, `Range.bound_mm`, in the
            mode pixels (8 bytes a frame).
        way: the tip's by the robot and by the distances, of frames that have both and no doubt.
        repeats: number of frames that equal the one before.
        disagreements: what two sources state differently, a sentence each.
        clocks: what the times of frames and poses say that cannot be; empty if nothing.
        fault: what broke it; empty unless `ended` is BROKEN or DISK_FULL.
    """

    records: list[SpotRecord] = field(default_factory=list)
    frames: int = 0
    distances: int = 0
    no_spot: Counter[str] = field(default_factory=Counter)
    most_significant: float | None = None
    doubtful: Counter[str] = field(default_factory=Counter)
    wall_memory: Counter[str] = field(default_factory=Counter)
    pose_ages_s: "array[float]" = field(default_factory=lambda: array("d"))
    over_bound: "array[float]" = field(default_factory=lambda: array("d"))
    way: TipWay = field(default_factory=TipWay)
    repeats: int = 0
    disagreements: list[str] = field(default_factory=list)
    clocks: str = ""
    ended: Ended = Ended.COMPLETE
    fault: str = ""

    @property
    def spots(self) -> int:
        """Number of frames with a spot."""
        return self.frames - self.no_spot.total()

    def break_off(self, error: InputError | OSError) -> None:
        """Note what broke the run."""
        full = isinstance(error, OSError) and error.errno in _FULL
        self.ended, self.fault = Ended.DISK_FULL if full else Ended.BROKEN, f"{error}"
        if isinstance(error, OSError) and error.filename:
            self.fault = f"{error.filename}: {error.strerror}."

    def _count(self, record: SpotRecord) -> None:
        self.frames += 1
        self.distances += not math.isnan(record.distance_mm)
        if not record.result:
            self.no_spot[record.reason] += 1
            if not math.isnan(record.significance):
                self.most_significant = max(self.most_significant or 0.0, record.significance)
        elif record.reason:
            self.doubtful[record.reason] += 1
        if record.wall_memory:
            self.wall_memory[record.wall_memory] += 1
        if not math.isnan(record.pose_age_s):
            self.pose_ages_s.append(record.pose_age_s)


def track_source(
    recording: Recording | Source,
    reader: Reader,
    *,
    draw: "Draw | None" = None,
    show: Callable[[Frame, Reading], None] | None = None,
    write: Callable[[SpotRecord], None] | None = None,
    progress: Callable[[SpotRecord], None] = lambda record: None,
) -> Tracking:
    """Measure a recording's frames until it ends, breaks or is stopped with Ctrl-C.

    The source's notes go to the standard error. What was measured so far is returned even if the
    source breaks off. A frame that meets a bug is a frame without a spot, see `Reader.read`.

    Args:
        draw: gets every frame with its record, see `overlay.overlay_writer`.
        show: gets every frame with its reading, for a recording.
        write: gets every record, see `spots_stream`; None keeps them in `Tracking.records`,
            1 KB a frame.

    Raises:
        InputError: the first frame cannot be measured: it is unreadable, has no time although
            there are poses, or as `Reader.read`.
        OSError: its results cannot be written.
        KeyboardInterrupt: stopped before the first frame was measured.
    """
    recording = Recording.open(recording)
    source, poses = recording.source, recording.poses()
    for note in source.notes:
        say(note)
    tracking, earliest, latest = Tracking(), math.inf, -math.inf
    before: np.ndarray | None = None
    write = write or tracking.records.append
    try:
        for frame, reading in _readings(source, reader, poses):
            record = record_of(frame, reading)
            if draw is not None:
                draw(frame, record)
            if show is not None:
                show(frame, reading)
            write(record)
            tracking._count(record)
            if reading.range is not None and reading.range.bound_mm > 0:
                tracking.over_bound.append(reading.range.sigma_mm / reading.range.bound_mm)
            # A time that is not known, NaN, changes neither.
            earliest, latest = min(earliest, frame.time_s), max(latest, frame.time_s)
            if before is not None and np.array_equal(before, frame.image):
                tracking.repeats += 1
            elif poses is not None:
                go_on(tracking.way, reader, reading, poses.interpolated(frame.time_s))
            before = None if source.unrelated else frame.image
            progress(record)
    except KeyboardInterrupt:
        if not tracking.frames:
            raise
        finish_first()
        tracking.ended = Ended.COMPLETE if source.live else Ended.INTERRUPTED
    except (InputError, OSError) as error:
        if not tracking.frames:
            raise
        tracking.break_off(error)
    if not tracking.frames:
        raise InputError(f"{source.name} holds no frames. Check that it is the right one.")
    tracking.clocks = _clocks(tracking.frames, earliest, latest, poses)
    if reader.calibration is not None:
        rig = recording.rig
        found = tracking.way.compared(rig.robot, rig.view, reader.calibration)
        tracking.disagreements = disagreements(found)
    return tracking


def go_on(way: TipWay, reader: Reader, reading: Reading, pose: Pose | None) -> None:
    """Take a frame into the tip's way, if it has a distance without a doubt, and a pose."""
    if pose is None or not reading.distance_mm > 0 or reading.doubt:
        return
    budget, parts = reading.budget, {"image": reading.sigma_distance_mm}
    if budget is not None:
        parts = {part.cause.value: part.sigma_mm for part in budget.parts}
    way.add(
        position_mm=pose.position_mm,
        axis=reader.beam_of(pose),
        spot=reading.result or None,
        distance_mm=budget.corrected_mm if budget else reading.distance_mm,
        sigma_mm=parts.get("image", math.nan),
        parts_mm=parts,
    )


def _clocks(frames: int, earliest_s: float, latest_s: float, poses: PoseTrack | None) -> str:
    """What the times of the frames and of the poses say that cannot be; empty if nothing."""
    if frames > 1 and latest_s == earliest_s:
        return (
            f"All {frames} frames have the time {latest_s:.3f} s. Stamp each image with its own "
            "time."
        )
    if poses is None or not len(poses) or latest_s < earliest_s:
        return ""
    first, last = poses.times_s[0], poses.times_s[-1]
    if first == last and len(poses) > 1:
        return (
            f"All {len(poses)} poses have the time {first:.3f} s. Name the column of their times "
            "in robot.columns."
        )
    if latest_s >= first and earliest_s <= last:
        return ""
    return (
        f"No frame has a pose of its time: the frames are of {earliest_s:.3f} to "
        f"{latest_s:.3f} s, the poses of {first:.3f} to {last:.3f} s. The clocks differ: "
        "state robot.clock_offset_s, or record both with one clock."
    )


def track_whole_source(
    recording: Recording | Source,
    reader: Reader,
    *,
    progress: Callable[[SpotRecord], None] = lambda record: None,
) -> list[SpotRecord]:
    """The records of all frames of a recording, for those who need it whole.

    Raises:
        InputError: a frame cannot be measured, or the source breaks off.
        KeyboardInterrupt: Ctrl-C.
    """
    tracking = track_source(recording, reader, progress=progress)
    if tracking.ended is Ended.INTERRUPTED:
        raise KeyboardInterrupt
    if tracking.ended is not Ended.COMPLETE:
        raise InputError(tracking.fault)
    return tracking.records


def _readings(
    source: Source, reader: Reader, poses: PoseTrack | None
) -> Iterator[tuple[Frame, Reading]]:
    for frame in source:
        if source.unrelated:
            reader.forget()
        where = f"{source.name}, frame {frame.index}"
        if poses is not None and math.isnan(frame.time_s):
            raise InputError(
                f"{where} has no time, so that no pose belongs to it. Leave the poses out, or give "
                "the times: frames.csv beside the images (file,time_s), or --fps."
            )
        if frame.fault:
            yield frame, Reading(reader.mode, NoSpot(Reason.UNREADABLE))
            continue
        try:
            reading = reader.read(frame, poses=poses or PoseTrack(()), name=where)
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
        yield frame, reading


@functools.cache
def _versions() -> str:
    return f"eyespot {version('eyespot')}, OpenCV {cv2.__version__}"


def record_of(frame: Frame, reading: Reading) -> SpotRecord:
    """The line of a spots file for a frame."""
    budget, found = reading.budget, reading.range
    low, high = reading.interval_mm
    pose = None
    if found and found.poses and (best := found.poses[0]).covariance is not None:
        pose = RecordedPose(best.tip_mm, best.axis, best.covariance, found.chi_squared)
    return SpotRecord(
        frame=frame.index,
        file_name=frame.file_name,
        time_s=frame.time_s,
        mode=reading.mode,
        result=reading.result,
        distance_mm=reading.distance_mm,
        sigma_distance_mm=reading.sigma_distance_mm,
        pose_age_s=reading.pose_age_s,
        distance_low_mm=low,
        distance_high_mm=high,
        surface_distance_mm=budget.surface.reading_mm if budget else math.nan,
        largest_cause=budget.largest.cause.value if budget and budget.largest else "",
        pose=pose,
        wall_memory=found.wall.value if found else "",
        doubt=reading.doubt,
        measured_with=_versions(),
    )


def summary_of(tracking: Tracking, source: Source, mode: str, seconds: float) -> dict[str, Any]:
    """What `eyespot track --json` prints, except the names of the files written."""
    return {
        "source": source.name,
        "mode": mode,
        "unrelated": source.unrelated,
        "frames": tracking.frames,
        "spots": tracking.spots,
        "no_spot": dict(tracking.no_spot.most_common()),
        "most_significant": tracking.most_significant,
        "distances": tracking.distances,
        "doubtful_distances": tracking.doubtful,
        "wall_memory": tracking.wall_memory,
        "disagreements": tracking.disagreements,
        "repeats": tracking.repeats,
        "clocks": tracking.clocks,
        "median_pose_age_s": median(tracking.pose_ages_s) if tracking.pose_ages_s else None,
        "median_over_bound": median(tracking.over_bound) if tracking.over_bound else None,
        "seconds": round(seconds, 3),
        "ended": tracking.ended.value,
        "fault": tracking.fault,
    }


def table_of(summary: dict[str, Any]) -> Group:
    """The summary as a table, and what it does not show in sentences."""
    table = Table()
    table.add_column(summary["mode"])
    table.add_column("frames", justify="right")
    table.add_row("spot", str(summary["spots"]))
    for reason, count in summary["no_spot"].items():
        table.add_row(f"no spot: {reason.replace('_', ' ')}", str(count))
    table.add_section()
    table.add_row("all", str(summary["frames"]))
    if summary["distances"]:
        # Behind a lens all pixels tell a distance also where too little of an outline is seen.
        table.add_section()
        table.add_row("distance, with a spot or without one", str(summary["distances"]))
    for flag, count in summary["doubtful_distances"].items():
        table.add_row(f"of these doubtful: {flag.replace('_', ' ')}", str(count))
    notes = [
        f"{summary['wall_memory'][memory.value]} frames: {memory.meaning}"
        for memory in (WallMemory.MOVED, WallMemory.DROPPED)
        if memory.value in summary["wall_memory"]
    ]
    if summary["unrelated"]:
        notes.append("Every image is measured by itself; --sequence follows the spot.")
    elif "ambiguous" in summary["no_spot"]:
        notes.append("After a jump a spot is ambiguous; --unrelated ignores jumps.")
    if summary["most_significant"] is not None:
        notes.append(
            f"Faint spots are up to {summary['most_significant']:.1f} times the noise and texture "
            "round them."
        )
    if summary["median_pose_age_s"] is not None:
        notes.append(f"Median age of the pose: {1e3 * summary['median_pose_age_s']:.1f} ms.")
    if summary["median_over_bound"] is not None:
        notes.append(
            f"Distances are stated to {summary['median_over_bound']:.2f} times (median) the least "
            "that noise, texture and priors allow (Cramér-Rao bound)."
        )
    if summary["clocks"]:
        notes.append(summary["clocks"])
    if summary["repeats"]:
        notes.append(f"{summary['repeats']} frames equal the one before and say nothing new.")
    notes += [f"Disagree: {said}." for said in summary["disagreements"]]
    return Group(table, *notes)
