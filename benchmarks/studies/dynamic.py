"""`eyespot study dynamic`: the error of a distance while the tip moves, and what makes it."""

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pandas as pd
from cyclopts import Parameter
from cyclopts.validators import Number
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot import optics, scenes
from eyespot.benchmarks import paper
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.reporting import grouped, number, rows_of, where
from eyespot.benchmarks.statistics import largest, rms
from eyespot.benchmarks.study import Study
from eyespot.benchmarks.study_command import LightSource, command
from eyespot.calibration import fit_plane
from eyespot.estimator import Ranger, open_source
from eyespot.formats.microscope import MicroscopeFile, read_microscope
from eyespot.formats.poses import PoseTrack, read_poses
from eyespot.formats.stack import Stack
from eyespot.scenes import Scene
from eyespot.scenes.world.true_calibration import study_calibration, true_calibration
from eyespot.scenes.world.world import World

# The scenes of the dynamic study: tips moving at several speeds, and the same without blur.

_MEAN_DISTANCE_MM = 3.0
_STRAIGHT_FRAMES = 5  # More would leave the view at the top speed.
_HAND_FRAMES = 10
_SLOWEST_HAND_MM_S = 2.0  # Below, the residual tremor is faster than the hand.
_FREEZING_GAIN = 1e4  # Exposures become shorter by as much.

_REST = {"start_mm": 1.0, "travel_mm": 3.5, "speed_mm_s": 0.1, "frames": 15}
"""A withdrawal as long and as slow as the paper's (2 um in 20 ms), over what motions reach."""


class MovingTrial(NamedTuple):
    """One motion (of `MOTIONS`), measured in one way.

    The speed is that of a straight motion, or a hand's highest. Each run, from 1, has its noise,
    texture and hand. `frozen`: the same with exposures too short for blur.
    """

    motion: str
    way: paper.Way
    speed_mm_s: float
    run: int
    moving: Scene
    frozen: Scene

    @property
    def name(self) -> str:
        """The name of its stack; the frozen one's ends with -frozen."""
        kind, speed = self.moving.source.kind, f"{self.speed_mm_s:g}"
        return "-".join([kind, self.motion, speed, self.way.slug, str(self.run)])


def trials(
    scene: Scene, way: paper.Way, *, sensitivity: float, speeds: Sequence[float], run: int
) -> list[MovingTrial]:
    """Every motion at every speed, once; runs count from 1."""
    own = scenes.changed(
        scene,
        {
            "seed": scene.seed + run - 1,
            "phantom.texture_seed": scene.phantom.texture_seed + run - 1,
            "clocks.seed": scene.clocks.seed + run - 1,
            "exposures.kinds": [way.exposure],
        },
    )
    found = []
    for motion, speed in product(MOTIONS, speeds):
        if motion != "hand" or speed >= _SLOWEST_HAND_MM_S:
            path = _path(motion, speed, interval_s=1 / scene.clocks.camera_hz, seed=own.seed)
            moving, frozen = (
                scenes.changed(own, path | {"exposures.sensitivity_mm2_sr_mj": sensitivity * gain})
                for gain in (1.0, _FREEZING_GAIN)
            )
            found.append(MovingTrial(motion, way, speed, run, moving, frozen))
    return found


def _path(motion: str, speed: float, *, interval_s: float, seed: int) -> dict[str, object]:
    """Settings of a motion; its first and last frames, at its ends, are not evaluated."""
    intervals = 1 + (_HAND_FRAMES if motion == "hand" else _STRAIGHT_FRAMES)
    duration, d = intervals * interval_s, _MEAN_DISTANCE_MM
    travel = speed * duration
    if motion == "withdrawal":
        path = {"start_mm": d - travel / 2, "travel_mm": travel, "frames": intervals + 1}
        return _motion(motion, speed_mm_s=speed, **path)
    path = {"duration_s": duration, "top_speed_mm_s": speed, "seed": seed}
    if motion == "scan":
        # From a trocar infinitely far away, so the tip is as fast as its spot.
        path = {"length_mm": travel, "speed_mm_s": speed, "trocar_mm": math.inf}
    return _motion(motion, distance_mm=d, **path)


