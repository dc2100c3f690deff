"""The wheel holds all that eyespot needs to run away from its checkout."""

import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.wheel

HOME = Path(__file__).resolve().parents[2]
PACKAGES = ("formats", "optics", "scenes", "estimator", "calibration", "benchmarks")


@pytest.fixture(scope="module")
def fresh_python(tmp_path_factory):
    """The interpreter of a new environment with the wheel in it, and our dependencies beside.

    The dependencies are lent through a .pth file: its folder is searched after the wheel's, and
    .pth files inside it, the editable install's among them, are not read.
    """
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder],
        cwd=HOME,
        check=True,
        capture_output=True,
    )
    (wheel,) = folder.glob("eyespot-*.whl")

    environment = folder / "environment"
    venv.create(environment)
    python = environment / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", python, "install"]
    subprocess.run([*pip, "--no-deps", "--no-index", wheel], check=True, capture_output=True)
    (site,) = environment.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return python


def run_away_from_the_checkout(fresh_python, *arguments):
    return subprocess.run(
        [fresh_python, *arguments],
        cwd=fresh_python.parent,
        check=True,
        capture_output=True,
        text=True,
    ).stdout


def test_the_wheel_installs_one_name_and_all_is_imported_from_there(fresh_python):
    (site,) = fresh_python.parents[1].glob("lib/python*/site-packages")
    installed = {path.name for path in site.iterdir() if path.suffix not in (".pth", ".dist-info")}
    assert installed == {"eyespot"}
    code = f"from eyespot import {', '.join(PACKAGES)}\n"
    code += f"for p in {', '.join(PACKAGES)}: print(p.__file__)"
    files = run_away_from_the_checkout(fresh_python, "-c", code).split()
    assert len(files) == len(PACKAGES)
    assert all(Path(file).is_relative_to(site / "eyespot") for file in files), files


def test_the_source_distribution_makes_the_same_wheel(fresh_python, tmp_path):
    build = [sys.executable, "-m", "hatchling", "build", "-d"]
    subprocess.run([*build, tmp_path, "-t", "sdist"], cwd=HOME, check=True, capture_output=True)
    (archive,) = tmp_path.glob("eyespot-*.tar.gz")
    subprocess.run(["tar", "-xf", archive, "-C", tmp_path], check=True)
    unpacked = archive.with_suffix("").with_suffix("")
    subprocess.run([*build, tmp_path, "-t", "wheel"], cwd=unpacked, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("eyespot-*.whl")
    (other,) = fresh_python.parents[2].glob("eyespot-*.whl")
    names = [zipfile.ZipFile(path).namelist() for path in (wheel, other)]
    assert sorted(names[0]) == sorted(names[1])


def test_every_file_of_the_packages_is_in_the_wheel(fresh_python):
    (site,) = fresh_python.parents[1].glob("lib/python*/site-packages")
    in_checkout = {
        Path("eyespot", path.relative_to(HOME))
        for package in PACKAGES
        for path in (HOME / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    missing = {path for path in in_checkout if not (site / path).is_file()}
    assert not missing
    # Data beside the code is what wheels lose most easily, so make sure that there was some.
    assert any(path.suffix == ".toml" for path in in_checkout)


def test_files_beside_a_script_may_have_the_names_of_our_packages(fresh_python, tmp_path):
    for name in (*PACKAGES, "tests"):
        path = tmp_path / (f"{name}/__init__.py" if name == "formats" else f"{name}.py")
        path.parent.mkdir(exist_ok=True)
        path.write_text("raise RuntimeError(__name__)\n")
    (tmp_path / "script.py").write_text(
        "import eyespot\n"
        "size = {'microscope.width_px': 320, 'microscope.height_px': 240}\n"
        "scale = {'microscope.scale_mm_px': 0.0134, 'motion.frames': 6, 'source.kind': 'cone'}\n"
        "eyespot.render(eyespot.Scene(), 'stack', size | scale)\n"
        "eyespot.fit('stack').save('beam.json')\n"
        "print(eyespot.track('stack', calibration='beam.json').distance_mm.count())\n"
    )
    child = subprocess.run(
        [fresh_python, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert int(child.stdout) >= 4, child.stderr


def test_the_functions_have_their_types(fresh_python):
    script = fresh_python.parent / "typed.py"
    script.write_text(
        "import eyespot\n"
        "reveal_type(eyespot.fit('stack').parameters)\n"
        "eyespot.track('stack', calibration=3)\n"
    )
    command = [sys.executable, "-m", "mypy", "--python-executable", fresh_python, script]
    told = subprocess.run(
        command, cwd=fresh_python.parent, capture_output=True, text=True, check=False
    ).stdout
    assert "py.typed" not in told
    assert "DataFrame" in told
    assert 'Argument "calibration" to "track" has incompatible type "int"' in told


def test_the_sample_set_is_scored_from_the_wheel(fresh_python):
    command = fresh_python.with_name("eyespot")
    assert "40" in run_away_from_the_checkout(fresh_python, command, "score", "--sample")


def test_the_main_job_runs_from_the_wheel(fresh_python):
    command, out = fresh_python.with_name("eyespot"), fresh_python.parent / "validate"
    assert "Wrote" in run_away_from_the_checkout(
        fresh_python, command, "validate", "--quick", "--out", out
    )
    assert (out / "report.html").is_file()


def test_the_wheel_has_the_version_that_the_repository_states(fresh_python):
    stated = tomllib.loads((HOME / "pyproject.toml").read_text())["project"]["version"]
    command = fresh_python.with_name("eyespot")
    assert run_away_from_the_checkout(fresh_python, command, "version").strip() == stated
