"""Accuracy of the mode pixels on rendered stacks, with its stated errors and the sub-pixel mode.

The beam is known. The robot says the beam's axis with an error of 5 degrees, one draw a stack, and
the tip's relative motion; nothing says the distance. Each wall, beam and motion is drawn anew from
a seed: place, tilt, texture and noise. Frames from the fifth on use what the earlier ones showed of
the wall.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

import optics
from benchmarks.bench.output import show, table
from benchmarks.evaluation import rms
from benchmarks.studies.pose import PRIOR_DEG, drawn_prior
from estimator.files import (
    Calibration,
    Pose,
    PoseTrack,
    Stack,
    read_poses,
    write_calibration,
)
from estimator.run import Options, Reader
from estimator.sources import open_source
from scenes import Scene, SceneError, load_mitsuba, render_stack

_BEAMS: dict[str, dict[str, Any]] = {
    "cone": {"kind": "cone"},
    "dome, vitreous": {"kind": "lens", "lens": "dome", "medium": "vitreous"},
    "candidate, air": {"kind": "lens", "lens": "paper-candidate", "medium": "air"},
}
_WALLS = ("uniform", "printed paper", "retina", "photograph")
_FIELD_MM = 2.2  # half of the photograph's width, where every wall has a picture
_FRAMES, _LATER = 12, 4  # frames from the fifth on have numbers from 4
_STACKS, _STACKS_FULL = 1, 4
_WIDTH = 160  # characters of the widest table
_SURE = 1e-6  # relative error of a beam that is known


class Reading(NamedTuple):
    """Errors of one frame; lengths in mm, angles in degrees, and NaN where there is no pose."""

    beam: str
    wall: str
    motion: str
    frame: int
    d_mm: float
    distance_mm: float
    sigma_mm: float
    tip_mm: float
    axis_deg: float
    sigma_axis_deg: float
    mahalanobis: float
    half_maximum_px: float
    doubt: str
    seconds: float


def run(*, full: bool) -> None:
    """Render, read, and print the errors (`full` draws more stacks)."""
    load_mitsuba()
    rng = np.random.default_rng(20261123)
    readings: list[Reading] = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(_STACKS_FULL if full else _STACKS):
            for beam in _BEAMS:
                for wall in _WALLS:
                    motion = "hand" if number % 2 else "withdrawal"
                    place = Path(folder) / f"{len(readings)}"
                    readings += list(_read(beam, wall, motion, rng, place))
    show(_errors(readings), _coverage(readings), width=_WIDTH)


def _read(
    beam: str, wall: str, motion: str, rng: np.random.Generator, folder: Path
) -> Iterator[Reading]:
    while True:
        seed = int(rng.integers(1, 2**31))
        scene = Scene.model_validate(_scene(beam, wall, motion, seed, rng))
        try:
            stack = render_stack(scene, folder)
        except SceneError:  # the drawn spot leaves the window
            continue
        break
    reader, poses = _reader(stack, beam, rng)
    for frame, labels in zip(open_source(stack.folder), stack.labels, strict=True):
        began = time.perf_counter()
        found = reader.read(
            frame.image, time_s=frame.time_s, exposure_s=frame.exposure_s, poses=poses
        )
        seconds = time.perf_counter() - began
        off, covariance = np.full(5, math.nan), np.eye(5)
        distance = sigma = half = math.nan
        if found.result:
            half = found.result.semi_minor_px - labels.half_max_semi_minor_px
        if found.range and found.range.poses:
            pose = found.range.poses[0]
            assert pose.covariance is not None and pose.across is not None
            turns = pose.across @ (pose.axis - np.array(labels.axis))
            off = np.concatenate([pose.tip_mm - np.array(labels.tip_mm), turns])
            distance, sigma = found.range.distance_mm - labels.d_mm, found.range.sigma_mm
            covariance = pose.covariance
        yield Reading(
            beam=beam,
            wall=wall,
            motion=motion,
            frame=frame.index,
            d_mm=labels.d_mm,
            distance_mm=distance,
            sigma_mm=sigma,
            tip_mm=float(np.linalg.norm(off[:3])),
            axis_deg=math.degrees(np.linalg.norm(off[3:])),
            sigma_axis_deg=math.degrees(math.sqrt(covariance[3, 3] + covariance[4, 4])),
            mahalanobis=float(off @ np.linalg.solve(covariance, off)),
            half_maximum_px=half,
            doubt=found.doubt,
            seconds=seconds,
        )


def _scene(
    beam: str, wall: str, motion: str, seed: int, rng: np.random.Generator
) -> dict[str, Any]:
    distance = float(rng.uniform(1.0, 3.5))
    moves = {
        "withdrawal": {
            "start_mm": distance,
            "travel_mm": 2.0,
            "frames": _FRAMES,
            "speed_mm_s": 1.0,
        },
        "hand": {
            "kind": "hand",
            "distance_mm": distance,
            "duration_s": 0.1 * (_FRAMES - 1),
            "top_speed_mm_s": 2.0,
            "seed": seed,
        },
    }
    return {
        "schema": 1,
        "seed": seed,
        "phantom": {"wall": wall, "texture_seed": seed},
        "instrument": {"visible": False},
        "source": _BEAMS[beam],
        "spot": {
            "eccentricity_mm": float(rng.uniform(0, _FIELD_MM)),
            "azimuth_deg": float(rng.uniform(60, 120)),
            "incidence_deg": float(rng.uniform(10, 30)),
            "incidence_azimuth_deg": float(rng.uniform(0, 360)),
        },
        "motion": moves[motion],
        "exposures": {"kinds": ["metered"]},
    }


def _reader(stack: Stack, beam: str, rng: np.random.Generator) -> tuple[Reader, PoseTrack]:
    """A reader with the true beam, and the robot's poses with an error of the axis."""
    calibration, stated = stack.folder / "beam.json", stack.folder / "stated.toml"
    write_calibration(calibration, _calibration(beam))
    stated.write_text(f"axis_sigma_deg = {PRIOR_DEG}\n")
    reader = Options.of(
        {
            "mode": "pixels",
            "calibration": calibration,
            "microscope": stack.folder / "microscope.json",
            "eye_from_robot": (0.0, 0.0, 0.0, 1.0),
            "stated": stated,
        }
    ).reader()
    axis = np.array(stack.labels[0].axis)
    turn = drawn_prior(axis, rng) - axis
    told = [
        Pose.along(
            _unit(np.array(pose.axis) + turn), time_s=pose.time_s, position_mm=pose.position_mm
        )
        for pose in read_poses(stack.folder / "kinematics.csv")
    ]
    return reader, PoseTrack(told)


