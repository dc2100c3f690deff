"""COCO: images SPLIT/STACK/000000.png, and annotations/SPLIT.json for each split.

The segmentation is the mask of the visible spot in COCO's run lengths, because polygons cannot
describe the holes and pieces of a partly hidden spot. An image without a visible spot has no
annotation. Extra keys contain our labels: all of them in images, the ellipses in annotations.
"""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np
from pycocotools import mask as run_lengths

from benchmarks.sets.read import SetStack, copy_description, qualified_name, split_name
from formats.microscope import read_microscope
from formats.stack import FrameLabels, Stack

_CATEGORY = {"id": 1, "name": "spot", "supercategory": "light"}
_ELLIPSES = ("half_max_", "cone_")


class _Image(NamedTuple):
    """An image of a split, with its number."""

    id: int
    entry: SetStack
    stack: Stack
    labels: FrameLabels


def write(stacks: Sequence[SetStack], out: Path, progress: Callable[[], None]) -> None:
    """Write images and annotations, with one of each at a time in memory."""
    (out / "annotations").mkdir(parents=True)
    for entry in stacks:
        copy_description(entry, out / qualified_name(entry))
    for part, group in itertools.groupby(stacks, key=split_name):
        split = list(group)
        with (out / "annotations" / f"{part}.json").open("w", encoding="utf-8") as file:
            file.write(f'{{"info": {json.dumps({"description": part})}, "licenses": [],\n')
            file.write(f'"categories": [{json.dumps(_CATEGORY)}],\n"images": ')
            _write_list(file, (_image_entry(image, out) for image in _images(split)))
            file.write(',\n"annotations": ')
            _write_list(file, _annotations(split, progress))
            file.write("}\n")


def _images(split: Sequence[SetStack]) -> Iterator[_Image]:
    ids = itertools.count(1)
    for entry in split:
        stack = entry.open()
        for row in stack.labels:
            yield _Image(next(ids), entry, stack, row)


def _write_list(file: TextIO, items: Iterator[dict[str, Any]]) -> None:
    file.write("[")
    for index, item in enumerate(items):
        file.write(",\n" if index else "\n")
        file.write(json.dumps(item))
    file.write("]")


def _image_entry(image: _Image, out: Path) -> dict[str, Any]:
    """Entry of an image; also copies the image."""
    name = f"{qualified_name(image.entry)}/{Path(image.labels.file_name).name}"
    shutil.copyfile(image.stack.path_of(image.labels.file_name), out / name)
    microscope = read_microscope(image.stack.folder / "microscope.json")
    return {
        **image.labels.row(),
        "id": image.id,
        "file_name": name,
        "width": microscope.width_px,
        "height": microscope.height_px,
    }


def _annotations(
    split: Sequence[SetStack], progress: Callable[[], None]
) -> Iterator[dict[str, Any]]:
    ids = itertools.count(1)
    for image in _images(split):
        seen = np.asfortranarray(image.stack.mask(image.labels) > 0).astype(np.uint8)
        progress()
        if not seen.any():
            continue
        encoded = run_lengths.encode(np.asfortranarray(seen))
        yield {
            "id": next(ids),
            "image_id": image.id,
            "category_id": _CATEGORY["id"],
            "iscrowd": 0,
            "segmentation": {"size": encoded["size"], "counts": encoded["counts"].decode()},
            "area": int(run_lengths.area(encoded)),
            "bbox": run_lengths.toBbox(encoded).tolist(),
            **{k: v for k, v in image.labels.row().items() if k.startswith(_ELLIPSES)},
        }