def _motion(kind: str, **path: float) -> dict[str, object]:
    return {"motion.kind": kind} | {f"motion.{name}": value for name, value in path.items()}


# What a moving tip adds to the error of a distance, part by part.
#
# The estimate from a frame is compared with the robot's reading, the distance along the beam at the
# pose that is taken for the frame's. With the estimate d' from the blurred frame and d'_0 from the
# same frame without blur, the true distance d in the middle of the exposure, the reading d_s of the
# pose with that stamp, and d_l of one that is read late,
#
#     d' - d_l = (d'_0 - d) + (d' - d'_0) + (d - d_s) + (d_s - d_l)
#       error  =    rest    +    blur     +  stamps   +   latency
#
# At constant withdrawal speed v a pose that is late by L gives the part latency = -v L: the robot
# has gone on since the frame was taken.

COMPARED = (paper.LITERAL, paper.SUBPIXEL)
MOTIONS = ("withdrawal", "scan", "hand")  # along the beam, across the wall, in a hand
LATENCIES_S = (0.0, 0.05, 0.1)  # A pose without a time stamp is read so late.
PARTS = ("rest", "blur", "stamps", "latency")


def parts(*, estimate: Any, frozen: Any, d: Any, stamped: Any, late: Any) -> dict[str, Any]:
    """Columns of the error and its `PARTS`, from d', d'_0, d, d_s and d_l; mm."""
    split = estimate - late, frozen - d, estimate - frozen, d - stamped, stamped - late
    return dict(zip((f"{name}_mm" for name in ("error", *PARTS)), split, strict=True))


def reading(poses: PoseTrack, time_s: float, wall: optics.Surface) -> float:
    """Distance along the beam to the eye's wall by the robot's pose at a time, mm, or NaN."""
    found = poses.at(time_s)
    if found is None:
        return math.nan
    pose, _ = found
    meets = wall.intersect(jnp.array(pose.position_mm), jnp.array(pose.axis))
    return float(meets.distance)


_EYE_FROM_ROBOT = (0.0, 0.0, 0.0, 1.0)  # The rendered robot reports in the eye's frame.


def ranger(rest: Stack, scene: Scene, way: paper.Way) -> Ranger:
    """The ranger that computes distances from a way's spots; InputError if too few are at rest.

    Literal mode has the paper's model with the k and b fitted to the withdrawal at rest, as on the
    paper's rig; sub-pixel mode has the true source and exact geometry.
    """
    microscope = read_microscope(rest.folder / "microscope.json")
    if way is not paper.LITERAL:
        return Ranger(true_calibration(scene), microscope)
    spots = paper.track_stack(rest, way)
    values = small_plane_line(spots[spots.used], microscope)
    about: dict[str, Any] = {"medium": scene.source.medium, "fitted_on": rest.folder.name}
    return Ranger(study_calibration("small_plane", values, **about), microscope)


def small_plane_line(spots: pd.DataFrame, microscope: MicroscopeFile) -> dict[str, float]:
    """k and b of the paper's model: a line, after subtracting its sagitta from the distance.

    d - (r - sqrt(r^2 - e1^2)) = k e1 + b with e1 = delta e1' cos(phi) (Zhou et al. 2020, eq. 10);
    the spots have the columns semi_minor_px (e1'), phi_rad (asin(c/r)) and d_mm.
    """
    scale, r = microscope.scale_mm_px, microscope.eye_radius_mm
    e, phi, d = spots[["semi_minor_px", "phi_rad", "d_mm"]].to_numpy(float).T
    seen = e * np.cos(phi)
    sagitta = optics.sagitta(spot_radius=scale * seen, eye_radius=r)
    line = fit_plane(semi_minor_px=seen, distance=d - sagitta)
    return {"k": line.delta_k / scale, "b": line.b}