def _unit(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (vector / np.linalg.norm(vector)).tolist()
    return x, y, z


def _calibration(beam: str) -> Calibration:
    source = _BEAMS[beam]
    medium = source.get("medium", "air")
    if source["kind"] == "cone":
        model, values = "planar", {"k": 20.0, "b": -5.117}
    else:
        lens = optics.load_lens(source["lens"])
        model = "lens"
        values = {name: float(x) for name, x in vars(lens).items() if x is not None}
    sigmas = _SURE * np.abs(list(values.values()))
    return Calibration(
        model=model,
        values=values,
        covariance=np.diag(np.square(sigmas)),
        medium=medium,
        medium_index=optics.MEDIA[medium],
        fitted_on="the beam that was rendered",
        data_sha256="0" * 64,
        software="benchmarks.bench.pixel_pose",
    )


def _errors(readings: list[Reading]) -> Table:
    made = table(
        f"mode pixels on single frames and from the fifth on; axis told to {PRIOR_DEG:g}°",
        *("beam", "wall", "frames", "with a pose", "doubtful", "d RMS, µm", "stated", "tip, µm"),
        *("axis, °", "stated", "chi²_5 / 5", "sub-pixel e₁′, px", "ms, median"),
    )
    for beam in _BEAMS:
        for wall in _WALLS:
            own = [one for one in readings if (one.beam, one.wall) == (beam, wall)]
            groups = {
                "first": [one for one in own if one.frame == 0],
                "5th on": [one for one in own if one.frame >= _LATER],
            }
            for name, some in groups.items():
                posed = [one for one in some if not math.isnan(one.distance_mm) and not one.doubt]
                made.add_row(
                    f"{beam}",
                    f"{wall}",
                    name,
                    f"{len(posed)} of {len(some)}",
                    f"{sum(bool(one.doubt) for one in some)}",
                    f"{1e3 * rms([one.distance_mm for one in posed]):.1f}",
                    f"{1e3 * rms([one.sigma_mm for one in posed]):.1f}",
                    f"{1e3 * rms([one.tip_mm for one in posed]):.1f}",
                    f"{rms([one.axis_deg for one in posed]):.3f}",
                    f"{rms([one.sigma_axis_deg for one in posed]):.3f}",
                    f"{np.mean([one.mahalanobis for one in posed]) / 5:.2f}",
                    f"{rms([one.half_maximum_px for one in posed]):.2f}",
                    f"{1e3 * np.median([one.seconds for one in some]):.0f}",
                )
    return made


def _coverage(readings: list[Reading]) -> Table:
    """Of first frames, one a stack, which are independent."""
    made = table(
        "first frames, one a stack: within the stated errors",
        *("wall", "stacks", "d within 1 σ, %", "d within 1.96 σ, %", "largest chi²_5"),
    )
    for wall in _WALLS:
        first = [one for one in readings if one.wall == wall and one.frame == 0 and not one.doubt]
        z = np.abs([one.distance_mm / one.sigma_mm for one in first])
        made.add_row(
            wall,
            f"{len(first)}",
            f"{100 * np.mean(z < 1):.0f}",
            f"{100 * np.mean(z < 1.96):.0f}",
            f"{max((one.mahalanobis for one in first), default=math.nan):.1f}",
        )
    return made
