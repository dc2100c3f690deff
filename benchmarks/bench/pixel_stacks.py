"""Drawn stacks for the benches of the mode pixels, and calibrations of their beams.

Each wall, beam and motion is drawn anew from a seed: place, tilt, texture and noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import optics
from benchmarks.bench.pixel_frames import FrameErrors, frame_errors
from estimator.files import Calibration, Stack, cache_file
from scenes import Scene, SceneError, load_mitsuba, render_stack

BEAMS: dict[str, dict[str, Any]] = {
    "cone": {"kind": "cone"},
    "dome, vitreous": {"kind": "lens", "lens": "dome", "medium": "vitreous"},
    "candidate, air": {"kind": "lens", "lens": "paper-candidate", "medium": "air"},
}
WALLS = ("uniform", "printed paper", "retina", "photograph")
MM_PER_FRAME = 2.0 / 12
"""Of a withdrawal."""

_FIELD_MM = 2.2  # half of the photograph's width, where every wall has a picture
_SURE = 1e-6  # relative error of a beam that is known
_TRIES = 50  # draws of a scene until its spot lies in the window


@dataclass(frozen=True)
class Circumstances:
    """What a stack is of.

    Attributes:
        beam: one of `BEAMS`.
        wall: one of `WALLS`.
        motion: "withdrawal" or "hand".
        tables: what else the scene has, by table.
        sigmas: relative errors of the beam's own parameters, by name.
        between_mm: least and largest first distance of a withdrawal, or mean distance of a hand.
    """

    beam: str
    wall: str
    motion: str
    frames: int
    tables: dict[str, dict[str, Any]] = field(default_factory=dict)
    sigmas: dict[str, float] = field(default_factory=dict)
    between_mm: tuple[float, float] = (1.0, 3.5)


def prepare() -> None:
    """Load Mitsuba, and let JAX keep what it compiles, as `eyespot` does: that takes minutes."""
    import jax

    jax.config.update("jax_compilation_cache_dir", str(cache_file("jax", "").parent))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    load_mitsuba()


def drawn_errors(
    what: Circumstances, rng: np.random.Generator, folder: Path
) -> Iterator[FrameErrors]:
    """Render a drawn stack into a folder and read its frames.

    Raises:
        SceneError: no drawn scene is possible.
    """
    stack = drawn_stack(what, rng, folder)
    yield from frame_errors(stack, drawn_calibration(what, rng), rng)


def drawn_stack(what: Circumstances, rng: np.random.Generator, folder: Path) -> Stack:
    """Draw scenes until one is possible, and render it into a folder.

    Raises:
        SceneError: no drawn scene is possible.
    """
    for _ in range(_TRIES):
        seed = int(rng.integers(1, 2**31))
        scene = Scene.model_validate(_scene(what, seed, rng))
        try:
            return render_stack(scene, folder)
        except SceneError as error:  # the drawn spot leaves the window
            refused = error
    raise refused


def _scene(what: Circumstances, seed: int, rng: np.random.Generator) -> dict[str, Any]:
    distance = float(rng.uniform(*what.between_mm))
    moves = {
        "withdrawal": {
            "start_mm": distance,
            "travel_mm": MM_PER_FRAME * what.frames,
            "frames": what.frames,
            "speed_mm_s": 1.0,
        },
        "hand": {
            "kind": "hand",
            "distance_mm": distance,
            "duration_s": 0.1 * what.frames - 0.05,  # in the middle between frames
            "top_speed_mm_s": 2.0,
            "seed": seed,
        },
    }
    tables: dict[str, Any] = {
        "schema": 1,
        "seed": seed,
        "phantom": {"wall": what.wall, "texture_seed": seed},
        "instrument": {"visible": False},
        "source": BEAMS[what.beam],
        "spot": {
            "eccentricity_mm": float(rng.uniform(0, _FIELD_MM)),
            "azimuth_deg": float(rng.uniform(60, 120)),
            "incidence_deg": float(rng.uniform(10, 30)),
            "incidence_azimuth_deg": float(rng.uniform(0, 360)),
        },
        "motion": moves[what.motion],
        "exposures": {"kinds": ["metered"]},
    }
    for name, table in what.tables.items():
        tables[name] = tables.get(name, {}) | table
    return tables


def drawn_calibration(what: Circumstances, rng: np.random.Generator) -> Calibration:
    """A calibration of a beam; parameters with an error in `sigmas` are off by one."""
    source = BEAMS[what.beam]
    medium = source.get("medium", "air")
    if source["kind"] == "cone":
        model, values = "planar", {"k": 20.0, "b": -5.117}
    else:
        lens = optics.load_lens(source["lens"])
        model = "lens"
        values = {name: float(x) for name, x in vars(lens).items() if x is not None}
    sigmas = [what.sigmas.get(name, _SURE) * abs(value) for name, value in values.items()]
    values = {
        name: value + sigma * rng.standard_normal() if name in what.sigmas else value
        for (name, value), sigma in zip(values.items(), sigmas, strict=True)
    }
    if model == "lens":  # the drawn cap may not reach below the core
        values["glue_length"] = max(values["glue_length"], values["sag"])
    return Calibration(
        model=model,
        values=values,
        covariance=np.diag(np.square(sigmas)),
        medium=medium,
        medium_index=optics.MEDIA[medium],
        fitted_on="the beam that was rendered",
        data_sha256="0" * 64,
        software="benchmarks.bench.pixel_stacks",
    )
