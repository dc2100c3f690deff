"""What the schema of a file forbids, its reader refuses with the names of the file and the key."""

import csv
import json
import shutil
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import hypothesis.strategies as st
import jsonschema
import pytest
import tomli_w
from hypothesis import HealthCheck, assume, given, settings

from docs.schemas import KINDS, schema_of
from eyespot.benchmarks.sets.read import read_set
from eyespot.benchmarks.sets.spec import load_spec
from eyespot.formats.calibration import read_calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.manifest import read_manifest
from eyespot.formats.microscope import read_microscope
from eyespot.formats.rig import read_rig
from eyespot.formats.spots import read_spots
from eyespot.formats.stack import read_stack
from eyespot.optics import load_lens
from eyespot.optics.viewing import schematic_eye as eye
from eyespot.scenes import Scene
from eyespot.scenes.description.scene_file import load_scene, scene_toml
from tests.house.test_bad_input import RIG
from tests.support.drawn.made_up import DOME
from tests.support.files.bad_input import OLD

STACK = OLD / "small-v1" / "train" / "0000"
SCHEMAS = {kind.slug: schema_of(kind) for kind in KINDS}


class Sample(NamedTuple):
    """A good file: its name, the text of it, and its reader, which takes its path."""

    name: str
    text: str
    read: Callable[[Path], object]


def old(name: str, read: Callable[[Path], object]) -> Sample:
    return Sample(Path(name).name, (OLD / name).read_text(), read)


SAMPLES = {
    "microscope": old("small-v1/train/0000/microscope.json", read_microscope),
    "calibration": old("calibration.json", read_calibration),
    "labels": old("small-v1/train/0000/metadata.jsonl", lambda path: read_stack(path.parent)),
    "spots": old("spots.csv", read_spots),
    "rig": Sample("rig.toml", RIG, read_rig),
    "scene": Sample("scene.toml", scene_toml(Scene()), load_scene),
    "spec": old("spec.toml", load_spec),
    "set": old("small-v1/set.json", lambda path: read_set(path.parent)),
    "manifest": old(
        "small-v1/manifest.json", lambda path: read_manifest(path.parent, remedy="Make it again.")
    ),
    "eye": Sample(
        "eye.toml", (Path(eye.__file__).parent / "eyes" / "navarro.toml").read_text(), eye.load_eye
    ),
    "glue-lens": Sample("lens.toml", tomli_w.dumps({"schema": 1, "lens": DOME}), load_lens),
}
WRONG: tuple[Any, ...] = (True, "wide", "", -1e30, 1e30, 1.5, None, [], {}, [True], {"a": 1})
"""Values of which each key of each file forbids some."""


def content_of(sample: Sample) -> Any:
    match Path(sample.name).suffix:
        case ".toml":
            return tomllib.loads(sample.text)
        case ".csv":
            cells = next(csv.DictReader(sample.text.splitlines()))
            return {name: cell for name, cell in cells.items() if cell}
        case ".jsonl":
            return json.loads(sample.text.splitlines()[0])
    return json.loads(sample.text)


def write(path: Path, sample: Sample, content: Any) -> None:
    match path.suffix:
        case ".toml":
            path.write_text(tomli_w.dumps(content))
        case ".csv":
            with path.open("w", newline="") as file:
                names = next(csv.reader([sample.text.splitlines()[0]]))
                table = csv.DictWriter(file, dict.fromkeys([*names, *content]))
                table.writeheader()
                table.writerow(content)
        case ".jsonl":
            path.write_text("\n".join([json.dumps(content), *sample.text.splitlines()[1:], ""]))
        case _:
            path.write_text(json.dumps(content))


def fulfils(part: Any, value: object, whole: dict[str, Any]) -> bool:
    return jsonschema.Draft202012Validator({**part, "$defs": whole.get("$defs", {})}).is_valid(
        value
    )


def places(
    part: dict[str, Any], content: Any, whole: dict[str, Any]
) -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
    """The paths in a content, and keys that it could have, with the schema of each."""
    if "$ref" in part:
        part = whole["$defs"][part["$ref"].rpartition("/")[2]]
    options = part.get("anyOf") or part.get("oneOf") or []
    for option in options:
        if fulfils(option, content, whole):
            yield from places(option, content, whole)
    inner = dict(part.get("properties", {})) if isinstance(content, dict) else {}
    if isinstance(more := part.get("additionalProperties"), dict) and isinstance(content, dict):
        inner |= dict.fromkeys(list(content)[:2], more)
    if isinstance(content, list) and content:
        inner[0] = part.get("items") or (part.get("prefixItems") or [{}])[0]
    for key, known in inner.items():
        yield (key,), known
        there = content[key] if isinstance(key, int) else content.get(key, {})
        yield from (((key, *path), found) for path, found in places(known, there, whole))


def changed(content: Any, path: tuple[Any, ...], value: object) -> Any:
    key, *rest = path
    if isinstance(content, list):
        return [changed(content[0], tuple(rest), value) if rest else value, *content[1:]]
    return content | {key: changed(content.get(key, {}), tuple(rest), value) if rest else value}


@pytest.mark.parametrize("slug", SAMPLES)
@settings(
    derandomize=True,
    max_examples=80,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.filter_too_much],
)
@given(data=st.data())
def test_a_reader_refuses_what_the_schema_forbids(tmp_path, slug, data):
    sample, whole = SAMPLES[slug], SCHEMAS[slug]
    content = content_of(sample)
    path, part = data.draw(st.sampled_from(list(places(whole, content, whole))))
    value = data.draw(st.sampled_from(WRONG))
    form = sample.name.rpartition(".")[2]
    assume(not fulfils(part, value, whole))
    assume(form != "toml" or value is not None)  # TOML has no null
    # An empty cell of a CSV file is none, and every other is a text.
    assume(form != "csv" or (value not in ("", None) and not fulfils(part, "wide", whole)))
    assume(slug != "spec" or path != ("scene",) or not isinstance(value, str))  # a scene's file
    file = tmp_path / "stack" / sample.name
    if slug in ("labels", "set") and not file.parent.exists():
        shutil.copytree(STACK if slug == "labels" else OLD / "small-v1", file.parent)
    file.parent.mkdir(exist_ok=True)
    write(file, sample, content)
    sample.read(file)
    write(file, sample, changed(content, path, value))
    with pytest.raises(InputError) as caught:
        sample.read(file)
    named = [key for key in path if isinstance(key, str)]
    assert file.name in str(caught.value) or file.parent.name in str(caught.value)
    said = named[-1].removesuffix("_version")
    assert said in str(caught.value), f"{path} = {value!r}: {caught.value}"
