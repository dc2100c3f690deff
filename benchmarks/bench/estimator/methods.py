"""The compared methods: both modes of the estimator, and other software on the same crops."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks.rivals import PupilDetector, contour_ellipse, why_unavailable
from estimator import LiteralSettings, Spot, SubpixelSettings, TrackState, measure
from estimator.detector import EdgeFit, Region, contour_of, contour_points, regions_in
from estimator.image import Window

CROP_PX = 200
"""Half the side of the square around the start point that all methods get."""

_SATURATED = 0.02  # a spot with a larger fraction of full-scale pixels counts as flagged
_DOUBTFUL_PX = 0.5  # so does a spot with a larger 3 sigma


class MethodInput(NamedTuple):
    """Input of a method.

    Attributes:
        image: 8-bit RGB frame.
        at: (x, y) start point, px.
        half_level: grey value halfway between the spot and its surroundings.
        reference: frame without the spot, or None.
    """

    image: np.ndarray
    at: tuple[float, float]
    half_level: float
    reference: np.ndarray | None

    def crop(self) -> np.ndarray:
        """The square around the start point."""
        x, y = (round(v) for v in self.at)
        return self.image[max(y - CROP_PX, 0) : y + CROP_PX, max(x - CROP_PX, 0) : x + CROP_PX]


class Measured(NamedTuple):
    """Semi-minor axis (px, NaN if missed), and whether the method flags it as uncertain."""

    semi_minor: float
    flagged: bool = False


_MISSED = Measured(math.nan, flagged=True)


def subpixel(view: MethodInput) -> Measured:
    """Our default mode. A spot is flagged if it is saturated or its sigma is large."""
    spot, _ = measure(view.image, TrackState(at_px=view.at), _settings(view))
    if not isinstance(spot, Spot):
        return _MISSED
    doubtful = not 3 * spot.sigma_semi_minor_px < _DOUBTFUL_PX
    return Measured(spot.semi_minor_px, spot.saturated > _SATURATED or doubtful)


def literal(view: MethodInput) -> Measured:
    """The paper's algorithm with its threshold."""
    return _literal(view, LiteralSettings())


def literal_at_half(view: MethodInput) -> Measured:
    """The paper's algorithm with its threshold set to the true half level."""
    return _literal(view, LiteralSettings(threshold=min(round(view.half_level), 254)))


def ellipse_on_edges(view: MethodInput) -> Measured:
    """scikit-image's EllipseModel through our edge points, including outliers."""
    window = Window.around(*view.at, CROP_PX, CROP_PX, view.image)
    for region in regions_in(view.image, window, _settings(view)):
        fit = contour_of(region) if isinstance(region, Region) else None
        if isinstance(fit, EdgeFit):
            return _ellipse_model(contour_points(fit.ellipse, fit.offsets)[fit.found])
    return _MISSED


def ellipse_on_contour(view: MethodInput) -> Measured:
    """scikit-image alone: EllipseModel through the longest contour at Otsu's threshold."""
    model = contour_ellipse(view.crop())
    return Measured(min(model.axis_lengths)) if model else _MISSED


def pupil(view: MethodInput) -> Measured:
    """The 2D detector of pupil-detectors on the negative of the crop."""
    from skimage.color import rgb2gray
    from skimage.util import img_as_ubyte

    found = _pupil_detector().ellipse(img_as_ubyte(rgb2gray(view.crop())))
    return Measured(min(found.first, found.second)) if found else _MISSED


METHODS: dict[str, Callable[[MethodInput], Measured]] = {
    "sub-pixel": subpixel,
    "literal": literal,
    "literal, half level": literal_at_half,
    "EllipseModel, our edges": ellipse_on_edges,
    "EllipseModel, contour": ellipse_on_contour,
    "pupil-detectors": pupil,
}


def available() -> dict[str, Callable[[MethodInput], Measured]]:
    """The methods that are installed on this machine."""
    return {k: v for k, v in METHODS.items() if v is not pupil or why_unavailable() is None}


@functools.cache
def _pupil_detector() -> PupilDetector:
    return PupilDetector()


def _settings(view: MethodInput) -> SubpixelSettings:
    return SubpixelSettings(reference=view.reference)


def _literal(view: MethodInput, settings: LiteralSettings) -> Measured:
    spot, _ = measure(view.image, TrackState(at_px=view.at), settings)
    return Measured(spot.semi_minor_px) if isinstance(spot, Spot) else _MISSED


def _ellipse_model(points: np.ndarray) -> Measured:
    from skimage.measure import EllipseModel

    model = EllipseModel.from_estimate(points)
    return Measured(min(model.axis_lengths)) if model else _MISSED
