"""COCO: images SPLIT/STACK/000000.png, and annotations/SPLIT.json for each split.

The segmentation is the mask of the visible spot in COCO's run lengths, because polygons cannot
describe the holes and pieces of a partly hidden spot. An image without a visible spot has no
annotation. Extra keys contain our labels: all of them in images, the ellipses in annotations.
"""

import itertools
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from pycocotools import mask as run_lengths

from benchmarks.sets.read import SetStack
from formats.microscope import read_microscope
from formats.stack import FrameLabels, Stack

_CATEGORY = {"id": 1, "name": "spot", "supercategory": "light"}
_ELLIPSES = ("half_max_", "cone_")


def write(stacks: Sequence[SetStack], out: Path, progress: Callable[[], None]) -> None:
    """Write images and annotations, with one of each at a time in memory."""
    (out / "annotations").mkdir()
    for part, group in itertools.groupby(stacks, key=lambda stack: stack.split_name):
        split = list(group)
        with (out / "annotations" / f"{part}.json").open("w", encoding="utf-8") as file:
            file.write(f'{{"info": {json.dumps({"description": part})}, "licenses": [],\n')
            file.write(f'"categories": [{json.dumps(_CATEGORY)}],\n"images": ')
            _write_list(file, _image_entries(split, out))
            file.write(',\n"annotations": ')
            _write_list(file, _annotations(split, progress))
            file.write("}\n")


def _images(split: Sequence[SetStack]) -> Iterator[tuple[int, str, Stack, FrameLabels]]:
    """Number and name of each image of a split, its stack and its labels."""
    ids = itertools.count(1)
    for entry in split:
        stack = entry.open()
        for row in stack.labels:
            yield next(ids), f"{entry.qualified_name}/{Path(row.file_name).name}", stack, row


def _write_list(file: TextIO, items: Iterator[dict[str, Any]]) -> None:
    file.write("[")
    for index, item in enumerate(items):
        file.write(",\n" if index else "\n")
        file.write(json.dumps(item))
    file.write("]")


def _image_entries(split: Sequence[SetStack], out: Path) -> Iterator[dict[str, Any]]:
    """Entries of the images; also copies them."""
    for number, name, stack, labels in _images(split):
        shutil.copyfile(stack.path_of(labels.file_name), out / name)
        microscope = read_microscope(stack.folder / "microscope.json")
        yield {
            **labels.row(),
            "id": number,
            "file_name": name,
            "width": microscope.width_px,
            "height": microscope.height_px,
        }


def _annotations(
    split: Sequence[SetStack], progress: Callable[[], None]
) -> Iterator[dict[str, Any]]:
    ids = itertools.count(1)
    for number, _, stack, labels in _images(split):
        seen = np.asfortranarray(stack.mask(labels) > 0).astype(np.uint8)
        progress()
        if not seen.any():
            continue
        encoded = run_lengths.encode(np.asfortranarray(seen))
        yield {
            "id": next(ids),
            "image_id": number,
            "category_id": _CATEGORY["id"],
            "iscrowd": 0,
            "segmentation": {"size": encoded["size"], "counts": encoded["counts"].decode()},
            "area": int(run_lengths.area(encoded)),
            "bbox": run_lengths.toBbox(encoded).tolist(),
            **{k: v for k, v in labels.row().items() if k.startswith(_ELLIPSES)},
        }
