"""The rendered part: all three sensors read distances from pictures of the same places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import optics
import scenes
from benchmarks.evaluation import SUBPIXEL, VISIBLE_ENOUGH, track_stack
from benchmarks.reporting import Study
from benchmarks.studies.rivals import marks, pictures, sensors
from benchmarks.studies.rivals.sensors import Known, Outcome, Sensor, outcomes_at
from benchmarks.studies.rivals.setup import (
    CONE,
    RADIUS_MM,
    Place,
    Views,
    centred,
    place,
    project,
    views,
)
from estimator import FrameLabels, NoSpot, Spot, Stack
from estimator.run import progress
from scenes import Scene

Reading = tuple[Sensor, str, str, float, float, Outcome, float, float]
READING = "sensor path wall c_mm d_mm outcome error_mm mark_error_px".split()
"""Row of readings.csv, and its columns; error = estimate - truth.

The marks' errors are the largest of the reading's marks: the semi-minor axis for the spot, the
place of tip and shadow otherwise; empty if nothing was read.
"""

_by_spot, _by_shadow, _in_space, _distance_along = (
    eqx.filter_jit(function)
    for function in (
        sensors.by_spot,
        sensors.by_shadow,
        sensors.in_space,
        sensors.distance_along,
    )
)


class Trial(NamedTuple):
    """Places with one path, one wall and one eccentricity.

    Attributes:
        c: mm.
        scene: that all places have in common.
    """

    path: str
    wall: str
    c: float
    scene: Scene
    places: list[Place]

    @property
    def name(self) -> str:
        """For folders and files."""
        return f"{self.path}-{self.wall}-{self.c:g}".replace(" ", "-")


def trials(
    scene: Scene,
    *,
    paths: Sequence[str],
    walls: Sequence[str],
    eccentricities: Sequence[float],
    distances: Sequence[float],
) -> list[Trial]:
    """All combinations of paths, walls and eccentricities, each with all distances."""
    return [
        Trial(
            path,
            wall,
            c,
            pictures.base_scene(scene, path, wall, eccentricity=c),
            [place(eccentricity=c, distance=d) for d in distances],
        )
        for path in paths
        for wall in walls
        for c in eccentricities
    ]


def by_spots(study: Study, every: Sequence[Trial]) -> list[Reading]:
    """Readings of the spot: a withdrawal with each trial's distances, tracked and read exactly."""
    folder = study.folder / "spots"
    folder.mkdir(exist_ok=True)
    named = {trial.name: trial for trial in every}
    cameras = {path: views(path) for path in dict.fromkeys(trial.path for trial in every)}

    def read(name: str, stack: Stack) -> list[Reading]:
        tracked = track_stack(stack, SUBPIXEL, spots_file=folder / f"{name}.csv")
        trial = named[name]
        return [
            _spot_reading(trial, one, cameras[trial.path], result, label)
            for one, result, label in zip(
                trial.places, tracked.results, tracked.labels, strict=True
            )
        ]

    found = study.measured({name: _withdrawal(t) for name, t in named.items()}, read)
    return [reading for readings in found.values() for reading in readings]


def by_pictures(
    every: Sequence[Trial],
) -> tuple[list[Reading], dict[tuple[str, float], pictures.Pictures]]:
    """Readings of shadow and stereo; and the pictures of the first wall by path and distance."""
    cameras = {path: views(path) for path in dict.fromkeys(trial.path for trial in every)}
    readings, kept = [], {}
    with progress("Photographing", total=sum(len(trial.places) for trial in every)) as advance:
        for trial in every:
            seen = cameras[trial.path]
            in_view = outcomes_at(Place(*map(np.stack, zip(*trial.places, strict=True))), seen)
            for k, one in enumerate(trial.places):
                taken = pictures.pictures(trial.scene, one, seen)
                readings.append(_shadow(trial, one, taken, in_view[Sensor.SHADOW][k]))
                readings.append(_stereo(trial, one, taken, in_view[Sensor.STEREO][k]))
                if trial.wall == every[0].wall and trial.c == every[0].c:
                    kept[trial.path, float(one.distance)] = taken
                advance(note=trial.name)
    return readings, kept


