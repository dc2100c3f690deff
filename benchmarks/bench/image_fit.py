"""Figures of the fit to all pixels, on rendered stacks whose labels it does not read.

    python -m benchmarks.bench.image_fit [--full]

A cone in 10 frames of 128 x 128 and the dome lens in air; with --full the cone in 40 of 640 x 480,
and the lens in vitreous, too. All from starts that are 30 % off.
"""

from __future__ import annotations

import argparse
import math
import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import calibration
import optics
from calibration.pixels import Footage, fit_footage, read_footage
from scenes import Scene, render_stack

_OFF = 0.3
_SMALL = {"frames": 10}, {"width_px": 128, "height_px": 128, "scale_mm_px": 0.02, "samples": 1024}
_FULL: tuple[dict[str, Any], dict[str, Any]] = ({"frames": 40}, {"samples": 256})
_LENS = {"width_px": 192, "height_px": 144, "samples": 16}
_SCALES = {"air": 0.03, "vitreous": 0.02}
_ASKED_S = 60  # of a cone in 40 frames of 640 x 480, on two cores, after compilation
_TRUE = {"sensitivity": 200.0, "illumination": 0.05}


def main() -> None:
    """Render, fit, and print what was found beside the truth."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="Large frames, and vitreous, too.")
    full = parser.parse_args().full
    console = Console()
    cone = {"half_angle": math.atan(1 / 20), "b": -5.117}
    frames, microscope = _FULL if full else _SMALL
    _report(
        console, "cone", "cone", _scene({"kind": "cone"}, frames, microscope), cone, tuple(cone)
    )
    lens = calibration.lens_start(optics.load_lens("dome"))
    for medium in _SCALES if full else ("air",):
        source = {"kind": "lens", "lens": "dome", "medium": medium}
        settings = _scene(source, {"frames": 10}, _LENS | {"scale_mm_px": _SCALES[medium]})
        title = f"dome lens in {medium}"
        _report(console, title, "lens", settings, lens, ("sag", "numerical_aperture"))


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
    console: Console,
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
        # Compiles. A lens's fit takes so long that what its compilation adds hardly shows.
        fit_footage(_few(footage), source=source, start=start, free=free)
    wall, cpu = time.perf_counter(), time.process_time()
    fit = fit_footage(footage, source=source, start=start, free=free)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    frames, height, width = footage.light.shape
    table = Table(title=f"{title}: {frames} frames of {width} x {height}")
    for heading in ("parameter", "true", "found", "± σ", "off, σ", "off, %"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    known = dict(true) | _TRUE
    for name, (value, sigma) in fit.parameters.items():
        if name in known:
            off = value - known[name]
            table.add_row(
                name,
                f"{known[name]:.6g}",
                f"{value:.6g}",
                f"{sigma:.2g}",
                f"{off / sigma:+.2f}",
                f"{100 * off / known[name]:+.4f}",
            )
    console.print(table)
    console.print(
        f"chi squared per degree of freedom {fit.chi_squared_per_dof:.4f} over "
        f"{fit.degrees_of_freedom}; converged: {fit.converged}; undetermined: "
        f"{'; '.join(fit.undetermined) or 'nothing'}; {wall:.1f} s, {cpu:.1f} s of CPU "
        f"{'after' if source == 'cone' else 'with'} compilation, "
        f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    )
    if source == "cone" and frames == _FULL[0]["frames"]:
        console.print(
            f"Asked: {_ASKED_S} s after compilation; {wall:.1f} s at this load, {cpu / 2:.1f} s of "
            "CPU for each of two cores."
        )
    console.print()


def _few(footage: Footage) -> Footage:
    """Three of the frames, for which the same functions are compiled as for all of them."""
    last = len(footage.readings) - 1
    few = [0, last // 2, last]
    arrays = ("light", "clear", "exposure_s", "readings")
    return replace(footage, **{name: getattr(footage, name)[few] for name in arrays})


if __name__ == "__main__":
    main()
