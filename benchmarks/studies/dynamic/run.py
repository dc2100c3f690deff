"""`eyespot study dynamic`: the error of a distance while the tip moves, and what makes it.

DIR/dynamic_error.csv  one row a frame and latency: estimate, the robot's reading, the error's parts
    dynamic_spread.csv sizes of errors and parts by speed
    SOURCE-rest-literal-paper-exposure.csv  spots at rest that literal mode is calibrated with
    stacks/            every motion, and the same with exposures too short for blur
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import scenes
from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, LITERAL, SUBPIXEL, largest
from benchmarks.reporting import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    Claim,
    Column,
    Picture,
    Report,
    Request,
    Section,
    Study,
    Table,
    rows_of,
    small_multiples,
)
from benchmarks.studies.dynamic import measure
from benchmarks.studies.dynamic.measure import (
    COMPARED,
    LATENCIES_S,
    MOTIONS,
    PARTS,
    speed_at,
    spreads,
)
from benchmarks.studies.dynamic.trials import at_rest, sensitivity, trials
from scenes import Scene, SceneError

SPEEDS_MM_S = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0)
_QUICK_SPEEDS_MM_S = (0.5, 1.5, 5.0)
_RUNS = 2

# A robot's stamps jitter; without, they would fall on the frames' own moments.
_DEFAULTS = ("clocks.kinematics_jitter_s=0.001",)


@dataclass(frozen=True, kw_only=True)
class DynamicFindings:
    """All results of a run.

    Attributes:
        scene: the study's.
        exposure_ms: at the mean distance.
        sources: kinds of light that were seen moving.
        speeds: mm/s.
        errors: every frame at every latency.
        spreads: by speed.
    """

    scene: Scene
    exposure_ms: float
    sources: tuple[str, ...]
    speeds: tuple[float, ...]
    errors: pd.DataFrame
    spreads: pd.DataFrame

    @property
    def stamped(self) -> pd.DataFrame:
        """Every frame, with stamped poses."""
        return self.errors[self.errors.latency_s == LATENCIES_S[0]]

    def by_speed(self, source: str, motion: str, way: str, latency_s: float) -> pd.DataFrame:
        """Rows that differ in the speed only, in its order."""
        of = self.spreads
        here = (of.source == source) & (of.motion == motion) & (of.way == way)
        return of[here & (of.latency_s == latency_s)].sort_values("speed_mm_s")

    def speed_limits(self, source: str, motion: str, way: str) -> list[float]:
        """Speed at which the RMS error is no longer acceptable, by latency, mm/s; NaN if none."""
        return [
            speed_at(self.by_speed(source, motion, way, latency), ACCEPTABLE_ERROR_MM)
            for latency in LATENCIES_S
        ]


def run(request: Request) -> DynamicFindings:
    """Render, read, split and report.

    Args:
        request: the arguments; its option "source" is "cone", "lens" or "both", and
            "exposure-ms" the exposure at the mean distance; metered ones grow with the distance.

    Raises:
        SceneError: the wall is no eyeball, or the spot moves out of view.
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    study = Study("dynamic", request, defaults=_DEFAULTS, check=check)
    asked = str(request.options["source"])
    sources = ("cone", "lens") if asked == "both" else (asked,)
    speeds = _QUICK_SPEEDS_MM_S if request.quick else SPEEDS_MM_S
    runs = 1 if request.quick else _RUNS
    rows = [row for source in sources for row in _rows(study, source, speeds=speeds, runs=runs)]
    errors = pd.DataFrame(rows)
    findings = DynamicFindings(
        scene=study.scene,
        exposure_ms=float(request.options["exposure-ms"]),
        sources=sources,
        speeds=speeds,
        errors=errors,
        spreads=spreads(errors, speeds),
    )
    study.publish(report, findings)
    return findings


