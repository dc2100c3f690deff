"""The report of the dynamic study."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, LITERAL, SUBPIXEL, largest
from benchmarks.reporting import Claim, Column, Picture, Report, Section, Table, frame_of
from benchmarks.studies.dynamic import figures
from benchmarks.studies.dynamic.findings import (
    COMPARED,
    LATENCIES_S,
    MOTIONS,
    PARTS,
    DynamicError,
    DynamicFindings,
    DynamicSpread,
)

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
            "dynamic_error.csv": frame_of(DynamicError, findings.rows),
            "dynamic_spread.csv": frame_of(DynamicSpread, findings.spreads),
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
    rows = [row for row in findings.stamped if (row.source, row.way) == (source, SUBPIXEL.name)]
    errors = [abs(row.error_mm) for row in rows if not row.doubt]
    exposures = [1000 * row.exposure_s for row in rows]
    return Claim(
        name=f"{source}, requirement",
        sentence="Sub-pixel mode with stamped poses is off by {value:.3f} mm at most up to "
        "{top:g} mm/s (required: {high:g} mm); blur and stamps together add up to {moved:.3f} mm. "
        "{within} of {estimates} estimates are within the requirement. {lost} of {frames} frames "
        "gave no estimate that counts. Exposures were {shortest:.1f} to {longest:.1f} ms.",
        value=largest(errors),
        high=_REQUIRED_MM,
        numbers={
            "top": findings.speeds[-1],
            "moved": largest(r.blur_mm + r.stamps_mm for r in rows if not r.doubt),
            "within": sum(error <= _REQUIRED_MM for error in errors),
            "estimates": len(errors),
            "lost": len(rows) - len(errors),
            "frames": len(rows),
            "shortest": min(exposures),
            "longest": max(exposures),
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
    for row in findings.by_speed(source, "withdrawal", way, late):
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
    scans = [
        row
        for row in findings.stamped
        if row[:3] == (source, "scan", LITERAL.name) and not math.isnan(row.blur_mm)
    ]
    if not scans:
        return
    paths = [row.speed_mm_s * row.exposure_s for row in scans]
    slope = float(np.dot(paths, [row.blur_mm for row in scans]) / np.dot(paths, paths))
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
            "longest": max(paths),
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
            figures.errors_by_speed(findings),
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
    latest = [row for row in findings.spreads if row.latency_s == LATENCIES_S[-1]]
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
                figures.parts_by_speed(findings, way=way.name),
                f"RMS of the parts, {way.name}, with poses {late}.",
                data="dynamic_spread.csv",
            )
            for name, way in (("literal", LITERAL), ("subpixel", SUBPIXEL))
        ),
        Table.of_rows(
            DynamicSpread,
            [row for row in latest if row.speed_mm_s in shown],
            f"RMS in mm of the error and of its parts ({', '.join(PARTS)}), with poses {late}.",
            data="dynamic_spread.csv",
        ),
    )


def _frames(findings: DynamicFindings) -> Section:
    rows = []
    for source in findings.sources:
        for way in COMPARED:
            here = [r for r in findings.stamped if (r.source, r.way) == (source, way.name)]
            reasons = _reasons(here)
            why = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
            durations = [1000 * row.exposure_s for row in here]
            lost = sum(reasons.values())
            rows.append((source, way.name, len(here), lost, why, min(durations), max(durations)))
    headings = ("source", "way", "frames", "left out", "why", "shortest, ms", "longest, ms")
    return Section(
        "Frames",
        Picture(
            "frames",
            figures.frame_by_frame(findings),
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


def _reasons(rows: Sequence[DynamicError]) -> dict[str, int]:
    """Number of frames without an estimate that counts, by reason."""
    return dict(Counter(row.doubt for row in rows if row.doubt).most_common())
