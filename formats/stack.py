"""Stack folder: frames, masks, one line of labels per frame, the scene as run, checksums.

    STACK/frames/000000.png …   images
          masks/000000.png …    255 where the wall inside the half-maximum contour is seen
          linear/000000.tiff …  on request: float32 RGB, the radiance behind an image
          metadata.jsonl        one `FrameLabels` a line
          kinematics.csv        what the robot reported, as `read_poses` reads it
          stack.toml            schema, the scene as run, versions
          microscope.json       camera matrix, pinhole height, eye radius, response
          rig.toml              the rig file, which a rig has as well
          manifest.json         size and SHA-256 of every file above

`StackWriter` writes into a folder with another name, which is renamed when the stack is complete.
The next run that describes the same stack uses what a stopped run has left in the other folder.
"""

import html
import io
import json
import math
import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

import cv2
import numpy as np
import tomli_w
from pydantic import ConfigDict, Field, model_validator
from pydantic import Strict as StrictType

from eyespot.formats.image_files import read_image
from eyespot.formats.inputs import (
    InputError,
    Strict,
    check_schema,
    in_file,
    inside,
    object_in,
    read_text,
    read_toml,
    shortened,
    validated,
)
from eyespot.formats.manifest import MANIFEST, differences, read_manifest, write_manifest
from eyespot.formats.rig import RIG, rig_of_scene
from eyespot.formats.tables import lines_of, numbers, read_table
from eyespot.formats.whole_files import (
    STOPPED,
    append_line,
    empty,
    errors_named,
    give_name,
    hidden_beside,
    lock,
    refuse_existing,
    sweep,
    write_text,
    written_whole,
)

SCHEMA = 1
HISTORY = {1: "the format of eyespot 0.1"}
"""What changed with each version of the format that is read, in any of its files."""

KINEMATICS = ("time_s", "x_mm", "y_mm", "z_mm", "axis_x", "axis_y", "axis_z")
"""Columns of kinematics.csv."""

_MAX_LABEL_BYTES = 2**28  # largest metadata.jsonl: 250,000 images
_MAX_LABEL = 1e12  # largest label; times in s since 1970 have ten digits
_AGAIN = "Render the stack again."
_Kind = TypeVar("_Kind")

Vector = Annotated[tuple[float, float, float], StrictType(False)]
"""Three numbers; JSON has a list for the tuple."""

Count = Annotated[int, Field(ge=0, lt=2**63)]
"""A whole number that NumPy and HDF5 can have, too."""


def _about(meaning: str) -> Any:
    return Field(description=meaning)


def _rare(meaning: str) -> Any:
    """A label that only some scenes have; NaN, and not in the file, in the others."""
    return Field(math.nan, description=meaning)


_CONE = "Edge of the geometric cone"
_HALF = "Half of the noise-free, unoccluded direct peak"
_SPREAD_CONE = "In green, where half of a point's spread light comes from inside the cone's edge"
_SPREAD_HALF = "Half of the green peak after the wall has spread the light"
_SHIFT = "Where this colour shows O, against green, px; not for a pinhole."
_REFLEX = "Brightest reflex of the microscope's lamp, px; if the scene shows one."
_VIEW = "Shift of the image by drift and shake, which the ellipses contain, px; if the view moves."
_TURN = "Rotation vector of the eyeball and its wall's picture, degrees; if the view moves."
_BOUND = (
    "Least standard deviation of an unbiased estimate of the half-maximum ellipse in this image "
    "(Cramér-Rao), px; if the scene asks for it."
)


