"""Accuracy of the fit to all pixels of rendered stacks; it does not use their labels.

The default is a cone in 10 frames of 128 x 128 px, and the dome lens in air. The full run is the
cone in 40 frames of 640 x 480 px, and the lens in air and in vitreous. All start values have errors
of 30 %.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import calibration
import optics
from benchmarks.bench.output import show, table
from calibration.pixels import Footage, fit_footage, read_footage
from scenes import Scene, render_stack

_OFF = 0.3
_SMALL = {"frames": 10}, {"width_px": 128, "height_px": 128, "scale_mm_px": 0.02, "samples": 1024}
_FULL: tuple[dict[str, Any], dict[str, Any]] = ({"frames": 40}, {"samples": 256})
_LENS = {"width_px": 192, "height_px": 144, "samples": 16}
_SCALES = {"air": 0.03, "vitreous": 0.02}
_TRUE = {"sensitivity": 200.0, "illumination": 0.05}


def run(*, full: bool) -> None:
    """Render, fit, and print the parameters with their true values.

    Args:
        full: larger frames, and also vitreous.
    """
    cone = {"half_angle": math.atan(1 / 20), "b": -5.117}
    frames, microscope = _FULL if full else _SMALL
    _report("cone", "cone", _scene({"kind": "cone"}, frames, microscope), cone, tuple(cone))
    lens = calibration.lens_start(optics.load_lens("dome"))
    for medium in _SCALES if full else ("air",):
        source = {"kind": "lens", "lens": "dome", "medium": medium}
        settings = _scene(source, {"frames": 10}, _LENS | {"scale_mm_px": _SCALES[medium]})
        title = f"dome lens in {medium}"
        _report(title, "lens", settings, lens, ("sag", "numerical_aperture"))


def _scene(source: dict[str, Any], motion: dict[str, Any], microscope: dict[str, Any]) -> Scene:
    return Scene.model_validate(
        {
            "schema": 1,
            "seed": 11,
            "phantom": {"wall": "uniform"},
            "source": source,
            "spot": {"eccentricity_mm": 2.0},
            "motion": {"travel_mm": 5.0, **motion},
            "microscope": microscope,
            "exposures": {"kinds": ["metered"]},
        }
    )


def _report(
    title: str,
    source: Any,
    scene: Scene,
    true: Mapping[str, float],
    free: tuple[str, ...],
) -> None:
    start = dict(true) | {
        name: true[name] * (1 + sign * _OFF) for name, sign in zip(free, (1, -1), strict=True)
    }
    with tempfile.TemporaryDirectory() as folder:
        footage = read_footage(render_stack(scene, Path(folder) / "stack"))
    if source == "cone":
        # This compiles. The fit of a lens takes so long that its compilation hardly matters.
        fit_footage(_few(footage), source=source, start=start, free=free)
    wall, cpu = time.perf_counter(), time.process_time()
    fit = fit_footage(footage, source=source, start=start, free=free)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    frames, height, width = footage.light.shape
    columns = ("parameter", "true", "found", "± σ", "error, σ", "error, %")
    made = table(f"{title}: {frames} frames of {width} x {height} px", *columns)
    known = dict(true) | _TRUE
    for name, (value, sigma) in fit.parameters.items():
        if name in known:
            error = value - known[name]
            made.add_row(
                name,
                f"{known[name]:.6g}",
                f"{value:.6g}",
                f"{sigma:.2g}",
                f"{error / sigma:+.2f}",
                f"{100 * error / known[name]:+.4f}",
            )
    show(
        made,
        f"chi squared per degree of freedom {fit.chi_squared_per_dof:.4f} over "
        f"{fit.degrees_of_freedom}; converged: {fit.converged}; undetermined: "
        f"{'; '.join(fit.undetermined) or 'nothing'}; {wall:.1f} s, {cpu:.1f} s of CPU "
        f"{'after' if source == 'cone' else 'with'} compilation, "
        f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
    )
    show("")


def _few(footage: Footage) -> Footage:
    """Three of the frames; they need the same compiled functions as all frames."""
    last = len(footage.readings) - 1
    few = [0, last // 2, last]
    arrays = ("light", "clear", "exposure_s", "readings")
    return replace(footage, **{name: getattr(footage, name)[few] for name in arrays})
