"""`eyespot study sensors`: one distance by the spot, by the instrument's shadow, and by stereo."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from operator import add, itemgetter
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot import optics, scenes
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.model_error import DISTANCE
from eyespot.benchmarks.paper import ACCEPTABLE_ERROR_MM, withdrawal
from eyespot.benchmarks.reporting import grouped, listed, number, rows_of, where
from eyespot.benchmarks.statistics import largest
from eyespot.benchmarks.studies import sensor_views
from eyespot.benchmarks.studies.sensor_views import (
    CONTOUR_PX,
    CONVERGENCE_DEG,
    MARK_PX,
    PATHS,
    PINHOLE_HEIGHT_MM,
    RADIUS_MM,
    SCALE_MM_PX,
    WALL_PX,
    InstrumentPlace,
    Known,
    Marks,
    Pictures,
    ReadingOutcome,
    Sensor,
    Views,
    Wrong,
    found_shift,
    outline,
    place,
)
from eyespot.benchmarks.study import OutputFolder, Quick, Seed, Study
from eyespot.estimator.run.progress_bar import progress
from eyespot.scenes import Scene

# What each sensor can reach: exact marks with stated noise, and with one wrong assumption.

_POINTS = 128
_LAMP_OFF_MM, _AXIS_OFF_DEG, _RADIUS_OFF_MM = 1.0, 1.0, 0.5
_DIRECTIONS = 4  # in which something is displaced


def expected(
    path: str, seen: Views, pinholes: Views, *, draws: int, seed: int
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of expected.csv and of wrong.csv for one path.

    The first are standard deviations over `draws` of the stated noise, with everything known; the
    second are errors of exact marks if one assumption is wrong, RMS over directions. `pinholes` are
    cameras at the same places without a path.
    """
    pairs = product((0.0, 1.5, 3.0), (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0))
    places = stacked([place(eccentricity=c, distance=d) for c, d in pairs])
    true, outcomes = _marks(places, seen), sensor_views.outcomes_at(places, seen)
    rng, sigma = np.random.default_rng(seed), Marks(CONTOUR_PX, MARK_PX, MARK_PX, MARK_PX, WALL_PX)
    noise = jax.tree.map(lambda leaf, s: s * rng.standard_normal((draws, *leaf.shape)), true, sigma)
    right = Known(seen, np.asarray(RADIUS_MM), places.lamp, places.axis)
    noisy = [
        _read(jax.tree.map(add, true, jax.tree.map(itemgetter(k), noise)), right)
        for k in range(draws)
    ]
    off = math.tan(math.radians(_AXIS_OFF_DEG))
    turned = [places.axis + aside for aside in _aside(places.axis, off)]
    turned = [axis / np.linalg.norm(axis, axis=-1, keepdims=True) for axis in turned]
    lamps = [places.lamp + aside for aside in _aside(places.lamp_axis, _LAMP_OFF_MM)]
    assumed = {
        Wrong.PATH: [] if path == "pinhole" else [right._replace(views=pinholes)],
        Wrong.LAMP: [right._replace(lamp=lamp) for lamp in lamps],
        Wrong.AXIS: [right._replace(axis=axis) for axis in turned],
        Wrong.RADIUS: [_in_larger_sphere(right, _RADIUS_OFF_MM)],
    }
    at = {"c_mm": places.eccentricity, "d_mm": places.distance}
    done = {sensor: np.array(outcomes[sensor]) == ReadingOutcome.READ for sensor in Sensor}
    sigmas, biases = [], []
    for sensor in Sensor:
        size = np.where(done[sensor], np.std([one[sensor] for one in noisy], axis=0), np.nan)
        found = {"outcome": outcomes[sensor], "sigma_mm": size}
        sigmas.append(pd.DataFrame({"sensor": sensor, "path": path, **at, **found}))
    for wrong, ones in assumed.items():
        read = [_read(true, one) for one in ones]
        affected = [Sensor.SHADOW] if wrong == Wrong.LAMP else list(Sensor)
        for sensor in affected if ones else ():
            error = np.array([one[sensor] for one in read]) - places.distance
            # Displacements in opposite directions have opposite effects; their size counts.
            size = error[0] if len(error) == 1 else np.sqrt(np.mean(error**2, axis=0))
            rows = {"sensor": sensor, "path": path, "wrong": wrong, **at, "error_mm": size}
            biases.append(pd.DataFrame(rows)[done[sensor]])
    return pd.concat(sigmas, ignore_index=True), pd.concat(biases, ignore_index=True)


