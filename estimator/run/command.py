"""The command `eyespot track`: opens what it is given, shows progress, writes and reports."""

from __future__ import annotations

import json
import sys
import time
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console

from estimator.detector import SubpixelSettings
from estimator.files import SpotRecord, pyarrow, read_poses, write_spots
from estimator.run.offline import Ended, track_source
from estimator.run.options import Options
from estimator.run.overlay import RIG_RATE_HZ, check_overlay_path, overlay
from estimator.run.progress_bar import progress
from estimator.run.summary import summary_of, table_of
from estimator.sources import open_source


def run(
    source_name: str,
    *,
    out: Path,
    mode: str = "subpixel",
    start: str = "auto",
    exposure: str | None = None,
    image_topic: str | None = None,
    microscope_file: Path | None = None,
    pinhole_height_mm: float | None = None,
    eye_radius_mm: float | None = None,
    calibration_file: Path | None = None,
    model: str | None = None,
    eccentricity_mm: float | None = None,
    exposure_s: float | None = None,
    poses_file: Path | None = None,
    pose_topic: str | None = None,
    eye_from_robot: str | None = None,
    overlay_path: Path | None = None,
    as_json: bool = False,
) -> None:
    """Track a source into a spots file.

    Args:
        source_name: as `sources.open_source` takes it.
        out: the spots file, `.csv` or `.parquet`; must not exist.
        mode: as in `Options`.
        start: as in `Options`, "X,Y" or "auto".
        exposure: of a stack with several.
        image_topic: of a bag.
        microscope_file: as in `Options`; by default the stack's own.
        pinhole_height_mm: as in `Options`.
        eye_radius_mm: as in `Options`.
        calibration_file: as in `Options`.
        model: as in `Options`.
        eccentricity_mm: as in `Options`.
        exposure_s: as in `Options`; a stack tells its own.
        poses_file: CSV or bag of the robot's poses, for their age at each frame.
        pose_topic: of the poses' bag.
        eye_from_robot: as in `Options`, "QX,QY,QZ,QW".
        overlay_path: video or folder to draw into; must not exist.
        as_json: print the summary as one JSON object instead of a table.

    Raises:
        ValueError: bad input; also after the spots of a source that breaks off are written.
        KeyboardInterrupt: stopped, after the spots measured so far are written.
    """
    _check_results(out, overlay_path)
    if poses_file is None:
        for name, value in (("pose_topic", pose_topic), ("eye_from_robot", eye_from_robot)):
            if value is not None:
                raise ValueError(f"{name} does nothing without poses. Give both, or neither.")
    source = open_source(source_name, exposure=exposure, image_topic=image_topic)
    options = Options.of(
        {
            "mode": mode,
            "start": start,
            "microscope": microscope_file or source.microscope_file,
            "pinhole_height_mm": pinhole_height_mm,
            "eye_radius_mm": eye_radius_mm,
            "calibration": calibration_file,
            "model": model,
            "eccentricity_mm": eccentricity_mm,
            "exposure_s": exposure_s,
            "eye_from_robot": eye_from_robot,
        }
    )
    poses = read_poses(poses_file, topic=pose_topic) if poses_file else None
    console = Console(stderr=True)
    with console.status("Preparing"):  # compiling `exact` or tracing the lens of `lens` takes time
        reader = options.reader()
    began = time.perf_counter()
    with ExitStack() as stack:
        draw = None
        if overlay_path is not None:
            settings = reader.settings
            draw = stack.enter_context(
                overlay(
                    overlay_path,
                    rate_hz=source.rate_hz or RIG_RATE_HZ,
                    response=settings.response,
                    camera=settings.camera if isinstance(settings, SubpixelSettings) else None,
                )
            )
        advance = stack.enter_context(progress("Tracking", total=source.length))
        spots = 0

        def measured(record: SpotRecord) -> None:
            nonlocal spots
            spots += bool(record.result)
            advance(note=f"{spots} spots")

        tracking = track_source(source, reader, poses=poses, draw=draw, progress=measured)
    seconds = time.perf_counter() - began
    write_spots(out, tracking.records)
    summary = summary_of(tracking, source, mode, seconds) | {
        "out": str(out),
        "overlay": str(overlay_path) if overlay_path else None,
    }
    if as_json:
        print(json.dumps(summary))
    else:
        Console().print(table_of(summary))
        print(f"Wrote {out}" + (f" and {overlay_path}." if overlay_path else "."))
    if tracking.ended is Ended.INTERRUPTED:
        kept = f"{out} holds the {len(tracking.records)} frames measured so far."
        print(f"Stopped. {kept}", file=sys.stderr)
        raise KeyboardInterrupt
    if tracking.ended is Ended.BROKEN:
        raise ValueError(
            f"{tracking.fault} {out} holds the {len(tracking.records)} frames before that."
        )


def _check_results(out: Path, overlay_path: Path | None) -> None:
    """What would go wrong only when all frames are measured goes wrong now."""
    if out.suffix.lower() not in (".csv", ".parquet"):
        raise ValueError(f"{out}: a spots file is named .csv or .parquet; got {out.suffix!r}.")
    if out.suffix.lower() == ".parquet":
        pyarrow()
    if overlay_path is not None:
        check_overlay_path(overlay_path)
    for path in filter(None, (out, overlay_path)):
        if path.exists():
            raise ValueError(
                f"{path} exists already. Choose another name; nothing is written over."
            )
        if not path.parent.is_dir():
            raise ValueError(
                f"{path.parent} is no folder. Make it, or write {path.name} elsewhere."
            )
