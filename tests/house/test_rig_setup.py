"""A machine that `make setup-rig` has set up measures and fits, and says what else is missing."""

import subprocess
from pathlib import Path

import pytest

from eyespot.scenes import Scene, changed, render_stack

HOME = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def rig_home(tmp_path_factory):
    """A copy of the checkout with its own environment, for which packages are downloaded."""
    home = tmp_path_factory.mktemp("rig")
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=HOME, check=True, capture_output=True).stdout
    tar = ["tar", "--create", "--null", "--files-from=-"]
    packed = subprocess.run(tar, cwd=HOME, input=names, check=True, capture_output=True).stdout
    subprocess.run(["tar", "--extract"], cwd=home, input=packed, check=True)
    subprocess.run(["make", "setup-rig"], cwd=home, check=True, capture_output=True)
    return home


def said(home, *words):
    """Exit code and all output of a command on the rig."""
    done = subprocess.run(
        [home / ".venv/bin/eyespot", *map(str, words)],
        cwd=home.parent,
        env={"PATH": "/usr/bin:/bin", "HOME": str(home)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


@pytest.mark.slow  # minutes: it installs 1 GB
def test_a_rig_fits_and_measures_and_names_what_it_lacks(rig_home, tmp_path):
    code, text = said(rig_home, "doctor", "--rig")
    assert code == 0, text
    assert said(rig_home, "doctor")[0] == 1
    scene = changed(Scene(), {"source.kind": "cone", "motion.frames": 12})
    render_stack(scene, stack := tmp_path / "stack")
    works: tuple[tuple[object, ...], ...] = (
        ("fit", stack, "--out", tmp_path / "beam.json"),
        ("track", stack, "--calibration", tmp_path / "beam.json", "--out", tmp_path / "spots.csv"),
        ("rig", "init", tmp_path / "rig.toml"),
        ("node", "--help"),
    )
    for words in works:
        code, text = said(rig_home, *words)
        assert code == 0, text
    (scene_file := tmp_path / "scene.toml").write_text("schema = 2\n")
    fails: tuple[tuple[object, ...], ...] = (
        ("mitsuba", "render", scene_file, "--out", tmp_path / "other"),
        ("distributed", "dataset", "make", scene_file, "--out", tmp_path / "set"),
        ("distributed", "rivals", "run", stack, "--out", tmp_path / "rivals"),
    )
    for package, *command in fails:
        code, text = said(rig_home, *command)
        assert code == 2, text
        assert f"needs the Python package {package}" in text
        assert "make setup" in text and "Traceback" not in text
