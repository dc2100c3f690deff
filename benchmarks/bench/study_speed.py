"""Time of a million geometries in the study of eccentricity, with the errors of all models."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import scenes
from benchmarks.bench.output import show
from benchmarks.studies.eccentricity import BLOCK
from benchmarks.studies.eccentricity import run as eccentricity

_COUNT = 1_000_000
_LIMIT_S = 60.0


def run(*, full: bool) -> None:
    """Print the time of a million geometries and its limit (`full` changes nothing)."""
    scene = scenes.load_scene(None, ("source.kind=cone",))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model_error.csv"
        eccentricity.fill_space(scene, count=BLOCK, seed=0, csv_file=file)  # compiles
        began, worked = time.perf_counter(), sum(os.times()[:2])
        space = eccentricity.fill_space(scene, count=_COUNT, seed=0, csv_file=file)
        seconds, worked = time.perf_counter() - began, sum(os.times()[:2]) - worked
        size = file.stat().st_size
    million = _COUNT / space.count
    show(
        f"study eccentricity: {space.count:,} geometries, 5 models, {size / 1e6:.0f} MB of CSV: "
        f"{space.count / seconds:,.0f} geometries/s; a million in {seconds * million:.1f} s (limit "
        f"{_LIMIT_S:.0f} s on two idle cores), {worked * million:.1f} s of processor time, load "
        f"{os.getloadavg()[0]:.1f}"
    )
