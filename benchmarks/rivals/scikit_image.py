"""scikit-image's `EllipseModel` with RANSAC on edges."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from skimage.color import rgb2gray
from skimage.feature import canny
from skimage.filters import gaussian
from skimage.measure import EllipseModel, find_contours, ransac

from benchmarks.rivals.entry import NO_SPOT, Answer, Entry, plain_spot
from benchmarks.rivals.learned.crops import Window, blob_in
from estimator import Frame

_SAMPLE = 6  # points of a trial; five determine an ellipse, one more steadies it
_SEED = 20


class Constants(NamedTuple):
    """Free constants.

    Attributes:
        level: of the contour whose points are the edges, between the window's border and its
            brightest value; 0 for Canny's edges.
        edge_px: standard deviation of the blur before.
        inlier_px: residual up to which an edge belongs to the ellipse.
        trials: of RANSAC, at most.
    """

    level: float = 0.5
    edge_px: float = 2.0
    inlier_px: float = 2.0
    trials: int = 100


class RadialEllipse(EllipseModel):
    """The model of scikit-image, with residuals along the ray from the centre.

    Its own residuals solve for the nearest point of the ellipse, point by point, which takes
    seconds a frame.
    """

    def residuals(self, data: np.ndarray) -> np.ndarray:
        """Distance of each point from the ellipse, along the ray through the point, px."""
        (x, y), (a, b), angle = self.center, self.axis_lengths, self.theta
        dx, dy = data[:, 0] - x, data[:, 1] - y
        c, s = np.cos(angle), np.sin(angle)
        relative = np.hypot((c * dx + s * dy) / a, (c * dy - s * dx) / b)
        return np.hypot(dx, dy) * np.abs(1 - 1 / np.maximum(relative, 1e-9))


class Ransac(Entry):
    """Edges around the brightest blob, and the ellipse that most of them agree with."""

    def __init__(self, constants: Mapping[str, Any]) -> None:
        self._constants = Constants(**constants)

    def read(self, frame: Frame) -> Answer:
        """The ellipse of the edges around the brightest blob."""
        blob = blob_in(frame.image)
        if blob is None:
            return NO_SPOT
        left, top, side = Window.around(blob)
        left, top, right, bottom = max(left, 0), max(top, 0), left + side, top + side
        grey = rgb2gray(frame.image[top:bottom, left:right])
        points = self._edges(grey)
        if len(points) < 2 * _SAMPLE:
            return NO_SPOT
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about a last fit that fails, which is a miss
            model, _ = ransac(
                points,
                RadialEllipse,
                min_samples=_SAMPLE,
                residual_threshold=self._constants.inlier_px,
                max_trials=self._constants.trials,
                is_model_valid=lambda model, *_: _is_sane(model, side),
                rng=np.random.default_rng(_SEED),
            )
        if not (model and _is_sane(model, side)):
            return NO_SPOT
        (x, y), axes = model.center, model.axis_lengths
        return Answer(plain_spot(x + left, y + top, axes[0], axes[1], model.theta))

    def _edges(self, grey: np.ndarray) -> np.ndarray:
        """(x, y) of the edges' points in a window, px."""
        level, blur_px, *_ = self._constants
        if not level:
            return np.argwhere(canny(grey, sigma=blur_px))[:, ::-1].astype(float)
        smooth = gaussian(grey, blur_px)
        border = np.concatenate([smooth[0], smooth[-1], smooth[:, 0], smooth[:, -1]])
        dark = float(np.median(border))
        contours = find_contours(smooth, dark + level * (float(smooth.max()) - dark))
        return max(contours, key=len)[:, ::-1] if contours else np.empty((0, 2))


def _is_sane(model: EllipseModel, side: int) -> bool:
    """Whether the ellipse may lie in a window of this side, px."""
    return bool(2 < min(model.axis_lengths) and max(model.axis_lengths) < side)