def stacked(every: Sequence[InstrumentPlace]) -> InstrumentPlace:
    """Places with a leading axis."""
    return InstrumentPlace(*map(np.stack, zip(*every, strict=True)))


@eqx.filter_jit
def _marks(places: InstrumentPlace, seen: Views) -> Marks:
    return jax.vmap(lambda one: sensor_views.marks_of(one, seen, points=_POINTS))(places)


def _in_larger_sphere(known: Known, by: float) -> Known:
    """What is known, in the frame of a larger sphere through the same pole; mm.

    Its centre lies higher above the pole, so cameras and lamp, which stay, lie lower in its frame.
    """
    lowered = [
        eqx.tree_at(lambda c: c.pole_height, camera, camera.pole_height - by)
        for camera in known.views
    ]
    lamp = known.lamp - by * np.array([0.0, 0.0, 1.0])
    return Known(Views(*lowered), known.radius + by, lamp, known.axis)


@eqx.filter_jit
def _read(marks: Marks, known: Known) -> dict[Sensor, Any]:
    """Readings of marks at all places, each with a lamp and an axis."""

    def one(own: Marks, lamp: Any, axis: Any) -> dict[Sensor, Any]:
        here = known._replace(lamp=lamp, axis=axis)
        return {
            Sensor.SPOT: sensor_views.by_spot(optics.ellipse_of_contour(own.contour), here),
            Sensor.SHADOW: sensor_views.by_shadow(own.tip, own.shadow, here),
            Sensor.STEREO: sensor_views.by_stereo(own.tip_pair, own.wall_pair, here),
        }

    return jax.vmap(one)(marks, known.lamp, known.axis)


def _aside(axes: np.ndarray, size: float) -> list[np.ndarray]:
    """Vectors across axes, in evenly spaced directions."""
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(axes))
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    return [size * (math.cos(a) * first + math.sin(a) * second) for a in angles]


# The rendered part: all three sensors read distances from pictures of the same places.

READING = "sensor path wall c_mm d_mm outcome error_mm mark_error_px".split()
"""Columns of readings.csv; error = estimate - truth, empty if nothing was read.

`mark_error_px` is of the semi-minor axis for the spot, of tip or shadow (the larger) otherwise.
"""


class Read(NamedTuple):
    """What became of a reading: the distance, mm, and the error of its marks, px."""

    outcome: ReadingOutcome
    distance: float = math.nan
    off: float = math.nan


class Trial(NamedTuple):
    """Places with one path, one wall and one eccentricity (mm), seen by the path's cameras."""

    path: str
    wall: str
    c: float
    scene: Scene
    places: list[InstrumentPlace]
    seen: Views

    @property
    def name(self) -> str:
        """For folders and files."""
        return f"{self.path}-{self.wall}-{self.c:g}".replace(" ", "-")

    def row(self, sensor: Sensor, one: InstrumentPlace, read: Read) -> tuple[Any, ...]:
        """Row of readings.csv."""
        (outcome, d, off), true = read, float(one.distance)
        return sensor, self.path, self.wall, self.c, true, outcome, d - true, off


