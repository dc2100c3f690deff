"""Writes croissant.json: the set described for search engines and data loaders.

The format is Croissant 1.0 of MLCommons (Akhtar et al. 2024). For each split it lists the label
table as a file with its checksum, the images and masks as sets of files, and a record set with
every column of the table.
"""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from eyespot.benchmarks.sets.read import LabelledSet
from eyespot.formats.stack import FrameLabels

FILE = "croissant.json"

_LICENCES = {"CC-BY-4.0": "https://creativecommons.org/licenses/by/4.0/"}
"""Address of a licence by SPDX name; of others the name itself is given."""

_OF_CROISSANT = (
    "citeAs column equivalentProperty extract field fileProperty fileObject fileSet format "
    "includes isLiveDataset jsonPath key md5 parentField path recordSet references regex repeated "
    "replace samplingRate separator source subField transform"
).split()
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{name: f"cr:{name}" for name in _OF_CROISSANT},
}
"""The context that the format prescribes: it gives the keys below their meaning."""


def croissant(labelled: LabelledSet, tables: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """The description of a complete set as JSON, from the lines of each split's metadata.jsonl."""
    about = labelled.description
    number = re.search(r"-v(\d+)$", labelled.name)  # static-v2 is 2.0.0
    distribution: list[dict[str, Any]] = []
    record_sets: list[dict[str, Any]] = []
    for split, lines in tables.items():
        distribution += _files(labelled, split)
        record_sets += [_labels(split, lines), _images(split, "frames"), _images(split, "masks")]
    content = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": labelled.name,
        "description": about["description"],
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "version": f"{number[1] if number else 1}.0.0",
        "license": _LICENCES.get(labelled.licence, labelled.licence),
        "keywords": ["retinal surgery", "structured light", "ellipse", "synthetic"],
        "distribution": distribution,
        "recordSet": record_sets,
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _node(kind: str, name: str, description: str, **more: Any) -> dict[str, Any]:
    about = {"@type": f"cr:{kind}", "@id": name, "name": name, "description": description}
    return about | more


def _files(labelled: LabelledSet, split: str) -> list[dict[str, Any]]:
    table = f"{split}/metadata.jsonl"
    sha256 = hashlib.sha256((labelled.folder / table).read_bytes()).hexdigest()
    about = {"contentUrl": table, "encodingFormat": "application/jsonlines", "sha256": sha256}
    text = f"One line of labels for each image of the split {split}."
    labels = _node("FileObject", table, text, **about) | {"name": f"{split}-labels"}
    images = [
        _node(
            "FileSet",
            f"{split}-{kind}-files",
            f"The {kind} of the split {split}.",
            encodingFormat="image/png",
            includes=f"{split}/*/{kind}/*.png",
        )
        for kind in ("frames", "masks")
    ]
    return [labels, *images]


def _labels(split: str, lines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The label table; its lines have the same columns."""
    table = {"@id": f"{split}/metadata.jsonl"}
    fields = [
        _node(
            "Field",
            f"{split}/{name}",
            meaning(name),
            dataType=_type([line[name] for line in lines]),
            **({"repeated": True} if isinstance(lines[0][name], list | tuple) else {}),
            source={"fileObject": table, "extract": {"column": name}},
        )
        for name in lines[0]
    ]
    text = f"Labels of the split {split}. file_name is relative to {split}/."
    return _node("RecordSet", split, text, field=fields)


def _images(split: str, kind: str) -> dict[str, Any]:
    name, files = f"{split}-{kind}", {"@id": f"{split}-{kind}-files"}
    fields = [
        _node(
            "Field",
            f"{name}/{field}",
            text,
            dataType=data_type,
            source={"fileSet": files, "extract": {"fileProperty": extracted}},
        )
        for field, text, data_type, extracted in (
            ("path", "Path within the set.", "sc:Text", "fullpath"),
            ("image", "The image.", "sc:ImageObject", "content"),
        )
    ]
    text = f"The {kind} of the split {split} with their paths in the set."
    return _node("RecordSet", name, text, field=fields)


def _type(values: Sequence[Any]) -> str:
    if isinstance(values[0], list | tuple):
        return "sc:Float"
    if all(isinstance(value, bool) for value in values):
        return "sc:Boolean"
    if all(isinstance(value, int) for value in values):
        return "sc:Integer"
    if all(isinstance(value, int | float) for value in values):
        return "sc:Float"
    return "sc:Text"


_OF_SETS = {
    "file_name": "Path of the image within the split.",
    "mask_file_name": "Path of the mask within the split: 255 where the wall in the spot is seen.",
    "stack": "Name of the stack.",
    "condition": "Difficult condition of the stack; empty if it has none.",
    "cone_k": "1/tan of the beam's half-angle; for a lens, of its effective cone.",
}
"""Meanings of the columns that a set adds to the labels, or changes."""


def meaning(name: str) -> str:
    """A sentence about a column; of a scene key, that it is one."""
    if name in _OF_SETS:
        return _OF_SETS[name]
    label = FrameLabels.model_fields.get(name)
    return (label and label.description) or f"Key {name} of the stack's scene."
