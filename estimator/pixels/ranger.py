"""Distances and poses by all pixels, for a calibration and a microscope file."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from estimator.distance import Range, calibrated_view
from estimator.files import (
    LENS_PARAMETERS,
    USUAL_SHAKE_PX,
    Calibration,
    MicroscopeFile,
    cache_file,
    kept_arrays,
)
from estimator.image import Outline
from estimator.pixels.beam import BeamLight, Sweep
from estimator.pixels.frame_state import Direction
from estimator.pixels.reference import Reference
from estimator.pixels.robot import RobotPose
from estimator.pixels.tracker import PoseTracker
from optics import InputError

_NEAREST_MM, _FARTHEST_MM = 0.25, 9.0
"""Distances of the table of a lens's light."""
_REACH = 1.05  # of a table over the light's envelope
_FINEST_PX = 1.0  # widest cell of a table; the mean light within a radius has no steps
_KNOWN = 1e-4
"""Relative error of a lens's parameter that does not matter: it is a third of a micrometre in the
distance. Each other parameter costs time in each frame."""


class PixelRanger:
    """Finds tip, axis and distance of the beam from all pixels of frames, in their order.

    Args:
        calibration: of a cone or a lens; its standard errors count.
        microscope: with the camera's noise.
        reference: image of the wall without the spot, H x W x 3; None if there is none.
        shake_px: least standard deviation of the image's shake along each side, px.

    Raises:
        InputError: the microscope file lacks the camera's noise or has what the mode does not
            support, or the lens is impossible.
    """

    model = "pixels"

    def __init__(
        self,
        calibration: Calibration,
        microscope: MicroscopeFile,
        reference: np.ndarray | None = None,
        *,
        shake_px: float = USUAL_SHAKE_PX,
    ) -> None:
        if microscope.noise is None:
            raise InputError(
                "the mode pixels needs the camera's noise, which the microscope file lacks. "
                "Measure it with `eyespot camera`, or render the stack again."
            )
        if microscope.camera() is not None:
            raise InputError(
                "the mode pixels takes images without distortion; the microscope file has "
                f"distortion {microscope.distortion.tolist()}. Undistort the images, or take the "
                "sub-pixel mode."
            )
        self.calibration = calibration
        self.microscope = view = calibrated_view(microscope, calibration.values)
        lens = calibration.model == "lens"
        source, spread = _lens(calibration, view) if lens else _cone(calibration)
        self._libraries = ThreadpoolController()
        beam = BeamLight(
            source,
            view,
            spread,
            sharp=not lens,
            apex_mm=0.0 if lens else -calibration.values["b"],
            within_mm=(_NEAREST_MM, _FARTHEST_MM) if lens else (0.0, math.inf),
        )
        beam.compile()
        self._tracker = PoseTracker(
            beam,
            microscope.noise,
            None if reference is None else Reference(reference, microscope.noise),
            shake_px=shake_px,
        )

    def forget(self) -> None:
        """Fit the next frame by itself."""
        self._tracker.forget()

    def distance(
        self,
        outlines: Sequence[Outline],
        *,
        frame: np.ndarray,
        axis: Any = None,
        axis_sigma_rad: float = math.radians(1.0),
        sweep: Sweep | None = None,
        robot: RobotPose | None = None,
    ) -> Range:
        """The pose in the next frame.

        Args:
            outlines: where the spot is, see `detector.outlines_of`.
            frame: H x W x 3.
            axis: of the beam, from the robot: unit vector from the tip towards the wall, eye frame.
            axis_sigma_rad: standard deviation of the axis across itself.
            sweep: motion during the exposure, from the robot; None if unknown.
            robot: where the robot says the tool is; None if it does not.
        """
        direction = None if axis is None else Direction(np.asarray(axis), axis_sigma_rad)
        # Several threads would wait for each other longer than they work on matrices of this size.
        with self._libraries.limit(limits=1, user_api="blas"):
            return self._tracker.read(frame, outlines, direction, sweep, robot)


def _cone(calibration: Calibration) -> tuple[Any, np.ndarray]:
    """The cone's light, and how its own parameters scatter."""
    from optics.wall_light import UniformCone

    values, names = calibration.values, list(calibration.values)
    first = "k" if "k" in values else "half_angle"
    angle = math.atan(1.0 / values["k"]) if first == "k" else values["half_angle"]
    per = -1.0 / (1.0 + values["k"] ** 2) if first == "k" else 1.0
    at = [names.index(first), names.index("b")]
    covariance = calibration.covariance[np.ix_(at, at)] * np.outer([per, 1.0], [per, 1.0])
    return UniformCone.of(angle, values["b"]), _root(covariance)


def _lens(calibration: Calibration, view: MicroscopeFile) -> tuple[Any, np.ndarray]:
    """The table of a lens's light, and how its own parameters scatter."""
    import optics
    from optics.wall_light import PARAMETERS, LensTable, halvings_for, lens_parameters, lens_table

    values, names = calibration.values, list(calibration.values)
    lens = optics.glue_lens(**{name: values[name] for name in LENS_PARAMETERS if name in values})
    parameters = lens_parameters(lens)
    free = tuple(
        n for n in PARAMETERS if n in names and calibration.sigma(n) > _KNOWN * abs(values[n])
    )
    at = [names.index(name) for name in free]
    light: dict[str, Any] = {
        "medium_index": calibration.medium_index,
        "farthest": _FARTHEST_MM,
        "finest": _FINEST_PX * view.scale_mm_px,
    }
    light |= {
        "halvings": halvings_for(parameters, **light),
        "nearest": _NEAREST_MM,
        "reach": _REACH,
    }

    def compute() -> dict[str, Any]:
        return lens_table(parameters, free, **light).arrays()

    key = hashlib.sha256(repr((sorted(parameters.items()), free, sorted(light.items()))).encode())
    for source in (Path(__file__), *sorted(Path(optics.__file__).parent.rglob("*.py"))):
        key.update(source.read_bytes())
    kept = kept_arrays(cache_file("lens_table", key.hexdigest()), compute)
    return LensTable.of_arrays(kept), _root(calibration.covariance[np.ix_(at, at)])


def _root(covariance: np.ndarray) -> np.ndarray:
    """A matrix that turns independent numbers of variance 1 into ones with this covariance."""
    if not covariance.size:
        return np.zeros((0, 0))
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-12 * max(values.max(), 1e-300)
    return vectors[:, kept] * np.sqrt(values[kept])
