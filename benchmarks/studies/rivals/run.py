"""`eyespot study rivals`: one distance by the spot, by the instrument's shadow, and by stereo.

DIR/expected.csv     standard deviations of the three by stated noise of their marks
    wrong.csv        errors if one of the things that they take as known is wrong
    readings.csv     distances read from rendered pictures
    stacks/, spots/  rendered spots, and what the estimator measured of them
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.evaluation import ACCEPTABLE_ERROR_MM, DISTANCE, largest
from benchmarks.reporting import (
    BLUE,
    ORANGE,
    VERMILION,
    Claim,
    Column,
    Picture,
    Report,
    Request,
    Section,
    Study,
    Table,
    grouped,
    limit_lines,
    small_multiples,
)
from benchmarks.studies.rivals import rendered
from benchmarks.studies.rivals.expected import expected
from benchmarks.studies.rivals.marks import REACH_PX
from benchmarks.studies.rivals.pictures import Pictures
from benchmarks.studies.rivals.sensors import (
    CONTOUR_PX,
    MARK_PX,
    WALL_PX,
    Outcome,
    Sensor,
    Wrong,
)
from benchmarks.studies.rivals.setup import (
    CONVERGENCE_DEG,
    LAMP_ABOVE_MM,
    LAMP_RADIUS_MM,
    PATHS,
    PINHOLE_HEIGHT_MM,
    SCALE_MM_PX,
    views,
)
from scenes import Scene

_ECCENTRICITIES_MM = np.array([0.0, 1.5, 3.0])
_DISTANCES_MM = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0])
_DRAWS, _QUICK_DRAWS = 200, 50
_WALLS = ("printed paper", "retina", "uniform")
_RENDERED_C_MM, _QUICK_C_MM = (0.0, 3.0), (0.0,)
_RENDERED_D_MM, _QUICK_D_MM = [1.0, 3.0, 5.0], [1.0, 4.0]


def run(request: Request) -> RivalFindings:
    """Compute, render, measure and report.

    Args:
        request: the arguments; of the scene the seed and the camera are used.

    Raises:
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    study = Study("rivals", request)
    quick = request.quick
    paths = [*PATHS][:2] if quick else [*PATHS]
    noise, wrong = [], []
    with study.timed("expected"):
        pinholes = views("pinhole")
        for path in paths:
            some, biases = expected(
                path,
                views(path),
                pinholes,
                eccentricities=_ECCENTRICITIES_MM,
                distances=_DISTANCES_MM,
                draws=_QUICK_DRAWS if quick else _DRAWS,
                seed=study.seed,
            )
            noise.append(some)
            wrong.append(biases)
    every = rendered.trials(
        study.scene,
        paths=paths,
        walls=(_WALLS[0], _WALLS[-1]) if quick else _WALLS,
        eccentricities=_QUICK_C_MM if quick else _RENDERED_C_MM,
        distances=_QUICK_D_MM if quick else _RENDERED_D_MM,
    )
    with study.timed("render and measure spots"):
        readings = rendered.by_spots(study, every)
    with study.timed("render and measure shadows and stereo pairs"):
        others, kept = rendered.by_pictures(every)
    findings = RivalFindings(
        scene=study.scene,
        expected=pd.concat(noise, ignore_index=True),
        wrong=pd.concat(wrong, ignore_index=True),
        readings=pd.DataFrame(readings + others, columns=rendered.READING),
        photographs=kept,
    )
    study.publish(report, findings)
    return findings


# What the page shows.


