"""Beams drawn at random, rendered, fitted as a user does: how far off, in standard errors.

    python -m tests.support.coverage.random_fits lenses FILE [FIRST LAST]   lenses, then read
    python -m tests.support.coverage.random_fits cones FILE [FIRST LAST]    withdrawals of cones

FILE is one of `tests.support.files.fit_files`; several runs may share it, and the table at the end
is of all its lines. VARIANT in the environment is Mitsuba's.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomli_w
from scipy.spatial.transform import Rotation

import eyespot
from eyespot import optics
from eyespot.estimator.distance.withdrawal import BORESIGHT_SIGMA
from tests.support.files.fit_files import collected, summary

LEAN, TOUCH_MM = math.radians(1.0), 0.02
"""Standard deviations of what a fit assumes about the robot's directions and the touch."""
WALLS = ("printed paper", "retina", "photograph")
_VARIANT: Any = os.environ.get("VARIANT", "llvm_ad_rgb")
_SMALL = {"microscope.width_px": 320, "microscope.height_px": 240, "microscope.scale_mm_px": 0.0134}


def _view(
    rng: np.random.Generator, most_eccentric: float, least_incidence: float
) -> dict[str, Any]:
    return {
        "seed": int(rng.integers(1 << 31)),
        "phantom.texture_seed": int(rng.integers(1 << 31)),
        "phantom.wall": str(rng.choice(WALLS)),
        "spot.eccentricity_mm": rng.uniform(0.0, most_eccentric),
        "spot.azimuth_deg": rng.uniform(0.0, 360.0),
        "spot.incidence_deg": rng.uniform(least_incidence, 30.0),
        "spot.incidence_azimuth_deg": rng.uniform(0.0, 360.0),
        "microscope.pinhole_height_mm": float(rng.choice([11.5, 200.0])),
        "exposures.kinds": ["metered"],
    }


def _touch_prior(scene: dict[str, Any], rng: np.random.Generator) -> str:
    """The distance at which the fibre's rim touches the wall, told with the operator's error."""
    wall: Any = optics.Sphere(11.5)
    if scene.get("phantom.kind") == "plane":
        wall = optics.Plane(point=np.array([0.0, 0.0, -11.5]), inward=np.array([0.0, 0.0, 1.0]))
    contact = optics.contact_distance(
        wall, incidence=math.radians(scene["spot.incidence_deg"]), rim_radius=0.25
    )
    return f"touch={float(contact) + TOUCH_MM * rng.standard_normal()},{TOUCH_MM}"


def misreported(kinematics: Path, rng: np.random.Generator) -> None:
    """Turn the robot's frame against the eye, and the tool against the beam, as priors expect."""
    table = pd.read_csv(kinematics)
    lean = Rotation.from_rotvec(LEAN * rng.standard_normal(3))
    place, axis = ["x_mm", "y_mm", "z_mm"], ["axis_x", "axis_y", "axis_z"]
    along = table[axis].to_numpy()
    askew = Rotation.from_rotvec(np.cross(along[0], BORESIGHT_SIGMA * rng.standard_normal(3)))
    table[place], table[axis] = lean.apply(table[place]), lean.apply(askew.apply(along))
    table.to_csv(kinematics, index=False)


def _fitted(stack: Path, out: Path, **choices: Any) -> tuple[dict[str, Any], eyespot.Fit]:
    began = time.monotonic()
    fit = eyespot.fit(stack, **choices)
    row = {"good": fit.good, "said": fit.verdict, "seconds": time.monotonic() - began}
    if fit.good:
        fit.save(out)
    pixels = fit.fitted.pixels
    row["over_bound"] = math.nan if pixels is None else pixels.over_bound
    return row | {"model": fit.model}, fit


def _errors(fit: eyespot.Fit, truth: dict[str, float]) -> dict[str, list[float]]:
    found = fit.parameters
    return {
        name: [float(found.value[name]) - true, float(found.sigma[name])]
        for name, true in truth.items()
        if name in found.index
    }


