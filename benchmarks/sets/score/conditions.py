"""Conditions by which images are grouped: position, exposure, occlusion ..."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from benchmarks.sets.read import SetStack, image_name, qualified_name
from estimator import FrameLabels, Stack, read_microscope

_SPLITS = ("train", "validation", "test", "adverse", "unseen")


class Circumstances(NamedTuple):
    """The labels of an image, and the properties by which images are grouped.

    Attributes:
        labels: the labels.
        stack: SPLIT/STACK.
        split: its split; empty for a single stack.
        adverse: its condition in the split `adverse`; empty in other splits.
        pair: the pair whose partner its stack is, or "first"; empty in a set without pairs.
        viewing: viewing lens and form of the eye; empty for a pinhole.
        scale_mm_px: delta, scale of the microscope.
        source: light source: cone, lens or photons.
        wall: picture on the wall.
    """

    labels: FrameLabels
    stack: str
    split: str
    adverse: str
    pair: str
    viewing: str
    scale_mm_px: float
    source: str
    wall: str

    @property
    def blur_px(self) -> float:
        """Path of the tip during the exposure, px at the retinal pole."""
        return self.labels.speed_mm_s * self.labels.exposure_s / self.scale_mm_px


def circumstances_of(stacks: Iterable[SetStack]) -> dict[str, Circumstances]:
    """All images of a set, by their names in the set."""
    images, stacks = {}, list(stacks)
    first = "first" if any(entry.pair for entry in stacks) else ""
    for entry in stacks:
        scale = read_microscope(entry.folder / "microscope.json").scale_mm_px
        stack = entry.open()
        for labels in stack.labels:
            images[image_name(entry, labels.file_name)] = Circumstances(
                labels=labels,
                stack=qualified_name(entry),
                split=entry.split,
                adverse=entry.condition or "",
                pair=entry.pair or first,
                viewing=_viewing_path(stack),
                scale_mm_px=scale,
                source=stack.described("scene.source.kind", str),
                wall=stack.described("scene.phantom.wall", str),
            )
    return images


def _viewing_path(stack: Stack) -> str:
    viewing = stack.description["scene"].get("viewing", {})  # not in stacks of eyespot 0.1
    if viewing.get("eye", "none") == "none":
        return ""
    return f"{viewing['lens']}, {viewing['form']}"


class Condition(NamedTuple):
    """A way to group images.

    Attributes:
        name: name of the condition with its unit, as in score.csv.
        title: title in figures.
        group_of: returns the group of an image, or "" if it has none.
        order: order of the groups; others follow by name.
    """

    name: str
    title: str
    group_of: Callable[[Circumstances], str]
    order: tuple[str, ...] = ()

    def groups(self, images: Iterable[Circumstances]) -> list[str]:
        """The groups of some images, in order."""
        place = {group: index for index, group in enumerate(self.order)}
        found = {self.group_of(image) for image in images} - {""}
        return sorted(found, key=lambda group: (place.get(group, len(place)), group))


def _binned(
    name: str,
    title: str,
    value_of: Callable[[Circumstances], float],
    edges: tuple[float, ...],
) -> Condition:
    """Groups [edge, next edge); the last group has no upper limit."""
    groups = tuple(
        f"≥ {low:g}" if math.isinf(high) else f"{low:g}–{high:g}"
        for low, high in zip(edges, (*edges[1:], math.inf), strict=True)
    )

    def group_of(image: Circumstances) -> str:
        # Labels such as c = 0 may have rounding errors of either sign.
        index = np.searchsorted(edges, value_of(image) + 1e-9, side="right") - 1
        return groups[max(int(index), 0)]

    return Condition(name, title, group_of, groups)


CONDITIONS = (
    Condition("split", "split", lambda image: image.split, _SPLITS),
    Condition("adverse", "adverse condition", lambda image: image.adverse),
    Condition("pair", "partner of a pair", lambda image: image.pair, ("first",)),
    Condition("viewing", "viewing path", lambda image: image.viewing),
    Condition("source", "light source", lambda image: image.source),
    Condition("wall", "wall", lambda image: image.wall),
    Condition("exposure", "exposure", lambda image: image.labels.exposure),
    Condition("medium", "medium", lambda image: image.labels.medium),
    _binned("c_mm", "eccentricity $c$ (mm)", lambda image: image.labels.c_mm, (0, 2, 4, 6)),
    _binned("d_mm", "distance $d$ (mm)", lambda image: image.labels.d_mm, (0, 1, 2, 4, 6)),
    _binned(
        "incidence_deg",
        "incidence (°)",
        lambda image: math.degrees(image.labels.incidence_rad),
        (0, 15, 30, 45),
    ),
    _binned("speed_mm_s", "speed (mm/s)", lambda image: image.labels.speed_mm_s, (0, 0.5, 1.5, 5)),
    _binned(
        "blur_px", "blur: path in an exposure (px)", lambda image: image.blur_px, (0, 0.5, 2, 8)
    ),
    _binned(
        "visible_fraction",
        "visible fraction",
        lambda image: image.labels.visible_fraction,
        (0, 0.5, 0.75, 0.95),
    ),
    _binned(
        "saturated_fraction",
        "saturated fraction",
        lambda image: image.labels.saturated_fraction,
        (0, 0.001, 0.1, 0.5),
    ),
)
