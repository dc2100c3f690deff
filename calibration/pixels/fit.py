"""Every pixel of a withdrawal fitted at once: source, brightness and pose, with their sigmas."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

import optics
from calibration.pixels.data import Footage, read_footage
from calibration.pixels.image_fit import ImageFit
from calibration.pixels.lens import lens_parameters
from calibration.pixels.parameters import FREE, check_names
from calibration.pixels.solver import Solver
from calibration.spots import Prior
from estimator import Stack


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
) -> ImageFit:
    """Fit the light of a cone or of a glue lens to all pixels that the beam reaches.

    Args:
        stack: a withdrawal from contact, on an even wall; its labels are not read. A rendered edge
            is as good as its samples: with 4 a pixel its weight is low, with 64 and more it counts.
        source: what the light comes from.
        start: values to begin with, and of what is not free: `half_angle` and `b` of a cone,
            `lens_start` of a lens; `reflectance` and `power` (default 0.5 and 1 mW) matter to
            the light that the eye scatters back, and 30 % off is near enough for what is free.
        free: names of `UNITS`; by default the cone's half_angle and b, or the lens's sag and
            numerical_aperture. The pose, sensitivity and illumination always are.
        priors: of free parameters.
        exposure: of a stack with several.
        exposures: taken as reported, or fitted too, each frame's as a multiple of the reported.
        lean_sigma: of the robot's axis, rad.

    Raises:
        ValueError: an unknown name, no start, or a stack that cannot be fitted.
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
    )


def lens_start(lens: optics.GlueLens) -> dict[str, float]:
    """Start values of a lens for `fit_image`."""
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
    progress: Callable[[float], None] = lambda chi_squared: None,
) -> ImageFit:
    """`fit_image` of frames that have been read; `progress` gets chi squared at every step."""
    if free is None:
        free = FREE[source]
    check_names(source, start, free, priors or {})
    solver = Solver(
        footage,
        source,
        start,
        tuple(free),
        priors or {},
        exposures == "fitted",
        lean_sigma,
        progress,
    )
    return solver.run()
