"""A set and its stacks, from set.json."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from estimator import Stack, read_stack
from estimator.files import FOLDER_NAME, inside, object_in
from optics import InputError, Strict, check_schema, in_file, read_text, validated

SCHEMA = 1
HISTORY = {1: "the format of eyespot 0.1"}
"""What changed with each version of the format that is read, in set.json and manifest.json."""

_AGAIN = "Make the set again."


class SetError(InputError):
    """A folder is not a labelled set, or it is incomplete; the text says what is wrong."""


@dataclass(frozen=True, kw_only=True)
class SetStack:
    """A stack of a set.

    Attributes:
        split: train, validation, test, adverse or unseen.
        condition: condition of an adverse stack, else None.
        pair: name of the pair whose partner the stack is, else None.
        parameters: values of the scene keys that vary within the set, by dotted name.
    """

    split: str
    name: str
    condition: str | None
    parameters: dict[str, Any]
    folder: Path
    pair: str | None = None

    def open(self) -> Stack:
        """Open the stack, for its labels and images."""
        return read_stack(self.folder)


@dataclass(frozen=True, kw_only=True)
class LabelledSet:
    """A set on disk.

    Attributes:
        name, licence: name and licence of its spec.
        stacks: all stacks of the set in order, also those not rendered yet.
    """

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
    split: Literal["train", "validation", "test", "adverse", "unseen"]
    name: Annotated[str, Field(pattern=FOLDER_NAME)]
    condition: Annotated[str, Field(pattern=FOLDER_NAME)] | None
    pair: Annotated[str, Field(pattern=FOLDER_NAME)] | None = None
    parameters: dict[str, Any]


class _SetFile(Strict):
    model_config = ConfigDict(extra="ignore")  # what describes the set as a whole

    schema_: Annotated[int, Field(alias="schema")]
    name: str
    licence: str
    stacks: list[_StackRow]


def read_set(folder: Path) -> LabelledSet:
    """Open a set, complete or not (`verify_set` checks that).

    Raises:
        SetError: the folder is not a set, or has another schema.
    """
    folder = Path(folder)
    with in_file(folder / "set.json", SetError):
        try:
            content = object_in(read_text(folder / "set.json"))
        except FileNotFoundError as error:
            raise SetError(f"{folder} is not a labelled set: set.json is missing.") from error
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
