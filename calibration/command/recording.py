"""Records a fit for the viewer rerun: frames, spots, distances by fit and robot, residuals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from calibration.command.fitted import Fitted
from calibration.recordings import Recording
from estimator import Calibration, Ranger, Spot
from estimator.sources import open_source
from estimator.viewer import recording_of

_SPOTS_FILES = (".csv", ".parquet")


def record_fit(
    target: str,
    fitted: Fitted,
    recordings: Sequence[Recording],
    calibration: Calibration,
    *,
    exposure: str | None,
) -> None:
    """Record the frames of a fit, one recording after the other on the timeline `frame`."""
    name = ", ".join(recording.name for recording in recordings)
    touches = {row[0].removeprefix("touch of "): row[1] for row in fitted.others}
    residuals = _residuals(fitted, recordings)
    first = 0
    with recording_of(target, name=name, microscope=recordings[0].microscope) as recorded:
        for recording in recordings:
            trial = recording.trial
            ranger = Ranger(calibration, recording.microscope)
            touch = touches.get(recording.name, trial.touch.mean)
            numbers = [record.frame for record in recording.records]
            seen = zip(recording.records, trial.readings, strict=True)
            spots = dict(zip(numbers, seen, strict=True))
            for number, time_s, image in _frames(recording, exposure):
                recorded.add_frame(first + number, time_s, image)
                if number not in spots:
                    continue
                record, reading = spots[number]
                assert isinstance(record.result, Spot)
                found = ranger.distance(record.result, axis=trial.axis, frame=image)
                recorded.add_measured(record.result, found, "")
                recorded.add_value("distance/robot", touch + float(reading))
                for kind, value in next(residuals, {}).items():
                    recorded.add_value(f"residuals/{kind.replace(' ', '_')}", value)
            first += recording.frames


def _frames(
    recording: Recording, exposure: str | None
) -> Iterator[tuple[int, float, np.ndarray | None]]:
    """Number, time and image of every frame; of a spots file those with a spot, without image."""
    source = recording.source
    if source.suffix.lower() in _SPOTS_FILES:
        yield from ((record.frame, record.time_s, None) for record in recording.records)
        return
    for frame in open_source(source, exposure=exposure):
        yield frame.index, frame.time_s, frame.image


def _residuals(fitted: Fitted, recordings: Sequence[Recording]) -> Iterator[dict[str, Any]]:
    """The residuals of each usable spot, in the order of the recordings; none of pixels."""
    order = [id(recording) for recording in fitted.recordings]
    if order != [id(recording) for recording in recordings]:
        return
    for row in zip(*fitted.residuals.values(), strict=True):
        yield {name: float(value) for name, value in zip(fitted.residuals, row, strict=True)}
