"""The report of the study of poses: sentences and tables, all from this run's numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import matplotlib
import numpy as np

from benchmarks.reporting import Data, Picture, Report, Row, Section, Table
from benchmarks.studies.pose import analytic
from benchmarks.studies.pose import figures as pictures
from benchmarks.studies.pose.errors import (
    ASKED_AXIS_DEG,
    ASKED_DISTANCE_MM,
    ASKED_TIP_MM,
    FREE,
    KNOWN,
    NAMES,
    PRIOR,
    PRIOR_DEG,
    REPORTED,
    PoseError,
    rms,
    scatter,
    some_of,
)
from benchmarks.studies.pose.run import LARGEST_C_MM, Findings
from benchmarks.studies.validate import Conclusion, figures, number

_SOURCES = ("analytic", "rendered")


def report(findings: Findings) -> Report:
    """The report of a run."""
    rows = findings.rows
    with matplotlib.rc_context(figures.STYLE):
        return Report(
            title="How well do one spot and three tell where the tool is?",
            lead="Tip and axis, five parameters, of an ideal cone: from exact contours with noise "
            "over a working volume of 10 × 10 × 5 mm, and from rendered frames.",
            found=list(_found(rows)),
            sections=[
                Section(
                    "Errors",
                    _table(rows),
                    Picture(
                        "incidence",
                        pictures.by_incidence(rows),
                        "Errors of tip and axis against the incidence, direction prior "
                        f"{PRIOR_DEG:g}°, mirrored solutions left out: dots are contours with "
                        f"noise of {analytic.NOISE_PX:g} px, crosses rendered frames, lines the "
                        "root mean square of the Cramér–Rao bound, dotted the mean errors "
                        "reported by Zhou et al. (2023).",
                        data="pose_error.csv",
                    ),
                    _method(findings),
                ),
                Section("The mirror solution", _mirror_table(rows), _MIRROR),
                Section(
                    "Axis known",
                    _known_table(rows),
                    Picture(
                        "known",
                        pictures.known_axis(rows),
                        "Error of the distance with the axis known, one spot in rendered frames, "
                        "against the eccentricity (farther ones to the right of nearer ones); bars "
                        "are the estimator's own standard deviation, dashed is what was asked for.",
                        data="pose_error.csv",
                    ),
                ),
            ],
            data=[Data("pose_error.csv", PoseError, rows)],
        )


def _found(rows: Sequence[PoseError]) -> Iterable[Conclusion]:
    for source in _SOURCES:
        for spots in REPORTED:
            yield _errors_found(source, spots, some_of(rows, source, spots, PRIOR))
    single = some_of(rows, "rendered", 1, PRIOR)
    rendered = scatter(single)
    by_incidence = {
        deg: scatter([row for row in single if row.incidence_deg == deg])
        for deg in sorted({row.incidence_deg for row in single})
    }
    told = "; ".join(
        f"at {deg:g}° {number(s.tip_mm, 4)} mm and {number(s.axis_deg, 3)}° (bound "
        f"{number(s.axis_bound_deg, 3)}°)"
        for deg, s in by_incidence.items()
    )
    met = rendered.tip_mm <= ASKED_TIP_MM and rendered.axis_deg <= ASKED_AXIS_DEG
    yield Conclusion(
        "asked, pose",
        f"Single rendered spots {'are' if met else 'are not'} within {ASKED_TIP_MM:g} mm and "
        f"{ASKED_AXIS_DEG:g}°.",
        f"Root mean squares of {rendered.poses} frames but for the mirrored ones: tip "
        f"{number(rendered.tip_mm, 4)} mm, axis {number(rendered.axis_deg, 3)}°; {told}. In "
        f"{number(100 * rendered.mirrored, 0)} % of the frames a prior drawn with {PRIOR_DEG:g}° "
        "chose the mirrored solution; with these the tip is off by "
        f"{number(rendered.tip_all_mm, 3)} mm.",
        met,
    )
    known = some_of(rows, "rendered", 1, KNOWN)
    worst = max(_by_c(known).values())
    yield Conclusion(
        "asked, distance",
        f"With the axis known the distance {'is' if worst <= ASKED_DISTANCE_MM else 'is not'} "
        f"within {ASKED_DISTANCE_MM:g} mm up to c = {LARGEST_C_MM:g} mm.",
        f"Root mean square {number(rms([r.distance_error_mm for r in known]), 4)} mm over "
        f"{len(known)} rendered frames, {number(worst, 4)} mm at the worst eccentricity.",
        worst <= ASKED_DISTANCE_MM,
    )
    yield _mirror_found(rows)


def _errors_found(source: str, spots: int, rows: Sequence[PoseError]) -> Conclusion:
    found, (tip, axis) = scatter(rows), REPORTED[spots]
    better = found.tip_mean_mm < tip and found.axis_mean_deg < axis
    where = "On exact contours with noise" if source == "analytic" else "In rendered frames"
    return Conclusion(
        f"{source}, {NAMES[spots]}",
        f"{where} {NAMES[spots]} give{'s' * (spots == 1)} the tip to "
        f"{number(found.tip_mm, 4)} mm and the axis to {number(found.axis_deg, 3)}°.",
        f"Root mean squares of {found.poses} poses without the mirrored ones; the bound is "
        f"{number(found.tip_bound_mm, 4)} mm and {number(found.axis_bound_deg, 3)}°. On average "
        f"{number(found.tip_mean_mm, 4)} mm and {number(found.axis_mean_deg, 3)}°, where {tip:g} "
        f"mm and {axis:g}° were reported, with another light, eye and camera.",
        better,
    )


def _mirror_found(rows: Sequence[PoseError]) -> Conclusion:
    by_spots = {
        spots: {p: scatter(some_of(rows, "analytic", spots, p)) for p in (PRIOR, FREE)}
        for spots in REPORTED
    }
    one, three = by_spots[1], by_spots[3]
    return Conclusion(
        "mirror",
        f"One spot without a prior is taken for its mirror image in "
        f"{number(100 * one[FREE].mirrored, 1)} % of the poses, three in "
        f"{number(100 * three[FREE].mirrored, 1)} %.",
        f"With a direction prior of {PRIOR_DEG:g}° it is {number(100 * one[PRIOR].mirrored, 1)} % "
        f"of one spot, whose tip then is off by {number(one[PRIOR].tip_all_mm, 3)} mm (root mean "
        f"square of all poses; {number(one[FREE].tip_all_mm, 3)} mm without a prior). The distance "
        f"hardly cares: {number(one[FREE].distance_mm, 4)} mm without a prior, mirrored ones "
        "included.",
    )


_HEADER = (
    "source",
    "spots",
    "z_F, mm",
    "poses",
    "tip, µm",
    "mean",
    "bound",
    "axis, °",
    "mean ",
    "bound ",
    "distance, µm",
)


def _table(rows: Sequence[PoseError]) -> Table:
    cells: list[Row] = []
    for source, spots, height, some in _groups(rows, PRIOR):
        found = scatter(some)
        micrometres = (found.tip_mm, found.tip_mean_mm, found.tip_bound_mm)
        cells.append(
            (
                source,
                spots,
                f"{height:g}",
                found.poses,
                *(1e3 * value for value in micrometres),
                found.axis_deg,
                found.axis_mean_deg,
                found.axis_bound_deg,
                1e3 * found.distance_mm,
            )
        )
    return Table(
        _HEADER,
        cells,
        f"Root mean square errors, mean errors and bounds, direction prior {PRIOR_DEG:g}°, "
        "mirrored solutions left out but for the distance.",
        data="pose_error.csv",
    )


def _mirror_table(rows: Sequence[PoseError]) -> Table:
    cells: list[Row] = []
    for prior in (PRIOR, FREE):
        for source, spots, height, some in _groups(rows, prior):
            found = scatter(some)
            share = 100 * found.mirrored
            tips = found.tip_mm, found.tip_all_mm
            cells.append((source, spots, f"{height:g}", prior, found.poses, share, *tips))
    return Table(
        ("source", "spots", "z_F, mm", "prior", "poses", "mirrored, %", "tip, mm", "with mirrored"),
        cells,
        "How often the mirrored solution is taken, and the tip's root mean square error without "
        "and with it.",
        data="pose_error.csv",
    )


def _known_table(rows: Sequence[PoseError]) -> Table:
    cells: list[Row] = []
    for source, spots, height, some in _groups(rows, KNOWN):
        found = scatter(some)
        own = [row.sigma_distance_mm for row in some]
        told = "–" if np.isnan(own).any() else f"{1e3 * rms(own):.3f}"
        values = [1e3 * v for v in (found.distance_mm, found.tip_mm, found.tip_bound_mm)]
        cells.append((source, spots, f"{height:g}", found.poses, *values, told))
    return Table(
        ("source", "spots", "z_F, mm", "poses", "distance, µm", "tip, µm", "bound", "σ of d, µm"),
        cells,
        "Root mean square errors where the robot knows the axis; the last column is what the "
        "estimator itself expects of the distance.",
        data="pose_error.csv",
    )


_MIRROR = (
    "A spot is explained almost as well by the beam that leans the other way, at the same distance "
    "but with the tip elsewhere. One spot tells the two apart by the quartic's difference from an "
    "ellipse, which shrinks with the incidence; an estimator that reports ellipses does not see "
    "it at all. Three splayed spots tell them apart by where they lie."
)


def _method(findings: Findings) -> str:
    noise = [row.noise_px for row in findings.rows if row.source == "rendered"]
    low, high = analytic.INCIDENCE_DEG
    source = findings.scene.source
    return (
        f"k = {source.cone_k:g}, b = {source.cone_apex_offset_mm:g} mm, "
        f"{1e3 * findings.scene.microscope.scale_mm_px:g} µm/px; O anywhere in 10 × 10 mm round "
        f"the microscope's axis, d = {analytic.NEAREST_MM:g} to {analytic.FARTHEST_MM:g} mm, "
        f"incidence {low:g} to {high:g}° from all sides; {analytic.NOISE_PX:g} px of noise across "
        "each of 128 points of a contour. Three spots are three such cones on one rigid tool, "
        "their tips 0.5 mm apart and splayed by 10°, lit one after the other; the tool's roll is "
        "found with its pose. Rendered frames have an even wall, camera noise and no instrument "
        "in front of the spot; what the estimator says of its ellipses is worth "
        f"{number(float(np.median(noise)), 3)} px on 128 points (median)."
    )


def _by_c(rows: Sequence[PoseError]) -> dict[float, float]:
    """Root mean square error of the distance at each eccentricity, mm."""
    return {
        c: rms([row.distance_error_mm for row in rows if row.c_mm == c])
        for c in sorted({row.c_mm for row in rows})
    } or {0.0: math.nan}


def _groups(
    rows: Sequence[PoseError], prior: str
) -> Iterable[tuple[str, int, float, list[PoseError]]]:
    for source in _SOURCES:
        for spots in REPORTED:
            some = some_of(rows, source, spots, prior)
            for height in dict.fromkeys(row.z_f_mm for row in some):
                yield source, spots, height, [row for row in some if row.z_f_mm == height]