def errors(trial: MovingTrial, *, moving: Stack, frozen: Stack, ranger: Ranger) -> pd.DataFrame:
    """Rows of dynamic_error.csv, frame by frame and latency by latency; error = estimate - reading.

    `set_speed_mm_s` is the trial's, `speed_mm_s` the tip's in the middle of the exposure. `doubt`
    is why an estimate does not count, `rest_doubt` the same of the frame without blur. The first
    frame and the last are left out, where the tip is at rest for half of the exposure.
    """
    poses, wall = read_poses(moving.folder / "kinematics.csv"), World(trial.moving).wall
    labels = pd.DataFrame([vars(row) for row in moving.exposed(trial.way.exposure)])
    seen, still = (_readings(stack, trial.way, ranger, poses) for stack in (moving, frozen))
    hidden = (labels.visible_fraction < paper.VISIBLE_ENOUGH) & (seen.doubt == "")
    seen.loc[hidden, :] = "less than half of the contour in view", math.nan
    about = {
        "source": trial.moving.source.kind,
        "motion": trial.motion,
        "way": trial.way.name,
        "set_speed_mm_s": trial.speed_mm_s,
        "run": trial.run,
        **labels[["frame", "time_s", "exposure_s", "speed_mm_s", "d_mm"]],
    }
    known = {"estimate": seen.distance_mm, "frozen": still.distance_mm, "d": labels.d_mm}
    tables = []
    for latency_s in LATENCIES_S:
        late = pd.Series([reading(poses, time + latency_s, wall) for time in labels.time_s])
        known.setdefault("stamped", late)  # by the first latency, none
        rows = about | {
            "latency_s": latency_s,
            "doubt": seen.doubt,
            "rest_doubt": still.doubt,
            "estimate_mm": seen.distance_mm,
            "reading_mm": late,
        }
        tables.append(pd.DataFrame(rows | parts(**known, late=late))[1:-1])
    return pd.concat(tables).sort_values("frame", kind="stable")


def _readings(stack: Stack, way: paper.Way, ranger: Ranger, poses: PoseTrack) -> pd.DataFrame:
    """Why each frame's estimate does not count, and those that do, mm."""
    start = way.click(stack.exposed(way.exposure))
    reader = way.reader(ranger, eye_from_robot=_EYE_FROM_ROBOT, start=start)
    frames = open_source(stack.folder, exposure=way.exposure)
    found = [reader.read(frame, poses=poses) for frame in frames]
    doubt = pd.Series([one.doubt.replace("_", " ") for one in found])
    distance = pd.Series([one.distance_mm for one in found]).where(doubt == "")
    return pd.DataFrame({"doubt": doubt, "distance_mm": distance})


# Sizes.


def spreads(errors: pd.DataFrame, speeds: tuple[float, ...]) -> pd.DataFrame:
    """Content of dynamic_spread.csv: all frames of about one speed, the nearest to the tip's own.

    `left_out` is the number of frames without an estimate.
    """
    counts_for = [min(speeds, key=lambda s: (abs(s - speed), s)) for speed in errors.speed_mm_s]
    frames = errors.assign(speed_mm_s=counts_for, left_out=errors.doubt != "")
    sizes = [f"{name}_mm" for name in ("error", *PARTS)]
    frames[sizes] = frames[sizes].where(~frames.left_out)
    by = frames.groupby(["source", "motion", "way", "speed_mm_s", "latency_s"])
    left_out, largest_error = by.left_out.sum(), by.error_mm.agg(largest)
    found = by[sizes].agg(rms).add_prefix("rms_").join(by[sizes].mean().add_prefix("mean_"))
    found.insert(1, "largest_error_mm", largest_error)
    counts = pd.DataFrame({"spots": by.size() - left_out, "left_out": left_out})
    return counts.join(found).reset_index()


