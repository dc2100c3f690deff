"""The card of a set, and its label tables as Hugging Face loads them."""

import json

import datasets
import numpy as np
import pytest

from eyespot.benchmarks.sets.card import write_card
from eyespot.benchmarks.sets.read import read_set
from tests.support.drawn.drawn_sets import SHAPE, write_set


@pytest.fixture(scope="module")
def carded(tmp_path_factory):
    folder = write_set(tmp_path_factory.mktemp("card") / "set")
    path = folder / "set.json"
    content = json.loads(path.read_text())
    more = {"description": "Drawn spots.", "seed": 0, "versions": {}, "spec": {"name": "drawn"}}
    path.write_text(json.dumps(content | more))
    for stack in folder.glob("*/*/stack.toml"):
        stack.write_text(stack.read_text() + "\n[cone]\nhalf_angle = 0.05\n")
    # Images of one stack have a label that the others lack.
    table = folder / "train" / "a" / "metadata.jsonl"
    lines = [json.loads(line) | {"bound_d_mm": 0.001} for line in table.read_text().splitlines()]
    table.write_text("".join(json.dumps(line) + "\n" for line in lines))
    write_card(read_set(folder))
    return folder


def test_a_label_that_only_some_images_have_is_a_column_of_all_splits(carded, tmp_path):
    loaded = datasets.load_dataset(str(carded), cache_dir=str(tmp_path))
    known = {split: np.isfinite(loaded[split]["bound_d_mm"]) for split in ("train", "adverse")}
    assert known["train"].sum() == 4  # images of the stack a
    assert not known["adverse"].any()


def test_every_split_is_loaded_with_images_masks_and_labels(carded, tmp_path):
    every = datasets.load_dataset(str(carded), cache_dir=str(tmp_path))
    # Four images of one stack, and twice four of the other.
    assert {split: len(rows) for split, rows in every.items()} == {"train": 12, "adverse": 4}
    (adverse,) = datasets.load_dataset(str(carded), "adverse", cache_dir=str(tmp_path)).values()
    row = adverse[3]
    assert row["image"].size == row["mask"].size == SHAPE[::-1]
    assert (row["condition"], row["c_mm"]) == ("shadow", 3.0)


def test_the_card_states_licence_and_intended_use(carded):
    card = (carded / "README.md").read_text()
    for words in ("## Intended use", "Not intended", "CC-BY-4.0"):
        assert words in card
