"""JSON that anyone may have written: every fault is one ValueError that names it."""

from typing import Annotated

import pytest
from pydantic import Field

from eyespot.formats.inputs import Strict, check_schema, object_in, read_text, validated


class Eye(Strict):
    radius_mm: Annotated[float, Field(ge=0)]
    name: str
    pixels: tuple[float, ...] = ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not JSON"),
        ("{", "not JSON .*line 1"),
        ("[1]", r"not a JSON object, but \[1\]"),
        ('{"a": ' * 20 + "1" + "}" * 20, "nested more than 16 levels"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a": ' + "9" * 4000 + "}", "at most 64 bits; got 9999"),
        (r'{"a": "\ud800"}', "must be Unicode"),
        (r'{"a\u0000": 1}', "without NUL"),
        (f'{{"a": {"9" * 5000}}}', "not JSON"),
    ],
)
def test_what_is_no_object_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        object_in(text)


def test_a_file_that_is_too_large_or_no_text_is_refused(tmp_path):
    path = tmp_path / "eye.json"
    path.write_bytes(b"x" * 11)
    with pytest.raises(ValueError, match="larger than 10 bytes"):
        read_text(path, most_bytes=10)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match="not a text file"):
        read_text(path)
    path.write_bytes(b"\xef\xbb\xbf{}")
    assert read_text(path) == "{}"


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"radius_mm": "11"}, "radius_mm must be a finite number; got '11'"),
        ({"radius_mm": True}, "radius_mm must be a finite number; got True"),
        ({"radius_mm": float("nan")}, "radius_mm must be a finite number; got nan"),
        ({"radius_mm": 10**400}, "radius_mm must be a finite number; got 1000"),
        ({"radius_mm": -1}, "radius_mm must be at least 0; got -1"),
        ({"name": 3}, "name must be text; got 3"),
        ({"name": {"deep": "x" * 1000}}, "name must be text; got {'deep': 'xxx.*…"),
        ({"pixels": (1, "2")}, r"pixels\.1 must be a finite number; got '2'"),
        ({"colour": 1}, "missing or unknown: colour"),
    ],
)
def test_a_wrong_value_is_named_with_its_rule_and_the_remedy(changed, message):
    with pytest.raises(ValueError, match=f"{message}.*Measure it again"):
        validated(Eye, {"radius_mm": 11.5, "name": "left", **changed}, remedy="Measure it again.")


def test_whole_numbers_are_numbers():
    assert validated(Eye, {"radius_mm": 11, "name": "left"}, remedy="").radius_mm == 11.0


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (None, "`schema` is missing. Write it again"),
        ("1", "schema is '1'; this eyespot .* reads 1. Write it again"),
        (True, "schema is True; .* Write it again"),
        (0, "schema is 0; .* Write it again"),
        (2, r"schema is 2; this eyespot \(\d+\.\d+\.\d+\) reads 1. Install a newer eyespot."),
    ],
)
def test_another_version_of_a_format_is_refused(found, message):
    with pytest.raises(ValueError, match=message):
        check_schema(found, {1: "the first"}, remedy="Write it again.")