def _rows(study: Study, source: str, *, speeds: tuple[float, ...], runs: int) -> list[pd.DataFrame]:
    scene = scenes.changed(study.scene, {"source.kind": source})
    exposure_s = float(study.options["exposure-ms"]) / 1000
    with study.timed(f"{source}: render at rest"):
        (rest,) = study.stacks(
            {f"{source}-rest": scenes.changed(scene, _motion("withdrawal", **_REST))}
        ).values()
    wanted = []
    for way in COMPARED:
        # The sensitivity at which exposures at the mean distance are as long as asked for.
        there = min(rest.exposed(way.exposure), key=lambda row: abs(row.d_mm - _MEAN_DISTANCE_MM))
        own = scene.exposures.sensitivity_mm2_sr_mj * there.exposure_s / exposure_s
        for run in range(1, runs + 1):
            wanted += trials(scene, way, sensitivity=own, speeds=speeds, run=run)
    with study.timed(f"{source}: render motions"):
        moving = study.stacks({trial.name: trial.moving for trial in wanted})
        frozen = study.stacks({f"{trial.name}-frozen": trial.frozen for trial in wanted})
    with study.timed(f"{source}: measure"):
        rangers = {way: ranger(rest, scene, way) for way in COMPARED}
        pairs = zip(wanted, moving.values(), frozen.values(), strict=True)
        return [errors(one, moving=m, frozen=f, ranger=rangers[one.way]) for one, m, f in pairs]


# Figures.

_LEAST_DRAWN_MM = 1e-3  # Smaller errors lie at the foot of the logarithmic axis.


def _errors_by_speed(spreads: pd.DataFrame) -> Figure:
    """RMS error against speed: a panel for each motion."""

    def draw(axes: Axes, _: str, motion: str) -> None:
        axes.axhline(paper.ACCEPTABLE_ERROR_MM, color=page.GREY, lw=0.8, ls=":")
        for way, colour in zip(COMPARED, (page.VERMILION, page.BLUE), strict=True):
            for latency, dashes in zip(LATENCIES_S, ("-", "--", ":"), strict=True):
                rows = where(spreads, motion=motion, way=way.name, latency_s=latency)
                label = f"{way.name}, {1000 * latency:g} ms late"
                _drawn(axes, rows, "error", color=colour, ls=dashes, label=label)

    return page.small_multiples(draw, columns=MOTIONS, x=_SPEED, y="RMS error (mm)", sharey=True)


def _parts_by_speed(spreads: pd.DataFrame) -> Figure:
    """RMS of each part of the error against speed, with the latest poses."""

    def draw(axes: Axes, way: str, motion: str) -> None:
        rows = where(spreads, motion=motion, way=way, latency_s=LATENCIES_S[-1])
        colours = page.GREY, page.ORANGE, page.GREEN, page.PURPLE
        for part, colour in zip(PARTS, colours, strict=True):
            _drawn(axes, rows, part, color=colour, label=part)
        _drawn(axes, rows, "error", color=page.BLACK, ls="--", label="error")

    ways = [way.name for way in COMPARED]
    shared: dict[str, Any] = {"sharex": True, "sharey": True}
    return page.small_multiples(draw, rows=ways, columns=MOTIONS, x=_SPEED, y="RMS (mm)", **shared)


_SPEED = "speed of the tip (mm/s)"


def _drawn(axes: Axes, rows: pd.DataFrame, part: str, **style: Any) -> None:
    sizes = rows[f"rms_{part}_mm"].clip(lower=_LEAST_DRAWN_MM)
    axes.plot(rows.speed_mm_s, sizes, marker="o", ms=3, **style)
    axes.set(xscale="log", yscale="log", xticks=rows.speed_mm_s)
    axes.minorticks_off()
    axes.xaxis.set_major_formatter("{x:g}")


