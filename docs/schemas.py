"""JSON schemas of every kind of file that eyespot reads or writes, made from its reader.

A schema describes the content of a file: of a TOML file what a TOML reader returns, of a CSV file
one row whose cells are numbers where the column holds numbers and null where they are empty.
"""

from collections.abc import Iterator
from functools import reduce
from operator import or_
from typing import Any, NamedTuple

from pydantic import TypeAdapter

from docs.file_meanings import COMMON, MEANINGS, attributes_of, named
from eyespot.formats.stack import KINEMATICS

DIALECT = "https://json-schema.org/draft/2020-12/schema"
_NUMBER, _WHOLE, _TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}


class FileKind(NamedTuple):
    """A kind of file.

    Attributes:
        slug: begins the name of its schema.
        title: in the reference.
        about: what it is for, and which command writes or reads it.
        models: pydantic models of the content, "module:name"; a file is one of them.
        meanings: classes whose docstring explains keys of the same names.
    """

    slug: str
    title: str
    about: str
    models: tuple[str, ...] = ()
    meanings: tuple[str, ...] = ()


KINDS = (
    FileKind(
        "scene",
        "Scene (TOML)",
        "What `eyespot render` renders. `eyespot scene init` writes one with all keys; their "
        "meanings and units are [on a page of their own](scene_keys.md).",
        models=("eyespot.scenes.description.scene:Scene",),
    ),
    FileKind(
        "stack",
        "Stack: `stack.toml`",
        "The scene as it was rendered, with versions. `eyespot render` writes it.",
    ),
    FileKind(
        "labels",
        "Stack: a line of `metadata.jsonl`",
        "True values of one image. `eyespot render` writes it, `eyespot score` reads it; Hugging "
        "Face `datasets` reads the file as it is.",
        models=("eyespot.formats.stack:FrameLabels",),
    ),
    FileKind(
        "kinematics",
        "Stack: a row of `kinematics.csv`",
        "What the robot reported: time, tip, and the unit vector of its axis. `--poses` reads it.",
    ),
    FileKind(
        "rig",
        "Rig (TOML)",
        "Microscope, camera, wall, instrument and robot. `eyespot rig init` writes one with all "
        "keys; a rendered stack contains one. `--rig` takes a file of stated uncertainties of "
        "eyespot 0.1 and 0.2, too, whose keys it has.",
        models=("eyespot.formats.rig:Rig",),
    ),
    FileKind(
        "microscope",
        "Microscope (`microscope.json`)",
        "The camera over the eye. Stacks have one; `eyespot camera` adds the camera's noise. "
        "Camera calibrations of OpenCV, ROS and Kalibr are read, too."
        " A rig file names one of them.",
        models=("eyespot.formats.microscope:MicroscopeFile",),
    ),
    FileKind(
        "calibration",
        "Calibration (JSON)",
        "Parameters of a beam with their covariance. `eyespot fit` writes it; `track`, `budget`, "
        "`console` and the node read it.",
        models=("eyespot.formats.calibration:Calibration",),
    ),
    FileKind(
        "spots",
        "Spots: a row (CSV or Parquet)",
        "What was measured in one frame. `eyespot track` writes it, `eyespot fit` and `eyespot "
        "score` read it.",
        models=("eyespot.formats.spots:SpotRow",),
        meanings=("eyespot.formats.spots:SpotRecord", "eyespot.formats.spot:Spot"),
    ),
    FileKind(
        "plain-spots",
        "Plain spots: a row (CSV)",
        "Spots of any tracker, for `eyespot score`.",
        models=("eyespot.benchmarks.sets.score.scored_spots:PlainRow",),
        meanings=("eyespot.formats.spots:SpotRecord", "eyespot.formats.spot:Spot"),
    ),
    FileKind(
        "budget",
        "Budget (JSON)",
        "The uncertainty of one distance by cause: what `eyespot budget --json` prints.",
        meanings=(
            "eyespot.estimator.distance.budget:Budget",
            "eyespot.estimator.distance.budget:Part",
        ),
    ),
    FileKind(
        "plan",
        "Plan (JSON)",
        "Predictions of an experiment. `eyespot preregister` writes it, `eyespot adjudicate` reads "
        "it.",
        models=("eyespot.benchmarks.predictions:Plan",),
    ),
    FileKind(
        "spec",
        "Spec of a labelled set (TOML)",
        "What `eyespot dataset` makes. Scene keys may be nested or dotted.",
        models=("eyespot.benchmarks.sets.spec:SetSpec",),
    ),
    FileKind(
        "set",
        "Labelled set (`set.json`)",
        "The stacks of a set. `eyespot dataset` writes it.",
        models=("eyespot.benchmarks.sets.read:_SetFile",),
    ),
    FileKind(
        "manifest",
        "Manifest (`manifest.json`)",
        "Size and SHA-256 of each file in a stack or set; `eyespot dataset verify` compares.",
        models=("eyespot.formats.manifest:_Manifest",),
    ),
    FileKind(
        "entry",
        "Entry of a leaderboard (`entry.json`)",
        "What an entrant says of its tracker; `eyespot score --entries` reads it.",
        models=("eyespot.benchmarks.sets.score.scored_spots:ScoredEstimator",),
    ),
    FileKind(
        "glue-lens",
        "Glue lens (TOML)",
        "A drop of glue on a fibre (`source.lens`, `--lens`). Those of eyespot lie in "
        "`optics/lenses`.",
        meanings=("eyespot.optics.lens:GlueLens",),
    ),
    FileKind(
        "eye",
        "Eye (TOML)",
        "An eye to look into (`viewing.eye`). Those of eyespot lie in `optics/viewing/eyes`. A "
        "value `[a, b]` is a + b times the refraction in dioptres.",
        models=("eyespot.optics.viewing.schematic_eye:EyeFile",),
    ),
    FileKind(
        "viewing-lens",
        "Viewing lens (TOML)",
        "A contact lens, or a lens held above the eye (`viewing.lens`). Those of eyespot lie in "
        "`optics/viewing/lenses`.",
        models=("eyespot.optics.viewing.schematic_eye:_ViewingLensFile",),
    ),
)


