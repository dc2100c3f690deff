"""The reference that docs/generated.py writes leaves nothing out, and its schemas are true."""

import json
import pkgutil
import re
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pandas as pd
import pytest

from docs.generated import write_pages
from docs.schemas import KINDS, rows_of, schema_of
from eyespot.calibration.command.fit_verdict import Fault
from eyespot.estimator.distance.budget import Cause
from eyespot.formats.spot import Reason
from eyespot.scenes import Scene
from tests.support.command_line import WORDS, options_of, printed

HOME = Path(__file__).resolve().parents[2]
PACKAGES = ("formats", "optics", "scenes", "estimator", "calibration", "benchmarks")
SAMPLE = HOME / "benchmarks" / "sets" / "score" / "sample-v2"


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reference")
    write_pages(folder)
    return {path.name: path.read_text(encoding="utf-8") for path in folder.iterdir()}


@pytest.mark.parametrize("words", WORDS)
def test_every_command_is_there_with_every_option(pages, words):
    section = pages["commands.md"].partition(f"## eyespot {words}\n")[2]
    assert section
    section = re.split(r"\n#+ eyespot", section)[0]
    for option in options_of(words):
        assert f"`{option.name}" in section


def test_every_scene_key_is_there_with_its_meaning(pages):
    text = pages["scene_keys.md"]
    for part in [Scene.model_json_schema(), *Scene.model_json_schema()["$defs"].values()]:
        for key, value in part["properties"].items():
            assert f"`{key}`" in text or f"`[{key}]" in text, key
            if "$ref" not in value and "description" in value:
                assert value["description"].split("|")[0] in text


def test_every_reason_is_there_with_what_to_do(pages):
    text = pages["messages.md"]
    for kind in (Reason, Cause):
        for one in kind:
            assert f"| `{one.value}` | {one.meaning}" in text
    for fault in Fault:
        assert f"| {fault.name.lower().replace('_', ' ')} |" in text


PAGES = {
    path: path.read_text(encoding="utf-8")
    for path in sorted((HOME / "docs").rglob("*.md"))
    if "generated" not in path.parts
}
CITED = re.compile(rf"`(eyespot\.(?:{'|'.join(PACKAGES)})(?:\.\w+)+)`")


def test_what_pages_cite_exists():
    tests = "".join(path.read_text(encoding="utf-8") for path in HOME.glob("tests/*/test_*.py"))
    for path, text in PAGES.items():
        for name in re.findall(r"`(test_\w+)`", text):
            assert f"def {name}(" in tests, f"{path}: {name}"
        for name in CITED.findall(text):
            assert pkgutil.resolve_name(name), f"{path}: {name}"


def test_every_page_of_the_theory_cites_functions_and_tests():
    for path, text in PAGES.items():
        if path.parent.name == "theory" and path.name != "index.md":
            assert re.search(r"`test_\w+`", text), path
            assert CITED.search(text), path


SCHEMAS = {kind.slug: kind for kind in KINDS}


def faults(slug: str, content: object) -> list[str]:
    validator = jsonschema.Draft202012Validator(schema_of(SCHEMAS[slug]))
    return [f"{fault.json_path}: {fault.message}"[:300] for fault in validator.iter_errors(content)]


@pytest.mark.parametrize("slug", SCHEMAS)
def test_a_schema_is_one_and_explains_every_key(slug):
    schema = schema_of(SCHEMAS[slug])
    jsonschema.Draft202012Validator.check_schema(schema)
    rows = list(rows_of(schema))
    assert rows
    if slug != "scene":  # its keys have a page of their own
        assert not [key for key, _, _, meaning in rows if not meaning]


def content_of(path: Path) -> dict[str, Any]:
    text = path.read_text()
    return tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)


def cells(path: Path) -> list[dict[str, Any]]:
    """Rows of a CSV file as the schemas have them."""
    table = pd.read_csv(path).astype(object)
    return table.where(table.notna(), None).to_dict("records")  # type: ignore[return-value]


