"""The numbers that the network gives for a window, and the ellipse and distance that they mean.

An ellipse is (x, y) of its centre in half sides of the window, the logarithm of its mean radius
over the one that the window was cut for, and the logarithm q of the ratio of its axes, as
(q cos 2θ, q sin 2θ), which is smooth where the ellipse is a circle. The sixth number is the
logarithm of the distance in mm.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from benchmarks.rivals.learned.crops import REACH, Window
from estimator import FrameLabels, MicroscopeFile

NUMBERS = ("x", "y", "size", "ratio_cos", "ratio_sin", "log_distance")
PLACES = 4
"""Numbers of `place_of`."""

_FIELD_MM, _HEIGHT_MM = 3.0, 200.0  # bring the place to the order of 1


def targets_of(labels: FrameLabels, window: Window) -> Float[np.ndarray, "6"]:
    """The true numbers of a window."""
    a, b = labels.half_max_semi_major_px, labels.half_max_semi_minor_px
    x, y = window.centre
    q, turn = math.log(a / b), 2 * labels.half_max_angle_rad
    return np.array(
        [
            (labels.half_max_x_px - x) / window.half,
            (labels.half_max_y_px - y) / window.half,
            math.log(REACH * math.sqrt(a * b) / window.half),
            q * math.cos(turn),
            q * math.sin(turn),
            math.log(labels.d_mm),
        ]
    )


def place_of(window: Window, microscope: MicroscopeFile) -> Float[np.ndarray, "4"]:
    """Where and how large a window is on the retina, and how high the pinhole is."""
    scale = microscope.scale_mm_px
    u, v = microscope.principal_point_px
    x, y = window.centre
    return np.array(
        [
            math.log(scale * window.half),
            scale * (x - u) / _FIELD_MM,
            scale * (y - v) / _FIELD_MM,
            microscope.pinhole_height_mm / _HEIGHT_MM,
        ]
    )


def ellipse_of(numbers: np.ndarray, window: Window) -> np.ndarray:
    """(x, y, semi-major, semi-minor, angle) in px and rad, of the first five numbers."""
    x, y = window.centre
    radius = window.half / REACH * math.exp(numbers[2])
    q = math.hypot(numbers[3], numbers[4])
    angle = math.atan2(numbers[4], numbers[3]) / 2
    return np.array(
        [
            x + window.half * numbers[0],
            y + window.half * numbers[1],
            radius * math.exp(q / 2),
            radius * math.exp(-q / 2),
            angle,
        ]
    )


def covariance_of(
    numbers: np.ndarray, sigmas: np.ndarray, window: Window
) -> Float[np.ndarray, "5 5"]:
    """Covariance of `ellipse_of`, px and rad, from independent errors of the numbers."""
    _, _, a, b, _ = ellipse_of(numbers, window)
    q = math.hypot(numbers[3], numbers[4])
    # Towards a circle the axes' direction is lost: there the ratio's error counts whichever way.
    along = np.array(numbers[3:5]) / q if q > 0 else np.array([1.0, 0.0])
    slopes = np.zeros((5, 5))
    slopes[0, 0] = slopes[1, 1] = window.half
    slopes[2, 2:] = a, *(a / 2 * along)
    slopes[3, 2:] = b, *(-b / 2 * along)
    floor = max(q, float(np.hypot(sigmas[3], sigmas[4])), 1e-9)
    slopes[4, 3:] = -along[1] / (2 * floor), along[0] / (2 * floor)
    return (slopes * np.square(sigmas[:5])) @ slopes.T
