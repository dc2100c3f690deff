"""The loader for PyTorch in the documentation, as it stands there."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.sets.read import read_set, rows
from benchmarks.sets.score.spots import sample_folder

PAGE = Path(__file__).resolve().parents[2] / "docs" / "datasets.md"


def documented_class() -> Any:
    (code,) = (
        block
        for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
        if "class Spots" in block
    )
    found: dict[str, Any] = {}
    exec(code, found)
    return found["Spots"]


def test_the_loader_returns_images_ellipses_and_distances_of_a_split():
    """A map-style dataset of PyTorch is any object with these two methods; torch is not here."""
    dataset = documented_class()(sample_folder(), "test")
    truth = [row for row in rows(read_set(sample_folder())) if row.planned.split == "test"]
    assert len(dataset) == len(truth) == 30
    for index in (0, 7, 29):
        image, ellipse, distance = dataset[index]
        labels, shown = truth[index].labels, truth[index].stack.image(truth[index].labels)
        np.testing.assert_allclose(image.transpose(1, 2, 0) * 255, shown, atol=1e-4)
        # Single precision of numbers up to 320 px.
        place = (labels.half_max_x_px, labels.half_max_y_px)
        np.testing.assert_allclose(ellipse[:2], place, rtol=1e-6)
        np.testing.assert_allclose(ellipse[3], labels.half_max_semi_minor_px, rtol=1e-6)
        np.testing.assert_allclose(distance, labels.d_mm, rtol=1e-6)
        assert image.dtype == ellipse.dtype == np.float32
