"""The command `eyespot budget`: what the distances of a source are worth, and why."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from pydantic import TypeAdapter

from eyespot.estimator.run.options import OUTPUT, Options, RecordingOptions
from eyespot.estimator.run.progress_bar import progress
from eyespot.formats.inputs import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from eyespot.estimator.distance.budget import Budget
    from eyespot.estimator.run.reader import Reading
    from eyespot.estimator.sources.source import Frame


def budget(
    source: str,
    /,
    *,
    frame: int | None = None,
    options: Options = Options(),
    recorded: RecordingOptions = RecordingOptions(),
    as_json: Annotated[bool, OUTPUT, Parameter("--json")] = False,
) -> None:
    """Say how uncertain a distance is, why, and what would halve the largest part.

    The terms are those of the GUM (JCGM 100:2008). The rig file states what the lab knows of its
    eye, robot and clocks.

    Args:
        source: Stack, folder of images, TIFF, video, or ROS bag.
        frame: Number of the frame (default: the one with the widest interval).
        as_json: Print the budget as one JSON object, and nothing else.
    """
    from rich.console import Console

    from eyespot.estimator.run.offline import track_source

    if options.mode == "auto":  # a budget is of an outline's distance
        options = options.model_copy(update={"mode": "subpixel"})
    opened = recorded.opened(source, options)
    if opened.beam is None:
        raise InputError(
            "a budget is of a distance, which needs a calibration. Give --calibration."
        )
    with Console(stderr=True).status("Preparing"):
        reader = opened.reader()
    found: dict[int, Budget] = {}

    def keep(one: Frame, reading: Reading) -> None:
        if reading.budget:
            found[one.index] = reading.budget

    with progress("Measuring", total=opened.recording.source.length) as advance:
        tracking = track_source(
            opened.recording,
            reader,
            show=keep,
            write=lambda record: None,
            progress=lambda record: advance(),
        )
    if not found:
        raise InputError(
            f"none of the {tracking.frames} frames has a distance. `eyespot track` says why; "
            "--overlay draws what it sees."
        )
    if frame is not None and frame not in found:
        raise InputError(
            f"frame {frame} has no distance. Frames with one: {min(found)} to {max(found)}, "
            f"{len(found)} of them."
        )
    chosen = max(found, key=lambda n: found[n].sigma_mm) if frame is None else frame
    if as_json:
        print(json.dumps({"frame": chosen, **_content(found[chosen])}))
        return
    console = Console()
    console.print(_table(found[chosen], chosen))
    for line in _sentences(found[chosen]):
        console.print(line, highlight=False)
    sigmas = sorted(b.sigma_mm for b in found.values())
    console.print(
        f"Of {tracking.frames} frames {len(found)} have a distance, with combined standard "
        f"uncertainties from {sigmas[0]:.3f} to {sigmas[-1]:.3f} mm.",
        highlight=False,
    )


def _table(budget: Budget, frame: int) -> Table:
    """The parts, largest first."""
    from rich.table import Table

    table = Table(title=f"Frame {frame}: what the distance is worth")
    numbers = ("u, mm", "ν", "share of u²")
    for name in ("cause", "type", *numbers, "from"):
        table.add_column(name, justify="right" if name in numbers else "left")
    for part in sorted(budget.parts, key=lambda part: -part.sigma_mm):
        share = (part.sigma_mm / budget.sigma_mm) ** 2 if budget.sigma_mm else math.nan
        known = not math.isnan(part.source_sigma)
        table.add_row(
            part.cause.meaning,
            part.cause.kind,
            f"{part.sigma_mm:.4f}",
            _freedom(part.freedom),
            f"{100 * share:.0f} %",
            f"{part.source} ± {part.source_sigma:.3g} {part.unit}".strip() if known else "",
        )
    table.add_section()
    table.add_row("combined", "", f"{budget.sigma_mm:.4f}", _freedom(budget.freedom), "", "")
    return table


def _sentences(budget: Budget) -> list[str]:
    low, high = budget.interval_mm
    lines = [f"Distance: {budget.corrected_mm:.3f} mm."]
    if budget.correction_mm:
        lines.append(
            f"The model in use reads {budget.reading_mm:.3f} mm; its error at this place, distance "
            f"and tilt is {-budget.correction_mm:+.3f} mm."
        )
    lines.append(
        f"95 % interval: {low:.3f} to {high:.3f} mm (coverage factor {budget.coverage_factor:.2f})."
    )
    if any(budget.layer_mm):
        surface = budget.surface
        near, far = surface.interval_mm
        lines.append(
            f"To the surface that a tool touches, over {budget.layer_mm[0]:.3f} mm of clear layer: "
            f"{surface.corrected_mm:.3f} mm, 95 % interval {near:.3f} to {far:.3f} mm."
        )
    if budget.largest is not None:
        lines.append(f"Largest cause: {budget.largest.cause.meaning}. {budget.largest.remedy}")
    return [*lines, *(f"Not assessed: {what}." for what in budget.left_out)]


def _content(budget: Budget) -> Any:
    """The budget for JSON, where what is infinite or unknown is null."""
    low, high = budget.interval_mm
    largest = budget.largest
    parts = [
        {
            "cause": part.cause.value,
            "type": part.cause.kind,
            "sigma_mm": part.sigma_mm,
            "degrees_of_freedom": part.freedom,
            "source": part.source,
            "source_sigma": part.source_sigma,
            "unit": part.unit,
        }
        for part in budget.parts
    ]
    content = {
        "distance_mm": budget.reading_mm,
        "correction_mm": budget.correction_mm,
        "corrected_mm": budget.corrected_mm,
        "sigma_mm": budget.sigma_mm,
        "degrees_of_freedom": budget.freedom,
        "coverage_factor": budget.coverage_factor,
        "low_mm": low,
        "high_mm": high,
        "surface_distance_mm": budget.surface.corrected_mm,
        "largest_cause": largest.cause.value if largest else None,
        "remedy": largest.remedy if largest else None,
        "parts": parts,
        "left_out": budget.left_out,
    }
    return json.loads(TypeAdapter(Any).dump_json(content))


def _freedom(value: float) -> str:
    return f"{value:.0f}" if value < 1e5 else "∞"
