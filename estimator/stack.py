"""Stack folder: frames, masks, one line of labels a frame, the scene as run, checksums.

    STACK/frames/000000.png …   images
          masks/000000.png …    255 where the wall inside the half-maximum contour is seen
          metadata.jsonl        one `FrameLabels` a line
          stack.toml            schema, the scene as run, versions
          microscope.json       camera matrix, pinhole height, eye radius, response
          manifest.json         size and SHA-256 of every file above

A stack is written into a folder with another name and renamed when it is whole: a folder that
bears the stack's name is complete.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tomllib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import tomli_w

SCHEMA = 1
# Level 1 costs 12 ms a frame against 41 ms at level 6; camera noise hardly compresses anyway.
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


class StackError(ValueError):
    """A folder is not a stack, or not one that this version reads; the text says which file."""


@dataclass(frozen=True, kw_only=True)
class FrameLabels:
    """Truth of one image; lengths mm, angles rad, eye frame; image quantities px of the window.

    Attributes:
        frame: index of the moment; images of several exposures share it.
        time_s: since the first frame.
        exposure: "paper" or "metered".
        d_mm: |SO|, tip to wall along the beam's axis.
        nearest_mm: tip to the nearest wall point.
        c_mm, azimuth_rad, phi_rad: of O; sin(phi) = c/r.
        incidence_rad, incidence_azimuth_rad: of the beam at O.
        cone_*: ellipse of the geometric cone's edge.
        half_max_*: ellipse of half of the noise-free, unoccluded direct peak.
        visible_fraction: part of the half-maximum contour that the camera sees.
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
    tip_mm: tuple[float, float, float]
    axis: tuple[float, float, float]
    spot_mm: tuple[float, float, float]
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


class StackWriter:
    """Writes a stack; leaving the `with` block without an error makes it whole and gives its name.

    Args:
        folder: name of the finished stack; must not exist yet.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self._partial = self.folder.with_name(f".{self.folder.name}.partial")
        self._labels: dict[str, FrameLabels] = {}

    def __enter__(self) -> Self:
        if self.folder.exists():
            raise StackError(f"{self.folder} exists already. Choose another folder or remove it.")
        shutil.rmtree(self._partial, ignore_errors=True)
        (self._partial / "frames").mkdir(parents=True)
        (self._partial / "masks").mkdir()
        return self

    def add(self, image: np.ndarray, labels: FrameLabels, mask: np.ndarray | None) -> None:
        """Write one image (RGB or grey), its labels, and its mask unless another image has.

        Images may be added in any order and from several threads; labels are sorted by name.
        """
        _write_png(self._partial / labels.file_name, image)
        if mask is not None:
            _write_png(self._partial / labels.mask_file_name, mask)
        self._labels[labels.file_name] = labels

    def describe(self, *, stack: dict[str, Any], microscope: dict[str, Any]) -> None:
        """Write stack.toml and microscope.json."""
        with (self._partial / "stack.toml").open("wb") as file:
            tomli_w.dump({"schema": SCHEMA, **stack}, file)
        (self._partial / "microscope.json").write_text(
            json.dumps({"schema": SCHEMA, **microscope}, indent=1) + "\n"
        )

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> None:
        if kind is not None:
            shutil.rmtree(self._partial, ignore_errors=True)
            return
        rows = [json.dumps(asdict(self._labels[name])) for name in sorted(self._labels)]
        (self._partial / "metadata.jsonl").write_text("\n".join(rows) + "\n")
        files = sorted(path for path in self._partial.rglob("*") if path.is_file())
        manifest = {str(path.relative_to(self._partial)): _fingerprint(path) for path in files}
        (self._partial / "manifest.json").write_text(
            json.dumps({"schema": SCHEMA, "files": manifest}, indent=1) + "\n"
        )
        self._partial.rename(self.folder)


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
        return _read_png(self.folder / labels.file_name)

    def mask(self, labels: FrameLabels) -> np.ndarray:
        """Mask of the visible spot, 0 or 255."""
        return _read_png(self.folder / labels.mask_file_name)

    def images(self, exposure: str) -> Iterator[np.ndarray]:
        """Images (RGB) of one kind of exposure, in order."""
        return (self.image(labels) for labels in self.exposed(exposure))

    def verify(self) -> None:
        """Compare every file with the manifest.

        Raises:
            StackError: naming the first file that is missing or differs.
        """
        for name, expected in _read_json(self.folder / "manifest.json")["files"].items():
            path = self.folder / name
            if not path.is_file():
                raise StackError(f"{path} is missing, though manifest.json lists it.")
            if _fingerprint(path) != expected:
                raise StackError(f"{path} differs from its checksum in manifest.json.")


def read_stack(folder: Path) -> Stack:
    """Open a stack and its labels (images are read when asked for).

    Raises:
        StackError: the folder is no stack, has another schema, or a label line is broken.
    """
    folder = Path(folder)
    try:
        description = tomllib.loads((folder / "stack.toml").read_text())
        lines = (folder / "metadata.jsonl").read_text().splitlines()
    except FileNotFoundError as error:
        raise StackError(
            f"{folder} is not a stack: {Path(error.filename).name} is missing."
        ) from error
    if description.get("schema") != SCHEMA:
        raise StackError(
            f"{folder / 'stack.toml'} has schema {description.get('schema')}; this version reads "
            f"{SCHEMA}. Render the stack again."
        )
    return Stack(
        folder, tuple(_parse(folder, n, line) for n, line in enumerate(lines, 1)), description
    )


def _parse(folder: Path, number: int, line: str) -> FrameLabels:
    where = f"{folder / 'metadata.jsonl'}, line {number}"
    try:
        row = json.loads(line)
    except json.JSONDecodeError as error:
        raise StackError(f"{where}: not JSON ({error.msg}).") from error
    names = {field.name for field in fields(FrameLabels)}
    if set(row) != names:
        wrong = ", ".join(sorted(names.symmetric_difference(row)))
        raise StackError(f"{where}: missing or unknown columns: {wrong}.")
    vectors = {name: tuple(row[name]) for name in ("tip_mm", "axis", "spot_mm")}
    return FrameLabels(**{**row, **vectors})


def _write_png(path: Path, image: np.ndarray) -> None:
    ordered = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    if not cv2.imwrite(str(path), ordered, _PNG):
        raise OSError(f"{path} could not be written. Check space and permissions.")


def _read_png(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise StackError(f"{path} is missing or not a readable image.")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if image.ndim == 3 else image


def _read_json(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError as error:
        raise StackError(f"{path} is missing.") from error
    except json.JSONDecodeError as error:
        raise StackError(f"{path}: not JSON ({error.msg}).") from error


def _fingerprint(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    return {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
