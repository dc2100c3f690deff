"""The report of the dynamic study: sentences and tables, all from this run's numbers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import matplotlib
import numpy as np

from benchmarks.evaluation import ACCEPTABLE_ERROR_MM
from benchmarks.reporting import Data, Picture, Report, Row, Section, Table
from benchmarks.studies.dynamic import figures as pictures
from benchmarks.studies.dynamic.parts import PARTS, DynamicError, DynamicSpread, speed_at
from benchmarks.studies.dynamic.run import Findings
from benchmarks.studies.dynamic.trials import COMPARED, LATENCIES_S, LITERAL, MOTIONS, SUBPIXEL
from benchmarks.studies.validate import Conclusion, figures, number

_ASKED_MM = 0.1
"""Of the sub-pixel mode with stamped poses, up to the top speed."""

_PAPERS_SPEED_MM_S = 1.5
"""Up to which the paper's error is acceptable (Zhou et al. 2020)."""


def report(findings: Findings) -> Report:
    """The report of a run."""
    with matplotlib.rc_context(figures.STYLE):
        return Report(
            title="How wrong is the distance while the tip moves, and why?",
            lead=f"Estimates from frames of {findings.exposure_ms:g} ms while the tip moves along "
            "the beam, across the wall and as a hand moves it, against what the robot reports.",
            found=list(_found(findings)),
            sections=[_speeds(findings), _parts(findings), _frames(findings)],
            data=[
                Data("dynamic_error.csv", DynamicError, findings.rows),
                Data("dynamic_spread.csv", DynamicSpread, findings.spreads),
                *(f"{source}-rest-{LITERAL.slug}.csv" for source in findings.sources),
            ],
        )


def _found(findings: Findings) -> Iterable[Conclusion]:
    for source in findings.sources:
        yield _kept(findings, source)
    for source in findings.sources:
        for way in COMPARED:
            yield _reached(findings, source, way.name)
    for source in findings.sources:
        for way in COMPARED:
            yield from _split(findings, source, way.name)
    for source in findings.sources:
        yield from _paper(findings, source)


def _kept(findings: Findings, source: str) -> Conclusion:
    """Whether the sub-pixel mode stays within what is asked."""
    rows = [
        row
        for row in findings.rows
        if (row.source, row.way, row.latency_s) == (source, SUBPIXEL.name, LATENCIES_S[0])
    ]
    errors = [abs(row.error_mm) for row in rows if not row.doubt]
    largest = max(errors, default=math.inf)
    within = sum(error <= _ASKED_MM for error in errors)
    moved = [abs(r.blur_mm + r.stamps_mm) for r in rows if not (r.doubt or r.rest_doubt)]
    holds = largest <= _ASKED_MM
    return Conclusion(
        f"{source}, {_ASKED_MM:g} mm",
        f"Sub-pixel mode with stamped poses {'stays' if holds else 'does not stay'} within "
        f"{_ASKED_MM:g} mm up to {findings.speeds[-1]:g} mm/s ({source}).",
        f"{within} of {len(errors)} estimates are; the largest error is {number(largest, 3)} mm, "
        f"of which blur and stamps make {number(max(moved, default=math.nan), 3)} mm at most. "
        f"{len(rows) - len(errors)} of {len(rows)} frames gave no estimate that counts"
        f"{_reasons(rows)}. Exposures were {_exposures(rows)}.",
        holds,
    )


def _reached(findings: Findings, source: str, way: str) -> Conclusion:
    """The speed at which the acceptable error is reached."""
    told = {latency: _limits(findings, source, way, latency) for latency in LATENCIES_S}
    first, *later = LATENCIES_S
    return Conclusion(
        f"{source}, {way}, {ACCEPTABLE_ERROR_MM:g} mm",
        f"{source}, {way}: with stamped poses {told[first]}.",
        " ".join(f"With poses {1000 * latency:g} ms late {told[latency]}." for latency in later)
        + f" The paper names {_PAPERS_SPEED_MM_S:g} mm/s.",
    )


