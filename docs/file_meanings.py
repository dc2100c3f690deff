"""Meanings of the keys of files: from docstrings, and those that no docstring has."""

import importlib
import inspect
import re
from typing import Any


def named(place: str) -> Any:
    """The object of a place "module:name"."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


def attributes_of(owner: type) -> dict[str, str]:
    """What a class's docstring says under `Attributes`, by attribute."""
    text = inspect.cleandoc(owner.__doc__ or "").partition("Attributes:\n")[2]
    found: dict[str, str] = {}
    for entry in re.split(r"\n(?=    \S)", text):
        names, colon, meaning = " ".join(entry.split()).partition(": ")
        if colon:
            found |= dict.fromkeys(names.split(", "), meaning)
    return found


COMMON = {"schema": "Version of the format.", "provenance": "Source of the numbers."}
MEANINGS = {
    "kinematics": {
        "time_s": "On the robot's clock, s.",
        **{f"{x}_mm": f"{x.upper()} of the tip, eye frame, mm." for x in "xyz"},
        **{f"axis_{x}": f"{x.upper()} of the tool's axis, a unit vector." for x in "xyz"},
    },
    "rig": {
        **{name: f"Table [{name}]." for name in named("eyespot.formats.rig:Rig").model_fields},
        **COMMON,
    },
    "budget": {"cause": "One of the [causes](messages.md).", "unit": "Of the quantity."},
    "glue-lens": {"lens": "The drop."},
    "viewing-lens": {
        "lens": "The lens.",
        "kind": "contact or wide-field.",
        "front_curvature_per_mm": "1/radius of the front; its back fits the cornea.",
        "thickness_mm": "On the axis.",
        "index": "Refractive index.",
        "power_d": "In air, dioptres; it is held one focal length above the cornea.",
    },
}
"""Meanings that no docstring has, by kind of file and key."""