def test_the_files_of_a_set_fulfil_their_schemas():
    stack = SAMPLE / "test" / "0000"
    for slug in ("set", "manifest"):
        assert not faults(slug, content_of(SAMPLE / f"{slug}.json"))
    assert not faults("spec", content_of(SAMPLE / "spec.toml"))
    assert not faults("stack", content_of(stack / "stack.toml"))
    assert not faults("scene", content_of(stack / "stack.toml")["scene"])
    assert not faults("microscope", content_of(stack / "microscope.json"))
    for line in (stack / "metadata.jsonl").read_text().splitlines():
        assert not faults("labels", json.loads(line))
    for row in cells(stack / "kinematics.csv"):
        assert not faults("kinematics", row)


@pytest.mark.parametrize(
    ("slug", "pattern"),
    [
        ("eye", "optics/viewing/eyes/*.toml"),
        ("viewing-lens", "optics/viewing/lenses/*.toml"),
        ("glue-lens", "optics/lenses/*.toml"),
        ("spec", "benchmarks/sets/named/*.toml"),
    ],
)
def test_files_that_come_with_eyespot_fulfil_their_schemas(slug, pattern):
    files = sorted(HOME.glob(pattern))
    assert files
    for file in files:
        assert not faults(slug, content_of(file)), file


SCENE = [
    *("source.kind=cone", "phantom.kind=plane", "phantom.wall=uniform", "motion.frames=9"),
    *("spot.eccentricity_mm=1", 'exposures.kinds=["metered"]'),
    *("microscope.width_px=320", "microscope.height_px=240", "microscope.scale_mm_px=0.0134"),
]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A folder in which eyespot's commands have written files, from a scene to a budget."""
    folder = tmp_path_factory.mktemp("written")
    changes = [word for change in SCENE for word in ("--set", change)]
    (folder / "stated.toml").write_text("eye_radius_sigma_mm = 0.2\ntouch_sigma_mm = 0.02\n")
    printed("scene", "init", folder / "scene.toml")
    printed("render", folder / "scene.toml", "--out", folder / "stack", *changes)
    printed("fit", folder / "stack", "--model", "plane", "--out", folder / "beam.json")
    calibrated = ("--calibration", folder / "beam.json")
    printed("track", folder / "stack", *calibrated, "--out", folder / "spots.csv")
    stated = ("--rig", folder / "stated.toml", "--json")
    budget = printed("budget", folder / "stack", *calibrated, *stated, "--frame", "6")
    (folder / "budget.json").write_text(budget)
    plan = ("--uncertain", "phantom.radius_mm=0.2", "--calibration", folder / "beam.json")
    printed("preregister", folder / "scene.toml", "--out", folder / "plan.json", *plan, *changes)
    return folder


@pytest.mark.parametrize(
    ("slug", "file"),
    [
        ("scene", "scene.toml"),
        ("stack", "stack/stack.toml"),
        ("microscope", "stack/microscope.json"),
        ("manifest", "stack/manifest.json"),
        ("calibration", "beam.json"),
        ("budget", "budget.json"),
        ("plan", "plan.json"),
    ],
)
def test_a_file_that_was_written_fulfils_its_schema(written, slug, file):
    assert not faults(slug, content_of(written / file))


def test_rows_that_were_written_fulfil_their_schemas(written):
    rows = cells(written / "spots.csv")
    assert len(rows) == 9
    for row in rows:
        assert not faults("spots", row)
    for row in cells(written / "stack" / "kinematics.csv"):
        assert not faults("kinematics", row)
    for line in (written / "stack" / "metadata.jsonl").read_text().splitlines():
        assert not faults("labels", json.loads(line))


def test_an_entry_of_a_leaderboard_fulfils_its_schemas(tmp_path):
    text = (HOME / "docs" / "leaderboard.md").read_text(encoding="utf-8")
    examples = re.findall(r"```json\n(.*?)```", text, flags=re.DOTALL)
    for example in examples:
        assert not faults("entry", json.loads(example))
    (tmp_path / "mine.csv").write_text(
        "file_name,x_px,y_px,semi_major_px,semi_minor_px\n"
        "test/0000/frames/000000.png,322.41,240.18,61.02,58.77\n"
        "test/0000/frames/000001.png,,,,\n"
    )
    for row in cells(tmp_path / "mine.csv"):
        assert not faults("plain-spots", row)