def by_pictures(
    every: Sequence[Trial],
) -> tuple[list[tuple[Any, ...]], dict[tuple[str, float], Pictures]]:
    """Readings of shadow and stereo; and the pictures of the first wall by path and distance."""
    readings, kept = [], {}
    with progress("Photographing", total=sum(len(trial.places) for trial in every)) as advance:
        for trial in every:
            in_view = sensor_views.outcomes_at(stacked(trial.places), trial.seen)
            for k, one in enumerate(trial.places):
                taken = sensor_views.pictures(trial.scene, one, trial.seen)
                for sensor, measure in ((Sensor.SHADOW, _shadow), (Sensor.STEREO, _stereo)):
                    read = Read(in_view[sensor][k])
                    if read.outcome == ReadingOutcome.READ:
                        read = measure(one, taken)
                    readings.append(trial.row(sensor, one, read))
                if trial.wall == every[0].wall and trial.c == every[0].c:
                    kept[trial.path, float(one.distance)] = taken
                advance(note=trial.name)
    return readings, kept


def _withdrawal(trial: Trial) -> Scene:
    """Frames at the trial's distances, which are evenly spaced."""
    first, last = trial.places[0], trial.places[-1]
    start, travel = float(first.distance), float(last.distance - first.distance)
    frame = optics.Sphere(RADIUS_MM).frame_at(
        eccentricity=trial.c, azimuth=math.radians(trial.scene.spot.azimuth_deg)
    )
    along, across, out = (
        float(first.axis @ np.asarray(v))
        for v in (frame.meridional, frame.azimuthal, frame.outward)
    )
    return scenes.changed(
        trial.scene,
        {
            "source.cone_k": 1.0 / math.tan(sensor_views.CONE["half_angle"]),
            "source.cone_apex_offset_mm": sensor_views.CONE["apex_offset"],
            "spot.incidence_deg": math.degrees(math.acos(out)),
            "spot.incidence_azimuth_deg": math.degrees(math.atan2(across, along)),
            **withdrawal(start_mm=start, travel_mm=travel, frames=len(trial.places)),
        },
    )


def _known(one: InstrumentPlace, seen: Views) -> Known:
    return Known(seen, jnp.asarray(RADIUS_MM), jnp.asarray(one.lamp), jnp.asarray(one.axis))


def _spot(one: InstrumentPlace, seen: Views, row: Any) -> Read:
    """The reading of a row of `spots_of`."""
    if not row.used:
        return Read(ReadingOutcome.HIDDEN if row.result else ReadingOutcome.NO_SPOT)
    centre = sensor_views.centred(seen.centre, one.spot)
    x, y, *axes_and_angle = jnp.array(row.result.ellipse)
    ellipse = optics.Ellipse(jnp.stack([x, y]), *axes_and_angle)
    distance = float(sensor_views.by_spot(ellipse, _known(one, seen._replace(centre=centre))))
    off = abs(row.semi_minor_px - row.half_max_semi_minor_px)
    return Read(ReadingOutcome.READ, distance, off)


def _shadow(one: InstrumentPlace, taken: Pictures) -> Read:
    camera, image = taken.seen.centre, sensor_views.grey(taken.centre)
    tip, shadow = (
        found_shift(image, outline(one, camera, shadow=dark), dark=dark) for dark in (False, True)
    )
    distance = sensor_views.by_shadow(
        _image(camera, one.tip) + tip,
        _image(camera, np.asarray(sensor_views.shadow_of(one.tip, one.lamp))) + shadow,
        _known(one, taken.seen),
    )
    off = max(np.linalg.norm(shift) for shift in (tip, shadow))
    return Read(ReadingOutcome.READ, float(distance), float(off))