# The page.

_REQUIRED_MM = 0.1  # Sub-pixel mode with stamped poses keeps it up to the top speed.
_PAPERS_SPEED_MM_S = 1.5  # Up to it the paper's error is acceptable (Zhou et al. 2020).


def report(errors: pd.DataFrame, spreads: pd.DataFrame, *, exposure_ms: float) -> page.Report:
    """The report of a run: dynamic_error.csv and dynamic_spread.csv."""
    source, top = errors.source.iloc[-1], spreads.speed_mm_s.max()
    late, shown = f"{1000 * LATENCIES_S[-1]:g} ms late", where(spreads, source=source)
    stamped = where(errors, latency_s=LATENCIES_S[0])
    used = where(stamped, source=source, way=paper.SUBPIXEL.name, doubt="")
    fastest = where(shown, speed_mm_s=top)
    last = where(fastest, motion="withdrawal", way=paper.SUBPIXEL.name, latency_s=LATENCIES_S[-1])
    names = (1000 * fastest.latency_s).map("{:g} ms late".format)
    table = fastest.assign(late=names).pivot(
        index=["motion", "way"], columns="late", values="rms_error_mm"
    )
    return page.Report(
        title="How wrong is the distance while the tip moves, and why?",
        answer=f"Up to {top:g} mm/s the distance from the {source}'s spot is off by "
        f"{number(largest(used.error_mm), 3)} mm at most in sub-pixel mode if the robot's poses "
        f"are stamped; poses {late} make it {number(rms(last.rms_error_mm), 2)} mm (rms, along the "
        "beam, at that speed).",
        lead=f"Estimates from frames of {exposure_ms:g} ms while the tip moves along the beam "
        "(withdrawal), across the wall at one distance (scan) and as a hand moves it on a robot, "
        "against the robot's readings. Literal mode has the paper's model with k and b from a "
        "withdrawal at rest; sub-pixel mode has the true source.",
        first=[
            page.Picture(
                "errors",
                _errors_by_speed(shown),
                "A late pose costs more than blur. RMS error of the estimates that count, "
                f"{source}, by the listed speed that is nearest to the tip's own; dotted: the "
                "error that the paper accepts.",
                data="dynamic_spread.csv",
            ),
            page.Table(
                table.reset_index(),
                ["motion", "way", *dict.fromkeys(names)],
                f"RMS error in mm at {top:g} mm/s, {source}.",
                data="dynamic_spread.csv",
            ),
        ],
        claims=list(_claims(stamped, spreads)),
        sections=[
            page.Section(
                "Blur and time",
                "Every motion is rendered twice: as it is, and with exposures too short for blur "
                "but the same poses, brightness and noise. So each frame's error is the sum of "
                "four parts. Rest: the error of the estimate from the frame without blur. Blur: "
                "the change of the estimate by the exposure. Stamps: the age of the robot's "
                "latest pose and its clock's errors. Latency: how far the robot has moved before "
                "a pose without a stamp is read. While the tip withdraws at speed v, a pose late "
                "by L adds −vL.",
                page.Picture(
                    "parts",
                    _parts_by_speed(shown),
                    f"RMS of the parts, {source}, with poses {late}.",
                    data="dynamic_spread.csv",
                ),
            ),
        ],
        data={"dynamic_error.csv": errors, "dynamic_spread.csv": spreads},
    )


