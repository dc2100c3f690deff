"""`eyespot study loop`: what distance can a robot keep with this sensor?

DIR/loop.csv     distance and reading of every run, at the robot's ticks
    runs.csv     error of each run: RMS, 95 %, largest; nearest and farthest distance
    assumed.csv  the same with a perfect sensor, where one of the assumptions does not hold
    film.mp4     what the microscope saw in one run, by the mode pixels
    start/       one frame of the scene, with the files that a reader needs
"""

import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from scipy.linalg import expm

from eyespot import scenes
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.statistics import largest, rms
from eyespot.benchmarks.study import Study
from eyespot.benchmarks.study_command import command
from eyespot.estimator import Frame
from eyespot.estimator.run.offline import record_of
from eyespot.estimator.run.overlay import annotated, overlay_writer
from eyespot.formats.camera_sheet import Response
from eyespot.formats.poses import Pose, PoseTrack
from eyespot.formats.spots import SpotRecord
from eyespot.scenes import LiveCamera, Scene, World

# The question: an arm through a trocar, a path along the wall, a camera with a delay.

TICK_S = 0.005  # SHER's joints run at 200 Hz.
LAG_S, TOP_SPEED_MM_S = 0.03, 5.0  # Of a joint; both are assumptions.
KEPT_MM, SETTLING_S = 2.0, 0.5  # Errors count from then on.
SPOT_TO_TROCAR_MM = 20.0  # Along the beam.
LONGEST_PATH_MM = 2.4  # The window shows no longer one.
LEAST_DISTANCE_MM = 1.0  # Nearer, the arm withdraws whatever the controller says.
MOST_HALF_EXPOSURE_S = 0.005
DARK_PLACE_MM = np.array([0.0, 0.0, -1e3])  # A tip there lights nothing.
BLIND_S, WITHDRAWAL_MM_S = 0.3, 2.0  # Blind for so long, the arm withdraws.


@dataclass(frozen=True, kw_only=True)
class LoopRun:
    """One run of the loop."""

    sensor: str = "perfect"  # or a mode of the reader
    speed_mm_s: float = 1.0  # of the spot along its path on the wall
    rate_hz: float = 30.0
    latency_s: float = 0.05  # from the middle of an exposure to its reading
    poses: bool = True  # whether the controller takes out how far the arm went since the exposure
    dark_s: tuple[float, float] = (math.inf, math.inf)  # between which the fibre is dark
    late_s: float = 0.0  # by which the poses are older than their stamps say
    noise_mm: float = 0.0  # standard deviation of the perfect sensor
    foreknown: float = 0.9  # share of the wall's rise along the beam that the feed-forward knows
    tremor_mm: float = 0.009  # RMS along the beam, 8 to 12 Hz: a hand's 0.18 mm, damped by 95 %

    @property
    def gain(self) -> float:
        """1/s, for a critically damped loop; without the poses the delay D is in it: 1/(e D)."""
        if self.poses:
            return 1 / (4 * (LAG_S + 0.5 * TICK_S))
        return 1 / (math.e * (self.latency_s + 0.5 / self.rate_hz + LAG_S))


class Course(NamedTuple):
    """Where the beam points at the ticks: axes, n x 3, and distances from the trocar, mm."""

    time_s: np.ndarray
    axis: np.ndarray
    depth_mm: np.ndarray
    trocar: np.ndarray

    @classmethod
    def of(cls, scene: Scene, run: LoopRun, seconds: float) -> "Course":
        """A straight vessel through the place of [spot], along which the wall rises most."""
        path = {
            "motion.kind": "scan",
            "motion.distance_mm": KEPT_MM,
            "motion.length_mm": run.speed_mm_s * seconds,
            "motion.speed_mm_s": run.speed_mm_s,
            "motion.direction_deg": scene.spot.incidence_azimuth_deg,
            "motion.trocar_mm": SPOT_TO_TROCAR_MM,
        }
        world = World(scenes.changed(scene, path))
        time = np.arange(0.0, seconds, TICK_S)
        tip, axis = world.motion.at(time)
        spot, beam = world.aim
        trocar = spot - SPOT_TO_TROCAR_MM * beam
        return cls(time, axis, np.linalg.norm(tip + KEPT_MM * axis - trocar, axis=1), trocar)


# The method: the arm is exact between its ticks; frames are rendered where it is.

