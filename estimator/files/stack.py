"""Stack folder: frames, masks, one line of labels a frame, the scene as run, checksums.

    STACK/frames/000000.png …   images
          masks/000000.png …    255 where the wall inside the half-maximum contour is seen
          linear/000000.tiff …  on request: float32 RGB, the radiance behind an image
          metadata.jsonl        one `FrameLabels` a line
          kinematics.csv        what the robot reported, as `read_poses` reads it
          stack.toml            schema, the scene as run, versions
          microscope.json       camera matrix, pinhole height, eye radius, response
          manifest.json         size and SHA-256 of every file above

`stack_writer` writes one.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import cv2
import numpy as np
from pydantic import ConfigDict, create_model
from pydantic import Strict as StrictType

from estimator.files.json_files import Strict, object_in, validated
from estimator.files.manifest import MANIFEST, Fingerprint, differences, read_manifest
from optics import InputError

SCHEMA = 1
_PNG_END = b"IEND\xaeB`\x82"  # the last chunk's name and checksum

Vector = Annotated[tuple[float, float, float], StrictType(False)]
"""Three numbers; JSON has a list for the tuple."""


class StackError(InputError):
    """A folder is not a stack, or not one that this version reads; the text says which file."""


@dataclass(frozen=True, kw_only=True)
class FrameLabels:
    """True values of one image; lengths mm, angles rad, eye frame; image quantities px.

    Attributes:
        frame: index of the moment; images of several exposures share it.
        time_s: middle of the exposure, on the camera's clock; 0 where the motion begins.
        exposure: "paper" or "metered".
        d_mm: |SO|, tip to wall along the beam's axis.
        nearest_mm: tip to the nearest wall point.
        c_mm, azimuth_rad, phi_rad: of O; sin(phi) = c/r.
        incidence_rad, incidence_azimuth_rad: of the beam at O.
        cone_*: ellipse of the geometric cone's edge.
        half_max_*: ellipse of half of the noise-free, unoccluded direct peak.
        visible_fraction: part of the half-maximum contour that the camera sees.
        speed_mm_s: of the tip in the middle of the exposure.
        saturated_fraction: part of the mask's pixels with a channel at full scale.
    """

    file_name: str
    mask_file_name: str
    frame: int
    time_s: float
    exposure: str
    exposure_s: float
    d_mm: float
    nearest_mm: float
    c_mm: float
    azimuth_rad: float
    phi_rad: float
    incidence_rad: float
    incidence_azimuth_rad: float
    tip_mm: Vector
    axis: Vector
    spot_mm: Vector
    cone_x_px: float
    cone_y_px: float
    cone_semi_major_px: float
    cone_semi_minor_px: float
    cone_angle_rad: float
    half_max_x_px: float
    half_max_y_px: float
    half_max_semi_major_px: float
    half_max_semi_minor_px: float
    half_max_angle_rad: float
    visible_fraction: float
    saturated_fraction: float
    speed_mm_s: float
    medium: str
    seed: int


@dataclass(frozen=True)
class Stack:
    """A stack on disk.

    Attributes:
        folder: where it lies.
        labels: one entry an image, in file order.
        description: content of stack.toml.
    """

    folder: Path
    labels: tuple[FrameLabels, ...]
    description: dict[str, Any]

    def exposed(self, exposure: str) -> tuple[FrameLabels, ...]:
        """Labels of the images with one kind of exposure."""
        return tuple(labels for labels in self.labels if labels.exposure == exposure)

    def image(self, labels: FrameLabels) -> np.ndarray:
        """The image (RGB) that the labels describe."""
        return _read_image(self.folder / labels.file_name)

    def linear(self, labels: FrameLabels) -> np.ndarray:
        """Noise-free radiance (RGB, float32, mW/(mm2 sr)) behind an image.

        Raises:
            StackError: the stack was rendered without `keep_linear`.
        """
        path = self.folder / linear_name(labels)
        if not path.is_file():
            raise StackError(
                f"{path} is missing. Render the stack with exposures.keep_linear = true."
            )
        return _read_image(path)

    def mask(self, labels: FrameLabels) -> np.ndarray:
        """Mask of the visible spot, 0 or 255."""
        return _read_image(self.folder / labels.mask_file_name)

    def images(self, exposure: str) -> Iterator[np.ndarray]:
        """Images (RGB) of one kind of exposure, in order."""
        return (self.image(labels) for labels in self.exposed(exposure))

    def verify(self) -> None:
        """Compare the folder with its manifest.

        Raises:
            StackError: naming the first file that is missing, changed or unexpected.
        """
        for difference in differences(self.folder, self._manifest()):
            raise StackError(f"{self.folder / difference}.")

    def _manifest(self) -> dict[str, Fingerprint]:
        try:
            return read_manifest(self.folder, remedy="Render the stack again.")
        except FileNotFoundError as error:
            raise StackError(f"{self.folder / MANIFEST} is missing.") from error
        except InputError as error:
            raise StackError(f"{error}") from error


class _AnyRow(Strict):
    model_config = ConfigDict(allow_inf_nan=True)


_COLUMNS: dict[str, Any] = {
    name: (kind, ...) for name, kind in get_type_hints(FrameLabels, include_extras=True).items()
}
_Row = create_model("_Row", __base__=_AnyRow, **_COLUMNS)
"""A line of metadata.jsonl: the fields of `FrameLabels`."""


def read_stack(folder: Path) -> Stack:
    """Open a stack and read its labels; images are read later, one by one.

    Raises:
        StackError: the folder is not a stack, has another schema, a label line is broken, or labels
            and frames do not match; the message names the file and the line.
    """
    folder = Path(folder)
    try:
        description = tomllib.loads((folder / "stack.toml").read_text())
        lines = (folder / "metadata.jsonl").read_text(encoding="utf-8").splitlines()
    except FileNotFoundError as error:
        raise StackError(
            f"{folder} is not a stack: {Path(error.filename).name} is missing."
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise StackError(f"{folder / 'stack.toml'}: not a TOML file: {error}.") from error
    if description.get("schema") != SCHEMA:
        raise StackError(
            f"{folder / 'stack.toml'} has schema {description.get('schema')}; this version reads "
            f"{SCHEMA}. Render the stack again."
        )
    labels = tuple(_parse(folder, n, line) for n, line in enumerate(lines, 1))
    _match(folder, labels)
    return Stack(folder, labels, description)


def _parse(folder: Path, number: int, line: str) -> FrameLabels:
    try:
        row = validated(_Row, object_in(line), remedy="Render the stack again.")
    except InputError as error:
        raise StackError(f"{folder / 'metadata.jsonl'}, line {number}: {error}") from error
    return FrameLabels(**vars(row))


def _match(folder: Path, labels: tuple[FrameLabels, ...]) -> None:
    """Every line has its frame, every frame its line."""
    frames = {f"frames/{path.name}" for path in (folder / "frames").glob("*.png")}
    seen: set[str] = set()
    for number, row in enumerate(labels, 1):
        where = f"{folder / 'metadata.jsonl'}, line {number}"
        if row.file_name in seen:
            raise StackError(f"{where}: {row.file_name} has a line already.")
        if row.file_name not in frames:
            raise StackError(f"{where}: {folder / row.file_name} is missing.")
        seen.add(row.file_name)
    if unlabelled := sorted(frames - seen):
        raise StackError(
            f"{folder / unlabelled[0]} has no line in metadata.jsonl, which ends after line "
            f"{len(labels)}. Render the stack again."
        )


def linear_name(labels: FrameLabels) -> str:
    """Name of the kept radiance behind an image."""
    return f"linear/{Path(labels.file_name).stem}.tiff"


def _read_image(path: Path) -> np.ndarray:
    # OpenCV decodes what there is of a truncated PNG, and says nothing.
    cut = path.suffix == ".png" and path.is_file() and not path.read_bytes().endswith(_PNG_END)
    image = None if cut else cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise StackError(f"{path} is {'truncated' if cut else 'missing or no readable image'}.")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if image.ndim == 3 else image