def check(scene: Scene) -> None:
    """Refuse a scene without an eyeball, which the models need.

    Raises:
        SceneError: saying what to change.
    """
    if scene.phantom.kind != "eyeball":
        raise SceneError(
            "the study's models are those of the eyeball; got phantom.kind "
            f"'{scene.phantom.kind}'. Set phantom.kind=eyeball."
        )


def _rows(
    study: Study, source: str, *, speeds: tuple[float, ...], runs: int
) -> list[dict[str, Any]]:
    scene = scenes.changed(study.scene, {"source.kind": source})
    exposure_s = float(study.request.options["exposure-ms"]) / 1000
    with study.timed(f"{source}: render at rest"):
        rest = study.stack(f"{source}-rest", at_rest(scene))
    wanted = [
        trial
        for way in COMPARED
        for run in range(1, runs + 1)
        for trial in trials(
            scene,
            way,
            sensitivity=sensitivity(rest, scene, way, exposure_s=exposure_s),
            speeds=speeds,
            run=run,
        )
    ]
    for trial in wanted:
        if trial.speed_mm_s == speeds[-1]:  # reaches furthest, so refuse it before rendering
            scenes.check_scene(trial.moving)
    with study.timed(f"{source}: render motions"):
        moving = study.stacks({trial.name: trial.moving for trial in wanted})
        frozen = study.stacks({f"{trial.name}-frozen": trial.frozen for trial in wanted})
    with study.timed(f"{source}: measure"):
        rangers = {
            way: measure.ranger(
                rest, scene, way, spots_file=study.folder / f"{source}-rest-{way.slug}.csv"
            )
            for way in COMPARED
        }
        return [
            row
            for trial in wanted
            for row in measure.errors(
                trial,
                moving=moving[trial.name],
                frozen=frozen[f"{trial.name}-frozen"],
                ranger=rangers[trial.way],
            )
        ]


# Figures.

