"""The command `eyespot track`: opens a source, tracks it, writes the results and reports.

`track` imports what it needs when it runs, so that `--help` stays fast.
"""

from __future__ import annotations

import json
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from eyespot.estimator.run.options import OUT, OUTPUT, Options, RecordingOptions, Rerun
from eyespot.estimator.run.progress_bar import progress
from eyespot.formats.inputs import InputError

if TYPE_CHECKING:
    from eyespot.estimator.recording import Recording
    from eyespot.estimator.run.offline import Tracking
    from eyespot.estimator.run.overlay import Draw
    from eyespot.estimator.run.reader import Reader, Reading
    from eyespot.estimator.sources.source import Frame, Source
    from eyespot.formats.spots import SpotRecord

_LEAST_LINE_BYTES = 60
"""Of a spots file's line for a frame without a spot; one with a spot is seven times as long."""


def track(
    source: str,
    /,
    *,
    out: Annotated[Path, OUT],
    unrelated: Annotated[bool | None, Parameter(negative="--sequence")] = None,
    options: Options = Options(),
    recorded: RecordingOptions = RecordingOptions(),
    overwrite: Annotated[bool, OUTPUT] = False,
    overlay: Annotated[Path | None, OUTPUT, Parameter(metavar="VIDEO|DIR")] = None,
    rerun: Rerun = None,
    as_json: Annotated[bool, OUTPUT, Parameter("--json")] = False,
) -> None:
    """Measure the spot in every frame and write a spots file.

    Ctrl-C ends the run, or a camera, and keeps the frames measured so far.

    Args:
        source: Stack, folder of images, TIFF, video, ROS bag, camera's number, or genicam:NAME.
        out: Spots file to write, .csv or .parquet.
        unrelated: Measure each image alone (default: by names).
        overwrite: Replace OUT if it exists.
        overlay: Draw the spots into a new video (.mp4, .avi) or folder.
        rerun: Record for the viewer rerun (.rrd), or show it there.
        as_json: Print the summary as one JSON object.
    """
    from rich.console import Console

    from eyespot.estimator.run.offline import summary_of, table_of
    from eyespot.formats.spots import spots_stream
    from eyespot.formats.whole_files import require_space

    _check_results(out, overlay, rerun, overwrite=overwrite)
    opened = recorded.opened(source, options, unrelated=unrelated)
    recording, options = opened.recording, opened.options
    frames = recording.source
    require_space(out, _LEAST_LINE_BYTES * (frames.length or 0))
    with spots_stream(out, replace=overwrite) as write:
        # Compiling the model `exact`, or tracing the lens of the model `lens`, takes time.
        with Console(stderr=True).status("Preparing"):
            reader = opened.reader()
            if frames.live:
                reader.prepare()
        began = time.perf_counter()
        with _shown(rerun, recording) as show:
            tracking, drawn = tracked(recording, reader, overlay=overlay, show=show, write=write)
    summary = summary_of(tracking, frames, reader.mode, time.perf_counter() - began) | {
        "out": str(out),
        "overlay": str(drawn) if drawn else None,
    }
    if as_json:
        print(json.dumps(summary))
    else:
        Console(markup=False).print(table_of(summary))  # a name may have brackets
        print(f"Wrote {out}" + (f" and {drawn}." if drawn else "."))
        if options.calibration:
            rig = ("--rig", str(options.rig)) if options.rig else ()
            words = ("budget", source, "--calibration", str(options.calibration), *rig)
            print(f"Next: eyespot {shlex.join(words)}")
        else:
            print("Next: eyespot fit makes the --calibration with which spots become distances.")
    _report_early_end(tracking, frames, out, drawn)


