"""A set and its stacks, from set.json."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from estimator import Stack, read_stack
from optics import InputError

SCHEMA = 1


class SetError(InputError):
    """A folder is not a labelled set, or it is incomplete; the text says what is wrong."""


@dataclass(frozen=True, kw_only=True)
class SetStack:
    """A stack of a set.

    Attributes:
        split: train, validation, test or adverse.
        name: name of its folder.
        condition: condition of an adverse stack, else None.
        parameters: values of the scene keys that vary within the set, by dotted name.
        folder: path of the stack.
    """

    split: str
    name: str
    condition: str | None
    parameters: dict[str, Any]
    folder: Path

    def open(self) -> Stack:
        """Open the stack, for its labels and images."""
        return read_stack(self.folder)


@dataclass(frozen=True, kw_only=True)
class LabelledSet:
    """A set on disk.

    Attributes:
        folder: path of the set.
        name, licence: name and licence of its spec.
        stacks: all stacks of the set in order, also those not rendered yet.
        description: content of set.json.
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


def read_set(folder: Path) -> LabelledSet:
    """Open a set, complete or not (`verify_set` checks that).

    Raises:
        SetError: the folder is not a set, or has another schema.
    """
    folder = Path(folder)
    try:
        content = json.loads((folder / "set.json").read_text())
    except OSError as error:
        raise SetError(f"{folder} is not a labelled set: set.json is missing.") from error
    except json.JSONDecodeError as error:
        raise SetError(f"{folder / 'set.json'}: not JSON ({error.msg}).") from error
    if content.get("schema") != SCHEMA:
        raise SetError(
            f"{folder / 'set.json'} has schema {content.get('schema')}; this version reads "
            f"{SCHEMA}. Make the set again."
        )
    return LabelledSet(
        folder=folder,
        name=content["name"],
        licence=content["licence"],
        stacks=tuple(
            SetStack(**row, folder=folder / row["split"] / row["name"]) for row in content["stacks"]
        ),
        description=content,
    )
