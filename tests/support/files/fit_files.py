"""Files to fit to; what fits find against the truth."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from eyespot.calibration.pixels.fit_result import ImageFit
from eyespot.formats.calibration import Calibration
from eyespot.formats.spot import Spot
from eyespot.formats.spots import SpotRecord, write_spots
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


def assert_within(found: ImageFit | Calibration, truth: Mapping[str, float], sigmas: float) -> None:
    """Parameters are as near to the truth as their standard errors say."""
    for name, true in truth.items():
        if isinstance(found, Calibration):
            value, sigma = found.values[name], found.sigma(name)
        else:
            value, sigma = found.parameters[name]
        assert abs(value - true) < sigmas * sigma, f"{name}: {value} +- {sigma}, true {true}"
