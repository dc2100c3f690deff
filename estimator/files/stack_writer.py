"""Writes a stack folder frame by frame, so that a stopped run can continue.

A stack is written into a folder with another name and renamed when it is complete. The next run
that describes the same stack uses what a stopped run has left in the other folder.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import tomli_w

from estimator.files.manifest import write_manifest
from estimator.files.stack import KINEMATICS, SCHEMA, FrameLabels, linear_name
from estimator.files.whole_files import (
    STOPPED,
    empty,
    errors_named,
    give_name,
    hidden_beside,
    lock,
    refuse_existing,
    sweep,
    written_whole,
)
from optics import InputError

# Camera noise has no repeated strings: entropy coding alone makes smaller files than zlib's default
# strategy, in half of the time. A mask consists of repeated strings.
_PNG = [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB]
_PNG += [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY]
_MASK = [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
_MASK += [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
_TIFF = [cv2.IMWRITE_TIFF_COMPRESSION, 1]  # none: noise-free floats hardly compress
_LABELS = "metadata.jsonl"
_IMAGES = ("frames", "masks", "linear")


class StackWriter:
    """Writes a stack; at the end of a `with` block without an error it is complete and renamed.

    After an error, or if the process ends at any moment, the frames that are complete remain. The
    next writer of that folder keeps them if its description is the same, and else starts again.

    Args:
        folder: name of the finished stack; must not exist yet.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self._partial = hidden_beside(self.folder, STOPPED)
        self._lines: dict[str, str] = {}
        self._described = False
        self._one_at_a_time = threading.Lock()

    def __enter__(self) -> Self:
        """Lock the folder.

        Raises:
            InputError: the stack exists.
            BeingWrittenError: another process is writing it.
            OSError: the folder cannot be written.
        """
        refuse_existing(self.folder)
        self.folder.parent.mkdir(parents=True, exist_ok=True)
        self._lock = lock(self._partial, of=self.folder)
        try:
            refuse_existing(self.folder)  # another process may just have finished it
        except InputError:
            os.close(self._lock)
            raise
        return self

    @property
    def has_begun(self) -> bool:
        """Whether another run writes the stack, or was stopped while it did."""
        return self._partial.is_dir()

    def describe(
        self,
        *,
        stack: dict[str, Any],
        microscope: dict[str, Any],
        kinematics: np.ndarray | None = None,
    ) -> None:
        """Write stack.toml, microscope.json and kinematics.csv; keep frames that belong to them.

        Args:
            stack: everything that determines images and labels: the scene, versions.
            microscope: the camera.
            kinematics: n x 7, time (s), tip (mm) and axis that the robot reported.
        """
        texts = {
            "stack.toml": tomli_w.dumps({"schema": SCHEMA, **stack}),
            "microscope.json": json.dumps({"schema": SCHEMA, **microscope}, indent=1) + "\n",
        }
        if kinematics is not None:
            texts["kinematics.csv"] = _kinematics_csv(kinematics)
        with errors_named(self._partial, self.folder):
            if not all(_holds(self._partial / name, text) for name, text in texts.items()):
                empty(self._partial)
                for name, text in texts.items():
                    _write_text(self._partial / name, text)
            for folder in (self._partial, *(self._partial / name for name in _IMAGES)):
                sweep(folder)
            self._lines = self._lines_left()
            self._described = True
            _write_text(self._partial / _LABELS, "".join(self._lines.values()))

    def has(self, file_name: str) -> bool:
        """Whether a stopped run has written an image, its mask and its labels."""
        return file_name in self._lines

    def add(
        self,
        image: np.ndarray,
        labels: FrameLabels,
        mask: np.ndarray | None,
        linear: np.ndarray | None = None,
    ) -> None:
        """Write one image (RGB or grey), its labels, and its mask unless another image shares it.

        Images may be added in any order and from several threads; labels are sorted by name.

        Args:
            image: 8 or 16 bits.
            labels: its true values.
            mask: 0 or 255.
            linear: radiance behind the image, to be kept with it.
        """
        with errors_named(self._partial, self.folder):
            if mask is not None:
                _write_image(self._partial / labels.mask_file_name, mask, _MASK)
            if linear is not None:
                light = linear.astype(np.float32)
                _write_image(self._partial / linear_name(labels), light, _TIFF)
            _write_image(self._partial / labels.file_name, image, _PNG)
            # Last, because a line means that the files it names are complete.
            self._add_line(labels)

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> None:
        try:
            if kind is None:
                with errors_named(self._partial, self.folder):
                    self._finish()
            elif self._described and not self._lines:
                shutil.rmtree(self._partial)
            else:  # frames of a stopped run, or nothing at all
                with suppress(OSError):
                    self._partial.rmdir()
        finally:
            os.close(self._lock)

    def _add_line(self, labels: FrameLabels) -> None:
        line = json.dumps(labels.row()) + "\n"
        path = self._partial / _LABELS
        with self._one_at_a_time:
            before = path.stat().st_size
            try:
                with path.open("a", encoding="utf-8") as file:
                    file.write(line)
            except OSError:
                os.truncate(path, before)  # the next line would end a half one
                raise
            self._lines[labels.file_name] = line

    def _finish(self) -> None:
        lines = [self._lines[name] for name in sorted(self._lines)]
        _write_text(self._partial / _LABELS, "".join(lines))
        write_manifest(self._partial, schema=SCHEMA)
        give_name(self._partial, self.folder)

    def _lines_left(self) -> dict[str, str]:
        """Label lines of the images that a stopped run has finished, by the image's name."""
        path = self._partial / _LABELS
        lines = path.read_text().splitlines(keepends=True) if path.exists() else []
        # A line that was not finished has no end.
        whole = [line for line in lines if line.endswith("\n")]
        return {json.loads(line)["file_name"]: line for line in whole}


def _kinematics_csv(rows: np.ndarray) -> str:
    """To 1 us, 1 nm and 1 nrad: far below a robot's accuracy."""
    text = io.StringIO()
    formats, header = ["%.6f"] * 4 + ["%.9f"] * 3, ",".join(KINEMATICS)
    np.savetxt(text, rows, fmt=formats, delimiter=",", header=header, comments="")
    return text.getvalue()


def _write_image(path: Path, image: np.ndarray, options: list[int]) -> None:
    ordered = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    # OpenCV does not say why it cannot write a file.
    _, encoded = cv2.imencode(path.suffix, ordered, options)
    path.parent.mkdir(exist_ok=True)
    with written_whole(path, replace=True) as partial:
        partial.write_bytes(encoded.tobytes())


def _write_text(path: Path, text: str) -> None:
    with written_whole(path, replace=True) as partial:
        partial.write_text(text, encoding="utf-8")


def _holds(path: Path, text: str) -> bool:
    return path.is_file() and path.read_bytes() == text.encode()
