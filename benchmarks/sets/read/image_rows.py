"""Every image of a set with what is known of it; the lines of a split's metadata.jsonl."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.sets.read.labelled_set import LabelledSet, SetStack
from estimator import FrameLabels, Stack


@dataclass(frozen=True, kw_only=True)
class Row:
    """An image of a set.

    Attributes:
        planned: the stack's place in the set.
        stack: the stack on disk.
        labels: the image's own.
    """

    planned: SetStack
    stack: Stack
    labels: FrameLabels

    @property
    def k(self) -> float:
        """1/tan of the half-angle of the source's cone, a lens's effective one included."""
        return 1 / math.tan(float(self.stack.description["cone"]["half_angle"]))

    def image(self) -> np.ndarray:
        """The image, RGB."""
        return self.stack.image(self.labels)

    def line(self) -> dict[str, Any]:
        """Its line of metadata.jsonl: the stack's own, and what is true of the whole stack."""
        line = asdict(self.labels)
        for name in ("file_name", "mask_file_name"):
            line[name] = f"{self.planned.name}/{line[name]}"
        return {
            **line,
            "stack": self.planned.name,
            "condition": self.planned.condition or "",
            "cone_k": self.k,
            **self.planned.parameters,
        }


def rows(labelled: LabelledSet) -> Iterator[Row]:
    """Every image of a set, in the order of its stacks."""
    for planned in labelled.stacks:
        stack = planned.open()
        for labels in stack.labels:
            yield Row(planned=planned, stack=stack, labels=labels)