_ELLIPSES = ("cone", "half_max", "spread_cone", "spread_half_max")
_ROUNDING = 1e-6
"""Relative, and in mm: how far two labels of one fact may differ."""
_UNIT_LENGTH_TOLERANCE = 1e-3
"""Of a unit vector's length, as people round it."""
_LARGEST_PX = 1e5
"""Semi-axis of a spot; our largest window has 8,192 px."""
_LARGEST_MM = 1e4
_RIGHT = math.pi / 2 + 1e-9
_LIMITS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("d_mm", "nearest_mm", "c_mm", "surface_mm"), (0.0, _LARGEST_MM)),
    **dict.fromkeys(("exposure_s", "speed_mm_s", "relative_power"), (0.0, _MAX_LABEL)),
    **dict.fromkeys(("visible_fraction", "saturated_fraction"), (0.0, 1.0)),
    **dict.fromkeys(("azimuth_rad", "incidence_azimuth_rad"), (-2 * math.pi, 2 * math.pi)),
    "phi_rad": (0.0, math.pi),
    "incidence_rad": (0.0, _RIGHT),
    **{f"{kind}_semi_major_px": (1e-6, _LARGEST_PX) for kind in _ELLIPSES},
    **{f"{kind}_semi_minor_px": (1e-6, _LARGEST_PX) for kind in _ELLIPSES},
    **{f"{kind}_angle_rad": (-_RIGHT, _RIGHT) for kind in _ELLIPSES},
    **{f"bound_{name}_px": (0.0, _MAX_LABEL) for name in ("x", "y", "semi_major", "semi_minor")},
    "bound_d_mm": (0.0, _MAX_LABEL),
}
"""Least and largest value of labels; others lie within `_MAX_LABEL`."""


class FrameLabels(Strict):
    """True values of one image; lengths mm, angles rad, eye frame; image quantities px.

    Images of several exposures share `frame`. O is where the beam's axis meets the wall, S the tip.
    The four ellipses have a centre, semi-axes, and the angle of the semi-major axis from right
    towards down. What each label means stands beside it.
    """

    model_config = ConfigDict(allow_inf_nan=True)

    file_name: str = _about("Path of the image, from the stack's folder.")
    mask_file_name: str = _about("Path of the mask: 255 where the wall within the spot is seen.")
    frame: Count = _about("Number of the moment within its stack.")
    time_s: float = _about("Middle of the exposure, camera's clock, s; 0 where the motion begins.")
    exposure: str = _about("How the exposure time was chosen: paper (fixed) or metered.")
    exposure_s: float = _about("Exposure time, s.")
    d_mm: float = _about("Distance from the tip to the wall along the beam, |SO|, mm.")
    nearest_mm: float = _about("Distance from the tip to the nearest point of the wall, mm.")
    c_mm: float = _about("Distance of O from the axis of the microscope, mm.")
    azimuth_rad: float = _about("Azimuth of O around the axis of the microscope, rad.")
    phi_rad: float = _about("Angle of O on the eyeball from the axis, rad: sin(phi) = c/r.")
    incidence_rad: float = _about("Angle between the beam and the outward normal of the wall, rad.")
    incidence_azimuth_rad: float = _about("Azimuth of the beam around that normal, rad.")
    tip_mm: Vector = _about("S in the eye frame, in the middle of the exposure, mm.")
    axis: Vector = _about("Unit vector along the beam, from the tip towards the wall.")
    spot_mm: Vector = _about("O in the eye frame, where the beam's axis meets the wall, mm.")
    cone_x_px: float = _about(f"{_CONE}: x of its centre, px.")
    cone_y_px: float = _about(f"{_CONE}: y of its centre, px.")
    cone_semi_major_px: float = _about(f"{_CONE}: semi-major axis, px.")
    cone_semi_minor_px: float = _about(f"{_CONE}: semi-minor axis, px.")
    cone_angle_rad: float = _about(f"{_CONE}: angle, rad.")
    half_max_x_px: float = _about(f"{_HALF}: x of its centre, px.")
    half_max_y_px: float = _about(f"{_HALF}: y of its centre, px.")
    half_max_semi_major_px: float = _about(f"{_HALF}: semi-major axis, px.")
    half_max_semi_minor_px: float = _about(f"{_HALF}: semi-minor axis, px.")
    half_max_angle_rad: float = _about(f"{_HALF}: angle, rad.")
    visible_fraction: float = _about("Part of the half-maximum contour that the camera sees.")
    saturated_fraction: float = _about("Part of the mask's pixels with a channel at full scale.")
    speed_mm_s: float = _about("Speed of the tip in the middle of the exposure, mm/s.")
    medium: str = _about("Medium between tip and wall.")
    seed: Count = _about("Random seed of the scene.")
    spread_cone_x_px: float = _rare(f"{_SPREAD_CONE}: x of its centre, px.")
    spread_cone_y_px: float = _rare(f"{_SPREAD_CONE}: y of its centre, px.")
    spread_cone_semi_major_px: float = _rare(f"{_SPREAD_CONE}: semi-major axis, px.")
    spread_cone_semi_minor_px: float = _rare(f"{_SPREAD_CONE}: semi-minor axis, px.")
    spread_cone_angle_rad: float = _rare(f"{_SPREAD_CONE}: angle, rad.")
    spread_half_max_x_px: float = _rare(f"{_SPREAD_HALF}: x of its centre, px.")
    spread_half_max_y_px: float = _rare(f"{_SPREAD_HALF}: y of its centre, px.")
    spread_half_max_semi_major_px: float = _rare(f"{_SPREAD_HALF}: semi-major axis, px.")
    spread_half_max_semi_minor_px: float = _rare(f"{_SPREAD_HALF}: semi-minor axis, px.")
    spread_half_max_angle_rad: float = _rare(f"{_SPREAD_HALF}: angle, rad.")
    red_shift_x_px: float = _rare(_SHIFT)
    red_shift_y_px: float = _rare(_SHIFT)
    blue_shift_x_px: float = _rare(_SHIFT)
    blue_shift_y_px: float = _rare(_SHIFT)
    reflex_x_px: float = _rare(_REFLEX)
    reflex_y_px: float = _rare(_REFLEX)
    view_x_px: float = _rare(_VIEW)
    view_y_px: float = _rare(_VIEW)
    eye_turn_x_deg: float = _rare(_TURN)
    eye_turn_y_deg: float = _rare(_TURN)
    eye_turn_z_deg: float = _rare(_TURN)
    relative_power: float = _rare("Power of the light source, relative to its mean.")
    surface_mm: float = _rare(
        "Distance from the tip to the surface of the wall's clear layer along the beam, mm."
    )
    bound_x_px: float = _rare(_BOUND)
    bound_y_px: float = _rare(_BOUND)
    bound_semi_major_px: float = _rare(_BOUND)
    bound_semi_minor_px: float = _rare(_BOUND)
    bound_d_mm: float = _rare("The same of the distance from that ellipse, beam known, mm.")

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        """Refuse what no image can have; what is unknown is NaN or infinite."""
        for name, value in self:
            low, high = _LIMITS.get(name, (-_MAX_LABEL, _MAX_LABEL))
            known = isinstance(value, float) and (name == "time_s" or math.isfinite(value))
            if known and not low <= value <= high:
                raise InputError(f"{name} must lie from {low:g} to {high:g}; got {value:g}")
        for kind in _ELLIPSES:
            minor, major = (getattr(self, f"{kind}_semi_{part}_px") for part in ("minor", "major"))
            if minor > major * (1 + _ROUNDING):
                raise InputError(
                    f"{kind}_semi_minor_px must not exceed {kind}_semi_major_px; got {minor:g} and "
                    f"{major:g} px"
                )
        if not abs(math.hypot(*self.axis) - 1) <= _UNIT_LENGTH_TOLERANCE:  # NaN is none, either
            raise InputError(f"axis must be a unit vector; got {list(self.axis)}")
        if self.nearest_mm > self.d_mm * (1 + _ROUNDING) + _ROUNDING:
            raise InputError(
                f"nearest_mm must not exceed d_mm; got {self.nearest_mm:g} and {self.d_mm:g} mm"
            )
        return self

    def row(self) -> dict[str, Any]:
        """The fields of a line, without those that this scene does not have."""
        needed = {name for name, key in FrameLabels.model_fields.items() if key.is_required()}
        return {n: v for n, v in vars(self).items() if n in needed or not math.isnan(v)}