def _stereo(one: InstrumentPlace, taken: Pictures) -> Read:
    images = [sensor_views.grey(photograph) for photograph in (taken.left, taken.right)]
    height = sensor_views.wall_height(images[0], images[1], one, taken.seen)
    if height is None:
        return Read(ReadingOutcome.NO_TEXTURE)
    pair = [taken.seen.left, taken.seen.right]
    shifts = [
        found_shift(image, outline(one, camera), dark=False)
        for image, camera in zip(images, pair, strict=True)
    ]
    places = [_image(camera, one.tip) + shift for camera, shift in zip(pair, shifts, strict=True)]
    (tip,) = sensor_views.in_space(jnp.stack(places)[:, None], taken.seen)
    wall = optics.Sphere(RADIUS_MM - height)
    distance = float(sensor_views.distance_along(wall, tip, _known(one, taken.seen)))
    off = max(float(np.linalg.norm(shift)) for shift in shifts)
    return Read(ReadingOutcome.READ, distance, off)


def _image(camera: optics.Camera, point: np.ndarray) -> np.ndarray:
    return np.asarray(sensor_views.project(camera, point[None]))[0]


Tables = Mapping[str, pd.DataFrame]  # `expected`, `wrong` and `readings`, as in the CSV files

# Figures.

_COLOURS = {Sensor.SPOT: page.BLUE, Sensor.SHADOW: page.ORANGE, Sensor.STEREO: page.VERMILION}
_MARKS = {Sensor.SPOT: "o", Sensor.SHADOW: "^", Sensor.STEREO: "s"}
_SMALLEST_MM, _LARGEST_MM = 1e-4, 5.0


def by_path_figure(tables: Tables, *, wrong: Wrong | None = None) -> Figure:
    """Standard deviation against distance, or the error if something is wrong, for each path."""
    rows, value = tables["expected"], "sigma_mm"
    if wrong is not None:
        rows, value = where(tables["wrong"], wrong=wrong), "error_mm"

    def draw(axes: Axes, _: str, path: str) -> None:
        if wrong is None:
            axes.axhline(ACCEPTABLE_ERROR_MM, color=page.VERMILION, lw=0.8, ls="--", zorder=2.1)
            axes.set(yscale="log", ylim=(_SMALLEST_MM, _LARGEST_MM))
        else:
            page.limit_lines(axes, ACCEPTABLE_ERROR_MM)
        for sensor, colour in _COLOURS.items():
            own = grouped(where(rows, path=path, sensor=sensor), "c_mm")
            for (c, line), style in zip(own, ("-", "--", ":"), strict=False):
                label, mark = f"{sensor}, c = {c:g} mm", _MARKS[sensor]
                points = line.d_mm, line[value]
                axes.plot(*points, style, label=label, ms=3, color=colour, marker=mark)

    return page.small_multiples(
        draw,
        columns=rows.path.unique().tolist(),
        x=DISTANCE,
        y="σ of d (mm)" if wrong is None else "estimate − truth (mm)",
        height=3.0,
        legend_columns=3,
        sharey=True,
    )


def reading_figure(readings: pd.DataFrame) -> Figure:
    """|Error| of the rendered readings against distance: rows of paths, columns of walls."""
    read = where(readings, outcome=ReadingOutcome.READ)

    def draw(axes: Axes, path: str, wall: str) -> None:
        for sensor, colour in _COLOURS.items():
            of = where(read, sensor=sensor, path=path, wall=wall)
            axes.plot(
                of.d_mm,
                of.error_mm.abs().clip(lower=_SMALLEST_MM),
                ls="",
                marker=_MARKS[sensor],
                ms=4,
                color=colour,
                label=sensor,
            )
        axes.axhline(ACCEPTABLE_ERROR_MM, color=page.VERMILION, lw=0.8, ls="--")
        axes.set_yscale("log")
        axes.set_ylim(_SMALLEST_MM, _LARGEST_MM)

    return page.small_multiples(
        draw,
        rows=readings.path.unique()[:2].tolist(),
        columns=readings.wall.unique().tolist(),
        x=DISTANCE,
        y="|error| (mm)",
        height=2.2,
        sharex=True,
        sharey=True,
    )