PoseAt = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Tips, mm, and axes at times, s, that lie in the past."""
Read = Callable[[float, PoseAt, bool], float]
"""Reads the distance at a time, mm, by the poses around it; the fibre may be dark. NaN: none."""


def simulated(
    run: LoopRun, course: Course, read: Read, *, seed: int, begin_mm: float, set_mm: float = KEPT_MM
) -> pd.DataFrame:
    """One run: distance, what the controller expects, and what it does, at each tick."""
    # Of place, velocity, and the velocity that is asked for, which is held between ticks.
    step = expm(TICK_S * np.array([[0.0, 1, 0], [0, -1 / LAG_S, 1 / LAG_S], [0, 0, 0]]))
    time, depth = course.time_s, course.depth_mm
    hz = np.random.default_rng(seed).uniform(8.0, 12.0, 32)
    shake = run.tremor_mm * np.sin(2 * np.pi * np.outer(time, hz) + hz**3).sum(axis=1) / 4
    known = run.foreknown * (depth - depth[0])
    rise = np.gradient(known, TICK_S)
    state, inserted = np.array([depth[0] - begin_mm, 0.0]), np.empty(time.size)
    target, seen_s, frame = math.nan, 0.0, 1
    waiting: list[tuple[float, float, float]] = []
    rows: list[tuple[float, ...]] = []

    def pose(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        past = time[: len(rows)]
        axis = np.stack([np.interp(times, past, x[: past.size]) for x in course.axis.T], axis=1)
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        length = np.interp(times, past, inserted[: past.size])
        return course.trocar + length[:, None] * axis, axis

    for k, now in enumerate(time):
        inserted[k] = state[0] + shake[k]
        while waiting and waiting[0][0] <= now + 1e-9:
            _, taken_s, reading = waiting.pop(0)
            if math.isfinite(reading):
                then = taken_s - run.late_s if run.poses else now
                moved = np.interp(then, time[: k + 1], inserted[: k + 1] - known[: k + 1])
                target, seen_s = moved + reading, now
        # By the last reading, the robot's pose and what is known of the wall.
        expected = target + known[k] - inserted[k]
        lost, near = now - seen_s > BLIND_S, expected < LEAST_DISTANCE_MM
        asked = run.gain * (expected - set_mm) + rise[k] if math.isfinite(expected) else 0.0
        asked = -WITHDRAWAL_MM_S if lost or near else asked
        asked = float(np.clip(asked, -TOP_SPEED_MM_S, TOP_SPEED_MM_S))
        rows.append((now, depth[k] - inserted[k], expected, asked, bool(lost), bool(near)))
        state = (step @ [*state, asked])[:2]
        while frame / run.rate_hz + MOST_HALF_EXPOSURE_S <= now + 1e-9:
            taken_s = frame / run.rate_hz
            dark = run.dark_s[0] <= taken_s < run.dark_s[1]
            waiting.append((taken_s + run.latency_s, taken_s, read(taken_s, pose, dark)))
            frame += 1
    return pd.DataFrame(rows, columns="time_s d_mm expected_mm asked_mm_s lost near".split())


class LoopCamera:
    """Renders frames where the arm is, and reads them; `seen` has those of the last run."""

    def __init__(self, study: Study) -> None:
        rest = {"motion.kind": "withdrawal", "motion.start_mm": KEPT_MM, "motion.frames": 1}
        scene = scenes.changed(study.scene, rest)
        self._start, self._camera = study.stacks({"start": scene})["start"], LiveCamera(scene)
        reader = functools.partial(study.reader, self._start, scene)
        self._reader = functools.cache(reader)
        self.seen: list[tuple[Frame, SpotRecord]] = []

    def reads(self, run: LoopRun) -> Read:
        """The sensor of one run; NaN also for a distance in doubt."""
        reader, self.seen = self._reader(run.sensor), []
        reader.forget()
        label = self._start.exposed("paper" if run.sensor == "literal" else "metered")[0]
        exposure_s = min(label.exposure_s, 2 * MOST_HALF_EXPOSURE_S)

        def read(taken_s: float, pose: PoseAt, dark: bool) -> float:
            tips, axes = pose(taken_s + exposure_s * np.array([-0.5, 0.0, 0.5]))
            tips, number = tips + dark * DARK_PLACE_MM, len(self.seen)
            image = self._camera.image(tips, axes, exposure_s=exposure_s, frame=number)
            times = taken_s + np.linspace(-0.1, MOST_HALF_EXPOSURE_S, 43)
            rows = zip(times.tolist(), *(part.tolist() for part in pose(times)), strict=True)
            poses = PoseTrack(Pose.along(u, time_s=t, position_mm=tip) for t, tip, u in rows)
            frame = Frame(index=number, time_s=taken_s, exposure_s=exposure_s, image=image)
            reading = reader.read(frame, poses=poses)
            self.seen.append((frame, record_of(frame, reading)))
            return math.nan if reading.doubt else reading.distance_mm

        return read


def perfect(course: Course, run: LoopRun, seed: int) -> Read:
    """A sensor that knows the distance, but for white noise."""
    rng = np.random.default_rng(seed)

    def read(taken_s: float, pose: PoseAt, dark: bool) -> float:
        (tip,), _ = pose(np.array([taken_s]))
        depth = np.interp(taken_s, course.time_s, course.depth_mm)
        true = depth - float(np.linalg.norm(tip - course.trocar))
        return math.nan if dark else true + run.noise_mm * rng.standard_normal()

    return read


# The tables.

SENSORS = {"perfect sensor": "perfect", "sub-pixel": "subpixel", "pixels": "pixels"}
VARIED = {  # name, unit, and values beside the usual one
    "speed_mm_s": ("speed along the wall", "mm/s", (0.25, 0.5, 2.0)),
    "rate_hz": ("frame rate", "Hz", (10.0, 60.0)),
    "latency_s": ("latency", "s", (0.02, 0.2)),
}


def runs(*, quick: bool) -> dict[str, LoopRun]:
    """The runs by name: one thing at a time, from a usual one."""
    usual = LoopRun(sensor="subpixel")
    table = {name: replace(usual, sensor=sensor) for name, sensor in SENSORS.items()} | {
        "literal": replace(usual, sensor="literal"),
        "sub-pixel, camera only": replace(usual, poses=False),
        "dark for 0.2 s": replace(usual, dark_s=(1.0, 1.2)),
        "dark for 0.6 s": replace(usual, dark_s=(0.6, 1.2)),
    }
    for name, (key, (label, unit, values)) in itertools.product(SENSORS, VARIED.items()):
        for value in () if quick else values:
            changes: dict[str, Any] = {key: value}
            table[f"{name}, {label} {value:g} {unit}"] = replace(table[name], **changes)
    return table


ASSUMED: dict[str, dict[str, Any]] = {
    "all of them hold": {},
    "no tremor": {"tremor_mm": 0.0},
    "the wall's rise is unknown": {"foreknown": 0.0},
    "poses are 50 ms older than stamped": {"late_s": 0.05},
    "no poses": {"poses": False},
    "the sensor has 0.1 mm of noise": {"noise_mm": 0.1},
}
"""What is assumed of the hand, the wall, the robot and the sensor, one at a time otherwise."""

COLUMNS = {
    "run": page.Column("run"),
    "rms_mm": page.Column("error, RMS, mm"),
    "p95_mm": page.Column("95 %, mm"),
    "largest_mm": page.Column("largest, mm"),
    "nearest_mm": page.Column("nearest to the wall, mm", 2),
    "farthest_mm": page.Column("farthest, mm", 2),
}

# The page.


def _report(
    errors: pd.DataFrame, assumed: pd.DataFrame, rows: pd.DataFrame, film: np.ndarray
) -> page.Report:
    by_run = errors.set_index("run")
    inks = {str(name): f"C{k}" for k, name in enumerate(by_run.index)}

    def draw_film(axes: Axes, *_: str) -> None:
        axes.imshow(film)
        axes.axis("off")

    def draw(axes: Axes, _: str, shown: str) -> None:
        for name in [*inks][:7]:
            if ("dark" in name) == ("dark" in shown):
                mine = rows[rows.run == name]
                axes.plot(mine.time_s, mine.d_mm, color=inks[name], label=name)

    def draw_errors(axes: Axes, _: str, key: str) -> None:
        for name in SENSORS:
            varied = by_run.index.str.startswith(f"{name}, {VARIED[key][0]}")
            mine = by_run[varied | (by_run.index == name)].sort_values(key)
            axes.loglog(mine[key], mine.rms_mm, "o-", color=inks[name], label=name)
            axes.loglog(mine[key], mine.largest_mm, "o:", color=inks[name])
        axes.set_xticks([*mine[key]], [f"{x:g}" for x in mine[key]], minor=False)
        axes.minorticks_off()

    strip = page.small_multiples(draw_film, columns=[""], legend_columns=0)
    panels, x, y = ["sensors", "dark fibre"], "time (s)", "distance (mm)"
    kept = page.small_multiples(draw, columns=panels, x=x, y=y, sharey=True)
    labels = {key: f"{name} ({unit})" for key, (name, unit, _) in VARIED.items()}
    how: dict[str, Any] = {"title": lambda *_: "", "x": labels.__getitem__, "sharey": True}
    depends = page.small_multiples(draw_errors, columns=list(labels), y="error (mm)", **how)
    alone = page.Picture("errors", depends, "RMS (solid) and largest error (dotted).", "runs.csv")
    speed, (ideal, outline, pixels, paper) = by_run.speed_mm_s.iloc[0], by_run.rms_mm.iloc[:4]
    said = "The distance is kept to {:.3f} mm (RMS). On a phantom 0.1 mm was published in 2021."
    claims = [
        page.Claim(name=name, sentence=said.format(error), value=error, high=high)
        for name, high in {"sub-pixel": 0.1, "pixels": 0.1, "literal": math.inf}.items()
        for error in [by_run.rms_mm[name]]
    ]
    of_perfect = {**COLUMNS, "run": page.Column("a perfect sensor, and")}
    touch = int((by_run.nearest_mm <= 0).sum())
    of_touch = f"Runs that touch the wall: {touch}."
    contacts = page.Claim(name="contacts", sentence=of_touch, value=touch, high=0)
    return page.Report(
        title="What distance can a robot keep with this sensor?",
        answer=f"At {speed:g} mm/s along the wall, {KEPT_MM:g} mm are kept to {outline:.3f} mm "
        f"(RMS) by the outline, to {pixels:.3f} mm by all pixels, to {paper:.3f} mm by the paper's "
        f"estimator, and to {ideal:.3f} mm by a perfect sensor.",
        lead="An arm through a trocar follows a vessel on the wall. Every frame is rendered where "
        "the arm is, and read by the rig's reader. It is assumed that the robot's poses are exact, "
        f"that 90 % of the wall's rise along the path are known, that the tremor is "
        f"{1e3 * LoopRun.tremor_mm:g} µm (RMS), and that calibration and microscope have no "
        "error. The last table has what the first three are worth.",
        first=[
            page.Picture("film", strip, "What the microscope sees.", "film.mp4", "jpeg"),
            page.Picture("distance", kept, "The distance in time, from 2.3 mm on.", "loop.csv"),
            page.Table(errors, COLUMNS, f"After the first {SETTLING_S:g} s.", data="runs.csv"),
            page.Table(assumed, of_perfect, "What the assumptions are worth.", data="assumed.csv"),
        ],
        claims=[contacts, *claims],
        sections=[page.Section("What the error depends on", alone)] if len(errors) > 7 else [],
        data={"runs.csv": errors, "assumed.csv": assumed, "loop.csv": rows},
    )


# The command.


@command(defaults=("source.kind=cone", "source.power_mw=5"))
def loop(study: Study) -> pd.DataFrame:
    """Keep a distance from the wall with a simulated robot, by frames rendered in the loop.

    To continue a run that was stopped, start it again with the same folder.
    """
    errors, every, eye, film = [], [], LoopCamera(study), study.folder / "film.mp4"

    def ran(name: str, run: LoopRun) -> tuple[pd.DataFrame, dict[str, Any]]:
        seconds = min(1.5 if study.quick else 4.0, LONGEST_PATH_MM / run.speed_mm_s)
        course, seed = Course.of(study.scene, run, seconds), study.seed
        read = perfect(course, run, seed) if run.sensor == "perfect" else eye.reads(run)
        rows = simulated(run, course, read, seed=seed, begin_mm=KEPT_MM + 0.3)
        settled = rows[rows.time_s > SETTLING_S]
        error = (settled.d_mm - KEPT_MM).abs()[~settled.lost & ~settled.near]
        ends = settled.d_mm.min(), settled.d_mm.max()
        found = name, rms(error), error.quantile(0.95), largest(error), *ends
        return rows.assign(run=name), dict(zip(COLUMNS, found, strict=True)) | asdict(run)

    with study.timed("runs"):
        assumed = [ran(name, LoopRun(**changes))[1] for name, changes in ASSUMED.items()]
        for name, run in runs(quick=study.quick).items():
            rows, error = ran(name, run)
            every.append(rows)
            errors.append(error)
            if name == "pixels":
                film.unlink(missing_ok=True)
                with overlay_writer(film, rate_hz=run.rate_hz, response=Response()) as draw:
                    for pair in eye.seen:
                        draw(*pair)
                shown = (eye.seen[k] for k in (0, len(eye.seen) // 2, -1))
                strip = np.hstack([annotated(*pair, response=Response()) for pair in shown])
    tables = pd.DataFrame(errors), pd.DataFrame(assumed), pd.concat(every, ignore_index=True)
    study.publish(_report, *tables, strip)
    return tables[0]
