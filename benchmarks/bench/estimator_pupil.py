"""The peer `pupil-detectors` in an environment of its own: it pulls in another OpenCV.

The environment is made in the user's cache on first use. This file is also what runs in it, as a
script: it reads crops from its standard input, each after a line with its height and width, and
answers each with a line.
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import BinaryIO

import numpy as np

PACKAGE = "pupil-detectors==2.0.2"
_SECONDS_TO_BUILD = 300
_SMALLEST_PX, _LARGEST_PX = 20, 400  # diameters that it looks for


class PupilUnavailable(RuntimeError):
    """The package cannot be had here; the message says why."""


class PupilDetector:
    """A process that finds the pupil in grey crops: a dark ellipse, so a spot's negative."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            # Isolated, so that no module of this folder is taken for one of the package's.
            [str(_environment()), "-I", __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )

    def semi_minor(self, crop: np.ndarray) -> float:
        """Semi-minor axis of the bright ellipse of an 8-bit grey crop, px; NaN if none is seen."""
        process = self._process
        assert process.stdin and process.stdout and process.stderr
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(f"{crop.shape[0]} {crop.shape[1]}\n".encode())
            process.stdin.write((255 - crop).tobytes())
            process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            said = process.stderr.read().decode().strip().splitlines()
            raise PupilUnavailable(said[-1] if said else "its process ended")
        return float(line)

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


@functools.cache
def why_unavailable() -> str | None:
    """Why there is no pupil detector here; None if there is one."""
    try:
        detector = PupilDetector()
        try:
            detector.semi_minor(np.zeros((100, 100), np.uint8))
        finally:
            detector.close()
    except PupilUnavailable as error:
        return str(error)
    return None


def _environment() -> Path:
    """Python of the environment with the package."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "eyespot"
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    home = cache / f"{PACKAGE.replace('==', '-')}-python{version}"
    if not home.exists():
        cache.mkdir(parents=True, exist_ok=True)
        # Made under another name: an environment that was cut short is never taken for whole.
        with tempfile.TemporaryDirectory(dir=cache, ignore_cleanup_errors=True) as made:
            _run([sys.executable, "-m", "venv", made])
            _run([str(Path(made) / "bin/python"), "-m", "pip", "install", "--quiet", PACKAGE])
            with contextlib.suppress(FileExistsError):  # another process was faster
                Path(made).rename(home)
    return home / "bin/python"


def _run(command: list[str]) -> None:
    try:
        subprocess.run(
            command, check=True, capture_output=True, text=True, timeout=_SECONDS_TO_BUILD
        )
    except subprocess.TimeoutExpired as error:
        raise PupilUnavailable(f"not built in {_SECONDS_TO_BUILD} s") from error
    except subprocess.CalledProcessError as error:
        lines = (error.stderr or error.stdout).strip().splitlines()
        reasons = [line for line in lines if "ERROR" in line] or lines or ["pip failed"]
        raise PupilUnavailable(reasons[-1]) from error


def _serve(crops: BinaryIO) -> None:
    from pupil_detectors import Detector2D  # type: ignore[import-not-found]

    detector = Detector2D()
    detector.update_properties({"pupil_size_min": _SMALLEST_PX, "pupil_size_max": _LARGEST_PX})
    while line := crops.readline():
        shape = tuple(int(side) for side in line.split())
        crop = np.frombuffer(crops.read(math.prod(shape)), np.uint8).reshape(shape).copy()
        semi_minor = min(detector.detect(crop)["ellipse"]["axes"]) / 2
        print(semi_minor if semi_minor > 0 else math.nan, flush=True)


if __name__ == "__main__":
    _serve(sys.stdin.buffer)
