"""Accuracy of tip and axis from all pixels of single rendered frames, for a cone and a lens.

The beam is known. The robot gives a direction with an error of 5 degrees and a distance with an
error of up to half a millimetre. Each frame is fitted alone. `eyespot study pose` uses the contour
only.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

import calibration
import optics
from benchmarks.bench.output import show, table
from benchmarks.paper import rms
from benchmarks.studies.pose import PRIOR_DEG, REPORTED, angle_deg, drawn_prior
from calibration import Prior
from calibration.pixels import Footage, fit_footage, read_footage
from scenes import Scene, load_mitsuba, render_stack

_INCIDENCES_DEG = (10.0, 20.0, 30.0)
_ECCENTRICITIES_MM = (0.0, 2.5, 5.0)
_FRAMES, _TRAVEL_MM = 4, 3.9
_DISTANCE_SIGMA_MM = 0.5
_LIGHT = {"sensitivity": Prior(200.0, 0.2), "illumination": Prior(0.05, 5e-4)}
"""Prior knowledge of the camera's sensitivity and the microscope light."""
_CONE = {"half_angle": math.atan(1 / 20), "b": -5.117}


class PoseErrors(NamedTuple):
    """Errors of the pose of one frame; lengths in mm, angles in degrees."""

    incidence_deg: float
    d_mm: float
    tip_mm: float
    axis_deg: float
    distance_mm: float
    sigma_axis_deg: float
    chi_squared: float


def run(*, full: bool) -> None:
    """Render, fit each frame, and print the errors (`full` changes nothing)."""
    load_mitsuba()
    sources: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, float]]] = {
        "cone": ({"kind": "cone"}, {"samples": 256}, _CONE),
        "lens": (
            {"kind": "lens", "lens": "dome"},
            {"width_px": 192, "height_px": 144, "scale_mm_px": 0.03, "samples": 16},
            calibration.lens_start(optics.load_lens("dome")),
        ),
    }
    for kind, (source, microscope, known) in sources.items():
        poses = list(_poses(kind, source, microscope, known))
        show(_table(kind, Scene.model_validate(_scene(source, microscope, 0, 10)), poses))


def _poses(
    kind: Any, source: dict[str, Any], microscope: dict[str, Any], known: Mapping[str, float]
) -> Iterator[PoseErrors]:
    rng = np.random.default_rng(0)
    for incidence in _INCIDENCES_DEG:
        for c in _ECCENTRICITIES_MM:
            scene = Scene.model_validate(_scene(source, microscope, c, incidence))
            with tempfile.TemporaryDirectory() as folder:
                stack = render_stack(scene, Path(folder) / "stack")
                footage = read_footage(stack)
            for frame, labels in enumerate(stack.labels[1:], 1):
                reported = drawn_prior(np.array(labels.axis), rng)
                distance = labels.d_mm + _DISTANCE_SIGMA_MM * rng.uniform(-1, 1)
                fit = fit_footage(
                    _single(footage, frame, reported),
                    source=kind,
                    start=known,
                    free=(),
                    priors={"touch": Prior(distance, _DISTANCE_SIGMA_MM), **_LIGHT},
                    lean_sigma=math.radians(PRIOR_DEG),
                )
                sigmas = (fit.parameters[name][1] for name in ("lean", "lean_sideways"))
                yield PoseErrors(
                    incidence_deg=incidence,
                    d_mm=labels.d_mm,
                    tip_mm=float(np.linalg.norm(fit.tips[0] - labels.tip_mm)),
                    axis_deg=angle_deg(fit.axis, np.array(labels.axis)),
                    distance_mm=fit.values["touch"] - labels.d_mm,
                    sigma_axis_deg=math.degrees(math.hypot(*sigmas)),
                    chi_squared=fit.chi_squared_per_dof,
                )


def _single(footage: Footage, frame: int, axis: np.ndarray) -> Footage:
    """One frame, with an axis from the robot."""
    one = slice(frame, frame + 1)
    return replace(
        footage,
        light=footage.light[one],
        clear=footage.clear[one],
        exposure_s=footage.exposure_s[one],
        readings=np.zeros(1),
        axis=axis,
    )


def _scene(
    source: dict[str, Any], microscope: dict[str, Any], c: float, incidence: float
) -> dict[str, Any]:
    return {
        "schema": 1,
        "seed": int(10 * c + incidence),
        "phantom": {"wall": "uniform"},
        "instrument": {"visible": False},
        "source": source,
        "spot": {"eccentricity_mm": c, "incidence_deg": incidence},
        "motion": {"travel_mm": _TRAVEL_MM, "frames": _FRAMES},
        "microscope": microscope,
        "exposures": {"kinds": ["metered"]},
    }


def _table(kind: str, scene: Scene, poses: list[PoseErrors]) -> Table:
    scale, camera = scene.microscope.scale_mm_px, scene.camera
    beam = f"k {1 / math.tan(_CONE['half_angle']):.0f}" if kind == "cone" else "lens 'dome' in air"
    tip, axis = REPORTED[1]
    made = table(
        f"{kind}: single frames, {beam}, δ {scale:g} mm/px, full well "
        f"{camera.full_well_e:g} e, read noise {camera.read_noise_e:g} e; best reported with one "
        f"spot: {tip:g} mm, {axis:g}°",
        *("incidence, °", "frames", "tip RMS, mm", "axis RMS, °", "σ of axis RMS, °"),
        *("distance RMS, mm", "χ²/n"),
    )
    groups = {f"{i:g}": [p for p in poses if p.incidence_deg == i] for i in _INCIDENCES_DEG}
    for name, some in (groups | {"all": poses}).items():
        made.add_row(
            name,
            f"{len(some)}",
            f"{rms([p.tip_mm for p in some]):.4f}",
            f"{rms([p.axis_deg for p in some]):.3f}",
            f"{rms([p.sigma_axis_deg for p in some]):.3f}",
            f"{rms([p.distance_mm for p in some]):.4f}",
            f"{np.mean([p.chi_squared for p in some]):.3f}",
        )
    return made
