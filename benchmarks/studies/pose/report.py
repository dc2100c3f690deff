"""The report of the study of poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.evaluation import rms
from benchmarks.reporting import Claim, Picture, Report, Section, Table, frame_of
from benchmarks.studies.pose import figures
from benchmarks.studies.pose.findings import (
    FARTHEST_MM,
    INCIDENCE_DEG,
    LARGEST_C_MM,
    NAMES,
    NEAREST_MM,
    NOISE_PX,
    PRIOR_DEG,
    REPORTED,
    REQUIRED_AXIS_DEG,
    REQUIRED_DISTANCE_MM,
    REQUIRED_TIP_MM,
    SOURCES,
    PoseError,
    PoseFindings,
    Prior,
    Scatter,
    scatter,
)

_FILE = "pose_error.csv"


def report(findings: PoseFindings) -> Report:
    """The report of a run."""
    return Report(
        title="How accurately do one spot and three spots give the tool's pose?",
        lead="Tip and axis, five parameters, of an ideal cone: from exact contours with noise "
        "over a working volume of 10 × 10 × 5 mm, and from rendered frames.",
        claims=list(_claims(findings)),
        sections=[
            Section(
                "Errors",
                Table.of_rows(
                    Scatter,
                    findings.scatters(Prior.ROUGH),
                    "Root mean square errors, mean errors and bounds, direction prior "
                    f"{PRIOR_DEG:g}°. Mirrored solutions are left out of the errors of tip and "
                    "axis.",
                    data=_FILE,
                ),
                Picture(
                    "incidence",
                    figures.by_incidence(findings),
                    f"Errors of tip and axis against the incidence, direction prior {PRIOR_DEG:g}°,"
                    f" without mirrored solutions. Dots: contours with noise of {NOISE_PX:g} px. "
                    "Crosses: rendered frames. Lines: root mean square of the Cramér–Rao bound. "
                    "Dotted: the mean errors reported by Zhou et al. (2023).",
                    data=_FILE,
                ),
                _method(findings),
            ),
            Section(
                "The mirror solution",
                Table.of_rows(
                    Scatter,
                    findings.scatters(Prior.ROUGH, Prior.NONE),
                    "How often the mirrored solution is taken, and the tip's root mean square "
                    "error without and with it.",
                    data=_FILE,
                ),
                _MIRROR,
            ),
            Section(
                "Axis known",
                Table.of_rows(
                    Scatter,
                    findings.scatters(Prior.KNOWN),
                    "Root mean square errors if the robot gives the axis. The last column is the "
                    "standard deviation of the distance that the estimator reports.",
                    data=_FILE,
                ),
                Picture(
                    "known",
                    figures.known_axis(findings),
                    "Error of the distance with the axis known, one spot in rendered frames, "
                    "against the eccentricity (farther ones to the right of nearer ones). Bars: "
                    "the estimator's own standard deviation. Dashed: the requirement.",
                    data=_FILE,
                ),
            ),
        ],
        data={_FILE: frame_of(PoseError, findings.rows)},
    )


def _claims(findings: PoseFindings) -> Iterator[Claim]:
    for source in SOURCES:
        for spots, (tip, axis) in REPORTED.items():
            found = scatter(findings.some(source, spots, Prior.ROUGH))
            yield Claim(
                name=f"{source}, {NAMES[spots]}, tip",
                sentence="The mean error of the tip is {value:.4f} mm (reported by others, with "
                "another light, eye and camera: {high:g} mm). Root mean square {all.tip_mm:.4f} "
                "mm over {all.poses} poses without mirrored ones; the bound is "
                "{all.tip_bound_mm:.4f} mm.",
                value=found.tip_mean_mm,
                high=tip,
                numbers={"all": found},
            )
            yield Claim(
                name=f"{source}, {NAMES[spots]}, axis",
                sentence="The mean error of the axis is {value:.3f}° (reported by others: "
                "{high:g}°). Root mean square {all.axis_deg:.3f}°; the bound is "
                "{all.axis_bound_deg:.3f}°.",
                value=found.axis_mean_deg,
                high=axis,
                numbers={"all": found},
            )
    single = findings.some("rendered", 1, Prior.ROUGH)
    found = scatter(single)
    by_incidence = [
        scatter([row for row in single if row.incidence_deg == deg])
        for deg in sorted({row.incidence_deg for row in single})
    ]
    incidences = tuple(sorted({row.incidence_deg for row in single}))
    yield Claim(
        name="requirement, tip",
        sentence="Single rendered spots give the tip to {value:.4f} mm (required: {high:g} mm), "
        "root mean square of {all.poses} frames without mirrored ones. At incidences of "
        "{incidences:g}° it is {each:.4f} mm. In {all.mirrored:.0%} of the frames a prior drawn "
        "with {prior:g}° led to the mirrored solution; with these the tip is off by "
        "{all.tip_all_mm:.3f} mm.",
        value=found.tip_mm,
        high=REQUIRED_TIP_MM,
        numbers={
            "all": found,
            "incidences": incidences,
            "each": tuple(part.tip_mm for part in by_incidence),
            "prior": PRIOR_DEG,
        },
    )
    yield Claim(
        name="requirement, axis",
        sentence="Single rendered spots give the axis to {value:.3f}° (required: {high:g}°). At "
        "incidences of {incidences:g}° it is {each:.3f}°, with bounds of {bounds:.3f}°.",
        value=found.axis_deg,
        high=REQUIRED_AXIS_DEG,
        numbers={
            "incidences": incidences,
            "each": tuple(part.axis_deg for part in by_incidence),
            "bounds": tuple(part.axis_bound_deg for part in by_incidence),
        },
    )
    known = findings.some("rendered", 1, Prior.KNOWN)
    yield Claim(
        name="requirement, distance",
        sentence="With the axis known the distance is off by {value:.4f} mm (root mean square) at "
        "the worst eccentricity up to c = {largest_c:g} mm (required: {high:g} mm), and by "
        "{rms:.4f} mm over all {frames} rendered frames.",
        value=max(
            rms(row.distance_error_mm for row in known if row.c_mm == c)
            for c in {row.c_mm for row in known}
        ),
        high=REQUIRED_DISTANCE_MM,
        numbers={
            "largest_c": LARGEST_C_MM,
            "rms": rms(row.distance_error_mm for row in known),
            "frames": len(known),
        },
    )
    free, led = (scatter(findings.some("analytic", 1, p)) for p in (Prior.NONE, Prior.ROUGH))
    yield Claim(
        name="mirror",
        sentence="Without a prior, one spot gives the mirror solution in {value:.1%} of the "
        "poses, three spots in {three.mirrored:.1%}. With a direction prior of {prior:g}° it is "
        "{led.mirrored:.1%} for one spot, and the tip is off by {led.tip_all_mm:.3f} mm (root mean "
        "square of all poses; {free.tip_all_mm:.3f} mm without a prior). The distance is off by "
        "{free.distance_mm:.4f} mm "
        "without a prior, mirrored solutions included.",
        value=free.mirrored,
        numbers={
            "three": scatter(findings.some("analytic", 3, Prior.NONE)),
            "free": free,
            "led": led,
            "prior": PRIOR_DEG,
        },
    )


_MIRROR = (
    "A beam that is tilted the other way explains a spot almost as well, at the same distance but "
    "with another tip. For one spot the two differ only in the contour's deviation from an "
    "ellipse. This deviation decreases with the incidence, and an estimator that reports ellipses "
    "does not measure it. For three splayed spots their positions distinguish the two solutions."
)


def _method(findings: PoseFindings) -> str:
    noise = [row.noise_px for row in findings.rows if row.source == "rendered"]
    low, high = INCIDENCE_DEG
    source = findings.scene.source
    return (
        f"k = {source.cone_k:g}, b = {source.cone_apex_offset_mm:g} mm, "
        f"{1e3 * findings.scene.microscope.scale_mm_px:g} µm/px; O anywhere in 10 × 10 mm round "
        f"the microscope's axis, d = {NEAREST_MM:g} to {FARTHEST_MM:g} mm, incidence {low:g} to "
        f"{high:g}° from all sides; {NOISE_PX:g} px of noise across each of 128 points of a "
        "contour. Three spots are three such cones on one rigid tool, their tips 0.5 mm apart and "
        "splayed by 10°, lit one after the other; the tool's roll is found with its pose. Rendered "
        "frames have an even wall, camera noise and no instrument in front of the spot. The "
        "estimator's standard errors of their ellipses correspond to noise of "
        f"{float(np.median(noise)):.3f} px on 128 points (median)."
    )
