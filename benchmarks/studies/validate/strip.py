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

from benchmarks.evaluation import WAYS, StaticTrial, Way
from benchmarks.reporting import ORANGE, SKY
from benchmarks.studies.validate.findings import ValidateFindings
from estimator import FrameLabels, NoSpot, Spot, read_stack

_COLUMNS = 7
_MARGIN = 1.5  # of the view, in units of the largest spot
_GAP, _CAPTION = 6, 44  # between frames, and below one, px of the frames
_WIDTH_IN, _LEGEND_IN, _LEFT = 10.0, 0.25, 0.04
_DASHES = (0, (3, 2))
# The last of the ways that share an exposure is the best one.
_SHOWN = {way.exposure: way for way in WAYS}


_EllipseNumbers = tuple[float, float, float, float, float]
"""Centre, semi-axes (px) and angle (rad)."""


class Shown(NamedTuple):
    """A frame of the strip."""

    trial: StaticTrial
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


def shown_frames(findings: ValidateFindings, group: str) -> list[list[Shown]]:
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
    """The frame's row of strip.csv."""
    return StripRow(
        frame.trial.name,
        frame.way.name,
        frame.labels.file_name,
        frame.labels.d_mm,
        frame.outcome,
        *_true_ellipse(frame.labels),
        *_measured_ellipse(frame.result),
    )


def strip_figure(lines: Sequence[Sequence[Shown]], *, stacks: Path) -> Figure:
    """Draw the frames, all at one scale.

    All frames are put into one picture, because an `Axes` for each takes ten times as long.

    Args:
        lines: of `shown_frames`.
        stacks: folder of the image stacks.
    """
    half = round(_MARGIN * max(f.labels.half_max_semi_major_px for line in lines for f in line))
    half += half % 2
    step = np.array([2 * half + _GAP, 2 * half + _CAPTION])
    columns = max(len(line) for line in lines)
    width, height = step * [columns, len(lines)] - [_GAP, 0]
    picture = np.full((height, width, 3), 255, np.uint8)
    figure = Figure(figsize=(_WIDTH_IN, _WIDTH_IN * (1 - _LEFT) * height / width + _LEGEND_IN))
    bottom = _LEGEND_IN / figure.get_figheight()
    axes = figure.add_axes((_LEFT, bottom, 1 - _LEFT, 1 - bottom), frameon=False)
    per_px = 72 * _WIDTH_IN * (1 - _LEFT) / width  # points on the page
    for row, line in enumerate(lines):
        first = line[0]
        stack = read_stack(stacks / first.trial.name)
        for column, frame in enumerate(line):
            corner = step * [column, row]
            tile, origin = _tile(stack.image(frame.labels), frame.labels, half)
            picture[corner[1] :, corner[0] :][: 2 * half, : 2 * half] = tile
            _annotate(axes, frame, corner, corner - origin, half, per_px)
        name = f"{first.trial.source}, {first.way.exposure}\n{first.way.name.split(',')[0]}"
        axes.text(-4 / per_px, step[1] * row + half, name, rotation=90, ha="right", va="center")
    axes.imshow(_halved(picture), extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    axes.set_axis_off()
    figure.legend(
        handles=[
            Line2D([], [], color=SKY, lw=1.8, label="measured"),
            Line2D([], [], color=ORANGE, lw=1.2, ls=_DASHES, label="true: half of the peak"),
        ],
        loc="lower center",
        ncols=2,
    )
    return figure


def _tile(image: np.ndarray, labels: FrameLabels, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Square of the image about the spot, black outside the frame, and its first pixel (u, v)."""
    origin = np.round([labels.half_max_x_px, labels.half_max_y_px]).astype(int) - half
    padded = np.pad(image, ((2 * half, 2 * half), (2 * half, 2 * half), (0, 0)))
    u, v = origin + 2 * half
    return padded[v : v + 2 * half, u : u + 2 * half], origin


def _halved(picture: np.ndarray) -> np.ndarray:
    """The picture at half the size, which is enough for a page and has a quarter of the bytes."""
    height, width = (2 * (n // 2) for n in picture.shape[:2])
    blocks = picture[:height, :width].reshape(height // 2, 2, width // 2, 2, 3)
    return blocks.mean(axis=(1, 3)).astype(np.uint8)


def _annotate(
    axes: Axes, frame: Shown, corner: np.ndarray, shift: np.ndarray, half: int, per_px: float
) -> None:
    """Both ellipses over a tile, its distance under it, and why there is no spot."""
    middle, foot = corner[0] + half, corner[1] + 2 * half
    if frame.result:
        _outline(axes, _measured_ellipse(frame.result), shift, color=SKY, lw=1.8)
    else:
        y = foot - 4 / per_px
        axes.text(middle, y, frame.outcome, color="white", ha="center", va="bottom", size=8)
    _outline(axes, _true_ellipse(frame.labels), shift, color=ORANGE, lw=1.0, ls=_DASHES)
    text = f"$d$ = {frame.labels.d_mm:.2f} mm"
    axes.text(middle, foot + 3 / per_px, text, ha="center", va="top")


def _outline(axes: Axes, ellipse: _EllipseNumbers, shift: np.ndarray, **style: Any) -> None:
    x, y, major, minor, angle = ellipse
    middle, degrees = (x + shift[0], y + shift[1]), math.degrees(angle)
    axes.add_patch(Ellipse(middle, 2 * major, 2 * minor, angle=degrees, fill=False, **style))


def _true_ellipse(labels: FrameLabels) -> _EllipseNumbers:
    names = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad")
    x, y, major, minor, angle = (getattr(labels, f"half_max_{name}") for name in names)
    return x, y, major, minor, angle


def _measured_ellipse(result: Spot | NoSpot) -> _EllipseNumbers:
    if isinstance(result, NoSpot):
        return (math.nan,) * 5
    return result.x_px, result.y_px, result.semi_major_px, result.semi_minor_px, result.angle_rad
