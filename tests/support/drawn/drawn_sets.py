"""Labelled sets whose frames are drawn, not rendered: quick to make, and true by construction."""

import hashlib
import json
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from eyespot.formats.stack import FrameLabels, StackWriter
from eyespot.scenes import load_scene
from eyespot.scenes.drawn import Drawing, Truth, frame_of
from tests.support.drawn.made_up import microscope_content

SHAPE = (120, 160)
STACKS = {"train": ("a", "b"), "adverse": ("shadow-0000",)}
MICROSCOPE: dict[str, object] = microscope_content(
    SHAPE[::-1], scale_mm_px=23.0 / 858.2, pinhole_height_mm=11.5, paper_exposure_s=0.02
)


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file, by its name; folders too."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        if path.is_file()
        else ""
        for path in sorted(folder.rglob("*"))
    }


def image_row(labels: FrameLabels, *, stack: str) -> dict[str, Any]:
    """Row of an image of a cone on an even wall, in a set that lies on no disk."""
    of_stack = {"stack": stack, "split": "test", "adverse": "", "pair": "", "viewing": ""}
    of_scene = {"scale_mm_px": 0.01, "source": "cone", "wall": "uniform"}
    return vars(labels) | of_stack | of_scene


def labels_of(index: int, **known: Any) -> FrameLabels:
    """Labels of the index-th image: a spot that grows and wanders, its cone's edge 1 px wider."""
    spot = {
        "x_px": 70.0 + 3 * index,
        "y_px": 58.0 - index,
        "semi_major_px": 28.0 + 2 * index,
        "semi_minor_px": 25.0 + 2 * index,
        "angle_rad": 0.3,
    }
    cone = spot | {name: spot[name] + 1 for name in ("semi_major_px", "semi_minor_px")}
    labels = FrameLabels(
        file_name=f"frames/{index:06d}.png",
        mask_file_name=f"masks/{index:06d}.png",
        frame=index,
        time_s=index / 10,
        exposure="metered",
        exposure_s=0.02,
        d_mm=1.0 + index,
        nearest_mm=0.9 + index,
        c_mm=3.0,
        azimuth_rad=0.0,
        phi_rad=math.asin(3.0 / 11.5),
        incidence_rad=0.5,
        incidence_azimuth_rad=1.5,
        tip_mm=(0.5, 0.25, -9.0 + index),
        axis=(0.0, 0.0, -1.0),
        spot_mm=(3.0, 0.0, -11.1),
        **{f"half_max_{name}": value for name, value in spot.items()},
        **{f"cone_{name}": value for name, value in cone.items()},
        visible_fraction=1.0,
        saturated_fraction=0.0,
        speed_mm_s=1.0,
        medium="air",
        seed=0,
    )
    known.setdefault("nearest_mm", 0.9 * known.get("d_mm", labels.nearest_mm / 0.9))
    return labels.model_copy(update=known)


def write_stack(folder: Path, labels: Sequence[FrameLabels], *, seed: int = 0) -> Path:
    """A stack whose images show what their labels say, but for spots that are hidden."""
    rng = np.random.default_rng(seed)
    described = load_scene(None, [f"seed={seed}", "source.kind=cone"])
    with StackWriter(folder) as writer:
        kinematics = np.array([[n / 20 - 0.1, 1, 2, n / 20, 0, 0, -1] for n in range(20)])
        writer.describe(
            stack={"scene": described.model_dump(mode="json", by_alias=True)},
            microscope=MICROSCOPE,
            kinematics=kinematics,
        )
        for row in labels:
            truth = Truth(
                x=row.half_max_x_px,
                y=row.half_max_y_px,
                semi_major=row.half_max_semi_major_px,
                semi_minor=row.half_max_semi_minor_px,
                angle=row.half_max_angle_rad,
            )
            amplitude = 180.0 if row.visible_fraction else 0.0
            scene = Drawing(truth=truth, amplitude=amplitude)
            silent = replace(scene, noise=0.0, ambient=0.0)
            seen = frame_of(silent, rng, SHAPE).max(axis=2) > amplitude / 2
            mask = np.where(seen & (amplitude > 0), 255, 0).astype(np.uint8)
            writer.add(frame_of(scene, rng, SHAPE), row, mask)
    return folder


def with_false_labels(stack: Path, copy: Path) -> Path:
    """A copy of a stack in which no number of a label is true but the times."""
    shutil.copytree(stack, copy)
    rows = map(json.loads, (copy / "metadata.jsonl").read_text().splitlines())
    kept = {"time_s", "exposure_s"}
    told = (
        {n: 1.0 if isinstance(v, float) and n not in kept else v for n, v in row.items()}
        for row in rows
    )
    (copy / "metadata.jsonl").write_text("".join(json.dumps(row) + "\n" for row in told))
    return copy


def describe_set(folder: Path, stacks: Mapping[str, Sequence[str]]) -> None:
    """Write set.json; adverse stacks are named CONDITION-NUMBER."""
    rows: list[dict[str, Any]] = [
        {
            "split": split,
            "name": name,
            "condition": name.rpartition("-")[0] if split == "adverse" else None,
            "parameters": {},
        }
        for split, names in stacks.items()
        for name in names
    ]
    content = {"schema": 1, "name": "drawn-v1", "licence": "CC-BY-4.0", "stacks": rows}
    (folder / "set.json").write_text(json.dumps(content))


def write_set(folder: Path, images: int = 4) -> Path:
    """Two stacks to train on, one of them in two exposures, and an adverse one."""
    for split, names in STACKS.items():
        for number, name in enumerate(names):
            labels = [labels_of(index) for index in range(images)]
            if name == "b":
                labels = [
                    row.model_copy(
                        update={
                            "exposure": kind,
                            "file_name": f"frames/{2 * row.frame + order:06d}.png",
                        }
                    )
                    for row in labels
                    for order, kind in enumerate(("paper", "metered"))
                ]
            if split == "adverse":
                labels[1] = labels[1].model_copy(update={"visible_fraction": 0.0})
            write_stack(folder / split / name, labels, seed=number)
    describe_set(folder, STACKS)
    return folder