@dataclass(frozen=True)
class Stack:
    """A stack on disk: labels in file order, and the content of stack.toml."""

    folder: Path
    labels: tuple[FrameLabels, ...]
    description: dict[str, Any]

    def __repr__(self) -> str:
        return f"<Stack {self.folder}: {len(self.labels)} images>"

    def _repr_html_(self) -> str:
        """The first labels, for notebooks."""
        import pandas as pd

        columns = ["file_name", "exposure", "d_mm", "c_mm"]
        rows = [[getattr(row, name) for name in columns] for row in self.labels[:5]]
        table = pd.DataFrame(rows, columns=columns).to_html(index=False)
        return f"<p>{html.escape(f'{self}'.strip('<>'))}; the first {len(rows)}:</p>{table}"

    def exposed(self, exposure: str) -> tuple[FrameLabels, ...]:
        """Labels of the images with one kind of exposure."""
        return tuple(labels for labels in self.labels if labels.exposure == exposure)

    def image(self, labels: FrameLabels) -> np.ndarray:
        """The image (RGB) that the labels describe."""
        return self._read(labels.file_name)

    def linear(self, labels: FrameLabels) -> np.ndarray:
        """Noise-free radiance (RGB, float32, mW/(mm2 sr)) behind an image.

        Raises:
            InputError: the stack was rendered without `keep_linear`.
        """
        name = linear_name(labels)
        if not self.path_of(name).is_file():
            raise InputError(
                f"{self.folder / name} is missing. Render the stack with exposures.keep_linear = "
                "true."
            )
        return self._read(name)

    def mask(self, labels: FrameLabels) -> np.ndarray:
        """Mask of the visible spot, 0 or 255."""
        return self._read(labels.mask_file_name)

    def kinematics(self) -> dict[str, np.ndarray]:
        """What the robot reported: the columns of kinematics.csv by name, as they are written.

        Raises:
            InputError: the file is no such table, or has more than finite numbers.
            OSError: the file is missing or cannot be read.
        """
        path = self.path_of("kinematics.csv")
        table, place = read_table(path), lines_of(path)
        if tuple(table.columns) != KINEMATICS:
            raise InputError(
                f"{path}, line 1: its columns must be {', '.join(KINEMATICS)}; got "
                f"{shortened(list(table.columns))}. {_AGAIN}"
            )
        return {name: numbers(table[name], place) for name in KINEMATICS}

    def path_of(self, name: str) -> Path:
        """Path of a file that the labels or the manifest name.

        Raises:
            InputError: the name leads out of the folder, see `inside`.
        """
        with in_file(self.folder):
            return inside(self.folder, name)

    def described(self, key: str, kind: type[_Kind]) -> _Kind:
        """A value of stack.toml.

        Args:
            key: with its tables, such as "scene.phantom.kind".
            kind: of the value; a whole number counts as a float.

        Raises:
            InputError: it is missing or of another kind.
        """
        found: Any = self.description
        for part in key.split("."):
            found = found.get(part) if isinstance(found, dict) else None
        if kind is float and type(found) is int:
            found = float(found)
        if type(found) is not kind or (isinstance(found, float) and not math.isfinite(found)):
            raise InputError(
                f"{self.folder / 'stack.toml'}: {key} must be a finite {kind.__name__}; got "
                f"{shortened(found)}. {_AGAIN}"
            )
        return found

    def _read(self, name: str) -> np.ndarray:
        path = self.path_of(name)
        try:
            return read_image(path).image
        except FileNotFoundError as error:
            raise InputError(f"{path} is missing. {_AGAIN}") from error
        except InputError as error:
            raise InputError(f"{path} {error}. {_AGAIN}") from error

    def images(self, exposure: str) -> Iterator[np.ndarray]:
        """Images (RGB) of one kind of exposure, in order."""
        return (self.image(labels) for labels in self.exposed(exposure))

    def verify(self) -> None:
        """Compare the folder with its manifest.

        Raises:
            InputError: naming the first file that is missing, changed or unexpected.
        """
        try:
            listed = read_manifest(self.folder, remedy=_AGAIN)
        except FileNotFoundError as error:
            raise InputError(f"{self.folder / MANIFEST} is missing.") from error
        for difference in differences(self.folder, listed):
            raise InputError(f"{self.folder / difference}.")


