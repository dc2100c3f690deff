"""The examples in docstrings say what really happens."""

import doctest
import importlib
import os
import re
import subprocess
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


@pytest.mark.parametrize("page", sorted((HOME / "docs" / "tutorials").glob("*.md")), ids=str)
def test_a_tutorial_hides_no_failure_of_its_commands(page):
    text = page.read_text(encoding="utf-8")
    # head ends before its source does, which then fails; /dev/null takes the message.
    assert not re.search(r"2>\s*/dev/null|\|\s*head\b|\|\|\s*true", text)


def test_a_cell_of_a_tutorial_fails_with_any_of_its_commands():
    conf = (HOME / "docs" / "conf.py").read_text(encoding="utf-8")
    (options,) = re.findall(r'os\.environ\["SHELLOPTS"\] = "(.+)"', conf)
    environment = {"PATH": os.environ["PATH"], "SHELLOPTS": options}
    for hidden in ("false | sed -n 1,3p; echo on", "false; echo on", "echo $undefined; echo on"):
        done = subprocess.run(["bash", "-c", hidden], env=environment, capture_output=True)
        assert done.returncode
        assert b"on" not in done.stdout
