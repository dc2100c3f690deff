"""The worked examples in docs/contributing/examples are changes that apply, and that work."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HOME = Path(__file__).resolve().parents[2]
EXAMPLES = HOME / "docs" / "contributing" / "examples"
PARTS = "formats optics eyespot scenes estimator calibration benchmarks tests docs".split()

# What each change adds a test to, and the house's rules that it must keep.
CHECKS = {
    "eye": ["tests/optics/test_viewing.py", "-k", "power_and_length"],
    "format": ["tests/benchmarks/test_export.py", "-k", "table"],
    "lens": ["tests/optics/test_lens.py", "-k", "flatter_drop or presets"],
    "model": [
        *("tests/optics/test_models.py", "tests/optics/test_transformations.py"),
        *("-k", "telecentric or accounted_for or by_name"),
    ],
    "source": ["tests/estimator/test_sources.py", "-k", "matlab"],
}
HOUSE = ["tests/house/test_imports.py", "-k", "face or itself"]


def test_every_example_is_checked():
    assert {path.stem for path in EXAMPLES.glob("*.diff")} == set(CHECKS)


@pytest.mark.parametrize("name", CHECKS)
def test_the_change_of_an_example_applies(name):
    subprocess.run(["git", "apply", "--check", EXAMPLES / f"{name}.diff"], cwd=HOME, check=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", CHECKS)
def test_the_change_of_an_example_works_and_keeps_the_rules(name, tmp_path):
    copy = tmp_path / "copy"
    ignored = shutil.ignore_patterns("__pycache__", "auto_gallery", "generated", "sample-v2")
    for part in PARTS:
        shutil.copytree(HOME / part, copy / part, ignore=ignored, symlinks=True)
    shutil.copy(HOME / "pyproject.toml", copy)
    subprocess.run(["git", "apply", str(EXAMPLES / f"{name}.diff")], cwd=copy, check=True)
    for selection in (CHECKS[name], HOUSE):
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *selection],
            cwd=copy,
            env=os.environ | {"PYTHONPATH": str(copy)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout[-3000:]
        assert " passed" in done.stdout


def test_the_calls_on_a_frame_s_way_stand_in_the_files_beside_them():
    page = (HOME / "docs" / "contributing" / "one_frame.md").read_text(encoding="utf-8")
    rows = [row.split("|") for row in page.splitlines() if row.count("|") == 5 and "`" in row]
    assert len(rows) > 30
    for _, _, calls, files, *_ in rows:
        text, folder = "", HOME / "estimator" / "pixels"
        for path in map(Path, re.findall(r"`([\w/]+\.py)`", files)):
            # A name without a folder lies beside the one before it.
            folder = HOME / path.parent if path.parent.name else folder
            text += (folder / path.name).read_text(encoding="utf-8")
        for call in re.findall(r"`([\w.]+)`", calls):
            assert re.search(rf"(def|class) {call.rpartition('.')[2]}\b", text), call
