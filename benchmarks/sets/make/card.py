"""Writes the data card and the label tables of a complete set."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from benchmarks.reporting import environment
from benchmarks.sets.make import croissant, pictures
from benchmarks.sets.read.labelled_set import LabelledSet
from benchmarks.sets.read.stacks import Row, rows
from estimator.files import written_whole

_LICENCES = {
    "CC-BY-4.0": "Creative Commons Attribution 4.0 International\n"
    "https://creativecommons.org/licenses/by/4.0/legalcode\n",
}
"""Text of LICENSE by SPDX name; for other licences it is the name itself."""


class Count(NamedTuple):
    """Number of stacks and images of a split and condition."""

    split: str
    condition: str
    stacks: int
    images: int


class Range(NamedTuple):
    """Range and median of a label in a set."""

    name: str
    unit: str
    least: float
    median: float
    most: float


def write_card(labelled: LabelledSet) -> None:
    """Write README.md with its figures, LICENSE, spec.toml, croissant.json and the label tables.

    Args:
        labelled: a set with all its stacks.
    """
    images = list(rows(labelled))
    tables = _tables(labelled, images)
    for split, lines in tables.items():
        text = "".join(json.dumps(line) + "\n" for line in lines)
        _write(labelled.folder / split / "metadata.jsonl", text)
    _write(labelled.folder / croissant.FILE, croissant.croissant(labelled, tables))
    licence = _LICENCES.get(labelled.licence, f"{labelled.licence}\n")
    _write(labelled.folder / "LICENSE", licence)
    _write(labelled.folder / "spec.toml", tomli_w.dumps(labelled.description["spec"]))
    pictures.histograms(images, labelled.folder / "histograms.png")
    pictures.samples(images, labelled.folder / "samples.png")
    text = (
        environment()
        .get_template("dataset_card.md.j2")
        .render(
            set=labelled,
            about=labelled.description,
            # `load_dataset(DIR)` loads all splits, `load_dataset(DIR, NAME)` one.
            configs={"default": labelled.splits} | {split: [split] for split in labelled.splits},
            counts=_counts(images),
            images=len(images),
            ranges=_ranges(images),
            bounded=any("bound_semi_minor_px" in row.line() for row in images),
            varied=sorted(labelled.stacks[0].parameters),
        )
    )
    _write(labelled.folder / "README.md", text)


def _tables(labelled: LabelledSet, images: Sequence[Row]) -> dict[str, list[dict[str, Any]]]:
    """The lines of each split, all with the same columns.

    A label that only some images have is NaN in the others. JSON's null would be stricter, but
    Hugging Face's loader refuses a set in which one split has nothing but null in a column.
    """
    lines = [(row.planned.split, row.line()) for row in images]
    columns = dict.fromkeys(name for _, line in lines for name in line)
    return {
        split: [
            {name: line.get(name, math.nan) for name in columns}
            for own, line in lines
            if own == split
        ]
        for split in labelled.splits
    }


def _counts(images: Sequence[Row]) -> list[Count]:
    of_images = Counter((row.planned.split, row.planned.condition or "") for row in images)
    planned = {row.planned.folder: row.planned for row in images}.values()
    of_stacks = Counter((stack.split, stack.condition or "") for stack in planned)
    return [Count(*group, of_stacks[group], number) for group, number in of_images.items()]


def _ranges(images: Sequence[Row]) -> list[Range]:
    return [
        Range(quantity.name, quantity.unit, *np.quantile(quantity.of(images), [0.0, 0.5, 1.0]))
        for quantity in pictures.QUANTITIES
    ]


def _write(path: Path, text: str) -> None:
    with written_whole(path, replace=True) as partial:
        partial.write_text(text, encoding="utf-8")
