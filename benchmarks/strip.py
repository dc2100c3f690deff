"""Frames of a withdrawal side by side, with the measured and the true ellipse drawn in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse

from benchmarks.figures import ORANGE, SKY
from benchmarks.tracking import WAYS, Way
from benchmarks.trials import Trial
from benchmarks.validate import Findings
from estimator import FrameLabels, NoSpot, Spot, read_stack

_COLUMNS = 7
_MARGIN = 1.3  # of the view, in units of the largest spot
# Of the ways that share an exposure the last one, which is the best there is.
_SHOWN = {way.exposure: way for way in WAYS}


class Shown(NamedTuple):
    """A frame of the strip."""

    trial: Trial
    way: Way
    labels: FrameLabels
    result: Spot | NoSpot
    outcome: str


class StripRow(NamedTuple):
    """Row of strip.csv: a frame of the strip with both ellipses; px and rad."""

    trial: str
    way: str
    file_name: str
    d_mm: float
    outcome: str
    true_x_px: float
    true_y_px: float
    true_semi_major_px: float
    true_semi_minor_px: float
    true_angle_rad: float
    x_px: float
    y_px: float
    semi_major_px: float
    semi_minor_px: float
    angle_rad: float


def shown_frames(findings: Findings, group: str) -> list[list[Shown]]:
    """One line of frames for each source and exposure, at evenly spaced distances.

    Args:
        findings: the run.
        group: place of the trials, "plane 1".
    """
    lines = []
    for trial in (trial for trial in findings.trials if trial.group == group):
        for exposure in trial.scene.exposures.kinds:
            way = _SHOWN[exposure]
            tracked = findings.tracked[trial.name, way.name]
            frames = list(zip(tracked.labels, tracked.results, tracked.outcomes, strict=True))
            chosen = np.linspace(0, len(frames) - 1, min(_COLUMNS, len(frames))).round()
            lines.append([Shown(trial, way, *frames[int(i)]) for i in chosen])
    return lines


def strip_row(frame: Shown) -> StripRow:
    """The frame's line in strip.csv."""
    return StripRow(
        frame.trial.name,
        frame.way.name,
        frame.labels.file_name,
        frame.labels.d_mm,
        frame.outcome,
        *_true_ellipse(frame.labels),
        *_measured_ellipse(frame.result),
    )


def strip(lines: Sequence[Sequence[Shown]], *, stacks: Path) -> Figure:
    """Draw the frames, all at one scale.

    Args:
        lines: of `shown_frames`.
        stacks: folder of the image stacks.
    """
    columns = max(len(line) for line in lines)
    figure = Figure(figsize=(10.0, 1.63 * len(lines) + 0.3))
    grid = figure.subplots(
        len(lines),
        columns,
        squeeze=False,
        gridspec_kw={
            "left": 0.04,
            "right": 0.999,
            "top": 0.995,
            "bottom": 0.5 / (1.63 * len(lines) + 0.3),
            "wspace": 0.03,
            "hspace": 0.14,
        },
    )
    half = _MARGIN * max(f.labels.half_max_semi_major_px for line in lines for f in line)
    for axes_row, line in zip(grid, lines, strict=True):
        first = line[0]
        stack = read_stack(stacks / first.trial.name)
        mode = first.way.name.split(",")[0]
        axes_row[0].set_ylabel(f"{first.trial.source}, {first.way.exposure}\n{mode}")
        for axes in axes_row:
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
        for axes, frame in zip(axes_row, line, strict=False):
            _draw(axes, stack.image(frame.labels), frame, half)
    figure.legend(
        handles=[
            Line2D([], [], color=SKY, lw=1.8, label="measured"),
            Line2D([], [], color=ORANGE, lw=1.2, ls=(0, (3, 2)), label="true: half of the peak"),
        ],
        loc="lower center",
        ncols=2,
    )
    return figure


def _draw(axes: Axes, image: np.ndarray, frame: Shown, half: float) -> None:
    labels = frame.labels
    height, width = image.shape[:2]
    left, top = (max(0, round(p - half)) for p in (labels.half_max_x_px, labels.half_max_y_px))
    right = min(width, round(labels.half_max_x_px + half))
    bottom = min(height, round(labels.half_max_y_px + half))
    axes.imshow(
        image[top:bottom, left:right],
        extent=(left - 0.5, right - 0.5, bottom - 0.5, top - 0.5),
    )
    if frame.result:
        _outline(axes, _measured_ellipse(frame.result), color=SKY, lw=1.8)
    _outline(axes, _true_ellipse(labels), color=ORANGE, lw=1.0, ls=(0, (3, 2)))
    note = "" if frame.result else f" ({frame.outcome})"
    axes.set_xlabel(f"$d$ = {labels.d_mm:.2f} mm{note}", labelpad=2)
    axes.grid(False)


def _outline(axes: Axes, ellipse: tuple[float, float, float, float, float], **style: Any) -> None:
    x, y, major, minor, angle = ellipse
    axes.add_patch(
        Ellipse((x, y), 2 * major, 2 * minor, angle=math.degrees(angle), fill=False, **style)
    )


def _true_ellipse(labels: FrameLabels) -> tuple[float, float, float, float, float]:
    return (
        labels.half_max_x_px,
        labels.half_max_y_px,
        labels.half_max_semi_major_px,
        labels.half_max_semi_minor_px,
        labels.half_max_angle_rad,
    )


def _measured_ellipse(result: Spot | NoSpot) -> tuple[float, float, float, float, float]:
    if isinstance(result, NoSpot):
        return (math.nan, math.nan, math.nan, math.nan, math.nan)
    return result.x_px, result.y_px, result.semi_major_px, result.semi_minor_px, result.angle_rad
