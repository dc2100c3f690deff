"""The images of a set with their labels, and the conditions by which they are grouped."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from benchmarks.sets.read.labelled_set import SetStack
from benchmarks.sets.read.stacks import image_name, qualified_name
from estimator import Stack, read_microscope

ALL = "all"
"""Condition and group of all images together."""


def images_of(stacks: Iterable[SetStack]) -> pd.DataFrame:
    """All images of a set, by their names in the set: the labels, and what groups them.

    `stack` is SPLIT/STACK; `split` is empty for a single stack, `adverse` in splits without
    conditions, `pair` in a set without pairs, `viewing` for a pinhole. `blur_px` is the path of the
    tip during the exposure at the retinal pole.
    """
    rows, stacks = {}, list(stacks)
    first = "first" if any(entry.pair for entry in stacks) else ""
    for entry in stacks:
        stack = entry.open()
        about = {
            "stack": qualified_name(entry),
            "split": entry.split,
            "adverse": entry.condition or "",
            "pair": entry.pair or first,
            "viewing": _viewing_path(stack),
            "scale_mm_px": read_microscope(entry.folder / "microscope.json").scale_mm_px,
            "source": stack.described("scene.source.kind", str),
            "wall": stack.described("scene.phantom.wall", str),
        }
        for labels in stack.labels:
            rows[image_name(entry, labels.file_name)] = vars(labels) | about
    return with_derived(pd.DataFrame.from_dict(rows, orient="index"))


def with_derived(images: pd.DataFrame) -> pd.DataFrame:
    """The images with the columns that follow from the labels."""
    return images.assign(
        incidence_deg=np.degrees(images.incidence_rad),
        blur_px=images.speed_mm_s * images.exposure_s / images.scale_mm_px,
    )


def _viewing_path(stack: Stack) -> str:
    viewing = stack.description["scene"].get("viewing", {})  # not in stacks of eyespot 0.1
    if viewing.get("eye", "none") == "none":
        return ""
    return f"{viewing['lens']}, {viewing['form']}"


class Condition(NamedTuple):
    """A way to group images: by a column's values, or by its bins [edge, next edge).

    Attributes:
        order: order of the groups; others follow by name.
        edges: of the bins; the last one has no upper limit.
    """

    title: str
    order: tuple[str, ...] = ()
    edges: tuple[float, ...] = ()


CONDITIONS = {
    "split": Condition("split", ("train", "validation", "test", "adverse", "unseen")),
    "adverse": Condition("adverse condition"),
    "pair": Condition("partner of a pair", ("first",)),
    "viewing": Condition("viewing path"),
    "source": Condition("light source"),
    "wall": Condition("wall"),
    "exposure": Condition("exposure"),
    "medium": Condition("medium"),
    "c_mm": Condition("eccentricity $c$ (mm)", edges=(0, 2, 4, 6)),
    "d_mm": Condition("distance $d$ (mm)", edges=(0, 1, 2, 4, 6)),
    "incidence_deg": Condition("incidence (°)", edges=(0, 15, 30, 45)),
    "speed_mm_s": Condition("speed (mm/s)", edges=(0, 0.5, 1.5, 5)),
    "blur_px": Condition("blur: path in an exposure (px)", edges=(0, 0.5, 2, 8)),
    "visible_fraction": Condition("visible fraction", edges=(0, 0.5, 0.75, 0.95)),
    "saturated_fraction": Condition("saturated fraction", edges=(0, 0.001, 0.1, 0.5)),
}
"""Conditions by the column of the images that they are about, as in score.csv."""


def groups(images: pd.DataFrame, condition: str) -> Iterator[tuple[str, pd.DataFrame]]:
    """The images of each group of a condition, in order; those without a group are left out."""
    if condition == ALL:
        yield ALL, images
        return
    about, values = CONDITIONS[condition], images[condition]
    if about.edges:
        ends = zip(about.edges, (*about.edges[1:], math.inf), strict=True)
        names = [f"≥ {low:g}" if math.isinf(high) else f"{low:g}–{high:g}" for low, high in ends]
        # Labels such as c = 0 may have rounding errors of either sign.
        bins = np.searchsorted(about.edges, values + 1e-9, side="right") - 1
        values = pd.Series(np.array(names)[np.maximum(bins, 0)], index=values.index)
        order = names
    else:
        place = {group: index for index, group in enumerate(about.order)}
        order = sorted(set(values) - {""}, key=lambda group: (place.get(group, len(place)), group))
    for group in order:
        if (members := values == group).any():
            yield group, images[members]
