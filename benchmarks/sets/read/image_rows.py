"""The images of a set with their labels: the lines of metadata.jsonl."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.sets.read.labelled_set import LabelledSet, SetStack
from estimator import FrameLabels, Stack


@dataclass(frozen=True, kw_only=True)
class Row:
    """An image of a set.

    Attributes:
        planned: the stack as an entry of the set.
    """

    planned: SetStack
    stack: Stack
    labels: FrameLabels

    @property
    def k(self) -> float:
        """1/tan of the half-angle of the source's cone (for a lens, the effective cone)."""
        return 1 / math.tan(self.stack.described("cone.half_angle", float))

    def image(self) -> np.ndarray:
        """The image, RGB."""
        return self.stack.image(self.labels)

    def line(self) -> dict[str, Any]:
        """The line of metadata.jsonl: labels of the image and parameters of its stack."""
        line = self.labels.row()
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
