"""The scenes of the dynamic study: tips moving at several speeds, and the same without blur."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import scenes
from benchmarks.evaluation import Way
from estimator import Stack
from scenes import Scene

_MEAN_DISTANCE_MM = 3.0
_STRAIGHT_FRAMES = 5  # as many as fit into the view at the top speed
_HAND_FRAMES = 10
_SLOWEST_HAND_MM_S = 2.0  # below, the residual tremor is faster than the hand
_FREEZES = 1e4  # how much shorter exposures are under so much more light

_REST = {"start_mm": 1.0, "travel_mm": 3.5, "speed_mm_s": 0.1, "frames": 15}
"""A withdrawal as long and as slow as the paper's (2 um in 20 ms), over what motions reach."""


class MovingTrial(NamedTuple):
    """One motion at one speed, measured in one way.

    Attributes:
        motion: one of `MOTIONS`.
        speed_mm_s: of a straight motion, or a hand's highest.
        run: from 1, each with noise, texture and hand of its own.
        frozen: the same poses, noise and brightness with exposures too short for blur.
    """

    motion: str
    way: Way
    speed_mm_s: float
    run: int
    moving: Scene
    frozen: Scene

    @property
    def name(self) -> str:
        """The name of its stack; the frozen one's ends with -frozen."""
        kind, speed = self.moving.source.kind, f"{self.speed_mm_s:g}"
        return "-".join([kind, self.motion, speed, self.way.slug, str(self.run)])


def at_rest(scene: Scene) -> Scene:
    """The withdrawal at rest, in both exposures, which calibrates and meters."""
    return _with_motion(scene, "withdrawal", _REST)


def sensitivity(rest: Stack, scene: Scene, way: Way, *, exposure_s: float) -> float:
    """Sensitivity at which a way's exposure has the requested length at the study's mean distance.

    Args:
        rest: of `at_rest(scene)`.
        scene: whose sensitivity the stack was exposed with.
        way: of measuring; "metered" exposures differ with the distance.
        exposure_s: asked for.
    """
    rows = rest.exposed(way.exposure)
    there = min(rows, key=lambda row: abs(row.d_mm - _MEAN_DISTANCE_MM))
    return scene.exposures.sensitivity_mm2_sr_mj * there.exposure_s / exposure_s


def trials(
    scene: Scene, way: Way, *, sensitivity: float, speeds: Sequence[float], run: int
) -> list[MovingTrial]:
    """Every motion at every speed, once; runs count from 1."""
    hands = [speed for speed in speeds if speed >= _SLOWEST_HAND_MM_S]
    wanted = [(motion, speed) for motion in ("withdrawal", "scan") for speed in speeds]
    wanted += [("hand", speed) for speed in hands]
    own = scenes.changed(
        scene,
        {
            "seed": scene.seed + run - 1,
            "phantom.texture_seed": scene.phantom.texture_seed + run - 1,
            "clocks.seed": scene.clocks.seed + run - 1,
            "exposures.kinds": [way.exposure],
            "exposures.sensitivity_mm2_sr_mj": sensitivity,
        },
    )
    frozen = scenes.changed(own, {"exposures.sensitivity_mm2_sr_mj": sensitivity * _FREEZES})
    found = []
    for motion, speed in wanted:
        path = _path(motion, speed, interval_s=1 / scene.clocks.camera_hz, seed=own.seed)
        moving, still = (_with_motion(s, motion, path) for s in (own, frozen))
        found.append(MovingTrial(motion, way, speed, run, moving, still))
    return found


def _path(motion: str, speed: float, *, interval_s: float, seed: int) -> dict[str, float | int]:
    """Settings of a motion; its first and last frames, at its ends, are not evaluated."""
    intervals = 1 + (_HAND_FRAMES if motion == "hand" else _STRAIGHT_FRAMES)
    duration = intervals * interval_s
    if motion == "withdrawal":
        travel = speed * duration
        return {
            "start_mm": _MEAN_DISTANCE_MM - travel / 2,
            "travel_mm": travel,
            "speed_mm_s": speed,
            "frames": intervals + 1,
        }
    if motion == "scan":
        return {
            "distance_mm": _MEAN_DISTANCE_MM,
            "length_mm": speed * duration,
            "speed_mm_s": speed,
            "trocar_mm": math.inf,  # so the tip is as fast as its spot
        }
    return {
        "distance_mm": _MEAN_DISTANCE_MM,
        "duration_s": duration,
        "top_speed_mm_s": speed,
        "seed": seed,
    }


def _with_motion(scene: Scene, kind: str, path: dict[str, float | int]) -> Scene:
    changes = {"motion.kind": kind} | {f"motion.{name}": value for name, value in path.items()}
    return scenes.changed(scene, changes)


def nearest_speed(speed: float, speeds: Sequence[float]) -> float:
    """The one of the study's speeds that a frame counts for."""
    return min(speeds, key=lambda s: (math.fabs(s - speed), s))
