"""The examples in docstrings say what really happens."""

import doctest
import importlib
from pathlib import Path

import pytest

HOME = Path(__file__).resolve().parents[2]
PACKAGES = ("formats", "optics", "scenes", "estimator", "calibration", "benchmarks")
MODULES = sorted(
    "eyespot." + path.relative_to(HOME).with_suffix("").as_posix().replace("/", ".")
    for package in PACKAGES
    for path in (HOME / package).rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_print_what_they_say(name):
    found = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert found.attempted
    assert not found.failed


def test_the_models_have_examples():
    assert {"eyespot.optics.models", "eyespot.optics.contour", "eyespot.optics.distance"} <= set(
        MODULES
    )
