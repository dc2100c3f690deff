"""Writes croissant.json: the set described for search engines and data loaders.

The format is Croissant 1.0 of MLCommons (Akhtar et al. 2024). For each split it lists the label
table as a file with its checksum, the images and masks as sets of files, and a record set with
every column of the table.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.sets.make.columns import meaning
from benchmarks.sets.read import LabelledSet

FILE = "croissant.json"

_LICENCES = {"CC-BY-4.0": "https://creativecommons.org/licenses/by/4.0/"}
"""Address of a licence by SPDX name; of others the name itself is given."""

_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
"""The context that the format prescribes: it gives the keys below their meaning."""


def croissant(labelled: LabelledSet, tables: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """The description as JSON text; the same set gives the same text.

    Args:
        labelled: a complete set, whose label tables are written.
        tables: lines of each split's metadata.jsonl.
    """
    about = labelled.description
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
        "version": _version(labelled.name),
        "license": _LICENCES.get(labelled.licence, labelled.licence),
        "keywords": ["retinal surgery", "structured light", "ellipse", "synthetic"],
        "distribution": distribution,
        "recordSet": record_sets,
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _version(name: str) -> str:
    """The number at the end of a set's name: static-v2 is 2.0.0; without one, 1.0.0."""
    number = re.search(r"-v(\d+)$", name)
    return f"{number[1] if number else 1}.0.0"


def _files(labelled: LabelledSet, split: str) -> list[dict[str, Any]]:
    table = labelled.folder / split / "metadata.jsonl"
    return [
        {
            "@type": "cr:FileObject",
            "@id": f"{split}/metadata.jsonl",
            "name": f"{split}-labels",
            "description": f"One line of labels for each image of the split {split}.",
            "contentUrl": f"{split}/metadata.jsonl",
            "encodingFormat": "application/jsonlines",
            "sha256": hashlib.sha256(table.read_bytes()).hexdigest(),
        },
        *(
            {
                "@type": "cr:FileSet",
                "@id": f"{split}-{kind}-files",
                "name": f"{split}-{kind}-files",
                "description": f"The {kind} of the split {split}.",
                "encodingFormat": "image/png",
                "includes": f"{split}/*/{kind}/*.png",
            }
            for kind in ("frames", "masks")
        ),
    ]


def _labels(split: str, lines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The label table; its lines have the same columns."""
    return {
        "@type": "cr:RecordSet",
        "@id": split,
        "name": split,
        "description": f"Labels of the split {split}. file_name is relative to {split}/.",
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"{split}/{name}",
                "name": f"{split}/{name}",
                "description": meaning(name),
                "dataType": _type([line[name] for line in lines]),
                **({"repeated": True} if isinstance(lines[0][name], list | tuple) else {}),
                "source": {
                    "fileObject": {"@id": f"{split}/metadata.jsonl"},
                    "extract": {"column": name},
                },
            }
            for name in lines[0]
        ],
    }


def _images(split: str, kind: str) -> dict[str, Any]:
    files = {"fileSet": {"@id": f"{split}-{kind}-files"}}
    return {
        "@type": "cr:RecordSet",
        "@id": f"{split}-{kind}",
        "name": f"{split}-{kind}",
        "description": f"The {kind} of the split {split} with their paths in the set.",
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"{split}-{kind}/path",
                "name": f"{split}-{kind}/path",
                "description": "Path within the set.",
                "dataType": "sc:Text",
                "source": {**files, "extract": {"fileProperty": "fullpath"}},
            },
            {
                "@type": "cr:Field",
                "@id": f"{split}-{kind}/image",
                "name": f"{split}-{kind}/image",
                "description": "The image.",
                "dataType": "sc:ImageObject",
                "source": {**files, "extract": {"fileProperty": "content"}},
            },
        ],
    }


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