def photograph_figure(
    photographs: Mapping[tuple[str, float], Pictures], full_scale_dn: float
) -> Figure:
    """What the sensors see at the largest distance, a row for each of two paths."""
    distance = max(d for _, d in photographs)

    def draw(axes: Axes, path: str, view: str) -> None:
        photograph = np.asarray(getattr(photographs[path, distance], view), float)
        axes.imshow(np.clip(photograph / full_scale_dn, 0.0, 1.0))
        axes.set_axis_off()

    paths = list(dict.fromkeys(path for path, _ in photographs))[:2]
    views = ["left", "centre", "right"]
    return page.small_multiples(draw, rows=paths, columns=views, height=2.6, legend_columns=0)


# The page.


def _report(
    tables: Tables, photographs: Mapping[tuple[str, float], Pictures], full_scale_dn: float
) -> page.Report:
    readings = tables["readings"]
    rows, path = where(readings, outcome=ReadingOutcome.READ), readings.path.iloc[0]
    sizes = 1e3 * rows.error_mm.abs().groupby(rows.sensor).median()
    medians = ", ".join(f"{number(sizes[s], 1)} µm from the {s}" for s in Sensor if s in sizes)
    here = where(readings, path=path)
    read = here.error_mm.abs().where(here.outcome == ReadingOutcome.READ)
    by_wall = read.groupby([here.sensor, here.wall], sort=False)
    found = by_wall.agg(asked="size", read="count", median_mm="median", largest_mm="max")
    return page.Report(
        title="Which is the best sensor of the distance: the spot, the shadow, or a stereo pair?",
        answer=f"In rendered pictures the median error of a distance is {medians}.",
        lead="The same distance d, from the instrument's tip to the wall along its axis, is read "
        "from the spot of its own light, from the shadow of its tip under a light guide, and from "
        f"a stereo pair with {CONVERGENCE_DEG:g}° between the lines of sight, by the same "
        f"microscope ({SCALE_MM_PX:g} mm/px at the pole) at the same places. All three know the "
        "instrument's axis, the wall's shape and their cameras.",
        first=[
            page.Picture(
                "noise",
                by_path_figure(tables),
                "The spot is the most precise of the three sensors. Standard deviation of d, for "
                f"noise of {CONTOUR_PX:g} px for each of 128 points of the spot's edge, "
                f"{MARK_PX:g} px in x and y for a tip and for a shadow's tip, {WALL_PX:g} px for "
                "the wall's texture in a pair; the last three are assumptions. Dashed: what "
                "the paper calls acceptable. A line ends where the window or the iris hides a "
                "mark, or the instrument hides its shadow.",
                data="expected.csv",
            ),
            page.Table(
                found.reset_index(),
                ["sensor", "wall", "asked", "read", "median_mm", "largest_mm"],
                f"Readings from rendered pictures through {path}.",
                data="readings.csv",
            ),
            page.Picture(
                "photographs",
                photograph_figure(photographs, full_scale_dn),
                "The instrument and its shadow, by the left half of the pair, the central "
                "microscope, and the right half.",
                inline="jpeg",
            ),
        ],
        claims=list(_claims(tables["expected"], tables["wrong"])),
        sections=[
            page.Section(
                "Methods",
                "Spot: the exact spot with the ellipse's centre and area, as --model area. "
                "Shadow: the line of sight of the shadow's tip meets the wall; from there a line "
                "to the light guide meets the tip's line of sight at the tip. Stereo: two lines of "
                "sight meet at the tip, two more on the wall below it. The labels say where marks "
                f"are to within {sensor_views.REACH_PX:g} px and how outlines run; "
                "docs/sensors.md says how the places are then measured.",
            ),
            page.Section(
                "What a wrong assumption gives",
                page.Picture(
                    "path",
                    by_path_figure(tables, wrong=Wrong.PATH),
                    "Error without noise if the microscope's pinhole is known, but the viewing "
                    f"lens and the eye in front of it (z_F = {PINHOLE_HEIGHT_MM:g} mm) are not.",
                    data="wrong.csv",
                ),
            ),
            page.Section(
                "Read from rendered pictures",
                page.Picture(
                    "readings",
                    reading_figure(readings),
                    "Errors of the readings; a missing mark was not read.",
                    data="readings.csv",
                ),
            ),
        ],
        data={f"{name}.csv": table for name, table in tables.items()},
    )


