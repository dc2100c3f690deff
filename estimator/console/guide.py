"""A calibration guided by the console: what to do next, and advice on exposure.

Withdraw from contact, see how much is covered, fit, save. The frames and poses of the withdrawal
are recorded in a bag. `eyespot fit` fits it in a program of its own, because a fit takes half a
minute and JAX.
"""

import math
import subprocess
import sys
import tempfile
import time
from enum import Enum
from pathlib import Path
from typing import IO

import numpy as np

from eyespot.estimator.console.session import CoursePoint, Session
from eyespot.formats.camera_sheet import Response
from eyespot.formats.inputs import InputError
from eyespot.formats.rig import Rig
from eyespot.formats.spot import NoSpot, Spot
from eyespot.formats.whole_files import write_text

_SATURATED_SHARE = 0.01
"""Part of the spot below which saturated pixels are hot ones and reflections."""
# Shares of full scale; at a quarter, noise of the edge has four times its least.
_DIM_PEAK, _GOOD_PEAK = 0.25, 0.8


def exposure_advice(result: Spot | NoSpot, frame: np.ndarray, response: Response) -> str:
    """One sentence about the exposure; empty if it is right."""
    if isinstance(result, NoSpot):
        return ""
    if result.saturated > _SATURATED_SHARE:
        # How far the light exceeds full scale is not in the image, so: halve it, and look again.
        return f"{result.saturated:.0%} of the spot is saturated: halve the exposure."
    # The brightest channel of the square in the spot's ellipse.
    half = result.semi_minor_px / np.sqrt(2)
    x0, x1 = (max(round(result.x_px + side * half), 0) for side in (-1, 1))
    y0, y1 = (max(round(result.y_px + side * half), 0) for side in (-1, 1))
    inside = frame[y0 : y1 + 1, x0 : x1 + 1]
    inside = inside.max(axis=2) if inside.ndim == 3 else inside
    if not inside.size or (frame.dtype != np.uint8 and response.full_scale is None):
        return ""  # of 16 bits, a camera may use 10
    peak = float(np.percentile(inside, 99)) / response.full_scale_of(frame)
    if peak < _DIM_PEAK:
        return (
            f"The spot reaches {peak:.0%} of full scale: make the exposure"
            f" {_GOOD_PEAK / max(peak, 0.01):.0f} times as long."
        )
    return ""


FEWEST_SPOTS, LEAST_MM = 8, 3.0
"""From here on a fit is worth trying: b and k separate over a withdrawal of 3 to 6 mm."""


class Stage(Enum):
    """Where a guided calibration is."""

    IDLE = "idle"
    WITHDRAWING = "withdrawing"
    FITTING = "fitting"
    SAVED = "saved"
    REFUSED = "refused"


class Guide:
    """Guides one calibration after the other, for all windows of a session."""

    def __init__(self, session: Session, folder: Path, rig: Rig) -> None:
        self._session, self._folder, self._rig = session, folder, rig
        self.stage = Stage.IDLE
        self.said = ""
        """What `eyespot fit` said."""
        self._bag = folder / "calibration.bag"
        self._fit: subprocess.Popen[bytes] | None = None
        self._log: IO[bytes] | None = None
        self._last: CoursePoint | None = None
        self.spots, self._low_mm, self._high_mm = 0, math.inf, -math.inf

    @property
    def covered_mm(self) -> float:
        """How far the spots reach so far, by the robot."""
        return max(self._high_mm - self._low_mm, 0.0)

    @property
    def enough(self) -> bool:
        """Whether a fit is worth trying."""
        return self.spots >= FEWEST_SPOTS and self.covered_mm >= LEAST_MM

    @property
    def file(self) -> Path:
        """The calibration file that is, or will be, written; its report lies beside it."""
        return self._bag.with_suffix(".json")

    def start(self) -> None:
        """Record from now on; the tip must touch the wall.

        Raises:
            InputError: the rig has no microscope.
            OSError: the bag cannot be written.
        """
        if self._rig.view is None:
            raise InputError("a calibration needs the microscope. Start the console with --rig.")
        self._bag = self._folder / time.strftime("calibration-%Y%m%d-%H%M%S.bag")
        self._session.start_recording(self._bag)
        course = self._session.course
        self._last = course[-1] if course else None
        self.spots, self._low_mm, self._high_mm = 0, math.inf, -math.inf
        self.stage, self.said = Stage.WITHDRAWING, ""

    def look(self) -> None:
        """Count what the session has measured since the last call, or see how the fit goes on."""
        if self.stage is Stage.WITHDRAWING:
            course = self._session.course
            # A recording that is set back to its begin has a new course.
            known = next((n for n, moment in enumerate(course) if moment is self._last), -1)
            for moment in course[known + 1 :]:
                self._last = moment
                if not math.isnan(moment.radius_px + moment.robot_mm):
                    self.spots += 1
                    self._low_mm = min(self._low_mm, moment.robot_mm)
                    self._high_mm = max(self._high_mm, moment.robot_mm)
        elif self.stage is Stage.FITTING and self._fit and self._log:
            code = self._fit.poll()
            if code is not None:
                self._log.seek(0)
                self.said = self._log.read().decode(errors="replace").strip()
                self._log.close()
                self.stage = Stage.SAVED if code == 0 else Stage.REFUSED

    def fit(self, *, phantom: str, medium: str) -> None:
        """End the withdrawal and fit it.

        Args:
            phantom: "plane" or "eyeball".
            medium: as wall.medium of a rig file.

        Raises:
            InputError: the bag could not be completed.
        """
        self._session.stop_recording()
        if self._session.recording_fault:
            self.stage, self.said = Stage.REFUSED, self._session.recording_fault
            raise InputError(self.said)
        file = self._bag.with_suffix(".toml")
        rig = self._rig.changed({"wall.kind": phantom, "wall.medium": medium})
        write_text(file, rig.toml(self._folder))
        options = {"--poses": self._bag, "--rig": file, "--out": self.file}
        words = [str(word) for pair in options.items() for word in pair]
        self._log = tempfile.TemporaryFile()
        self._fit = subprocess.Popen(
            [sys.executable, "-m", "eyespot", "fit", str(self._bag), *words],
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )
        self.stage = Stage.FITTING

    def close(self) -> None:
        """End a fit that goes on."""
        if self._fit is not None and self._fit.poll() is None:
            self._fit.terminate()
            self._fit.wait()
