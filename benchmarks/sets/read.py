"""A set and its stacks, from set.json."""

import functools
import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field

from eyespot.estimator import (
    LiteralMode,
    LiteralSettings,
    PixelsMode,
    Ranger,
    Reader,
    SubpixelMode,
    SubpixelSettings,
)
from eyespot.estimator.run.reader import best_mode
from eyespot.formats.calibration import Calibration
from eyespot.formats.inputs import (
    FOLDER_NAME,
    InputError,
    Strict,
    check_schema,
    in_file,
    in_utf8,
    inside,
    object_in,
    read_text,
    validated,
)
from eyespot.formats.manifest import (
    MANIFEST,
    changes,
    differences,
    fingerprint,
    read_manifest,
    write_manifest,
)
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.spot import Spot
from eyespot.formats.stack import FrameLabels, Stack, read_stack

SCHEMA = 1
HISTORY = {1: "the format of eyespot 0.1"}
_AGAIN = "Run `eyespot dataset` with its spec and this folder again."


@dataclass(frozen=True, kw_only=True)
class SetStack:
    """A stack of a set: what set.json says of it, and its folder."""

    split: str
    name: str
    condition: str | None
    parameters: dict[str, Any]
    folder: Path
    pair: str | None = None

    @property
    def qualified_name(self) -> str:
        """SPLIT/STACK, or STACK for a single stack."""
        return f"{self.split}/{self.name}" if self.split else self.name

    @property
    def split_name(self) -> str:
        """Name for the files of a split: SPLIT, or STACK for a single stack."""
        return self.split or self.name

    def image_name(self, file_name: str) -> str:
        """Path of an image from the set (SPLIT/STACK/frames/000000.png), or from a single stack."""
        return f"{self.qualified_name}/{file_name}" if self.split else file_name

    def open(self) -> Stack:
        """Open the stack, for its labels and images."""
        return read_stack(self.folder)


@dataclass(frozen=True, kw_only=True)
class LabelledSet:
    """A set on disk, with all its stacks in order, also those not rendered yet."""

    folder: Path
    name: str
    licence: str
    stacks: tuple[SetStack, ...]
    description: dict[str, Any]

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that have stacks, in order."""
        return tuple(dict.fromkeys(stack.split for stack in self.stacks))

    @property
    def missing(self) -> list[SetStack]:
        """Stacks that have not been rendered yet."""
        return [stack for stack in self.stacks if not stack.folder.is_dir()]


class _StackRow(Strict):
    split: Literal["train", "validation", "test", "adverse", "unseen"] = Field(
        description="One of the splits."
    )
    name: Annotated[str, Field(pattern=FOLDER_NAME)] = Field(description="Of the stack's folder.")
    condition: Annotated[str, Field(pattern=FOLDER_NAME)] | None = Field(
        description="Of an adverse stack; null otherwise."
    )
    pair: Annotated[str, Field(pattern=FOLDER_NAME)] | None = Field(
        None, description="What distinguishes the stack from its partner."
    )
    parameters: dict[str, Any] = Field(description="What was drawn for the stack, by scene key.")


class _SetFile(Strict):
    model_config = ConfigDict(extra="ignore")  # what describes the set as a whole

    schema_: Annotated[int, Field(alias="schema")]
    name: str = Field(description="Of the set.")
    licence: str = Field(description="Of images and labels (SPDX name).")
    stacks: list[_StackRow] = Field(description="The stacks of the set.")


def read_set(folder: str | Path) -> LabelledSet:
    """Open a set, complete or not (`verify_set` checks that); InputError if the folder is none."""
    folder = Path(folder)
    with in_file(folder / "set.json"):
        try:
            content = object_in(read_text(folder / "set.json"))
        except FileNotFoundError as error:
            raise InputError(f"{folder} is not a labelled set: set.json is missing.") from error
        check_schema(content.get("schema"), HISTORY, remedy=_AGAIN)
        file = validated(_SetFile, content, remedy=_AGAIN)
        stacks = tuple(
            SetStack(**vars(row), folder=inside(folder, f"{row.split}/{row.name}"))
            for row in file.stacks
        )
        if len({stack.folder for stack in stacks}) < len(stacks):
            raise InputError(f"two stacks have the same name. {_AGAIN}")
    return LabelledSet(
        folder=folder,
        name=file.name,
        licence=file.licence,
        stacks=stacks,
        description=content,
    )


# The stacks of a set, or a single stack: names, images, true beams, and our readers for them.

_DESCRIPTION = ("stack.toml", "metadata.jsonl", "microscope.json", "kinematics.csv")
"""Files of a stack other than images; kinematics.csv may be missing."""


def stacks_of(folder: str | Path) -> list[SetStack]:
    """The stacks of a set, sorted by split; a single stack is a set of one with an empty split.

    Raises:
        InputError: the folder is neither, or the set is incomplete.
    """
    folder = Path(folder)
    if (folder / "stack.toml").is_file():
        place = folder.resolve()
        name = in_utf8(place.name)  # of a set's stacks, set.json has it as text
        return [SetStack(split="", name=name, condition=None, parameters={}, folder=place)]
    if not (folder / "set.json").is_file():
        raise InputError(
            f"{folder} is neither a set (set.json is missing) nor a stack (stack.toml is missing). "
            "Give a folder that `eyespot dataset` or `eyespot render` wrote."
        )
    labelled = read_set(folder)
    if missing := labelled.missing:
        raise InputError(
            f"{folder} is incomplete: {len(missing)} of {len(labelled.stacks)} stacks are missing. "
            f"{_AGAIN}"
        )
    return sorted(labelled.stacks, key=lambda stack: stack.split)


def check_unchanged(stacks: Sequence[SetStack]) -> None:
    """Refuse a set or a stack whose files are not those that its manifest lists.

    Files beside them are ignored, and a folder without a manifest, which others made, is accepted.

    Raises:
        InputError: something is missing or changed; the message lists it.
    """
    folder = stacks[0].folder.parents[1] if stacks[0].split else stacks[0].folder
    if (folder / MANIFEST).is_file():
        listed = read_manifest(folder, remedy="Copy it again.")
        if problems := list(changes(folder, listed)):
            raise InputError(_listed(folder, problems))


def set_files(stacks: Sequence[SetStack]) -> list[Path]:
    """set.json and LICENSE of the stacks' set; nothing for a single stack."""
    folder = stacks[0].folder.parents[1]
    files = [inside(folder, name) for name in ("set.json", "LICENSE") if stacks[0].split]
    return [path for path in files if path.is_file()]


