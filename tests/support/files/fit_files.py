"""Files to fit to; and fits by the hundred, a line of JSON each, so that a killed run goes on."""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eyespot.calibration.pixels.fit import ImageFit
from eyespot.formats.calibration import Calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.spots import Spot, SpotRecord, write_spots
from eyespot.formats.stack import KINEMATICS


def a_recording(file: Path, spots: Iterable[Spot], times_s: Iterable[float], poses: Any) -> str:
    """Write what a rig records: spots, and poses in a file beside them, whose path is returned."""
    records = [
        SpotRecord(frame=n, file_name="", time_s=time, mode="subpixel", result=spot)
        for n, (spot, time) in enumerate(zip(spots, times_s, strict=True))
    ]
    write_spots(file, records)
    beside = file.with_name(f"{file.stem}-poses.csv")
    np.savetxt(beside, poses, delimiter=",", header=",".join(KINEMATICS), comments="")
    return str(beside)


def collected(file: Path, fits: Mapping[str, Callable[[], dict[str, Any]]]) -> pd.DataFrame:
    """Results by name: those in the file, and those that it lacked, which it then has too."""
    for name, fit in fits.items():
        if name in _in(file):
            continue
        try:
            row = fit()
        except InputError as error:  # a scene that is impossible, or a fit that cannot begin
            row = {"good": False, "said": str(error)}
        with file.open("a") as appended:
            appended.write(json.dumps({"name": name, **row}) + "\n")
    return pd.DataFrame.from_dict(_in(file), orient="index")


def _in(file: Path) -> dict[str, dict[str, Any]]:
    lines = file.read_text().splitlines() if file.exists() else []
    return {row.pop("name"): row for row in map(json.loads, lines)}


def assert_within(found: ImageFit | Calibration, truth: Mapping[str, float], sigmas: float) -> None:
    """Parameters are as near to the truth as their standard errors say."""
    for name, true in truth.items():
        if isinstance(found, Calibration):
            value, sigma = found.values[name], found.sigma(name)
        else:
            value, sigma = found.parameters[name]
        assert abs(value - true) < sigmas * sigma, f"{name}: {value} +- {sigma}, true {true}"


def pulls(rows: pd.DataFrame, name: str) -> np.ndarray:
    """Errors over standard errors of what fits have as pairs of both, or as lists of such pairs."""
    pairs = [np.array(pair, float).reshape(-1, 2) for pair in rows[name].dropna()]
    error, sigma = np.concatenate([*pairs, np.zeros((0, 2))]).T
    return np.abs(error / sigma)[np.isfinite(error / sigma)]


def summary(rows: pd.DataFrame, names: Iterable[str]) -> str:
    """What was accepted, shares of errors within 1, 1.96, 3 and 4 sigma, and what was refused."""
    good = rows[rows.good.astype(bool)]
    lines = [f"{len(good)} of {len(rows)} accepted; median {rows.seconds.median():.0f} s a fit."]
    for title, own in (("accepted", good), ("all", rows)):
        for name in (name for name in names if name in own):
            z = pulls(own, name)
            within = ", ".join(f"{np.mean(z < n):.1%} within {n:g}" for n in (1, 1.96, 3, 4))
            lines.append(f"{name}, {title}: {z.size} errors, {within} sigma; largest {z.max():.1f}")
    refused = rows[~rows.good.astype(bool)]
    said = (f"refused {name}: {' '.join(str(said).split())}" for name, said in refused.said.items())
    return "\n".join([*lines, *said])
