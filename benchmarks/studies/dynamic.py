"""`eyespot study dynamic`: the error of a distance while the tip moves, and what makes it."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Annotated, Any

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

# What a moving tip adds to the error of a distance, part by part.
#
# The estimate from a frame is compared with the robot's reading, the distance along the beam at the
# pose that is taken for the frame's. With the estimate d' from the blurred frame and d'_0 from the
# same frame without blur, the true distance d in the middle of the exposure, the reading d_s of the
# pose with that stamp, and d_l of one that is read late,
#
#     d' - d_l = (d'_0 - d) + (d' - d'_0) + (d - d_s) + (d_s - d_l)
#       error  =    rest    +    blur     +  stamps   +   latency

COMPARED = (paper.LITERAL, paper.SUBPIXEL)
MOTIONS = {"withdrawal": 5, "scan": 5, "hand": 10}  # In so many frames the spot stays in the view.
LATENCIES_S = (0.0, 0.05, 0.1)  # A pose without a time stamp is read so late.
PARTS = ("rest", "blur", "stamps", "latency")
_SIZES = [f"{name}_mm" for name in ("error", *PARTS)]


def parts(*, estimate: Any, frozen: Any, d: Any, stamped: Any, late: Any) -> dict[str, Any]:
    """Columns of the error and its `PARTS`, from d', d'_0, d, d_s and d_l; mm."""
    split = estimate - late, frozen - d, estimate - frozen, d - stamped, stamped - late
    return dict(zip(_SIZES, split, strict=True))


# The scenes: tips moving at several speeds, and the same without blur.

_MEAN_DISTANCE_MM = 3.0
_SLOWEST_HAND_MM_S = 2.0  # Below, the residual tremor is faster than the hand.
_FREEZING_GAIN = 1e4  # Exposures become shorter by as much.
_SENSITIVITY = "exposures.sensitivity_mm2_sr_mj"

# As long and as slow as the paper's (2 um in 20 ms), over what motions reach.
_REST = {"kind": "withdrawal", "start_mm": 1.0, "travel_mm": 3.5, "speed_mm_s": 0.1, "frames": 15}


def trials(
    scene: Scene,
    sensitivities: Mapping[paper.Way, float],
    *,
    frames: Mapping[str, int],
    speeds: Sequence[float],
    runs: int,
) -> pd.DataFrame:
    """Motions of so many frames at every speed, measured in every way, some times.

    Returns:
        Columns name (of its stack), motion, way, speed_mm_s (a hand's highest), run, and the scenes
        moving and frozen, with exposures too short for blur. Each run has its noise and texture.
    """
    rows = []
    for way, run, motion, speed in product(sensitivities, range(runs), frames, speeds):
        if motion == "hand" and speed < _SLOWEST_HAND_MM_S:
            continue
        own = {
            "seed": scene.seed + run,
            "phantom.texture_seed": scene.phantom.texture_seed + run,
            "clocks.seed": scene.clocks.seed + run,
            "exposures.kinds": [way.exposure],
            "motion": _path(scene, motion, speed=speed, frames=frames[motion], run=run),
        }
        gains = (sensitivities[way] * gain for gain in (1.0, _FREEZING_GAIN))
        both = (scenes.changed(scene, own | {_SENSITIVITY: gain}) for gain in gains)
        name = f"{scene.source.kind}-{motion}-{speed:g}-{way.slug}-{run + 1}"
        rows.append((name, motion, way, speed, run + 1, *both))
    return pd.DataFrame(rows, columns="name motion way speed_mm_s run moving frozen".split())


def _path(scene: Scene, motion: str, /, *, speed: float, frames: int, run: int) -> Any:
    """Settings of a motion; in a further frame at either end, not evaluated, the tip rests."""
    d, duration = _MEAN_DISTANCE_MM, (frames + 1) * (1 / scene.clocks.camera_hz)
    travel = speed * duration
    settings: dict[str, dict[str, object]] = {
        "withdrawal": {"start_mm": d - travel / 2, "travel_mm": travel, "frames": frames + 2},
        # From a trocar infinitely far away, so the tip is as fast as its spot.
        "scan": {"distance_mm": d, "length_mm": travel, "trocar_mm": math.inf},
        "hand": {"distance_mm": d, "duration_s": duration, "seed": scene.seed + run},
    }
    fast = "top_speed_mm_s" if motion == "hand" else "speed_mm_s"
    return {"kind": motion, fast: speed} | settings[motion]


# The method: every frame's estimate, and the robot's reading for it.


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
    beam = study_calibration("small_plane", values, medium=scene.source.medium)
    return Ranger(beam, microscope)


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


def reading(poses: PoseTrack, time_s: float, wall: optics.Surface) -> float:
    """Distance along the beam to the eye's wall by the robot's pose at a time, mm, or NaN."""
    found = poses.at(time_s)
    if found is None:
        return math.nan
    pose, _ = found
    return float(wall.intersect(jnp.array(pose.position_mm), jnp.array(pose.axis)).distance)


def errors(trial: Any, *, moving: Stack, frozen: Stack, ranger: Ranger) -> pd.DataFrame:
    """Rows of dynamic_error.csv of a row of `trials`; error = estimate - reading.

    `speed_mm_s` is the tip's in the middle of the exposure. `doubt` is why an estimate does not
    count, `rest_doubt` the same of the frame without blur.
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
    of_frames = {"doubt": seen.doubt, "rest_doubt": still.doubt, "estimate_mm": seen.distance_mm}
    known = {"estimate": seen.distance_mm, "frozen": still.distance_mm, "d": labels.d_mm}
    tables = []
    for latency_s in LATENCIES_S:
        late = pd.Series([reading(poses, time + latency_s, wall) for time in labels.time_s])
        known.setdefault("stamped", late)  # by the first latency, none
        rows = about | {"latency_s": latency_s} | of_frames | {"reading_mm": late}
        tables.append(pd.DataFrame(rows | parts(**known, late=late))[1:-1])
    return pd.concat(tables).sort_values("frame", kind="stable")


def _readings(stack: Stack, way: paper.Way, ranger: Ranger, poses: PoseTrack) -> pd.DataFrame:
    """Why each frame's estimate does not count, and those that do, mm."""
    same_frame, start = (0.0, 0.0, 0.0, 1.0), way.click(stack.exposed(way.exposure))
    reader = way.reader(ranger, eye_from_robot=same_frame, start=start)
    frames = open_source(stack.folder, exposure=way.exposure)
    found = [reader.read(frame, poses=poses) for frame in frames]
    doubt = pd.Series([one.doubt.replace("_", " ") for one in found])
    distance = pd.Series([one.distance_mm for one in found]).where(doubt == "")
    return pd.DataFrame({"doubt": doubt, "distance_mm": distance})


def spreads(errors: pd.DataFrame, speeds: tuple[float, ...]) -> pd.DataFrame:
    """Content of dynamic_spread.csv: all frames of about one speed, the nearest to the tip's own.

    `left_out` is the number of frames without an estimate.
    """
    counts_for = [min(speeds, key=lambda s: (abs(s - speed), s)) for speed in errors.speed_mm_s]
    frames = errors.assign(speed_mm_s=counts_for, left_out=errors.doubt != "")
    frames[_SIZES] = frames[_SIZES].where(~frames.left_out)
    by = frames.groupby(["source", "motion", "way", "speed_mm_s", "latency_s"])
    found = by[_SIZES].agg(rms).add_prefix("rms_").join(by[_SIZES].mean().add_prefix("mean_"))
    found.insert(1, "largest_error_mm", by.error_mm.agg(largest))
    left_out = by.left_out.sum()
    counts = pd.DataFrame({"spots": by.size() - left_out, "left_out": left_out})
    return counts.join(found).reset_index()


def measure(study: Study, source: str, **plan: Any) -> pd.DataFrame:
    """Render and track all motions with one source: its rows of dynamic_error.csv."""
    scene = scenes.changed(study.scene, {"source.kind": source})
    exposure_s, sensitivities = float(study.options["exposure-ms"]) / 1000, {}
    with study.timed(f"{source}: render"):
        at_rest = {f"{source}-rest": scenes.changed(scene, {"motion": _REST})}
        (rest,) = study.stacks(at_rest).values()
        for way in COMPARED:
            labels, own = rest.exposed(way.exposure), scene.exposures.sensitivity_mm2_sr_mj
            there = min(labels, key=lambda row: abs(row.d_mm - _MEAN_DISTANCE_MM))
            # Exposures at the mean distance are as long as asked for.
            sensitivities[way] = own * there.exposure_s / exposure_s
        every = rows_of(trials(scene, sensitivities, **plan))
        moving = study.stacks({one.name: one.moving for one in every})
        frozen = study.stacks({f"{one.name}-frozen": one.frozen for one in every})
    with study.timed(f"{source}: measure"):
        rangers = {way: ranger(rest, scene, way) for way in COMPARED}
        of_each = zip(every, moving.values(), frozen.values(), strict=True)
        found = [errors(one, moving=m, frozen=f, ranger=rangers[one.way]) for one, m, f in of_each]
    return pd.concat(found)


# The page.

_REQUIRED_MM = 0.1  # Sub-pixel mode with stamped poses keeps it up to the top speed.
_PAPERS_SPEED_MM_S = 1.5  # Up to it the paper's error is acceptable (Zhou et al. 2020).


def _figure(spreads: pd.DataFrame) -> Figure:
    def draw(axes: Axes, _: str, motion: str) -> None:
        axes.axhline(paper.ACCEPTABLE_ERROR_MM, color=page.GREY, lw=0.8, ls=":")
        for way, colour in zip(COMPARED, (page.VERMILION, page.BLUE), strict=True):
            for latency, dashes in zip(LATENCIES_S, ("-", "--", ":"), strict=True):
                own = where(spreads, motion=motion, way=way.name, latency_s=latency)
                label = f"{way.name}, {1000 * latency:g} ms late"
                axes.plot(own.speed_mm_s, own.rms_error_mm, f"o{dashes}", c=colour, label=label)
        axes.set(yscale="log")

    return page.small_multiples(
        draw, columns=list(MOTIONS), x="speed of the tip (mm/s)", y="RMS error (mm)", sharey=True
    )


def report(errors: pd.DataFrame, spreads: pd.DataFrame, *, exposure_ms: float) -> page.Report:
    """The report of a run: dynamic_error.csv and dynamic_spread.csv."""
    source, top = errors.source.iloc[-1], spreads.speed_mm_s.max()
    late, shown = f"{1000 * LATENCIES_S[-1]:g} ms late", where(spreads, source=source)
    stamped = where(errors, latency_s=LATENCIES_S[0])
    used = where(stamped, source=source, way=paper.SUBPIXEL.name, doubt="")
    split = where(shown, speed_mm_s=top, latency_s=LATENCIES_S[-1])
    last = where(split, motion="withdrawal", way=paper.SUBPIXEL.name)
    return page.Report(
        title="How wrong is the distance while the tip moves, and why?",
        answer=f"Up to {top:g} mm/s the distance from the {source}'s spot is off by "
        f"{number(largest(used.error_mm), 3)} mm at most in sub-pixel mode with stamped poses; "
        f"poses {late} make it {number(rms(last.rms_error_mm), 2)} mm (RMS, along the beam).",
        lead=f"Estimates from frames of {exposure_ms:g} ms while the tip moves along the beam "
        "(withdrawal), across the wall at one distance (scan) and as a hand moves it on a robot, "
        "against the robot's readings. Literal mode has the paper's model, fitted to a withdrawal "
        "at rest; sub-pixel mode has the true source.",
        first=[
            page.Picture(
                "errors",
                _figure(shown),
                "A late pose costs more than blur. RMS error of the estimates that count, "
                f"{source}, by the listed speed that is nearest to the tip's own; dotted: the "
                "error that the paper accepts.",
                data="dynamic_spread.csv",
            ),
            page.Table(
                split,
                ["motion", "way", *(f"rms_{size}" for size in _SIZES)],
                f"RMS of the error and of its parts at {top:g} mm/s with poses {late}, {source}. "
                "Rest: the error without blur. Blur: what the exposure adds. Stamps: the age of "
                "the latest pose and its clock's errors. Latency: how far the robot has moved "
                "before a pose without a stamp is read, −vL if the tip withdraws at v.",
                data="dynamic_spread.csv",
            ),
        ],
        claims=list(_claims(stamped)),
        data={"dynamic_error.csv": errors, "dynamic_spread.csv": spreads},
    )


def _claims(stamped: pd.DataFrame) -> Iterator[page.Claim]:
    for source, rows in grouped(where(stamped, way=paper.SUBPIXEL.name), "source"):
        worst, doubts = largest(where(rows, doubt="").error_mm), rows.doubt[rows.doubt != ""]
        why = "".join(f"; {n} {reason}" for reason, n in doubts.value_counts().items())
        yield page.Claim(
            name=f"{source}, requirement",
            sentence=f"Sub-pixel mode with stamped poses is off by {worst:.3f} mm at most up to "
            f"{rows.set_speed_mm_s.max():g} mm/s (required: {_REQUIRED_MM:g} mm). {len(doubts)} of "
            f"{len(rows)} frames gave no estimate that counts{why}.",
            value=worst,
            high=_REQUIRED_MM,
        )
    delay_ms = 1000 * paper.ACCEPTABLE_ERROR_MM / _PAPERS_SPEED_MM_S
    slow = stamped[stamped.set_speed_mm_s <= _PAPERS_SPEED_MM_S]
    for source, rows in grouped(where(slow, way=paper.LITERAL.name), "source"):
        yield page.Claim(
            name=f"{source}, the paper's speed",
            sentence=f"A pose {delay_ms:.0f} ms late would explain the paper's "
            f"{paper.ACCEPTABLE_ERROR_MM:g} mm at {_PAPERS_SPEED_MM_S:g} mm/s. Up to that speed "
            f"blur changes a distance by {largest(rows.blur_mm):.3f} mm at most in literal mode.",
            value=largest(rows.blur_mm),
            high=paper.ACCEPTABLE_ERROR_MM,
        )


# The command.

_JITTER = ("clocks.kinematics_jitter_s=0.001",)  # Else stamps fall on the frames' own moments.


def check(scene: Scene) -> None:
    """Refuse a scene without an eyeball."""
    Study.demand(scene, {"phantom.kind": "eyeball"}, "the study's models are those of the eyeball")


@command(defaults=_JITTER, check=check, varies=("source.kind", "motion"))
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
    plan: dict[str, Any] = {
        "frames": dict.fromkeys(MOTIONS, 2) if study.quick else MOTIONS,
        "speeds": (1.5, 5.0) if study.quick else (0.5, 1.0, 1.5, 2.0, 3.0, 5.0),
        "runs": 1 if study.quick else 2,
    }
    errors = pd.concat([measure(study, one, **plan) for one in sources], ignore_index=True)
    study.publish(report, errors, spreads(errors, plan["speeds"]), exposure_ms=exposure_ms)
    return errors