def _limits(findings: Findings, source: str, way: str, latency: float) -> str:
    """In words, where the acceptable error is reached in each motion."""
    if not any(s.spots for s in findings.spreads if (s.source, s.way) == (source, way)):
        return "no estimate counts"
    found = {motion: _limit(findings, source, motion, way, latency) for motion in MOTIONS}
    reached = [
        f"{number(speed, 2)} mm/s {MOTIONS[motion]}"
        for motion, speed in found.items()
        if not math.isnan(speed)
    ]
    if not reached:
        return f"the RMS error stays below {ACCEPTABLE_ERROR_MM:g} mm at all speeds"
    return f"the RMS error reaches {ACCEPTABLE_ERROR_MM:g} mm at {', '.join(reached)}"


def _limit(findings: Findings, source: str, motion: str, way: str, latency: float) -> float:
    """Speed at which the RMS error is no longer acceptable, mm/s; NaN where it stays so."""
    rows = [s for s in findings.spreads if s[:3] == (source, motion, way)]
    return speed_at([s for s in rows if s.latency_s == latency], ACCEPTABLE_ERROR_MM)


def _split(findings: Findings, source: str, way: str) -> Iterable[Conclusion]:
    """Blur and time offset at the top speed along the beam, where means do not cancel."""
    late = LATENCIES_S[-1]
    key = source, "withdrawal", way, findings.speeds[-1], late
    for row in findings.spreads:
        if row[:5] != key or not row.spots:
            continue
        of = {part: getattr(row, f"mean_{part}_mm") for part in PARTS}
        blur, latency = abs(of["blur"]), abs(of["latency"])
        larger = "by the late pose" if latency > blur else "by blur"
        yield Conclusion(
            f"{source}, {way}, parts",
            f"{source}, {way}: along the beam at {row.speed_mm_s:g} mm/s motion adds most "
            f"{larger}.",
            f"With poses {1000 * late:g} ms late the mean error of "
            f"{number(row.mean_error_mm, 3, sign=True)} mm over {row.spots} frames is the sum of "
            + ", ".join(f"{part} {number(size, 3, sign=True)}" for part, size in of.items())
            + " mm (means over frames that have both estimates).",
        )


def _paper(findings: Findings, source: str) -> Iterable[Conclusion]:
    """What would explain the paper's figure: its delay alone, or its blur alone."""
    delay = ACCEPTABLE_ERROR_MM / _PAPERS_SPEED_MM_S
    paths, blurs = [], []
    for row in findings.rows:
        key = row.source, row.motion, row.way, row.latency_s
        if key == (source, "scan", LITERAL.name, LATENCIES_S[0]) and not math.isnan(row.blur_mm):
            paths.append(row.speed_mm_s * row.exposure_s)
            blurs.append(row.blur_mm)
    if not paths:
        return
    slope = float(np.dot(paths, blurs) / np.dot(paths, paths))
    exposure = 1000 * delay / slope if slope > 0 else math.nan
    yield Conclusion(
        f"{source}, the paper's speed",
        f"Alone, {number(1000 * delay, 0)} ms between frame and pose would explain the paper's "
        f"{ACCEPTABLE_ERROR_MM:g} mm at {_PAPERS_SPEED_MM_S:g} mm/s, or blur of exposures of "
        f"{number(exposure, 0)} ms ({source}).",
        "The paper blames blur. In literal mode blur across the wall adds "
        f"{number(slope, 2, sign=True)} mm a mm of the spot's path during the exposure, by a line "
        f"through {len(paths)} frames with paths up to {number(max(paths), 3)} mm; the exposure is "
        f"where that line leads, and the camera leaves {1000 / findings.scene.clocks.camera_hz:g} "
        "ms a frame. --exposure-ms renders it.",
    )