def _claims(stamped: pd.DataFrame, spreads: pd.DataFrame) -> Iterator[page.Claim]:
    """From the errors with stamped poses, and the sizes of all."""
    top = spreads.speed_mm_s.max()
    for source, rows in grouped(where(stamped, way=paper.SUBPIXEL.name), "source"):
        used = where(rows, doubt="")
        worst, moved = largest(used.error_mm), largest(used.blur_mm + used.stamps_mm)
        reasons = rows.doubt[rows.doubt != ""].value_counts()
        why = "".join(f"; {number} {reason}" for reason, number in reasons.items())
        yield page.Claim(
            name=f"{source}, requirement",
            sentence=f"Sub-pixel mode with stamped poses is off by {worst:.3f} mm at most up to "
            f"{top:g} mm/s (required: {_REQUIRED_MM:g} mm); blur and stamps together add up to "
            f"{moved:.3f} mm. {len(rows) - len(used)} of {len(rows)} frames gave no estimate that "
            f"counts{why}.",
            value=worst,
            high=_REQUIRED_MM,
        )
    # Blur and latency at the top speed along the beam, where means do not cancel.
    fastest = where(spreads, motion="withdrawal", latency_s=LATENCIES_S[-1], speed_mm_s=top)
    for row in rows_of(fastest[fastest.spots > 0]):
        latency, blur = abs(row.mean_latency_mm), abs(row.mean_blur_mm)
        yield page.Claim(
            name=f"{row.source}, {row.way}, late pose against blur",
            sentence=f"Along the beam at {top:g} mm/s, poses {1000 * LATENCIES_S[-1]:g} ms "
            f"late add {latency:.3f} mm to the mean error, blur adds {blur:.3f} mm.",
            value=latency,
            low=blur,
        )
    # The delay or the blur that alone would explain the paper's error.
    delay = paper.ACCEPTABLE_ERROR_MM / _PAPERS_SPEED_MM_S
    literal = where(stamped, way=paper.LITERAL.name, motion="scan").dropna(subset="blur_mm")
    for source, scans in grouped(literal, "source"):
        paths = scans.speed_mm_s * scans.exposure_s
        slope = float(np.dot(paths, scans.blur_mm) / np.dot(paths, paths))
        exposure_ms = 1000 * delay / slope if slope > 0 else math.nan
        yield page.Claim(
            name=f"{source}, the paper's speed",
            sentence=f"A delay of {1000 * delay:.0f} ms between frame and pose would explain the "
            f"paper's {paper.ACCEPTABLE_ERROR_MM:g} mm at {_PAPERS_SPEED_MM_S:g} mm/s, and so "
            f"would blur of exposures of {exposure_ms:.0f} ms. In literal mode blur across the "
            f"wall adds {slope:+.2f} mm per mm of the spot's path during the exposure (a line "
            f"through {len(scans)} frames with paths up to {paths.max():.3f} mm).",
            value=exposure_ms,
        )


# The command.

_JITTER = ("clocks.kinematics_jitter_s=0.001",)
"""A robot's stamps jitter; without, they would fall on the frames' own moments."""
VARIED = ("source.kind", "motion")
"""Keys of the scene that the study sets itself."""


def check(scene: Scene) -> None:
    """Refuse a scene without an eyeball."""
    why = "the study's models are those of the eyeball"
    Study.demand(scene, {"phantom.kind": "eyeball"}, why)


@command(defaults=_JITTER, check=check, varies=VARIED)
def dynamic(
    study: Study,
    *,
    source: LightSource = "both",
    exposure_ms: Annotated[float, Parameter(validator=Number(gte=0.1, lte=100))] = 20.0,
) -> pd.DataFrame:
    """Measure the error while the tip moves: by speed, motion blur and a late pose.

    Args:
        exposure_ms: Exposure time of a frame at the mean distance, 0.1 to 100.
    """
    sources = ("cone", "lens") if source == "both" else (source,)
    speeds = (0.5, 1.5, 5.0) if study.quick else (0.5, 1.0, 1.5, 2.0, 3.0, 5.0)
    runs = 1 if study.quick else 2
    tables = [rows for one in sources for rows in _rows(study, one, speeds=speeds, runs=runs)]
    errors = pd.concat(tables, ignore_index=True)
    study.publish(report, errors, spreads(errors, speeds), exposure_ms=exposure_ms)
    return errors