_WAY_COLOURS = {LITERAL: VERMILION, SUBPIXEL: BLUE}
_PART_COLOURS = dict(zip(PARTS, (GREY, ORANGE, GREEN, PURPLE), strict=True))
_SPEED = "speed of the tip (mm/s)"
_DASHES = dict(zip(LATENCIES_S, ("-", "--", ":"), strict=True))
_MARKS = dict(zip(MOTIONS, ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^")), strict=True))
_LEAST_MM = 1e-3
"""Smaller errors are drawn at the foot of a logarithmic axis."""


def errors_by_speed(findings: DynamicFindings) -> Figure:
    """RMS error against speed: a row for each source, a column for each motion."""

    def draw(axes: Axes, source: str, motion: str) -> None:
        axes.axhline(ACCEPTABLE_ERROR_MM, color=GREY, lw=0.8, ls=":")
        for way, colour in _WAY_COLOURS.items():
            for latency, dashes in _DASHES.items():
                rows = findings.by_speed(source, motion, way.name, latency)
                x, y = rows.speed_mm_s, rows.rms_error_mm.clip(lower=_LEAST_MM)
                label = f"{way.name}, {1000 * latency:g} ms late"
                axes.plot(x, y, color=colour, ls=dashes, marker="o", ms=3, label=label)

    return _by_source_and_motion(findings, draw, y="RMS error (mm)")


def parts_by_speed(findings: DynamicFindings, *, way: str) -> Figure:
    """RMS of each part of one way's error against speed, with the latest poses."""

    def draw(axes: Axes, source: str, motion: str) -> None:
        rows = findings.by_speed(source, motion, way, LATENCIES_S[-1])
        x = rows.speed_mm_s
        for part, colour in _PART_COLOURS.items():
            y = rows[f"rms_{part}_mm"].clip(lower=_LEAST_MM)
            axes.plot(x, y, color=colour, marker="o", ms=3, label=part)
        axes.plot(x, rows.rms_error_mm, color=BLACK, ls="--", label="error")

    return _by_source_and_motion(findings, draw, y="RMS (mm)")


def frame_by_frame(findings: DynamicFindings) -> Figure:
    """Error of every frame with stamped poses against the tip's speed in it."""
    stamped = findings.stamped

    def draw(axes: Axes, source: str, way: str) -> None:
        axes.axhline(0, color=GREY, lw=0.8)
        for motion, (colour, marker) in _MARKS.items():
            here = stamped[(stamped.source == source) & (stamped.motion == motion)]
            here = here[(here.way == way) & (here.doubt == "")]
            x, y = here.speed_mm_s, here.error_mm
            axes.plot(x, y, ls="", marker=marker, ms=3, color=colour, label=motion)

    ways = [way.name for way in COMPARED]
    rows = findings.sources
    return small_multiples(draw, rows=rows, columns=ways, x=_SPEED, y="error (mm)", sharex=True)


def _by_source_and_motion(
    findings: DynamicFindings, draw: Callable[[Axes, str, str], None], *, y: str
) -> Figure:
    speeds = sorted(set(findings.spreads.speed_mm_s))

    def drawn(axes: Axes, source: str, motion: str) -> None:
        draw(axes, source, motion)
        axes.set(xscale="log", yscale="log", xticks=speeds)
        axes.set_ylim(bottom=_LEAST_MM)
        axes.minorticks_off()
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")

    rows, columns = findings.sources, list(MOTIONS)
    return small_multiples(
        drawn, rows=rows, columns=columns, x=_SPEED, y=y, sharex=True, sharey=True
    )


# The page.

_REQUIRED_MM = 0.1
"""Required of the sub-pixel mode with stamped poses, up to the top speed."""

_PAPERS_SPEED_MM_S = 1.5
"""Speed up to which the paper's error is acceptable (Zhou et al. 2020)."""


def report(findings: DynamicFindings) -> Report:
    """The report of a run."""
    return Report(
        title="How wrong is the distance while the tip moves, and why?",
        lead=f"Estimates from frames of {findings.exposure_ms:g} ms while the tip moves along "
        "the beam, across the wall and as a hand moves it, against the robot's readings.",
        claims=list(_claims(findings)),
        sections=[_speeds(findings), _parts(findings), _frames(findings)],
        data={
            "dynamic_error.csv": findings.errors,
            "dynamic_spread.csv": findings.spreads,
            **{f"{source}-rest-{LITERAL.slug}.csv": None for source in findings.sources},
        },
    )


def _claims(findings: DynamicFindings) -> Iterator[Claim]:
    pairs = [(source, way.name) for source in findings.sources for way in COMPARED]
    for source in findings.sources:
        yield _requirement(findings, source)
    for source, way in pairs:
        yield from _acceptable(findings, source, way)
    for source, way in pairs:
        yield from _largest_part(findings, source, way)
    for source in findings.sources:
        yield from _papers_speed(findings, source)


def _requirement(findings: DynamicFindings, source: str) -> Claim:
    rows = _stamped(findings, source, SUBPIXEL.name)
    used = rows[rows.doubt == ""]
    return Claim(
        name=f"{source}, requirement",
        sentence="Sub-pixel mode with stamped poses is off by {value:.3f} mm at most up to "
        "{top:g} mm/s (required: {high:g} mm); blur and stamps together add up to {moved:.3f} mm. "
        "{within} of {estimates} estimates are within the requirement. {lost} of {frames} frames "
        "gave no estimate that counts. Exposures were {shortest:.1f} to {longest:.1f} ms.",
        value=largest(used.error_mm),
        high=_REQUIRED_MM,
        numbers={
            "top": findings.speeds[-1],
            "moved": largest(used.blur_mm + used.stamps_mm),
            "within": int((used.error_mm.abs() <= _REQUIRED_MM).sum()),
            "estimates": len(used),
            "lost": len(rows) - len(used),
            "frames": len(rows),
            "shortest": 1000 * rows.exposure_s.min(),
            "longest": 1000 * rows.exposure_s.max(),
            "reasons": _reasons(rows),
        },
    )


def _acceptable(findings: DynamicFindings, source: str, way: str) -> Iterator[Claim]:
    by_motion = [findings.speed_limits(source, motion, way) for motion in MOTIONS]
    for latency, speeds in zip(LATENCIES_S, zip(*by_motion, strict=True), strict=True):
        yield Claim(
            name=f"{source}, {way}, {1000 * latency:g} ms late",
            sentence="The RMS error reaches the acceptable {limit:g} mm at {value:.2f} mm/s "
            "({motions}; a dash: not up to {top:g} mm/s). The paper reports {papers:g} mm/s.",
            value=speeds,
            numbers={
                "limit": ACCEPTABLE_ERROR_MM,
                "motions": tuple(MOTIONS.values()),
                "top": findings.speeds[-1],
                "papers": _PAPERS_SPEED_MM_S,
            },
        )


def _largest_part(findings: DynamicFindings, source: str, way: str) -> Iterator[Claim]:
    """Blur and latency at the top speed along the beam, where means do not cancel."""
    late = LATENCIES_S[-1]
    for row in rows_of(findings.by_speed(source, "withdrawal", way, late)):
        if row.speed_mm_s == findings.speeds[-1] and row.spots:
            yield Claim(
                name=f"{source}, {way}, late pose against blur",
                sentence="Along the beam at {row.speed_mm_s:g} mm/s, poses {late:g} ms late add "
                "{value:.3f} mm to the mean error, blur adds {low:.3f} mm. The mean error of "
                "{row.mean_error_mm:+.3f} mm over {row.spots} frames is the sum of rest "
                "{row.mean_rest_mm:+.3f}, blur {row.mean_blur_mm:+.3f}, stamps "
                "{row.mean_stamps_mm:+.3f} and latency {row.mean_latency_mm:+.3f} mm.",
                value=abs(row.mean_latency_mm),
                low=abs(row.mean_blur_mm),
                numbers={"row": row, "late": 1000 * late},
            )


def _papers_speed(findings: DynamicFindings, source: str) -> Iterator[Claim]:
    """The delay or the blur that alone would explain the paper's error."""
    delay = ACCEPTABLE_ERROR_MM / _PAPERS_SPEED_MM_S
    rows = _stamped(findings, source, LITERAL.name)
    scans = rows[(rows.motion == "scan") & rows.blur_mm.notna()]
    if scans.empty:
        return
    paths = scans.speed_mm_s * scans.exposure_s
    slope = float(np.dot(paths, scans.blur_mm) / np.dot(paths, paths))
    yield Claim(
        name=f"{source}, the paper's speed",
        sentence="A delay of {delay:.0f} ms between frame and pose would explain the paper's "
        "{error:g} mm at {speed:g} mm/s, and so would blur of exposures of {value:.0f} ms. In "
        "literal mode blur across the wall adds {slope:+.2f} mm per mm of the spot's path during "
        "the exposure (a line through {frames} frames with paths up to {longest:.3f} mm). The "
        "camera allows {interval:g} ms a frame; --exposure-ms sets the exposure.",
        value=1000 * delay / slope if slope > 0 else math.nan,
        numbers={
            "delay": 1000 * delay,
            "error": ACCEPTABLE_ERROR_MM,
            "speed": _PAPERS_SPEED_MM_S,
            "slope": slope,
            "frames": len(scans),
            "longest": paths.max(),
            "interval": 1000 / findings.scene.clocks.camera_hz,
        },
    )


def _speeds(findings: DynamicFindings) -> Section:
    rows = [
        (source, motion, way.name, *findings.speed_limits(source, motion, way.name))
        for source in findings.sources
        for motion in MOTIONS
        for way in COMPARED
    ]
    latencies = [Column(f"{1000 * latency:g} ms late", 2) for latency in LATENCIES_S]
    return Section(
        "Error against speed",
        "Withdrawal is along the beam; scan is across the wall at one distance; hand is a hand's "
        "slow motion with the tremor that remains on a robot. Each frame counts for the listed "
        "speed that is nearest to the tip's own. Literal mode has the paper's model with k and b "
        "from a withdrawal at rest; sub-pixel mode has the true source.",
        Picture(
            "errors",
            errors_by_speed(findings),
            "RMS error of the estimates that count; dotted: the error that the paper accepts.",
            data="dynamic_spread.csv",
        ),
        Table(
            [Column("source"), Column("motion"), Column("way"), *latencies],
            rows,
            f"Speed in mm/s at which the RMS error reaches {ACCEPTABLE_ERROR_MM:g} mm. A dash: not "
            f"up to {findings.speeds[-1]:g} mm/s, or there is no estimate.",
            data="dynamic_spread.csv",
        ),
    )


def _parts(findings: DynamicFindings) -> Section:
    late = f"{1000 * LATENCIES_S[-1]:g} ms late"
    shown = (_PAPERS_SPEED_MM_S, findings.speeds[-1])
    of = findings.spreads
    latest = of[(of.latency_s == LATENCIES_S[-1]) & of.speed_mm_s.isin(shown)]
    return Section(
        "Blur and time",
        "Every motion is rendered twice: as it is, and with exposures too short for blur but the "
        "same poses, brightness and noise. So each frame's error is the sum of four parts. Rest: "
        "the error of the estimate from the frame without blur. Blur: the change of the estimate "
        "by the exposure. Stamps: the age of the robot's latest pose and its clock's errors. "
        "Latency: how far the robot has moved before a pose without a stamp is read. While the tip "
        "withdraws at speed v, a pose late by L adds −vL.",
        *(
            Picture(
                f"parts_{name}",
                parts_by_speed(findings, way=way.name),
                f"RMS of the parts, {way.name}, with poses {late}.",
                data="dynamic_spread.csv",
            )
            for name, way in (("literal", LITERAL), ("subpixel", SUBPIXEL))
        ),
        Table.of(
            latest,
            {
                "source": Column("source"),
                "motion": Column("motion"),
                "way": Column("way"),
                "speed_mm_s": Column("mm/s", 1),
                "spots": Column("spots"),
                "left_out": Column("left out"),
                "rms_error_mm": Column("error"),
                **{f"rms_{part}_mm": Column(part) for part in PARTS},
            },
            f"RMS in mm of the error and of its parts ({', '.join(PARTS)}), with poses {late}.",
            data="dynamic_spread.csv",
        ),
    )


def _frames(findings: DynamicFindings) -> Section:
    rows = []
    for source in findings.sources:
        for way in COMPARED:
            here = _stamped(findings, source, way.name)
            reasons = _reasons(here)
            why = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
            times = 1000 * here.exposure_s
            lost = sum(reasons.values())
            rows.append((source, way.name, len(here), lost, why, times.min(), times.max()))
    headings = ("source", "way", "frames", "left out", "why", "shortest, ms", "longest, ms")
    return Section(
        "Frames",
        Picture(
            "frames",
            frame_by_frame(findings),
            "Every estimate that counts, with stamped poses.",
            data="dynamic_error.csv",
        ),
        Table(
            [Column(heading, 1) for heading in headings],
            rows,
            "Frames, those without an estimate that counts, and the range of the exposures.",
            data="dynamic_error.csv",
        ),
    )


def _stamped(findings: DynamicFindings, source: str, way: str) -> pd.DataFrame:
    rows = findings.stamped
    return rows[(rows.source == source) & (rows.way == way)]


def _reasons(rows: pd.DataFrame) -> dict[Any, int]:
    """Number of frames without an estimate that counts, by reason."""
    return rows.doubt[rows.doubt != ""].value_counts().to_dict()