def copy_description(stack: SetStack, folder: Path) -> None:
    """Copy the files of a stack other than images into a new folder."""
    folder.mkdir(parents=True)
    for name in _DESCRIPTION:
        # A link in the place of a file could lead to any file of whoever exports the stack.
        if (path := inside(stack.folder, name)).is_file():
            shutil.copyfile(path, folder / name)


def exposures_of(stack: Stack) -> tuple[str, ...]:
    """Kinds of exposure in a stack, in its order."""
    return tuple(dict.fromkeys(row.exposure for row in stack.labels))


def true_beam(stack: Stack) -> Calibration:
    """The true beam of a stack; stacks of one source share an object, whose light is traced once.

    Raises:
        InputError: the stack was not rendered, so that nothing says what its source is.
    """
    from eyespot.scenes import Scene  # loads JAX, which a reader of files need not have

    scene = stack.description.get("scene")
    if not isinstance(scene, dict):
        raise InputError(
            f"{stack.folder} has no scene, so its light source is not known. Give --calibration."
        )
    content = Scene.model_validate(scene)
    return _beam(content.model_dump_json(include={"schema_version", "source"}, by_alias=True))


@functools.cache
def _beam(source: str) -> Calibration:
    from eyespot.scenes import Scene
    from eyespot.scenes.world.true_calibration import true_calibration

    return true_calibration(Scene.model_validate_json(source))


def plain_spot(
    x: float, y: float, first: float, second: float, angle: float, covariance: object = math.nan
) -> Spot:
    """A spot that is only an ellipse: centre and semi-axes in px, of which either is the longer.

    The angle is that of the first axis, from +u towards +v, rad; the covariance, 5 x 5, has the
    order of `formats.spot.PARAMETERS`, NaN if unknown.
    """
    if second > first:
        first, second, angle = second, first, angle + math.pi / 2
    return Spot(
        x_px=float(x),
        y_px=float(y),
        semi_major_px=float(first),
        semi_minor_px=float(second),
        angle_rad=float(math.pi / 2 - (math.pi / 2 - angle) % math.pi),
        covariance=np.broadcast_to(np.asarray(covariance, float), (5, 5)).copy(),
        edge_width_px=math.nan,
        coverage=math.nan,
        inlier_fraction=math.nan,
        saturated=math.nan,
    )


Mode = Literal["auto", "literal", "subpixel", "pixels"]


