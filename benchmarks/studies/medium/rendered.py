"""The rendered part: calibrated on a plane in air, used in an eyeball full of another medium."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

import scenes
from benchmarks.evaluation import SUBPIXEL, Tracked, track_stack
from benchmarks.reporting import Study
from benchmarks.studies.medium.light import (
    AIR,
    COLUMNS,
    CONE,
    FARTHEST_MM,
    NEAREST_MM,
    VITREOUS,
    Curve,
    Method,
)
from calibration import PlaneFit, fit_plane
from estimator import Calibration, Ranger, Spot, Stack, read_microscope
from scenes import Scene
from scenes.world import study_calibration, true_calibration

_HEIGHT_PX = 600  # the dome's spot in air outgrows the default window


def trials(scene: Scene, *, lights: Sequence[str], frames: int) -> dict[str, Scene]:
    """Withdrawals with each light: on a plane in air, in an eyeball in both media.

    Args:
        lights: lenses, and "cone".
    """
    return {
        f"{_slug(light)}-{medium}-{phantom}": scenes.changed(
            scene,
            {
                **({"source.kind": CONE} if light == CONE else {"source.lens": light}),
                "source.medium": medium,
                "phantom.kind": phantom,
                "motion.kind": "withdrawal",
                "motion.start_mm": NEAREST_MM,
                "motion.travel_mm": FARTHEST_MM - NEAREST_MM,
                "motion.frames": frames,
                "exposures.kinds": ["metered"],
                "microscope.height_px": _HEIGHT_PX,
            },
        )
        for light in lights
        for medium, phantom in ((AIR, "plane"), (AIR, "eyeball"), (VITREOUS, "eyeball"))
    }


def measure(study: Study, *, frames: int, curves: Mapping[tuple[str, str], Curve]) -> pd.DataFrame:
    """Render, track, calibrate in air and use: errors in the eyeball.

    Args:
        curves: by light and medium: what the lens model says without another fit.
    """
    lights = list(dict.fromkeys(light for light, _ in curves))
    every = trials(study.scene, lights=lights, frames=frames)
    spots = study.folder / "spots"
    spots.mkdir(exist_ok=True)

    def track(name: str, stack: Stack) -> tuple[Stack, Tracked]:
        return stack, track_stack(stack, SUBPIXEL, spots_file=spots / f"{name}.csv")

    tracked = study.measured(every, track)
    errors = []
    for light in lights:
        _, seen = tracked[f"{_slug(light)}-{AIR}-plane"]
        # The robot's reading since the first frame, whose distance is known here.
        reading = NEAREST_MM + seen.travel_mm
        fit = fit_plane(semi_minor_px=seen.semi_minor_px, distance=reading)
        for medium in (AIR, VITREOUS):
            name = f"{_slug(light)}-{medium}-eyeball"
            calibrations = {Method.AIR_CONE: _of_fit(fit, study.scene)}
            if light != CONE and medium == VITREOUS:
                regression = curves[light, medium].cone
                values = {"k": regression.k, "b": regression.b_mm}
                calibrations[Method.LENS_CONE] = study_calibration("planar", values, medium=medium)
                calibrations[Method.LENS] = true_calibration(every[name])
            errors.append(_errors(every[name], *tracked[name], calibrations))
    return pd.concat(errors, ignore_index=True)


def _slug(light: str) -> str:
    """For names of folders: a lens may be a file."""
    return Path(light).stem


def _errors(
    scene: Scene, stack: Stack, tracked: Tracked, calibrations: Mapping[Method, Calibration]
) -> pd.DataFrame:
    light = CONE if scene.source.kind == CONE else scene.source.lens
    microscope = read_microscope(stack.folder / "microscope.json")
    rows = []
    for method, known in calibrations.items():
        # `corrected` is the cone of a plane, taken to the sphere.
        model = None if known.model == "lens" else "corrected"
        ranger = Ranger(known, microscope, model=model)
        for label, result, used in zip(tracked.labels, tracked.results, tracked.used, strict=True):
            if not (used and isinstance(result, Spot)):
                continue
            found = ranger.distance(result, frame=stack.image(label))
            radius, estimate = result.semi_minor_px * microscope.scale_mm_px, found.distance_mm
            values = (label.d_mm, radius, estimate, estimate - label.d_mm, bool(found.others_mm))
            rows.append(("rendered", light, scene.source.medium, method, *values))
    return pd.DataFrame(rows, columns=COLUMNS)


def _of_fit(fit: PlaneFit, scene: Scene) -> Calibration:
    """What the plane in air gave: k and b, with their covariance."""
    to_k = np.diag([1.0 / scene.microscope.scale_mm_px, 1.0])
    values = {"k": fit.delta_k / scene.microscope.scale_mm_px, "b": fit.b}
    return study_calibration("planar", values, medium=AIR, covariance=to_k @ fit.covariance @ to_k)