def _withdrawal(trial: Trial) -> Scene:
    """Frames at the trial's distances, which are evenly spaced."""
    first, last = trial.places[0], trial.places[-1]
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
            "source.cone_k": 1.0 / math.tan(CONE["half_angle"]),
            "source.cone_apex_offset_mm": CONE["apex_offset"],
            "spot.incidence_deg": math.degrees(math.acos(out)),
            "spot.incidence_azimuth_deg": math.degrees(math.atan2(across, along)),
            "motion.kind": "withdrawal",
            "motion.start_mm": float(first.distance),
            "motion.travel_mm": float(last.distance - first.distance),
            "motion.frames": len(trial.places),
            "exposures.kinds": ["metered"],
        },
    )


def _known(one: Place, seen: Views) -> Known:
    return Known(seen, jnp.asarray(RADIUS_MM), jnp.asarray(one.lamp), jnp.asarray(one.axis))


def _reading(
    sensor: Sensor,
    trial: Trial,
    one: Place,
    outcome: Outcome,
    distance: float = math.nan,
    mark_error: float = math.nan,
) -> Reading:
    d = float(one.distance)
    return sensor, trial.path, trial.wall, trial.c, d, outcome, distance - d, mark_error


def _spot_reading(
    trial: Trial, one: Place, seen: Views, result: Spot | NoSpot, label: FrameLabels
) -> Reading:
    if not isinstance(result, Spot):
        return _reading(Sensor.SPOT, trial, one, Outcome.NO_SPOT)
    if label.visible_fraction < VISIBLE_ENOUGH:
        return _reading(Sensor.SPOT, trial, one, Outcome.HIDDEN)
    centre = centred(seen.centre, one.spot)
    ellipse = optics.Ellipse(
        centre=jnp.array([result.x_px, result.y_px]),
        semi_major=jnp.asarray(result.semi_major_px),
        semi_minor=jnp.asarray(result.semi_minor_px),
        angle=jnp.asarray(result.angle_rad),
    )
    distance = float(_by_spot(ellipse, _known(one, seen._replace(centre=centre))))
    off = abs(result.semi_minor_px - label.half_max_semi_minor_px)
    return _reading(Sensor.SPOT, trial, one, Outcome.READ, distance, off)


def _shadow(trial: Trial, one: Place, taken: pictures.Pictures, outcome: Outcome) -> Reading:
    if outcome != Outcome.READ:
        return _reading(Sensor.SHADOW, trial, one, outcome)
    camera, image = taken.seen.centre, pictures.grey(taken.centre)
    tip = marks.found_shift(image, marks.tool_outline(one, camera), dark=False)
    shadow = marks.found_shift(image, marks.shadow_outline(one, camera), dark=True)
    distance = _by_shadow(
        _image(camera, one.tip) + tip,
        _image(camera, np.asarray(sensors.shadow_of(one.tip, one.lamp))) + shadow,
        _known(one, taken.seen),
    )
    off = max(np.linalg.norm(shift) for shift in (tip, shadow))
    return _reading(Sensor.SHADOW, trial, one, Outcome.READ, float(distance), float(off))


def _stereo(trial: Trial, one: Place, taken: pictures.Pictures, outcome: Outcome) -> Reading:
    if outcome != Outcome.READ:
        return _reading(Sensor.STEREO, trial, one, outcome)
    images = [pictures.grey(photograph) for photograph in (taken.left, taken.right)]
    height = marks.wall_height(images[0], images[1], one, taken.seen)
    if height is None:
        return _reading(Sensor.STEREO, trial, one, Outcome.NO_TEXTURE)
    pair = [taken.seen.left, taken.seen.right]
    shifts = [
        marks.found_shift(image, marks.tool_outline(one, camera), dark=False)
        for image, camera in zip(images, pair, strict=True)
    ]
    places = [_image(camera, one.tip) + shift for camera, shift in zip(pair, shifts, strict=True)]
    (tip,) = _in_space(jnp.stack(places)[:, None], taken.seen)
    wall = optics.Sphere(RADIUS_MM - height)
    distance = float(_distance_along(wall, tip, _known(one, taken.seen)))
    off = max(float(np.linalg.norm(shift)) for shift in shifts)
    return _reading(Sensor.STEREO, trial, one, Outcome.READ, distance, off)


def _image(camera: optics.Camera, point: np.ndarray) -> np.ndarray:
    return np.asarray(project(camera, point[None]))[0]