def read_stack(folder: str | Path) -> Stack:
    """Open a stack and read its labels; images are read later, one by one.

    Raises:
        InputError: the folder is not a stack, has another schema, a label line is broken, or labels
            and frames do not match; the message names the file and the line.
    """
    folder = Path(folder)
    try:
        with in_file(folder):
            for name in ("stack.toml", "metadata.jsonl", "microscope.json", "kinematics.csv"):
                inside(folder, name)
        with in_file(folder / "stack.toml"):
            description = read_toml(folder / "stack.toml")
            check_schema(description.get("schema"), HISTORY, remedy=_AGAIN)
        with in_file(folder / "metadata.jsonl"):
            text = read_text(folder / "metadata.jsonl", most_bytes=_MAX_LABEL_BYTES)
    except FileNotFoundError as error:
        raise InputError(
            f"{folder} is not a stack: {Path(error.filename).name} is missing."
        ) from error
    lines = text.removesuffix("\n").split("\n") if text else []
    frames = {f"frames/{path.name}" for path in (folder / "frames").glob("*.png")}
    found: dict[str, FrameLabels] = {}
    moments: set[tuple[int, str]] = set()
    for number, line in enumerate(lines, 1):
        with in_file(f"{folder / 'metadata.jsonl'}, line {number}"):
            row = validated(FrameLabels, object_in(line), remedy=_AGAIN)
            for name in (row.file_name, row.mask_file_name):
                inside(folder, name)
            if row.mask_file_name in frames:
                raise InputError(f"{row.mask_file_name} is a frame, not a mask. {_AGAIN}")
            if row.file_name in found:
                raise InputError(f"{row.file_name} has a line already.")
            moment = row.frame, row.exposure
            if moment in moments:
                raise InputError(
                    f"frame {row.frame} has another line with exposure {shortened(row.exposure)}. "
                    f"{_AGAIN}"
                )
            moments.add(moment)
            if row.file_name not in frames:
                raise InputError(f"{folder / row.file_name} is missing.")
            found[row.file_name] = row
    if unlabelled := sorted(frames - found.keys()):
        raise InputError(
            f"{folder / unlabelled[0]} has no line in metadata.jsonl, which ends after line "
            f"{len(found)}. {_AGAIN}"
        )
    return Stack(folder, tuple(found.values()), description)


