"""A recording of a drawn spot that wanders and grows, and what is measured in it."""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from eyespot.estimator import Reader, SubpixelMode, SubpixelSettings
from eyespot.estimator.run.offline import Tracking, track_source
from eyespot.estimator.sources.source import Source
from eyespot.formats.spot import NoSpot, Spot
from eyespot.formats.spots import SpotRecord
from eyespot.formats.stack import StackWriter
from eyespot.scenes.drawn import Drawing, Truth, frame_of
from tests.support.drawn.drawn_sets import labels_of

SHAPE = (160, 200)
GONE = 4  # the frame without a spot


def truth(k: int) -> Truth:
    return Truth(x=70.3 + 6 * k, y=80, semi_major=33 + k, semi_minor=30 + k, angle=0.3)


@functools.cache
def recorded(count: int) -> list[np.ndarray]:
    """The first frames, RGB."""
    rng = np.random.default_rng(0)
    scenes = [Drawing(truth=truth(k), amplitude=0.0 if k == GONE else 180.0) for k in range(count)]
    return [frame_of(scene, rng, SHAPE) for scene in scenes]


def opencv_order(image: np.ndarray) -> np.ndarray:
    return image[:, :, ::-1] if image.ndim == 3 else image


def write_folder(folder: Path, images: Sequence[np.ndarray], name: str = "frame{}.png") -> Path:
    folder.mkdir()
    for k, image in enumerate(images):
        assert cv2.imwrite(str(folder / name.format(k)), opencv_order(image))
    return folder


def write_video(
    path: Path, images: list[np.ndarray], codec: str = "FFV1", hz: float = 25.0
) -> Path:
    size = images[0].shape[1], images[0].shape[0]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), hz, size)
    assert writer.isOpened()
    for image in images:
        writer.write(np.ascontiguousarray(opencv_order(image)))
    writer.release()
    return path


def write_stack(
    folder: Path, images: list[np.ndarray], exposures: Sequence[str], **microscope: Any
) -> Path:
    """A stack whose labels say nothing true of its images but their time."""
    with StackWriter(folder) as writer:
        writer.describe(stack={}, microscope=microscope)
        for k, image in enumerate(images):
            for exposure in exposures:
                dimmed = image // 2 if exposure == "paper" else image
                name = f"frames/{exposure}{k:06d}.png"
                about = {"file_name": name, "time_s": k / 25, "exposure": exposure}
                writer.add(dimmed, labels_of(k, **about), None)
    return folder


def new_reader(**options: object) -> Reader:
    return SubpixelMode(SubpixelSettings(), None, **options)


def tracked(source: Source) -> Tracking:
    return track_source(source, new_reader())


def assert_same(
    found: Sequence[SpotRecord | Spot | NoSpot], expected: Sequence[Spot | NoSpot]
) -> None:
    """Every digit; a file has the covariance's upper triangle."""
    for one, other in zip(found, expected, strict=True):
        result = one.result if isinstance(one, SpotRecord) else one
        if isinstance(other, Spot):
            assert isinstance(result, Spot)
            mine, its = (vars(s) | {"covariance": np.triu(s.covariance)} for s in (result, other))
            np.testing.assert_equal(mine, its)
        else:
            assert result == other
