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

from benchmarks.sets.read import LabelledSet

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


_MEANINGS = {
    "file_name": "Path of the image within the split.",
    "mask_file_name": "Path of the mask: 255 where the wall within the spot is seen.",
    "frame": "Number of the moment within its stack.",
    "time_s": "Middle of the exposure, s.",
    "exposure": "How the exposure time was chosen: paper (fixed) or metered.",
    "exposure_s": "Exposure time, s.",
    "d_mm": "Distance from the tip to the wall along the beam, mm.",
    "nearest_mm": "Distance from the tip to the nearest point of the wall, mm.",
    "c_mm": "Distance of the spot from the axis of the microscope, mm.",
    "azimuth_rad": "Azimuth of the spot around the axis of the microscope, rad.",
    "phi_rad": "Angle of the spot on the eyeball from the axis, rad.",
    "incidence_rad": "Angle between the beam and the outward normal of the wall, rad.",
    "incidence_azimuth_rad": "Azimuth of the beam around that normal, rad.",
    "tip_mm": "Position of the tip in the eye frame, mm.",
    "axis": "Unit vector along the beam, from the tip towards the wall.",
    "spot_mm": "Where the beam's axis meets the wall, mm.",
    "visible_fraction": "Part of the half-maximum contour that the camera sees.",
    "saturated_fraction": "Part of the mask's pixels with a channel at full scale.",
    "speed_mm_s": "Speed of the tip, mm/s.",
    "medium": "Medium between tip and wall.",
    "seed": "Random seed of the stack.",
    "relative_power": "Power of the light source, relative to its mean.",
    "stack": "Name of the stack.",
    "condition": "Difficult condition of the stack; empty if it has none.",
    "cone_k": "1/tan of the beam's half-angle; for a lens, of its effective cone.",
}
_FAMILIES = {
    "spread_cone": "edge of the geometric cone after the wall has spread the light",
    "spread_half_max": "half of the peak after the wall has spread the light",
    "cone": "edge of the geometric cone",
    "half_max": "half of the noise-free, unoccluded peak",
}
_PARTS = {
    "x_px": "x of its centre, px",
    "y_px": "y of its centre, px",
    "semi_major_px": "its semi-major axis, px",
    "semi_minor_px": "its semi-minor axis, px",
    "angle_rad": "angle of its semi-major axis from right towards down, rad",
}
_OTHERS = (
    (
        r"bound_(x|y|semi_major|semi_minor)_px",
        "Least standard deviation of the half-maximum "
        "ellipse that an unbiased estimator can reach in this image (Cramér-Rao), px.",
    ),
    (r"bound_d_mm", "The same of the distance from the ellipse, with the beam known, mm."),
    (r"(red|blue)_shift_[xy]_px", "Where this colour shows the spot, against green, px."),
    (r"reflex_[xy]_px", "Brightest reflex of the microscope's lamp, px."),
    (r"view_[xy]_px", "Shift of the image by drift and shake, px."),
    (r"eye_turn_[xyz]_deg", "Rotation vector of the eyeball, degrees."),
)


def meaning(name: str) -> str:
    """A sentence about a column; of a scene key, that it is one."""
    if name in _MEANINGS:
        return _MEANINGS[name]
    for family, contour in _FAMILIES.items():
        if name.startswith(f"{family}_") and (part := _PARTS.get(name.removeprefix(f"{family}_"))):
            return f"Ellipse at the {contour}: {part}."
    for pattern, sentence in _OTHERS:
        if re.fullmatch(pattern, name):
            return sentence
    return f"Key {name} of the stack's scene."
