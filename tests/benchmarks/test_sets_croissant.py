"""croissant.json: MLCommons' own library accepts it, and reads labels and images by it."""

import json

import datasets
import numpy as np
import pytest

from eyespot.benchmarks.sets.card import write_card
from eyespot.benchmarks.sets.croissant import meaning
from eyespot.benchmarks.sets.read import read_set, rows
from tests.support.command_line import run_python
from tests.support.drawn.drawn_sets import write_set

READ = """
import json
import mlcroissant

dataset = mlcroissant.Dataset(jsonld="croissant.json")
assert not dataset.metadata.ctx.issues.errors, dataset.metadata.ctx.issues.errors
found = {"labels": [], "images": []}
for record in dataset.records("train"):
    found["labels"].append({key: value for key, value in record.items() if key == "train/d_mm"})
for record in dataset.records("train-frames"):
    path, image = record["train-frames/path"], record["train-frames/image"]
    found["images"].append([path.decode(), image.size])
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def carded(tmp_path_factory):
    folder = write_set(tmp_path_factory.mktemp("croissant") / "set")
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


def test_the_library_of_the_format_reads_labels_and_images(carded):
    # In a process of its own: the library warns of its dependencies' code.
    done = run_python(READ, cwd=carded, PYTHONWARNINGS="ignore")
    assert done.exit_code == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    train = [row for row in rows(read_set(carded)) if row.planned.split == "train"]
    assert [line["train/d_mm"] for line in found["labels"]] == [row.labels.d_mm for row in train]
    paths = {f"train/{row.line()['file_name']}" for row in train}
    assert {path for path, _ in found["images"]} == paths
    assert all(size == [160, 120] for _, size in found["images"])


def test_a_label_that_only_some_images_have_is_a_column_of_all_splits(carded, tmp_path):
    loaded = datasets.load_dataset(str(carded), cache_dir=str(tmp_path))
    known = {split: np.isfinite(loaded[split]["bound_d_mm"]) for split in ("train", "adverse")}
    assert known["train"].sum() == 4  # images of the stack a
    assert not known["adverse"].any()


def test_every_column_of_a_set_has_a_meaning(carded):
    described = json.loads((carded / "croissant.json").read_text())
    (train,) = (own for own in described["recordSet"] if own["@id"] == "train")
    fields = {field["source"]["extract"]["column"] for field in train["field"]}
    first = (carded / "train" / "metadata.jsonl").read_text().splitlines()[0]
    assert fields == set(json.loads(first))
    assert not [name for name in fields if meaning(name).startswith("Key ")]


def test_the_card_states_licence_and_intended_use(carded):
    card = (carded / "README.md").read_text()
    for words in ("## Intended use", "Not intended", "CC-BY-4.0", "croissant.json"):
        assert words in card
