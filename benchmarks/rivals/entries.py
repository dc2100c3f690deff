"""All entries by name, each with what it is and how it is made."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from skimage.color import rgb2gray
from skimage.filters import gaussian
from skimage.measure import EllipseModel, find_contours, ransac

from eyespot.benchmarks.rivals.pupil import PupilDetector, why_unavailable
from eyespot.benchmarks.sets.read import Mode, own_reader, plain_spot
from eyespot.estimator import Frame, Reading
from eyespot.formats.calibration import Calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.spot import NoSpot, Reason

# What an entry is: a frame goes in, an ellipse or a miss comes out.


class Entry:
    """A way to measure spots, frame by frame in their order.

    Attributes:
        own_distance: whether its answers contain distances. Those of other entries follow from
            their ellipses by the true beam, the same way for all.
        seconds_elsewhere: processor time that it has used in other processes so far, s.
    """

    own_distance = False
    seconds_elsewhere = 0.0

    def begin(
        self, microscope: MicroscopeFile, beam: Calibration, click: tuple[float, float]
    ) -> None:
        """Get ready for the frames of a stack, with its true beam and first spot, (x, y) in px.

        An entry without a memory has nothing to do.
        """

    def read(self, frame: Frame) -> Reading:
        """Measure a frame."""
        raise NotImplementedError

    def close(self) -> None:
        """End what it has started."""


NO_SPOT = Reading("", NoSpot(Reason.NONE_FOUND))


_FEWEST_POINTS = 6
_INSIDE_PX = 0.5
"""A contour runs through the centres of its outermost pixels, half a pixel inside of the edge."""


@dataclass
class OpenCV(Entry):
    """Blur (standard deviation in px), threshold, and `fitEllipse` on the largest contour's hull.

    The convex hull bridges what an instrument hides. The level lies between the frame's median, 0,
    and its brightest blurred value, 1.
    """

    level: float
    blur_px: float = 2.0

    def read(self, frame: Frame) -> Reading:
        """The ellipse of the largest bright region."""
        grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
        if self.blur_px:
            grey = cv2.GaussianBlur(grey, (0, 0), self.blur_px)
        dark, bright = float(np.median(grey)), float(grey.max())
        above = cv2.threshold(grey, dark + self.level * (bright - dark), 255, cv2.THRESH_BINARY)[1]
        contours, _ = cv2.findContours(above, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if not contours:
            return NO_SPOT
        corners = cv2.convexHull(max(contours, key=cv2.contourArea))[:, 0].astype(float)
        steps = np.roll(corners, -1, axis=0) - corners
        # Points a pixel apart: long edges of the hull weigh as much as curved ones.
        sides = [
            start + np.linspace(0, 1, max(round(length), 1), endpoint=False)[:, None] * step
            for start, step, length in zip(corners, steps, np.hypot(*steps.T), strict=True)
        ]
        points = np.concatenate(sides).astype(np.float32)[:, None]
        if len(points) < _FEWEST_POINTS:
            return NO_SPOT
        (x, y), (width, height), degrees = cv2.fitEllipse(points)
        if not (math.isfinite(x + y) and 0 < width < math.inf and 0 < height < math.inf):
            return NO_SPOT
        axes = width / 2 + _INSIDE_PX, height / 2 + _INSIDE_PX
        return Reading("", plain_spot(x, y, *axes, math.radians(degrees)))


_BLOB_CELL_PX, _BLOB_BLUR_CELLS = 8, 1.5
_LEAST_CONTRAST_DN = 2.0  # A blob is brighter than the frame's median by as much.
_HALF_SQUARE_RADII = 1.9  # The spot's surroundings are inside.
_LEAST_HALF_PX = 24


def square_around_blob(image: np.ndarray) -> tuple[int, int, int] | None:
    """Left and upper edge and side (px) of a square around the brightest blurred blob, if any."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    height, width = (max(side // _BLOB_CELL_PX, 1) for side in grey.shape)
    coarse = cv2.resize(grey.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(coarse, (0, 0), _BLOB_BLUR_CELLS)
    dark, bright = float(np.median(coarse)), float(coarse.max())
    if bright - dark < _LEAST_CONTRAST_DN:
        return None
    above = (coarse > (dark + bright) / 2).astype(np.uint8)
    _, labels, stats, centres = cv2.connectedComponentsWithStats(above)
    label = labels[np.unravel_index(np.argmax(coarse), coarse.shape)]
    cell = np.array([grey.shape[1] / width, grey.shape[0] / height])
    radius = math.sqrt(stats[label, cv2.CC_STAT_AREA] * cell.prod() / math.pi)
    half = max(_HALF_SQUARE_RADII * radius, _LEAST_HALF_PX)
    left, top = np.rint((centres[label] + 0.5) * cell - half).astype(int).tolist()
    return left, top, round(2 * half)


# scikit-image's `EllipseModel` with RANSAC on edges.

_TRIAL_POINTS = 6  # Five determine an ellipse, one more steadies it.
_SEED = 20


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


@dataclass
class Ransac(Entry):
    """Edges around the brightest blob, and the ellipse that most of them agree with.

    The edges are a contour at a level between the window's border, 0, and its brightest value, 1,
    after a blur of the standard deviation `edge_px`. RANSAC has residuals up to `inlier_px`.
    """

    level: float = 0.5
    edge_px: float = 2.0
    inlier_px: float = 2.0
    trials: int = 100

    def read(self, frame: Frame) -> Reading:
        """The ellipse of the edges around the brightest blob."""
        square = square_around_blob(frame.image)
        if square is None:
            return NO_SPOT
        left, top, side = square
        left, top, right, bottom = max(left, 0), max(top, 0), left + side, top + side
        smooth = gaussian(rgb2gray(frame.image[top:bottom, left:right]), self.edge_px)
        border = np.concatenate([smooth[0], smooth[-1], smooth[:, 0], smooth[:, -1]])
        dark = float(np.median(border))
        contours = find_contours(smooth, dark + self.level * (float(smooth.max()) - dark))
        points = max(contours, key=len)[:, ::-1] if contours else np.empty((0, 2))
        if len(points) < 2 * _TRIAL_POINTS:
            return NO_SPOT
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about a last fit that fails, which is a miss
            model, _ = ransac(
                points,
                RadialEllipse,
                min_samples=_TRIAL_POINTS,
                residual_threshold=self.inlier_px,
                max_trials=self.trials,
                is_model_valid=lambda model, *_: _is_sane(model, side),
                rng=np.random.default_rng(_SEED),
            )
        if not (model and _is_sane(model, side)):
            return NO_SPOT
        (x, y), axes = model.center, model.axis_lengths
        return Reading("", plain_spot(x + left, y + top, axes[0], axes[1], model.theta))


def _is_sane(model: EllipseModel, side: int) -> bool:
    """Whether the ellipse may lie in a window of this side, px."""
    return bool(2 < min(model.axis_lengths) and max(model.axis_lengths) < side)


class Pupil(Entry):
    """The 2D detector of pupil-detectors, on the negative of the frame, made smaller.

    `largest` is a diameter, px of the smaller frame. `intensity_range` (grey values above the
    darkest that count as pupil) and `blur_size` (px, of its median filter) are the package's.
    """

    def __init__(self, smaller: int, largest: int, **constants: int) -> None:
        self._smaller = smaller
        sizes = {"pupil_size_min": 10, "pupil_size_max": largest}
        self._detector = PupilDetector(sizes | constants)

    def read(self, frame: Frame) -> Reading:
        """The ellipse of the brightest region."""
        n = self._smaller
        grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
        size = grey.shape[1] // n, grey.shape[0] // n
        found = self._detector.ellipse(cv2.resize(grey, size, interpolation=cv2.INTER_AREA))
        self.seconds_elsewhere = self._detector.seconds
        if found is None:
            return NO_SPOT
        *place, first, second, angle = found
        x, y = ((at + 0.5) * n - 0.5 for at in place)
        return Reading("", plain_spot(x, y, n * first, n * second, angle))

    def close(self) -> None:
        """End the detector's process."""
        self._detector.close()


class EyespotMode(Entry):
    """A mode of eyespot, which follows the spot from frame to frame (`own_reader`)."""

    def __init__(self, mode: Mode, constants: Mapping[str, Any]) -> None:
        self.own_distance = mode == "pixels"
        self._mode = mode
        self._constants = constants

    def begin(
        self, microscope: MicroscopeFile, beam: Calibration, click: tuple[float, float]
    ) -> None:
        """Start a new reader."""
        self._reader = own_reader(
            self._mode, microscope, click=click, beam=beam, constants=self._constants
        )

    def read(self, frame: Frame) -> Reading:
        """Measure the next frame."""
        return self._reader.read(frame, name=frame.file_name)


class Kind(NamedTuple):
    """A kind of entry, made from its constants."""

    about: str  # for entry.json and the documentation
    make: Callable[[Mapping[str, Any]], Entry]
    packages: tuple[str, ...]  # distributions whose versions matter
    grid: Mapping[str, tuple[Any, ...]] = {}  # values of free constants to try, the start first


KINDS: dict[str, Kind] = {
    "subpixel": Kind(
        "eyespot's sub-pixel mode: the half-maximum contour",
        lambda constants: EyespotMode("subpixel", constants),
        ("eyespot",),
    ),
    "literal": Kind(
        "eyespot's literal mode: the paper's Algorithms 1 and 2, started by a click",
        lambda constants: EyespotMode("literal", constants),
        ("eyespot",),
        {"threshold": (60, 30, 40, 50, 80, 100, 140, 200)},
    ),
    "pixels": Kind(
        "eyespot's mode pixels: ellipse of the sub-pixel mode, distance by all pixels",
        lambda constants: EyespotMode("pixels", constants),
        ("eyespot",),
    ),
    "opencv-relative": Kind(
        "OpenCV: threshold between median and maximum, largest contour, ellipse fit",
        lambda constants: OpenCV(**constants),
        ("opencv-python-headless",),
        {
            "level": (0.5, 0.3, 0.35, 0.4, 0.45, 0.55, 0.6),
            "blur_px": (2.0, 0.0, 1.0, 3.0, 5.0),
        },
    ),
    "skimage-ransac": Kind(
        "scikit-image: edges around the brightest blob, EllipseModel with RANSAC",
        lambda constants: Ransac(**constants),
        ("scikit-image",),
        {
            "level": (0.5, 0.4, 0.45, 0.55),
            "edge_px": (2.0, 1.0, 3.0, 5.0),
            "inlier_px": (2.0, 1.0, 4.0, 6.0),
            "trials": (100, 300),
        },
    ),
    "pupil-detectors": Kind(
        "the 2D detector of pupil-detectors on the frame's negative",
        lambda constants: Pupil(**constants),
        (),
        {
            "smaller": (3, 1, 2, 4),
            "intensity_range": (40, 12, 23, 60, 80),
            "blur_size": (5, 3, 9),
            "largest": (400, 200),
        },
    ),
}


def unavailable(name: str) -> str | None:
    """Why an entry cannot run on this machine; None if it can."""
    return why_unavailable() if name == "pupil-detectors" else None


def chosen(names: Sequence[str]) -> list[str]:
    """The names, or all if there are none; InputError for an unknown one."""
    for name in names:
        if name not in KINDS:
            raise InputError(f"no entry is called {name}. They are: {', '.join(KINDS)}.")
    return list(names or KINDS)