def lens(seed: int, folder: Path) -> dict[str, Any]:
    """A lens is fitted without a start, and distances are read with it over another wall."""
    rng = np.random.default_rng([38, seed])
    core = rng.uniform(0.18, 0.25)
    drop = {
        "core_radius": core,
        "aperture_radius": rng.uniform(core, 0.28),
        "glue_index": 1.49,
        "sag": rng.uniform(0.0, 0.15),
        "numerical_aperture": rng.uniform(0.09, 0.22),
    }
    drop["glue_length"] = drop["sag"]
    (folder / "drop.toml").write_text(tomli_w.dumps({"schema": 1, "lens": drop}))
    beam = {
        **_SMALL,
        "source.lens": str(folder / "drop.toml"),
        "source.medium": str(rng.choice(["air", "vitreous"])),
        "phantom.kind": str(rng.choice(["plane", "eyeball"])),
    }
    fitted = beam | _view(rng, 2.0, 15.0) | {"motion.frames": 21, "motion.travel_mm": 6.0}
    eyespot.render(eyespot.Scene(), folder / "fit", fitted, variant=_VARIANT)
    misreported(folder / "fit/kinematics.csv", rng)
    row, fit = _fitted(folder / "fit", folder / "c.json", prior=[_touch_prior(fitted, rng)])
    row |= {"scene": fitted, "drop": drop} | _errors(fit, drop)
    if not fit.good or fit.model != "lens":
        return row
    others = [wall for wall in WALLS if wall != fitted["phantom.wall"]]
    read = beam | _view(rng, 2.0, 15.0) | {"motion.frames": 9, "motion.travel_mm": 5.0}
    read |= {"spot.eccentricity_mm": 2.6, "phantom.wall": str(rng.choice(others))}
    read |= {"phantom.kind": "eyeball", "motion.start_mm": 0.8}
    stack = eyespot.render(eyespot.Scene(), folder / "read", read, variant=_VARIANT)
    began = time.monotonic()
    spots = eyespot.track(folder / "read", calibration=folder / "c.json")
    truth = pd.read_json(stack.folder / "metadata.jsonl", lines=True)["d_mm"].to_numpy()
    off = spots["distance_mm"].to_numpy(float) - truth
    row["distances"] = np.stack([off, spots["sigma_distance_mm"].to_numpy(float)]).T.tolist()
    row["read_seconds"] = time.monotonic() - began
    return row


def cone(seed: int, folder: Path) -> dict[str, Any]:
    """A cone is fitted to a clean withdrawal."""
    rng = np.random.default_rng([39, seed])
    k = rng.uniform(10.0, 25.0)
    scene = _view(rng, 5.0, 0.0) | {
        "source.kind": "cone",
        "source.cone_k": k,
        "source.cone_apex_offset_mm": -k * rng.uniform(0.22, 0.25),
        "motion.frames": int(rng.integers(5, 61)),
        "motion.travel_mm": 6.0,
        "microscope.width_px": 448,
        "microscope.height_px": 384,
    }
    eyespot.render(eyespot.Scene(), folder / "fit", scene, variant=_VARIANT)
    misreported(folder / "fit/kinematics.csv", rng)
    row, fit = _fitted(folder / "fit", folder / "c.json", prior=[_touch_prior(scene, rng)])
    truth = {"half_angle": math.atan(1.0 / k), "b": scene["source.cone_apex_offset_mm"]}
    return row | {"scene": scene} | _errors(fit, truth)


KINDS: dict[str, Callable[[int, Path], dict[str, Any]]] = {"lenses": lens, "cones": cone}


def results(file: Path, kind: str, seeds: range) -> pd.DataFrame:
    def fit(seed: int) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            return KINDS[kind](seed, Path(folder))

    return collected(file, {str(seed): partial(fit, seed) for seed in seeds})


if __name__ == "__main__":
    kind, file, *limits = sys.argv[1:]
    found = results(Path(file), kind, range(*map(int, limits or ("0", "100"))))
    print(summary(found, ("sag", "numerical_aperture", "half_angle", "b", "distances")))
    over = found.over_bound[found.good.astype(bool)].quantile([0.5, 0.9]).to_list()
    print("sigma over its bound: median {:.2f}, nine in ten below {:.2f}".format(*over))
    if "distances" in found:
        off = [np.array(pairs, float)[:, 0] for pairs in found.distances.dropna()]
        rms = [np.sqrt(np.nanmean(np.square(errors))) for errors in off]
        print(f"distances: median of the lenses' RMS {1e3 * np.median(rms):.1f} um")