def linear_name(labels: FrameLabels) -> str:
    """Name of the kept radiance behind an image."""
    return f"linear/{Path(labels.file_name).stem}.tiff"


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
        touch: tuple[float, float] | None = None,
    ) -> None:
        """Write stack.toml, microscope.json, rig.toml and kinematics.csv; keep their frames.

        Args:
            stack: everything that determines images and labels: the scene, versions.
            kinematics: n x 7, time (s), tip (mm) and axis that the robot reported.
            touch: first distance and its standard uncertainty, as the rig file states them, mm.
        """
        texts = {
            "stack.toml": tomli_w.dumps({"schema": SCHEMA, **stack}),
            "microscope.json": json.dumps({"schema": SCHEMA, **microscope}, indent=1) + "\n",
        }
        if "scene" in stack:
            texts[RIG] = tomli_w.dumps(rig_of_scene(stack["scene"], touch=touch))
        if kinematics is not None:
            # To 1 us, 1 nm and 1 nrad: far below a robot's accuracy.
            rows, formats = io.StringIO(), ["%.6f"] * 4 + ["%.9f"] * 3
            header = ",".join(KINEMATICS)
            np.savetxt(rows, kinematics, fmt=formats, delimiter=",", header=header, comments="")
            texts["kinematics.csv"] = rows.getvalue()
        with errors_named(self._partial, self.folder):
            there = ((self._partial / name, text.encode()) for name, text in texts.items())
            if not all(path.is_file() and path.read_bytes() == text for path, text in there):
                empty(self._partial)
                for name, text in texts.items():
                    write_text(self._partial / name, text, replace=True)
            for folder in (self._partial, *(self._partial / name for name in _IMAGES)):
                sweep(folder)
            path = self._partial / _LABELS
            lines = path.read_text().splitlines(keepends=True) if path.exists() else []
            # A line that was not finished has no end.
            whole = [line for line in lines if line.endswith("\n")]
            self._lines = {json.loads(line)["file_name"]: line for line in whole}
            self._described = True
            write_text(path, "".join(self._lines.values()), replace=True)

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
            line = json.dumps(labels.row()) + "\n"
            with self._one_at_a_time:
                with (self._partial / _LABELS).open("ab", buffering=0) as file:
                    append_line(file, line)
                self._lines[labels.file_name] = line

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> None:
        try:
            if kind is None:
                with errors_named(self._partial, self.folder):
                    lines = [self._lines[name] for name in sorted(self._lines)]
                    write_text(self._partial / _LABELS, "".join(lines), replace=True)
                    write_manifest(self._partial, schema=SCHEMA)
                    give_name(self._partial, self.folder)
            elif self._described and not self._lines:
                shutil.rmtree(self._partial)
            else:  # frames of a stopped run, or nothing at all
                with suppress(OSError):
                    self._partial.rmdir()
        finally:
            os.close(self._lock)


def _write_image(path: Path, image: np.ndarray, options: list[int]) -> None:
    ordered = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    # OpenCV does not say why it cannot write a file.
    _, encoded = cv2.imencode(path.suffix, ordered, options)
    path.parent.mkdir(exist_ok=True)
    with written_whole(path, replace=True) as partial:
        partial.write_bytes(encoded.tobytes())