def _speeds(findings: Findings) -> Section:
    rows: list[Row] = [
        (
            source,
            motion,
            way.name,
            *(_limit(findings, source, motion, way.name, latency) for latency in LATENCIES_S),
        )
        for source in findings.sources
        for motion in MOTIONS
        for way in COMPARED
    ]
    late = [f"{1000 * latency:g} ms late" for latency in LATENCIES_S[1:]]
    return Section(
        "Error against speed",
        "Withdrawal is along the beam, scan across the wall at one distance, hand as a hand's slow "
        "motion with what the robot leaves of its tremor. Each frame counts for the listed speed "
        "that is nearest to the tip's own. Literal mode has the paper's model with k and b from "
        "a withdrawal at rest; sub-pixel mode has the true source.",
        Picture(
            "errors",
            pictures.errors_by_speed(findings.spreads),
            "RMS error of the estimates that count; dotted: the error that the paper accepts.",
            data="dynamic_spread.csv",
        ),
        Table(
            ("source", "motion", "way", "stamped", *late),
            rows,
            f"Speed in mm/s at which the RMS error reaches {ACCEPTABLE_ERROR_MM:g} mm; a dash: it "
            f"does not up to {findings.speeds[-1]:g} mm/s, or there is no estimate.",
            digits=2,
            data="dynamic_spread.csv",
        ),
    )


def _parts(findings: Findings) -> Section:
    late = LATENCIES_S[-1]
    rows: list[Row] = [
        (
            s.source,
            s.motion,
            s.way,
            s.speed_mm_s,
            s.spots,
            s.left_out,
            s.rms_error_mm,
            *(getattr(s, f"rms_{part}_mm") for part in PARTS),
        )
        for s in findings.spreads
        if s.latency_s == late and s.speed_mm_s in (_PAPERS_SPEED_MM_S, findings.speeds[-1])
    ]
    return Section(
        "Blur and time",
        "Every motion is rendered twice: as it is, and with exposures too short for blur but equal "
        "in poses, brightness and noise. So each frame's error is the sum of four parts: rest, "
        "what the estimate from the frame without blur is off; blur, what the exposure changes in "
        "it; stamps, the age of the robot's latest pose and its clock's errors; latency, how far "
        "the robot has gone on before a pose without a stamp is read. While the tip withdraws at "
        "speed v, a pose late by L gives −vL.",
        *(
            Picture(
                f"parts_{'literal' if way is LITERAL else 'subpixel'}",
                pictures.parts_by_speed(findings.spreads, way=way.name),
                f"RMS of the parts, {way.name}, with poses {1000 * late:g} ms late.",
                data="dynamic_spread.csv",
            )
            for way in COMPARED
        ),
        Table(
            ("source", "motion", "way", "mm/s", "spots", "left out", "error", *PARTS),
            rows,
            f"RMS in mm with poses {1000 * late:g} ms late.",
            data="dynamic_spread.csv",
        ),
    )


def _frames(findings: Findings) -> Section:
    stamped = [row for row in findings.rows if row.latency_s == LATENCIES_S[0]]
    rows: list[Row] = []
    for source in findings.sources:
        for way in COMPARED:
            here = [r for r in stamped if (r.source, r.way) == (source, way.name)]
            lost = sum(bool(r.doubt) for r in here)
            rows.append((source, way.name, len(here), lost, _reasons(here)[2:], _exposures(here)))
    return Section(
        "Frames",
        Picture(
            "frames",
            pictures.frame_by_frame(findings.rows),
            "Every estimate that counts, with stamped poses.",
            data="dynamic_error.csv",
        ),
        Table(
            ("source", "way", "frames", "left out", "why", "exposures"),
            rows,
            "Frames, those without an estimate that counts, and exposures as labelled.",
            data="dynamic_error.csv",
        ),
    )


def _reasons(rows: Sequence[DynamicError]) -> str:
    counts = Counter(row.doubt for row in rows if row.doubt)
    told = ", ".join(f"{count} {reason}" for reason, count in counts.most_common())
    return f": {told}" if told else ""


def _exposures(rows: Sequence[DynamicError]) -> str:
    durations = [1000 * row.exposure_s for row in rows]
    return f"{number(min(durations), 1)} to {number(max(durations), 1)} ms"
