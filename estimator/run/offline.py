"""Reads a source from its first frame to its last and returns the records of the spots."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from estimator.files import PoseTrack, SpotRecord
from estimator.run.reader import Reader, Reading
from estimator.sources import Frame, Source
from optics import InputError

if TYPE_CHECKING:
    from estimator.run.overlay import Draw


class Ended(Enum):
    """How a run came to its end."""

    COMPLETE = "complete"
    INTERRUPTED = "interrupted"
    BROKEN = "broken"


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """What a run measured.

    Attributes:
        records: one a frame, in order.
        doubtful: number of doubtful distances by `RangeFlag`.
        ended: how it came to its end.
        fault: what broke it; empty unless `ended` is BROKEN.
    """

    records: list[SpotRecord]
    doubtful: Counter[str]
    ended: Ended
    fault: str = ""

    @property
    def spots(self) -> int:
        """Number of frames with a spot."""
        return sum(bool(record.result) for record in self.records)

    @property
    def no_spot(self) -> Counter[str]:
        """Number of frames without a spot, by reason."""
        return Counter(record.reason for record in self.records if not record.result)


def track_source(
    source: Source,
    reader: Reader,
    *,
    poses: PoseTrack | None = None,
    draw: Draw | None = None,
    progress: Callable[[SpotRecord], None] = lambda record: None,
) -> Tracking:
    """Measure a source's frames until it ends, breaks or is stopped with Ctrl-C.

    The records of the frames measured so far are returned even if the source breaks off.

    Args:
        source: of the frames.
        reader: new; it has not read a frame.
        poses: on the source's clock.
        draw: gets every frame with its record, see `overlay.overlay_writer`.
        progress: gets every record.

    Raises:
        InputError: the first frame cannot be measured: it is unreadable, has no time although
            there are poses, or as `Reader.read`.
        KeyboardInterrupt: stopped before the first frame was measured.
    """
    records: list[SpotRecord] = []
    doubtful: Counter[str] = Counter()
    ended, fault = Ended.COMPLETE, ""
    try:
        for frame, reading in _readings(source, reader, poses):
            record = _record(frame, reading, reader.mode)
            if draw is not None:
                draw(frame, record)
            records.append(record)
            if reading.result and reading.doubt:
                doubtful[reading.doubt] += 1
            progress(record)
    except KeyboardInterrupt:
        if not records:
            raise
        ended = Ended.COMPLETE if source.live else Ended.INTERRUPTED
    except (InputError, OSError) as error:
        if not records:
            raise
        ended, fault = Ended.BROKEN, str(error)
    if not records:
        raise InputError(f"{source.name} holds no frames. Check that it is the right one.")
    return Tracking(records=records, doubtful=doubtful, ended=ended, fault=fault)


def _readings(
    source: Source, reader: Reader, poses: PoseTrack | None
) -> Iterator[tuple[Frame, Reading]]:
    for frame in source:
        if source.unrelated:
            reader.forget()
        where = f"{source.name}, frame {frame.index}"
        if poses is not None and math.isnan(frame.time_s):
            raise InputError(
                f"{where} has no time, so that no pose belongs to it. Leave the poses out, or use"
                " a bag or a video."
            )
        try:
            reading = reader.read(
                frame.image,
                time_s=frame.time_s,
                exposure_s=frame.exposure_s,
                poses=poses or PoseTrack(()),
            )
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
        yield frame, reading


def _record(frame: Frame, reading: Reading, mode: str) -> SpotRecord:
    return SpotRecord(
        frame=frame.index,
        file_name=frame.file_name,
        time_s=frame.time_s,
        mode=mode,
        result=reading.result,
        distance_mm=reading.distance_mm,
        sigma_distance_mm=reading.sigma_distance_mm,
        pose_age_s=reading.pose_age_s,
    )
