"""The report of the study of rivals."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.evaluation import largest
from benchmarks.reporting import Claim, Picture, Report, Section, Table, frame_of
from benchmarks.studies.rivals import figures
from benchmarks.studies.rivals.findings import (
    CONTOUR_PX,
    MARK_PX,
    WALL_PX,
    Bias,
    Expected,
    Outcome,
    Reading,
    ReadSummary,
    RivalFindings,
    Sensor,
    Wrong,
    median,
)
from benchmarks.studies.rivals.marks import REACH_PX
from benchmarks.studies.rivals.setup import (
    CONVERGENCE_DEG,
    LAMP_ABOVE_MM,
    LAMP_RADIUS_MM,
    PINHOLE_HEIGHT_MM,
    SCALE_MM_PX,
)


def report(findings: RivalFindings) -> Report:
    """The report of a run."""
    return Report(
        title="Which is the best sensor of the distance: the spot, the shadow, or a stereo pair?",
        lead="The same distance d, from the instrument's tip to the wall along its axis, is read "
        "from the spot of its own light, from the shadow of its tip under a light guide, and from "
        f"a stereo pair with {CONVERGENCE_DEG:g}° between the lines of sight, by the same "
        f"microscope ({SCALE_MM_PX:g} mm/px at the pole) at the same places. All three know the "
        "instrument's axis, the wall's shape and their cameras.",
        claims=list(_claims(findings)),
        sections=[
            Section(
                "What stated noise gives",
                Picture(
                    "noise",
                    figures.noise_figure(findings),
                    f"Standard deviation of d. Noise: {CONTOUR_PX:g} px for each of 128 points of "
                    f"the spot's edge, {MARK_PX:g} px in x and y for a tip and for a shadow's tip, "
                    f"{WALL_PX:g} px for the wall's texture in a pair; the last three are "
                    "assumptions. Dashed: the clinically acceptable error. A line ends where the "
                    "window or the iris hides a mark, or the instrument hides its shadow.",
                    data="expected.csv",
                ),
                _METHODS,
            ),
            Section(
                "What a wrong assumption gives",
                Picture(
                    "path",
                    figures.path_figure(findings),
                    "Error without noise if the microscope's pinhole is known, but the viewing "
                    f"lens and the eye in front of it (z_F = {PINHOLE_HEIGHT_MM:g} mm) are not.",
                    data="wrong.csv",
                ),
                Table.of_rows(
                    Bias,
                    [row for row in findings.wrong if row.d_mm == 2.0],
                    "Errors at d = 2 mm if one assumption is wrong; RMS over directions, where "
                    "something lies or points elsewhere.",
                    data="wrong.csv",
                ),
            ),
            Section(
                "Read from rendered pictures",
                Picture(
                    "readings",
                    figures.reading_figure(findings),
                    "Errors of the readings; a missing mark was not read.",
                    data="readings.csv",
                ),
                Table.of_rows(
                    ReadSummary,
                    findings.summaries(),
                    "Readings by sensor, path and wall. The mark's error is that of the semi-minor "
                    "axis for the spot, and the largest of the places of tip and shadow otherwise.",
                    data="readings.csv",
                ),
                Picture(
                    "photographs",
                    figures.photograph_figure(findings),
                    "The instrument and its shadow, by the left half of the pair, the central "
                    "microscope, and the right half.",
                    inline="jpeg",
                ),
                _HELP,
            ),
        ],
        data={
            "expected.csv": frame_of(Expected, findings.expected),
            "wrong.csv": frame_of(Bias, findings.wrong),
            "readings.csv": frame_of(Reading, findings.readings),
        },
    )


_METHODS = (
    "Spot: the exact spot with the ellipse's centre and area, as `--model area`. Shadow: the line "
    "of sight of the shadow's tip meets the wall; from there a line to the light guide meets the "
    "tip's line of sight at the tip. Stereo: two lines of sight meet at the tip, two more on the "
    "wall below it. Shadows of instruments were used for the same task by Koyama et al. (2021, "
    "arXiv 2107.11985) and by Yang et al. (ICRA 2024, “Shadow-Based 3D Pose Estimation of "
    "Intraocular Instrument Using Only 2D Images”), who report errors of 1 to 2 mm without "
    "knowing where the light is."
)

_HELP = (
    "The labels help shadow and stereo where the literature needs a network: they say how the "
    "outlines of the instrument's end and of its shadow run, and where they are to within "
    f"{REACH_PX:g} px. The place is then measured from the picture, as the shift at which the "
    "picture is steepest across the outline. The wall's height in a pair is the one at which the "
    "textures of both images agree best; the instrument is left out. The light guide is a disc "
    f"of {LAMP_RADIUS_MM:g} mm radius, {LAMP_ABOVE_MM:g} mm from the pole, for the shadow, and a "
    "point for the pair. The spot is an ideal cone's. On the set `static-v1` a lens's bell-shaped "
    "spot is measured with an error of 1.2 px, a cone's with 0.014 px (RMS of e₁′), "
    "because the wall is textured; with a lens the spot's advantage is that much smaller."
)


def _claims(findings: RivalFindings) -> Iterator[Claim]:
    for path in findings.paths:
        sigmas = [median(findings.sigma(sensor, path)) for sensor in Sensor]
        yield Claim(
            name=f"noise, {path}",
            sentence="Through {path}, marks of the stated noise give {value:.4f} mm "
            "({sensors}; medians over the places in view). In view are {seen} of {places} places.",
            value=tuple(sigmas),
            numbers={
                "path": path,
                "sensors": ", ".join(Sensor),
                "seen": tuple(len(findings.sigma(sensor, path)) for sensor in Sensor),
                "places": sum(r[:2] == (Sensor.SPOT, path) for r in findings.expected),
            },
        )
    for path in findings.paths[1:]:
        yield Claim(
            name=f"unknown path, {path}",
            sentence="If {path} is taken for a pinhole, the largest errors are {value:.2f} mm "
            "({sensors}).",
            value=tuple(largest(findings.bias(sensor, path, Wrong.PATH)) for sensor in Sensor),
            numbers={"path": path, "sensors": ", ".join(Sensor)},
        )
    yield Claim(
        name="light guide",
        sentence="A light guide 1 mm beside the place where it is thought to be changes the "
        "shadow's distance by up to {value:.2f} mm.",
        value=largest(row.error_mm for row in findings.wrong if row.wrong == Wrong.LAMP),
    )
    for sensor in Sensor:
        rows = findings.read(sensor)
        done = [abs(row.error_mm) for row in rows if row.outcome == Outcome.READ]
        yield Claim(
            name=f"rendered, {sensor}",
            sentence="From rendered pictures the {sensor} was read at {read} of {places} places, "
            "with a median error of {value:.3f} mm and at most {worst:.3f} mm.",
            value=median(done),
            numbers={
                "sensor": str(sensor),
                "read": len(done),
                "places": len(rows),
                "worst": largest(done),
            },
        )
