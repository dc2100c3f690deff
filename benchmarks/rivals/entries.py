"""All entries by name, each with what it is and how it is made; eyespot's own and the network."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.rivals.entry import NO_SPOT, Answer, Entry, Recording, plain_spot
from benchmarks.rivals.learned.estimator import LearnedEstimator
from benchmarks.rivals.opencv import OpenCV
from benchmarks.rivals.pupil import why_unavailable
from benchmarks.rivals.pupil_entry import Pupil
from benchmarks.rivals.scikit_image import Ransac
from benchmarks.sets.read.stacks import Mode, own_reader
from estimator import Frame, Range
from optics import InputError


class EyespotMode(Entry):
    """A mode of eyespot, which follows the spot from frame to frame.

    The mode pixels gets the beam. The literal mode starts at a click on the spot, as the paper's
    operator does. No mode gets the robot's poses.

    Args:
        mode: as of `eyespot track`.
        constants: of `LiteralSettings` or `SubpixelSettings`; those that are not given are the
            product's.
    """

    def __init__(self, mode: Mode, constants: Mapping[str, Any]) -> None:
        self.own_distance = mode == "pixels"
        self._mode = mode
        self._constants = constants

    def begin(self, recording: Recording) -> None:
        """Start a new reader."""
        self._reader = own_reader(
            self._mode,
            recording.microscope,
            click=recording.click,
            beam=recording.beam,
            constants=self._constants,
        )

    def read(self, frame: Frame) -> Answer:
        """Measure the next frame."""
        reading = self._reader.read(
            frame.image, time_s=frame.time_s, exposure_s=frame.exposure_s, name=frame.file_name
        )
        return Answer(reading.result, reading.range)


class LearnedEntry(Entry):
    """The network, frame by frame. Its distance does not go by its ellipse.

    Args:
        weights: a file of weights.
        direct: whether the distance is the network's own; else it follows from its ellipse.
    """

    def __init__(self, weights: Path, *, direct: bool) -> None:
        self.own_distance = direct
        self._estimator = LearnedEstimator.load(weights)

    def begin(self, recording: Recording) -> None:
        """Note the microscope."""
        self._microscope = recording.microscope

    def read(self, frame: Frame) -> Answer:
        """Measure a frame."""
        said = self._estimator.measure(frame.image, self._microscope)
        if said is None:
            return NO_SPOT
        x, y, first, second, angle = said.ellipse.tolist()
        spot = plain_spot(x, y, first, second, angle, said.covariance)
        if not self.own_distance:
            return Answer(spot)
        return Answer(spot, Range(distance_mm=said.distance_mm, sigma_mm=said.sigma_distance_mm))


class Kind(NamedTuple):
    """A kind of entry.

    Attributes:
        about: what it is, for entry.json and the documentation.
        make: makes it from its constants and the weights of the network.
        packages: distributions whose versions matter.
        grid: values to try of each free constant, in the order in which they are chosen; the
            first one is the start.
    """

    about: str
    make: Callable[[Mapping[str, Any], Path], Entry]
    packages: tuple[str, ...]
    grid: Mapping[str, tuple[Any, ...]] = {}


_LEARNED = ("equinox", "jax", "opencv-python-headless")

KINDS: dict[str, Kind] = {
    "subpixel": Kind(
        "eyespot's sub-pixel mode: the half-maximum contour",
        lambda constants, _: EyespotMode("subpixel", constants),
        ("eyespot",),
    ),
    "literal": Kind(
        "eyespot's literal mode: the paper's Algorithms 1 and 2, started by a click",
        lambda constants, _: EyespotMode("literal", constants),
        ("eyespot",),
        {"threshold": (60, 30, 40, 50, 80, 100, 140, 200)},
    ),
    "pixels": Kind(
        "eyespot's mode pixels: ellipse of the sub-pixel mode, distance by all pixels",
        lambda constants, _: EyespotMode("pixels", constants),
        ("eyespot",),
    ),
    "learned": Kind(
        "network from crop to ellipse; distance from the ellipse by the true beam",
        lambda _, weights: LearnedEntry(weights, direct=False),
        _LEARNED,
    ),
    "learned-direct": Kind(
        "the same network; distance straight from the crop and its place",
        lambda _, weights: LearnedEntry(weights, direct=True),
        _LEARNED,
    ),
    "opencv-relative": Kind(
        "OpenCV: threshold between median and maximum, largest contour, ellipse fit",
        lambda constants, _: OpenCV(constants),
        ("opencv-python-headless",),
        {
            "level": (0.5, 0.3, 0.35, 0.4, 0.45, 0.55, 0.6),
            "blur_px": (2.0, 0.0, 1.0, 3.0, 5.0),
            "hull": (True, False),
            "grow_px": (0.5, 0.0),
            "fit": ("direct", "plain", "ams"),
        },
    ),
    "skimage-ransac": Kind(
        "scikit-image: edges around the brightest blob, EllipseModel with RANSAC",
        lambda constants, _: Ransac(constants),
        ("scikit-image",),
        {
            "level": (0.5, 0.4, 0.45, 0.55, 0.0),
            "edge_px": (2.0, 1.0, 3.0, 5.0),
            "inlier_px": (2.0, 1.0, 4.0, 6.0),
            "trials": (100, 300),
        },
    ),
    "pupil-detectors": Kind(
        "the 2D detector of pupil-detectors on the frame's negative",
        lambda constants, _: Pupil(constants),
        (),
        {
            "smaller": (3, 1, 2, 4),
            "intensity_range": (40, 12, 23, 60, 80),
            "blur_size": (5, 3, 9),
            "largest": (400, 200),
        },
    ),
}
"""The entries, by the name of their folder."""


def unavailable(name: str) -> str | None:
    """Why an entry cannot run on this machine; None if it can."""
    return why_unavailable() if name == "pupil-detectors" else None


def chosen(names: list[str]) -> list[str]:
    """The names, or all of them if there are none; each one is checked.

    Raises:
        InputError: an unknown name.
    """
    for name in names:
        if name not in KINDS:
            raise InputError(f"no entry is called {name}. They are: {', '.join(KINDS)}.")
    return names or list(KINDS)