def schema_of(kind: FileKind) -> dict[str, Any]:
    """The JSON schema of a kind of file, with the meanings of its keys."""
    made = _BY_HAND.get(kind.slug)
    schema = made() if made else _of_models(kind)
    if kind.slug in ("eye", "viewing-lens"):
        schema = _with_origin(schema)
    if kind.slug in ("spots", "plain-spots"):  # empty cells
        for name in schema["properties"].keys() - schema["required"]:
            column = schema["properties"][name]
            said = {key: column.pop(key) for key in ("description", "default") if key in column}
            schema["properties"][name] = said | _or_null(column)
    explained = dict(COMMON)
    for place in kind.meanings:
        explained |= attributes_of(named(place))
    explained |= MEANINGS.get(kind.slug, {})
    for part in _parts(schema):
        for key, value in part.get("properties", {}).items():
            if isinstance(value, dict) and key in explained:  # several keys may share a value
                part["properties"][key] = {"description": explained[key]} | value
    return {"$schema": DIALECT, **schema, "title": kind.title}


def _parts(schema: Any) -> Iterator[dict[str, Any]]:
    """A schema and all objects in it."""
    if isinstance(schema, dict):
        yield schema
        schema = list(schema.values())
    if isinstance(schema, list):
        for one in schema:
            yield from _parts(one)


def _of_models(kind: FileKind) -> dict[str, Any]:
    models = [named(place) for place in kind.models]
    schema: dict[str, Any] = TypeAdapter(reduce(or_, models)).json_schema()
    for part in _parts(schema):
        # Where pydantic chooses one of several options by a function, a value may meet several.
        if {} in part.get("oneOf", []):
            part["anyOf"] = part.pop("oneOf")
    return schema


def _with_origin(schema: dict[str, Any]) -> dict[str, Any]:
    origin = {
        "schema": {"const": 1, "description": "Version of the format."},
        "provenance": {**_TEXT, "description": "Source of the numbers."},
    }
    return {
        **schema,
        "properties": origin | schema["properties"],
        "required": ["schema", "provenance", *schema["required"]],
    }


def _object(properties: dict[str, Any], *, required: Iterator[str] | None = None) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties) if required is None else list(required),
        "additionalProperties": False,
    }


def _or_null(kind: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [kind, {"type": "null"}]}


def _stack() -> dict[str, Any]:
    scene = TypeAdapter(named("eyespot.scenes.description.scene:Scene")).json_schema()
    parts = scene.pop("$defs")
    return {
        "type": "object",
        "properties": {
            "schema": {"const": 1, "description": "Version of the format."},
            "scene": {"$ref": "#/$defs/Scene", "description": "The scene as rendered."},
            "cone": {"type": "object", "description": "The cone whose edge the labels describe."},
            "wall_colour": {
                "type": "array",
                "items": _NUMBER,
                "description": "Mean reflectance of the wall in red, green and blue.",
            },
            "files": {
                "type": "object",
                "description": "SHA-256 of the files that the scene names.",
            },
            "run": {"type": "object", "description": "Variant of Mitsuba, versions of libraries."},
        },
        "required": ["schema", "scene"],
        "$defs": {**parts, "Scene": scene},
    }


