"""Writes the data card and the label tables of a complete set."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import tomli_w
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.paper import ELLIPSE
from eyespot.benchmarks.sets.asked import asked_and_drawn
from eyespot.benchmarks.sets.read import LabelledSet, Row, rows
from eyespot.formats.whole_files import write_text, written_whole

# Figures of the data card: histograms of the labels and sample images.

_COLOURS = {
    "train": page.BLUE,
    "validation": page.GREEN,
    "test": page.ORANGE,
    "adverse": page.VERMILION,
    "unseen": page.PURPLE,
}
_BINS, _COLUMNS = 24, 4
_IMAGES_A_GROUP = 6
_WIDTH_IN = 10.0

QUANTITIES = {
    "c_mm": ("c, eccentricity", "mm"),
    "d_mm": ("d, tip to wall along the beam", "mm"),
    "incidence_deg": ("incidence", "deg"),
    "cone_k": ("k, 1/tan of the cone's half-angle", ""),
    "half_max_semi_minor_px": ("semi-minor axis, half maximum", "px"),
    "visible_fraction": ("visible fraction of the contour", ""),
    "saturated_fraction": ("saturated fraction of the spot", ""),
    "speed_mm_s": ("speed of the tip", "mm/s"),
}
"""Name and unit of labels by column."""


def histograms(labels: pd.DataFrame, path: Path) -> None:
    """Draw histograms of each quantity, with one line per split."""
    lines = math.ceil(len(QUANTITIES) / _COLUMNS)
    with mpl.rc_context(page.STYLE):
        figure = Figure(figsize=(_WIDTH_IN, 2.1 * lines + 0.4), layout="constrained")
        panels = figure.subplots(lines, _COLUMNS, squeeze=False).ravel()
        for axes, (column, (name, unit)) in zip(panels, QUANTITIES.items(), strict=True):
            low, high = labels[column].min(), labels[column].max()
            # If all values are equal up to rounding, draw one bar.
            alike = high - low < 1e-6 * max(abs(low), abs(high), 1.0)
            edges = low + np.array([-0.5, 0.5]) if alike else np.linspace(low, high, _BINS + 1)
            for split, values in page.grouped(labels, "split"):
                part = np.histogram(values[column], edges)[0] / len(values)
                axes.stairs(part, edges, color=_COLOURS[split], label=split)
            axes.set_xlabel(f"{name} ({unit})" if unit else name)
            axes.set_ylim(bottom=0)
        panels[0].set_ylabel("fraction of the split's images")
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=len(names))
        with written_whole(path, replace=True) as partial:
            figure.savefig(partial)


def samples(rows: Sequence[Row], path: Path) -> None:
    """Draw sample images of every split and condition with their true half-maximum ellipses."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        name = "\n".join(filter(None, [row.planned.split, row.planned.condition]))
        groups.setdefault(name, []).append(row)
    with mpl.rc_context(page.STYLE):
        size = _WIDTH_IN, 1.5 * len(groups)
        figure = Figure(figsize=size, layout="constrained")
        lines = figure.subplots(len(groups), _IMAGES_A_GROUP, squeeze=False)
        for axes in lines.flat:
            axes.set_axis_off()
        for (name, group), line in zip(groups.items(), lines, strict=True):
            line[0].text(-0.05, 0.5, name, ha="right", va="center", transform=line[0].transAxes)
            # Evenly spread over the stacks and distances.
            chosen = (
                np.linspace(0, len(group) - 1, min(_IMAGES_A_GROUP, len(group))).round().astype(int)
            )
            for axes, row in zip(line, [group[i] for i in chosen], strict=False):
                _draw(axes, row)
        with written_whole(path, replace=True) as partial:
            figure.savefig(partial)


def _draw(axes: Axes, row: Row) -> None:
    """One image with its ellipse."""
    of, bits = row.labels, row.stack.described("scene.camera.bit_depth", int)
    true = [getattr(of, f"half_max_{name}") for name in ELLIPSE]
    look = {"color": page.ORANGE, "lw": 0.8, "ls": (0, (3, 2))}
    page.draw_spots(axes, row.stack.image(of), bits, (true, look))
    axes.set_title(f"$d$ {of.d_mm:.1f}, $c$ {of.c_mm:.1f} mm", size=7)


_LICENCES = {
    "CC-BY-4.0": "Creative Commons Attribution 4.0 International\n"
    "https://creativecommons.org/licenses/by/4.0/legalcode\n",
}
"""Text of LICENSE by SPDX name; for other licences it is the name itself."""


def write_card(labelled: LabelledSet) -> None:
    """Write README.md with its figures, LICENSE, spec.toml and the label tables."""
    images = list(rows(labelled))
    every = [(row.planned.split, row.line()) for row in images]
    columns = dict.fromkeys(name for _, line in every for name in line)
    tables: dict[str, list[dict[str, Any]]] = {split: [] for split in labelled.splits}
    for split, line in every:
        # A label that only some images have is NaN in the others. JSON's null would be stricter,
        # but Hugging Face's loader refuses a set with a split that has only null in a column.
        tables[split].append({name: line.get(name, math.nan) for name in columns})
    for split, lines in tables.items():
        text = "".join(json.dumps(line) + "\n" for line in lines)
        write_text(labelled.folder / split / "metadata.jsonl", text, replace=True)
    texts = {
        "LICENSE": _LICENCES.get(labelled.licence, f"{labelled.licence}\n"),
        "spec.toml": tomli_w.dumps(labelled.description["spec"]),
    }
    for name, text in texts.items():
        write_text(labelled.folder / name, text, replace=True)
    labels = pd.DataFrame([{"split": split, **line} for split, line in every])
    labels = labels.assign(incidence_deg=np.degrees(labels.incidence_rad))
    counts = labels.groupby(["split", "condition"], sort=False)["stack"]
    ranges = [
        (*about, *np.quantile(labels[column], [0.0, 0.5, 1.0]))
        for column, about in QUANTITIES.items()
    ]
    parameters, pairs = asked_and_drawn(labelled)
    histograms(labels, labelled.folder / "histograms.png")
    samples(images, labelled.folder / "samples.png")
    text = (
        page.environment()
        .get_template("dataset_card.md.j2")
        .render(
            set=labelled,
            about=labelled.description,
            # `load_dataset(DIR)` loads all splits, `load_dataset(DIR, NAME)` one.
            configs={"default": labelled.splits} | {split: [split] for split in labelled.splits},
            counts=page.rows_of(counts.agg(stacks="nunique", images="size").reset_index()),
            images=len(images),
            ranges=ranges,
            bounded="bound_semi_minor_px" in labels,
            varied=sorted(labelled.stacks[0].parameters),
            parameters=page.rows_of(parameters),
            pairs=page.rows_of(pairs),
            left_out=labelled.description.get("left_out", []),
        )
    )
    write_text(labelled.folder / "README.md", text, replace=True)
