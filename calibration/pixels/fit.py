"""Fit of source, brightness and pose to all pixels of a withdrawal at once."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, cast

import numpy as np

import optics
from calibration.pixels.data import Footage, read_footage
from calibration.pixels.image_fit import ImageFit
from calibration.pixels.parameters import FREE, check_names
from calibration.pixels.solver import Solver
from calibration.spots import BORESIGHT_SIGMA, Prior
from estimator import Stack
from optics import InputError
from optics.wall_light import TABLE_ERROR, lens_parameters

_OTHER_SAGS = (0.5, 2.0)
"""Factors of the sag for further starts, if the first fit misses more light than a table's error.
Two drops can have nearly the same light, and a drop that focuses it near the tip is found from
flatter ones only (numbers 42 and 41 of `tests.photon_fits coverage`)."""


def fit_image(
    stack: Stack,
    *,
    source: Literal["cone", "lens"],
    start: Mapping[str, float],
    free: Sequence[str] | None = None,
    priors: Mapping[str, Prior] | None = None,
    exposure: str | None = None,
    exposures: Literal["reported", "fitted"] = "reported",
    lean_sigma: float = np.radians(1.0),
    boresight_sigma: float = BORESIGHT_SIGMA,
) -> ImageFit:
    """Fit the light of a cone or of a glue lens to all pixels that the beam reaches.

    Args:
        stack: a withdrawal from contact, on an even wall; its labels are not read. The more samples
            per pixel the stack was rendered with, the larger the weight of pixels on the edge.
        source: kind of the light source.
        start: start values of free parameters, within 30 %, and values of the others: `half_angle`
            and `b` for a cone, `lens_start` for a lens. `reflectance` and `power` (default 0.5 and
            1 mW) affect the light that the eye scatters back.
        free: names from `UNITS`; by default the cone's half_angle and b, or the lens's sag and
            numerical_aperture. The pose, sensitivity and illumination are always free.
        priors: priors of free parameters.
        exposure: see `open_source`.
        exposures: use the reported exposure times, or also fit each frame's as a multiple of it.
        lean_sigma: standard deviation of the robot's directions, rad.
        boresight_sigma: standard deviation of the beam's angle from the tool's axis, rad.

    Raises:
        InputError: an unknown name, a missing start value, or a stack that cannot be fitted.
    """
    footage = read_footage(stack, exposure=exposure)
    return fit_footage(
        footage,
        source=source,
        start=start,
        free=free,
        priors=priors,
        exposures=exposures,
        lean_sigma=lean_sigma,
        boresight_sigma=boresight_sigma,
    )


def lens_start(lens: optics.GlueLens) -> dict[str, float]:
    """Start values of `fit_image` for a lens."""
    return lens_parameters(lens)


def fit_footage(
    footage: Footage,
    *,
    source: Literal["cone", "lens"],
    start: Mapping[str, float],
    free: Sequence[str] | None = None,
    priors: Mapping[str, Prior] | None = None,
    exposures: Literal["reported", "fitted"] = "reported",
    lean_sigma: float = np.radians(1.0),
    boresight_sigma: float = BORESIGHT_SIGMA,
    progress: Callable[[float], None] = lambda chi_squared: None,
) -> ImageFit:
    """`fit_image` for frames in memory; calls `progress` with chi squared at every step."""
    if free is None:
        free = FREE[source]
    check_names(source, start, free, priors or {})

    def fitted(start: Mapping[str, float], known: ImageFit | None = None) -> ImageFit | None:
        solver = Solver(
            footage,
            source,
            start,
            tuple(free),
            priors or {},
            exposures == "fitted",
            lean_sigma,
            boresight_sigma,
            progress,
        )
        return solver.run(known)

    best = cast(ImageFit, fitted(start))
    for factor in _OTHER_SAGS if "sag" in free else ():
        if not (best.failed or (best.misfit.structured and best.misfit.share > TABLE_ERROR)):
            break
        # A half ball is the highest drop; a fit that starts there cannot move.
        sag = min(factor * start["sag"], (start["sag"] + start["aperture_radius"]) / 2)
        with contextlib.suppress(InputError):  # no drop at all from there
            other = fitted({**start, "sag": sag}, best)
            if other is not None and other.chi_squared_per_dof < best.chi_squared_per_dof:
                best = other
    return best