def _budget() -> dict[str, Any]:
    from eyespot.estimator.distance.budget import Cause

    causes = [cause.value for cause in Cause]
    number = _or_null(_NUMBER)
    part = _object(
        {
            "cause": {"enum": causes},
            "type": {"enum": ["A", "B", "A, B"], "description": "Of evaluation, by the GUM."},
            "sigma_mm": number,
            "degrees_of_freedom": {**number, "description": "null: infinitely many."},
            "source": _TEXT,
            "source_sigma": number,
            "unit": _TEXT,
        }
    )
    return _object(
        {
            "frame": {**_WHOLE, "description": "Index of the frame."},
            "distance_mm": {**_NUMBER, "description": "The reading, by the model in use."},
            "correction_mm": _NUMBER,
            "corrected_mm": {**_NUMBER, "description": "Reading plus correction."},
            "sigma_mm": {**number, "description": "Combined standard uncertainty."},
            "degrees_of_freedom": {**number, "description": "null: infinitely many."},
            "coverage_factor": {**number, "description": "Student's, of the 95 % interval."},
            "low_mm": {**number, "description": "Begin of the 95 % interval."},
            "high_mm": {**number, "description": "Its end."},
            "surface_distance_mm": {
                **_NUMBER,
                "description": "The best estimate less a clear layer over the wall.",
            },
            "largest_cause": {"enum": [None, *causes], "description": "What counts most."},
            "remedy": {**_or_null(_TEXT), "description": "What halves it."},
            "parts": {"type": "array", "items": part, "description": "By cause."},
            "left_out": {"type": "array", "items": _TEXT},
        }
    )


def _glue_lens() -> dict[str, Any]:
    from eyespot.optics import GlueLens

    meanings = attributes_of(GlueLens)
    numbers = {name: {**_NUMBER, "description": text} for name, text in meanings.items()}
    optional = ("launch_radius", "launch_aperture")
    lens = _object(numbers, required=(name for name in numbers if name not in optional))
    return {
        "type": "object",
        "properties": {
            "schema": {"const": 1, "description": "Version of the format."},
            "provenance": {"description": "Source of the numbers."},
            "lens": lens,
        },
        "required": ["schema", "lens"],
    }


_BY_HAND = {
    "stack": _stack,
    "kinematics": lambda: _object({name: {**_NUMBER} for name in KINEMATICS}),
    "budget": _budget,
    "glue-lens": _glue_lens,
}
"""Schemas of the formats whose reader is no pydantic model."""


def rows_of(schema: dict[str, Any]) -> Iterator[tuple[str, str, bool, str]]:
    """Keys with their tables, types, whether they are required, and meanings; each key once."""
    seen: set[str] = set()
    for option in _options(schema, schema):
        for row in _rows(option, schema, ""):
            if row[0] not in seen:
                seen.add(row[0])
                yield row


def _rows(
    part: dict[str, Any], whole: dict[str, Any], table: str
) -> Iterator[tuple[str, str, bool, str]]:
    required = part.get("required", [])
    for key, value in part.get("properties", {}).items():
        yield table + key, _type(value, whole), key in required, value.get("description", "")
        inner = _resolved(value.get("items", value), whole)
        for option in _options(inner, whole):
            if option.get("properties") and key not in ("scene", "calibration"):
                yield from _rows(option, whole, f"{table}{key}.")


def _options(part: dict[str, Any], whole: dict[str, Any]) -> list[dict[str, Any]]:
    options = part.get("anyOf") or part.get("oneOf") or [part]
    return [_resolved(option, whole) for option in options]


def _resolved(part: dict[str, Any], whole: dict[str, Any]) -> dict[str, Any]:
    reference = part.get("$ref", "") if isinstance(part, dict) else ""
    found: dict[str, Any] = whole["$defs"][reference.split("/")[-1]] if reference else part
    return found if isinstance(found, dict) else {}


def _type(value: dict[str, Any], whole: dict[str, Any]) -> str:
    """A type in words."""
    if "const" in value:
        return repr(value["const"])
    if "enum" in value:
        return "one of " + ", ".join("(empty)" if v is None else str(v) for v in value["enum"])
    options = value.get("anyOf") or value.get("oneOf")
    if options:
        return " or ".join(dict.fromkeys(_type(option, whole) for option in options))
    if "$ref" in value:
        return "table"
    kind = value.get("type", "any")
    if kind == "array":
        items = value.get("items") or (value.get("prefixItems") or [{}])[0]
        return f"list of {_type(items, whole)}" if items else "list"
    return {"object": "table", "string": "text", "null": "null"}.get(kind, str(kind))