def tracked(
    recording: Recording,
    reader: Reader,
    *,
    overlay: Path | None = None,
    show: Callable[[Frame, Reading], None] | None = None,
    write: Callable[[SpotRecord], None] | None = None,
) -> tuple[Tracking, Path | None]:
    """What was measured, and the overlay; None without one or if it could not be finished.

    As `track_source`, with a progress bar.
    """
    from eyespot.estimator.run.offline import track_source
    from eyespot.estimator.run.overlay import RIG_RATE_HZ, overlay_writer

    frames, tracking, spots, settings = recording.source, None, 0, reader.settings
    drawing: AbstractContextManager[Draw | None] = nullcontext()
    if overlay is not None:
        drawing = overlay_writer(
            overlay,
            rate_hz=frames.rate_hz or RIG_RATE_HZ,
            response=settings.response,
            camera=getattr(settings, "camera", None),
        )
    try:
        with drawing as draw, progress("Tracking", total=frames.length) as advance:

            def measured(record: SpotRecord) -> None:
                nonlocal spots
                spots += bool(record.result)
                advance(note=f"{spots} spots")

            tracking = track_source(
                recording, reader, draw=draw, show=show, write=write, progress=measured
            )
    except (InputError, OSError) as error:
        if tracking is None:
            raise
        tracking.break_off(error)
        return tracking, None
    return tracking, overlay


def _check_results(out: Path, overlay: Path | None, rerun: str | None, *, overwrite: bool) -> None:
    """Find out before the run what would fail after it."""
    from eyespot.estimator.run.overlay import check_overlay_path
    from eyespot.formats.inputs import in_utf8
    from eyespot.formats.whole_files import refuse_existing

    if rerun is not None:
        from eyespot.estimator.viewer import check_recording_path

        check_recording_path(rerun)
    if out.suffix.lower() not in (".csv", ".parquet"):
        raise InputError(f"{out}: a spots file is named .csv or .parquet; got {out.suffix!r}.")
    if overlay is not None:
        check_overlay_path(overlay)
    recording = None if rerun in (None, "live") else Path(rerun)
    for path in filter(None, (out, overlay, recording)):
        if path != out or not overwrite:
            refuse_existing(path, offered=path == out)
        if path.suffix and path != out and in_utf8(path) != str(path):
            raise InputError(f"{path}: the name of a video or recording must be UTF-8. Choose one.")
        if not path.parent.is_dir():
            raise InputError(
                f"{path.parent} is not a folder. Make it, or write {path.name} elsewhere."
            )


@contextmanager
def _shown(
    target: str | None, recording: Recording
) -> Iterator[Callable[[Frame, Reading], None] | None]:
    """Records every frame with its reading and, of a stack, its labels; None for no recording."""
    if target is None:
        yield None
        return
    from eyespot.estimator.viewer import recording_of

    truth = {labels.file_name: labels for labels in recording.labels}
    with recording_of(target, name=recording.source.name, microscope=recording.view) as shown:

        def show(frame: Frame, reading: Reading) -> None:
            shown.add_reading(frame, reading)
            if frame.file_name in truth:
                shown.add_truth(truth[frame.file_name])

        yield show


def _report_early_end(tracking: Tracking, source: Source, out: Path, overlay: Path | None) -> None:
    from eyespot.estimator.run.offline import Ended

    kept = f"{out} holds the {tracking.frames} frames"
    if tracking.ended is Ended.INTERRUPTED:
        print(f"Stopped. {kept} measured so far.", file=sys.stderr)
        raise KeyboardInterrupt
    if tracking.ended is Ended.BROKEN:
        raise InputError(f"{tracking.fault} {kept} before that.")
    if tracking.ended is Ended.DISK_FULL:
        remedy = "Free some space, or choose another disk."
        if source.length and source.length > tracking.frames:
            left = source.length - tracking.frames
            written = [out, *((overlay, *overlay.rglob("*")) if overlay else ())]
            size = sum(file.stat().st_size for file in written if file.is_file())
            remedy += f" The other {left} need about {size * left / tracking.frames / 1e6:.1f} MB."
        raise InputError(f"{tracking.fault} {kept} before that. {remedy}")
