"""Time and accuracy of the fit of a lens to pixels.

The default is 24 frames of 320 x 240 px. The full run is 200 frames of 640 x 480 px. Both start
with errors of 26 % in sag and numerical aperture.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import optics
from benchmarks.bench.output import show, table
from calibration.pixels import ImageFit, fit_footage, lens_start, read_footage
from scenes import Scene, render_stack

_LIMIT_S = 90  # 200 frames of 640 x 480 px, on two idle cores, with compilation
_TRUE = {"sag": 0.07, "numerical_aperture": 0.15}
_START = {"sag": 1.26 * 0.07, "numerical_aperture": 0.74 * 0.15}
_SMALL = 24, 320, 240, 0.0134
_FULL = 200, 640, 480, 0.0067
_LENS = """schema = 1
[lens]
core_radius = 0.25
aperture_radius = 0.30
glue_index = 1.49
sag = 0.07
glue_length = 0.11
numerical_aperture = 0.15
"""


def run(*, full: bool) -> None:
    """Render a drop with a rim on a plane in air and in an eyeball in vitreous, and fit it."""
    for kind, medium in (("plane", "air"), ("eyeball", "vitreous")):
        with tempfile.TemporaryDirectory() as folder:
            lens = Path(folder) / "lens.toml"
            lens.write_text(_LENS)
            scene = _scene(kind, medium, lens, *(_FULL if full else _SMALL))
            footage = read_footage(render_stack(scene, Path(folder) / "stack"))
            start = lens_start(optics.load_lens(str(lens))) | _START
        wall, cpu = time.perf_counter(), time.process_time()
        fit = fit_footage(footage, source="lens", start=start)
        _report(
            f"{kind} in {medium}: frames x height x width {footage.light.shape}",
            fit,
            time.perf_counter() - wall,
            time.process_time() - cpu,
        )


def _scene(
    kind: str, medium: str, lens: Path, frames: int, width: int, height: int, scale: float
) -> Scene:
    settings: dict[str, Any] = {
        "schema": 1,
        "seed": 3,
        "phantom": {"kind": kind, "wall": "uniform"},
        "source": {"kind": "lens", "lens": str(lens), "medium": medium},
        "spot": {"eccentricity_mm": 2.0},
        "motion": {"travel_mm": 5.0, "frames": frames},
        "microscope": {"width_px": width, "height_px": height, "scale_mm_px": scale},
        "exposures": {"kinds": ["metered"]},
    }
    return Scene.model_validate(settings)


def _report(title: str, fit: ImageFit, wall_s: float, cpu_s: float) -> None:
    made = table(title, "parameter", "true", "found", "± σ", "error, σ")
    for name, true in _TRUE.items():
        value, sigma = fit.parameters[name]
        cells = f"{true:.6g}", f"{value:.6g}", f"{sigma:.2g}", f"{(value - true) / sigma:+.2f}"
        made.add_row(name, *cells)
    pixels = np.count_nonzero(fit.sides)
    ending = fit.failed.reason if fit.failed else "converged"
    show(
        made,
        f"{pixels:,} pixels as {fit.degrees_of_freedom:,} data; chi squared per datum "
        f"{fit.chi_squared_per_dof:.3f}; {ending}; {wall_s:.0f} s, "
        f"{cpu_s:.0f} s of CPU with compilation, load {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores (limit of the full run: {_LIMIT_S} s)",
    )