def _claims(expected: pd.DataFrame, wrong: pd.DataFrame) -> Iterator[page.Claim]:
    named, paths = ", ".join(Sensor), expected.path.unique().tolist()
    for path in paths:
        there = where(expected, path=path, outcome=ReadingOutcome.READ)
        sigmas = [where(there, sensor=sensor).sigma_mm for sensor in Sensor]
        medians, seen = tuple(float(s.median()) for s in sigmas), [len(s) for s in sigmas]
        places = len(where(expected, sensor=Sensor.SPOT, path=path))
        yield page.Claim(
            name=f"noise, {path}",
            sentence=f"Through {path}, marks of the stated noise give {listed(medians, '.4f')} mm "
            f"({named}; medians over the places in view). In view are {listed(seen, 'd')} of "
            f"{places} places.",
            value=medians,
        )
    for path in paths[1:]:
        taken = where(wrong, path=path, wrong=Wrong.PATH)
        worst = tuple(largest(where(taken, sensor=sensor).error_mm) for sensor in Sensor)
        yield page.Claim(
            name=f"unknown path, {path}",
            sentence=f"If {path} is taken for a pinhole, the largest errors are "
            f"{listed(worst, '.2f')} mm ({named}).",
            value=worst,
        )
    lamp = largest(where(wrong, wrong=Wrong.LAMP).error_mm)
    yield page.Claim(
        name="light guide",
        sentence="A light guide 1 mm beside the place where it is thought to be changes the "
        f"shadow's distance by up to {lamp:.2f} mm.",
        value=lamp,
    )


# The command.


def sensors(
    *, out: OutputFolder, quick: Quick = False, seed: Seed = None
) -> dict[str, pd.DataFrame]:
    """Read one distance from the spot, from the instrument's shadow and from a stereo pair."""
    study = Study("sensors", out, quick=quick, seed=seed)
    paths = [*PATHS][:2] if quick else [*PATHS]
    with study.timed("expected"):
        how: dict[str, Any] = {"draws": 50 if quick else 200, "seed": study.seed}
        cameras = {path: sensor_views.views(path) for path in paths}
        found = [expected(path, seen, cameras["pinhole"], **how) for path, seen in cameras.items()]
        noise, wrong = (pd.concat(of, ignore_index=True) for of in zip(*found, strict=True))
    walls = ["printed paper", "uniform"] if quick else ["printed paper", "retina", "uniform"]
    every = []
    for path, wall, c in product(paths, walls, [0.0] if quick else [0.0, 3.0]):
        scene = sensor_views.base_scene(study.scene, path, wall, eccentricity=c)
        distances = [1.0, 4.0] if quick else [1.0, 3.0, 5.0]
        own = [place(eccentricity=c, distance=d) for d in distances]
        every.append(Trial(path, wall, c, scene, own, cameras[path]))
    with study.timed("render and measure spots"):
        spots = study.tracked({trial.name: _withdrawal(trial) for trial in every})
        readings = [
            trial.row(Sensor.SPOT, one, _spot(one, trial.seen, row))
            for trial in every
            for one, row in zip(trial.places, rows_of(spots[trial.name]), strict=True)
        ]
    with study.timed("render and measure shadows and stereo pairs"):
        others, kept = by_pictures(every)
    tables = {
        "expected": noise,
        "wrong": wrong,
        "readings": pd.DataFrame(readings + others, columns=READING),
    }
    study.publish(_report, tables, kept, study.scene.camera.full_scale_dn)
    return tables