@dataclass(frozen=True, kw_only=True)
class RivalFindings:
    """All results of a run.

    Attributes:
        scene: the study's; its seed and its camera are used.
        expected: with stated noise.
        wrong: with one wrong assumption.
        photographs: of the first wall, by path and distance.
    """

    scene: Scene
    expected: pd.DataFrame
    wrong: pd.DataFrame
    readings: pd.DataFrame
    photographs: dict[tuple[str, float], Pictures]

    @property
    def paths(self) -> list[str]:
        """Names of the viewing paths."""
        return list(dict.fromkeys(self.expected.path))

    def sigma(self, sensor: Sensor, path: str) -> pd.Series:
        """Standard deviations of the places that the sensor can read, mm."""
        of = self.expected
        return of.sigma_mm[(of.sensor == sensor) & (of.path == path) & (of.outcome == Outcome.READ)]

    def bias(self, sensor: Sensor, path: str, wrong: Wrong) -> pd.Series:
        """Errors under one wrong assumption at the places that the sensor can read, mm."""
        of = self.wrong
        return of.error_mm[(of.sensor == sensor) & (of.path == path) & (of.wrong == wrong)]

    def summaries(self) -> pd.DataFrame:
        """The readings by sensor, path and wall."""
        rows = []
        for key, every in grouped(self.readings, "sensor", "path", "wall"):
            done = every[every.outcome == Outcome.READ]
            reasons = every.outcome[every.outcome != Outcome.READ]
            why = [f"{why} {(reasons == why).sum()}" for why in dict.fromkeys(reasons)]
            errors = done.error_mm.abs()
            sizes = (errors.median(), errors.max(), done.mark_error_px.median())
            rows.append((*key, len(every), len(done), *sizes, ", ".join(why)))
        columns = "sensor path wall asked read median_mm largest_mm mark_px why_not"
        return pd.DataFrame(rows, columns=columns.split())


# Figures.

_COLOURS = {Sensor.SPOT: BLUE, Sensor.SHADOW: ORANGE, Sensor.STEREO: VERMILION}
_MARKS = {Sensor.SPOT: "o", Sensor.SHADOW: "^", Sensor.STEREO: "s"}
_LINES = ("-", "--", ":")
_SMALLEST_MM, _LARGEST_MM = 1e-4, 5.0


def noise_figure(findings: RivalFindings) -> Figure:
    """Standard deviation against distance: a panel for each path, a line style for each c."""
    expected = findings.expected

    def draw(axes: Axes, _: str, path: str) -> None:
        for sensor in _COLOURS:
            _lines(axes, sensor, expected[expected.path == path], "sigma_mm")
        axes.axhline(ACCEPTABLE_ERROR_MM, color=VERMILION, lw=0.8, ls="--")
        axes.set_yscale("log")
        axes.set_ylim(_SMALLEST_MM, _LARGEST_MM)

    return small_multiples(
        draw,
        rows=[""],
        columns=findings.paths,
        x=DISTANCE,
        y="σ of d (mm)",
        legend_columns=3,
        sharey=True,
    )


def path_figure(findings: RivalFindings) -> Figure:
    """Error against distance if the path is taken for a pinhole: a panel for each path."""
    wrong = findings.wrong[findings.wrong.wrong == Wrong.PATH]

    def draw(axes: Axes, _: str, path: str) -> None:
        limit_lines(axes, ACCEPTABLE_ERROR_MM)
        for sensor in _COLOURS:
            _lines(axes, sensor, wrong[wrong.path == path], "error_mm")

    return small_multiples(
        draw,
        rows=[""],
        columns=list(dict.fromkeys(wrong.path)),
        x=DISTANCE,
        y="estimate − truth (mm)",
        height=3.2,
        legend_columns=3,
        sharey=True,
    )


def _lines(axes: Axes, sensor: Sensor, rows: pd.DataFrame, value: str) -> None:
    """Lines of a sensor's values against distance, one for each c."""
    own = grouped(rows[rows.sensor == sensor], "c_mm")
    for (c, line), style in zip(own, _LINES, strict=False):
        marks: dict[str, Any] = {"color": _COLOURS[sensor], "marker": _MARKS[sensor], "ms": 3}
        label = f"{sensor}, c = {c:g} mm"
        axes.plot(line.d_mm, line[value], style, label=label, **marks)


def reading_figure(findings: RivalFindings) -> Figure:
    """|Error| of the rendered readings against distance: rows of paths, columns of walls."""
    read = findings.readings[findings.readings.outcome == Outcome.READ]

    def draw(axes: Axes, path: str, wall: str) -> None:
        for sensor, colour in _COLOURS.items():
            of = (read.sensor == sensor) & (read.path == path) & (read.wall == wall)
            axes.plot(
                read.d_mm[of],
                read.error_mm[of].abs().clip(lower=_SMALLEST_MM),
                ls="",
                marker=_MARKS[sensor],
                ms=4,
                color=colour,
                label=sensor,
            )
        axes.axhline(ACCEPTABLE_ERROR_MM, color=VERMILION, lw=0.8, ls="--")
        axes.set_yscale("log")
        axes.set_ylim(_SMALLEST_MM, _LARGEST_MM)

    return small_multiples(
        draw,
        rows=findings.paths,
        columns=list(dict.fromkeys(findings.readings.wall)),
        x=DISTANCE,
        y="|error| (mm)",
        height=2.2,
        sharex=True,
        sharey=True,
    )


