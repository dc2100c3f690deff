"""The detector of `pupil-detectors`, in its own environment because it needs another OpenCV.

The environment is created in the user's cache on first use. This file also runs there as a script:
it reads crops from its standard input, each after a line with height and width, and prints one line
per crop: centre, axes and angle of the ellipse, and the processor time that it has used so far.
"""

import contextlib
import functools
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

PACKAGE = "pupil-detectors==2.0.2"
_SECONDS_TO_BUILD = 300


class PupilUnavailable(RuntimeError):
    """The package is not available; the message says why."""


class PupilDetector:
    """A process that finds a pupil (a dark ellipse, the negative of a spot) in grey crops.

    `properties` of `Detector2D` may differ from its own; `seconds` of processor time are counted.
    """

    def __init__(self, properties: Mapping[str, float]) -> None:
        self.seconds = 0.0
        self._process = subprocess.Popen(
            # -I: modules of this folder must not hide those of the package.
            [str(_environment()), "-I", __file__, json.dumps(dict(properties))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )

    def ellipse(self, crop: np.ndarray) -> list[float] | None:
        """The bright ellipse of an 8-bit crop: x, y, semi-axes (px) and angle (rad); or None."""
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
        *ellipse, self.seconds = (float(word) for word in line.split())
        return ellipse if min(ellipse[2:4]) > 0 else None

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


@functools.cache
def why_unavailable() -> str | None:
    """Why the detector is not available; None if it is."""
    try:
        detector = PupilDetector({})
        try:
            detector.ellipse(np.zeros((100, 100), np.uint8))
        finally:
            detector.close()
    except PupilUnavailable as error:
        return str(error)
    return None


def _environment() -> Path:
    """Python of the environment with the package."""
    from eyespot.formats.cache_folder import cache_folder  # which that environment does not have

    cache = Path(cache_folder(), "eyespot")
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    home = cache / f"{PACKAGE.replace('==', '-')}-python{version}"
    if not home.exists():
        cache.mkdir(parents=True, exist_ok=True)
        # Made under a temporary name, so that an incomplete environment is never used.
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


def _serve(crops: BinaryIO, properties: Mapping[str, float]) -> None:
    from pupil_detectors import Detector2D  # type: ignore[import-not-found]

    detector = Detector2D()
    detector.update_properties(properties)
    while line := crops.readline():
        shape = tuple(int(side) for side in line.split())
        crop = np.frombuffer(crops.read(math.prod(shape)), np.uint8).reshape(shape).copy()
        found = detector.detect(crop)
        ellipse = found["ellipse"]
        axes = (axis / 2 for axis in ellipse["axes"])
        turned = math.radians(ellipse["angle"])
        said = (*ellipse["center"], *axes, turned, time.process_time())
        print(*said, flush=True)


if __name__ == "__main__":
    _serve(sys.stdin.buffer, json.loads(sys.argv[1]))