def own_reader(
    mode: Mode,
    microscope: MicroscopeFile,
    *,
    click: tuple[float, float],
    beam: Calibration | None = None,
    constants: Mapping[str, Any] | None = None,
) -> Reader:
    """A reader that knows nothing of the robot.

    The literal mode starts at a click on the first spot, (x, y) in px, as the paper's operator
    does; the modes pixels and auto use the beam. Other constants than the product's may be given.

    Raises:
        InputError: the mode pixels cannot read the stack; the text says why.
    """
    given = {"response": microscope.response} | dict(constants or {})
    if mode == "literal":
        return LiteralMode(LiteralSettings(**given), None, start=click)
    settings, ranger = SubpixelSettings(**given), None
    if mode == "auto" and best_mode(beam, microscope)[0] == "subpixel":
        mode = "subpixel"
        if beam is not None and microscope.camera() is None:
            ranger = Ranger(beam, microscope)
    if mode == "subpixel":
        return SubpixelMode(settings, ranger)
    from eyespot.estimator.pixels.tracker import PixelRanger

    assert beam is not None, "the mode pixels needs the beam"
    return PixelsMode(settings, PixelRanger(beam, microscope))


class Row(NamedTuple):
    """An image of a set; `planned` is its stack as an entry of the set."""

    planned: SetStack
    stack: Stack
    labels: FrameLabels

    def line(self) -> dict[str, Any]:
        """The line of metadata.jsonl: labels of the image and parameters of its stack."""
        line = self.labels.row()
        for name in ("file_name", "mask_file_name"):
            line[name] = f"{self.planned.name}/{line[name]}"
        return {
            **line,
            "stack": self.planned.name,
            "condition": self.planned.condition or "",
            # Of a lens, of the effective cone.
            "cone_k": 1 / math.tan(self._half_angle()),
            **self.planned.parameters,
        }

    def _half_angle(self) -> float:
        found = self.stack.described("cone.half_angle", float)
        if not 0.0 < found < math.pi / 2:
            raise InputError(
                f"{self.stack.folder / 'stack.toml'}: cone.half_angle must lie in (0, pi/2); got "
                f"{found:g} rad. {_AGAIN}"
            )
        return found


def rows(labelled: LabelledSet) -> Iterator[Row]:
    """Every image of a set, in the order of its stacks."""
    for planned in labelled.stacks:
        stack = planned.open()
        for labels in stack.labels:
            yield Row(planned, stack, labels)


# The manifest: sizes and SHA-256 of all files of a set.

_MAX_PROBLEMS_IN_MESSAGE = 20  # An incomplete copy has thousands.


def write_set_manifest(labelled: LabelledSet) -> None:
    """Write a list of all files of a set; files of a stack are taken from the stack's manifest."""
    known: dict[str, Any] = {}
    for stack in labelled.stacks:
        listed = read_manifest(stack.folder, remedy="Render the stack again.")
        listed[MANIFEST] = fingerprint(stack.folder / MANIFEST)
        known |= {f"{stack.qualified_name}/{name}": file for name, file in listed.items()}
    write_manifest(labelled.folder, schema=SCHEMA, known=known)


def verify_set(folder: Path) -> int:
    """Verify that a set has all its files unchanged, and nothing else; returns their number.

    Raises:
        InputError: something is missing, changed or unexpected; the message lists it.
    """
    labelled = read_set(folder)
    if missing := [stack.qualified_name for stack in labelled.missing]:
        raise InputError(_listed(folder, [f"stack {name} is missing" for name in missing]))
    try:
        files = read_manifest(labelled.folder, remedy="Copy the set again.")
    except FileNotFoundError as error:
        raise InputError(f"{folder} is incomplete: {MANIFEST} is missing. {_AGAIN}") from error
    if problems := list(differences(labelled.folder, files)):
        raise InputError(_listed(folder, problems))
    return len(files)


def _listed(folder: Path, problems: Sequence[str]) -> str:
    more = len(problems) - _MAX_PROBLEMS_IN_MESSAGE
    lines = [f"{folder}: {problem}" for problem in problems[:_MAX_PROBLEMS_IN_MESSAGE]]
    return "\n".join(lines + ([f"{folder}: and {more} more"] if more > 0 else []))


def verify(folder: Path, /) -> None:
    """Verify a set: list every file that is missing or changed.

    Args:
        folder: Folder of the set.
    """
    print(f"{folder}: complete, {verify_set(folder)} files match the manifest.")