def photograph_figure(findings: RivalFindings) -> Figure:
    """What the sensors see: the central image and the left one, a row for each path."""
    distance = max(d for _, d in findings.photographs)

    def draw(axes: Axes, path: str, view: str) -> None:
        photograph = np.asarray(getattr(findings.photographs[path, distance], view), float)
        axes.imshow(np.clip(photograph / findings.scene.camera.full_scale_dn, 0.0, 1.0))
        axes.set_axis_off()

    return small_multiples(
        draw,
        rows=findings.paths,
        columns=["left", "centre", "right"],
        x="",
        y="",
        height=2.6,
        legend_columns=0,
    )


# The page.


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
                    noise_figure(findings),
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
                    path_figure(findings),
                    "Error without noise if the microscope's pinhole is known, but the viewing "
                    f"lens and the eye in front of it (z_F = {PINHOLE_HEIGHT_MM:g} mm) are not.",
                    data="wrong.csv",
                ),
                Table.of(
                    findings.wrong[findings.wrong.d_mm == 2.0],
                    {
                        "sensor": Column("sensor"),
                        "path": Column("path"),
                        "wrong": Column("what is wrong"),
                        "c_mm": Column("c, mm", 1),
                        "d_mm": Column("d, mm", 1),
                        "error_mm": Column("error, mm", sign=True),
                    },
                    "Errors at d = 2 mm if one assumption is wrong; RMS over directions, where "
                    "something lies or points elsewhere.",
                    data="wrong.csv",
                ),
            ),
            Section(
                "Read from rendered pictures",
                Picture(
                    "readings",
                    reading_figure(findings),
                    "Errors of the readings; a missing mark was not read.",
                    data="readings.csv",
                ),
                Table.of(
                    findings.summaries(),
                    {
                        "sensor": Column("sensor"),
                        "path": Column("path"),
                        "wall": Column("wall"),
                        "asked": Column("places"),
                        "read": Column("read"),
                        "median_mm": Column("median |error|, mm"),
                        "largest_mm": Column("largest, mm"),
                        "mark_px": Column("median mark's error, px", 2),
                        "why_not": Column("not read because"),
                    },
                    "Readings by sensor, path and wall. The mark's error is that of the semi-minor "
                    "axis for the spot, and the largest of the places of tip and shadow otherwise.",
                    data="readings.csv",
                ),
                Picture(
                    "photographs",
                    photograph_figure(findings),
                    "The instrument and its shadow, by the left half of the pair, the central "
                    "microscope, and the right half.",
                    inline="jpeg",
                ),
                _HELP,
            ),
        ],
        data={
            "expected.csv": findings.expected,
            "wrong.csv": findings.wrong,
            "readings.csv": findings.readings,
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
        sigmas = [findings.sigma(sensor, path) for sensor in Sensor]
        of = findings.expected
        yield Claim(
            name=f"noise, {path}",
            sentence="Through {path}, marks of the stated noise give {value:.4f} mm "
            "({sensors}; medians over the places in view). In view are {seen} of {places} places.",
            value=tuple(float(sigma.median()) for sigma in sigmas),
            numbers={
                "path": path,
                "sensors": ", ".join(Sensor),
                "seen": tuple(map(len, sigmas)),
                "places": int(((of.sensor == Sensor.SPOT) & (of.path == path)).sum()),
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
        value=largest(findings.wrong.error_mm[findings.wrong.wrong == Wrong.LAMP]),
    )
    for sensor in Sensor:
        rows = findings.readings[findings.readings.sensor == sensor]
        done = rows.error_mm[rows.outcome == Outcome.READ].abs()
        yield Claim(
            name=f"rendered, {sensor}",
            sentence="From rendered pictures the {sensor} was read at {read} of {places} places, "
            "with a median error of {value:.3f} mm and at most {worst:.3f} mm.",
            value=float(done.median()),
            numbers={
                "sensor": str(sensor),
                "read": len(done),
                "places": len(rows),
                "worst": largest(done),
            },
        )
