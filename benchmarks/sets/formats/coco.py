"""COCO: images with the names that they have in the set, and annotations/SPLIT.json for each split.

The segmentation is the mask of the visible spot in COCO's run lengths, because polygons cannot
describe the holes and pieces of a partly hidden spot; mask files are left out. An image without a
visible spot has no annotation. Extra keys contain our labels: all of them in images, the ellipses
in annotations.
"""

import itertools
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pycocotools import mask as run_lengths

from eyespot.benchmarks.sets.read import SetStack
from eyespot.formats.microscope import read_microscope

_CATEGORY = {"id": 1, "name": "spot", "supercategory": "light"}
_ELLIPSES = ("half_max_", "cone_")


def write(stacks: Sequence[SetStack], out: Path, progress: Callable[[], None]) -> None:
    """Write images and annotations, with one image and the entries of a split in memory."""
    (out / "annotations").mkdir()
    for part, group in itertools.groupby(stacks, key=lambda stack: stack.split_name):
        images: list[dict[str, Any]] = []
        annotations: list[dict[str, Any]] = []
        for entry in group:
            stack = entry.open()
            microscope = read_microscope(stack.folder / "microscope.json")
            size = {"width": microscope.width_px, "height": microscope.height_px}
            for labels in stack.labels:
                name = entry.image_name(labels.file_name)
                (out / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(stack.path_of(labels.file_name), out / name)
                row, number = labels.row(), len(images) + 1
                del row["mask_file_name"]
                images.append({**row, "id": number, "file_name": name, **size})
                if (seen := stack.mask(labels) > 0).any():
                    encoded = run_lengths.encode(np.asfortranarray(seen, np.uint8))
                    annotations.append(
                        {
                            "id": len(annotations) + 1,
                            "image_id": number,
                            "category_id": _CATEGORY["id"],
                            "iscrowd": 0,
                            "segmentation": {**encoded, "counts": encoded["counts"].decode()},
                            "area": int(run_lengths.area(encoded)),
                            "bbox": run_lengths.toBbox(encoded).tolist(),
                            **{k: v for k, v in row.items() if k.startswith(_ELLIPSES)},
                        }
                    )
                progress()
        about = {"info": {"description": part}, "licenses": [], "categories": [_CATEGORY]}
        with (out / "annotations" / f"{part}.json").open("w", encoding="utf-8") as file:
            # Unlike json.dumps it holds no second copy of the entries.
            json.dump(about | {"images": images, "annotations": annotations}, file)
