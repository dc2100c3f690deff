"""The command `python -m benchmarks.bench` against the modules that it runs."""

import ast
import math
import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmarks.bench.__main__ import BY_NAME_ONLY, MAKE_BENCH, SEEDED
from benchmarks.bench.output import add_line, lines_in
from benchmarks.bench.pixel_branches import share_a_radius
from benchmarks.bench.pixel_frames import doubt_of_pose
from estimator import NoSpot, Range, Reading, Reason

BENCH = Path(__file__).resolve().parents[1] / "benchmarks" / "bench"


def run_parameters(path: Path) -> list[str] | None:
    """Names of the keyword-only parameters of a module's function `run`; None without one."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == "run":
            assert not node.args.args
            return [argument.arg for argument in node.args.kwonlyargs]
    return None


def test_the_command_knows_every_bench_and_all_are_called_alike():
    found = {
        path.relative_to(BENCH).with_suffix("").as_posix().replace("/", "."): parameters
        for path in BENCH.rglob("*.py")
        if (parameters := run_parameters(path)) is not None
    }
    assert found == {
        name: ["full", "seed"] if name in SEEDED else ["full"]
        for name in (*MAKE_BENCH, *BY_NAME_ONLY)
    }


def test_an_unknown_bench_is_refused():
    command = [sys.executable, "-m", "benchmarks.bench", "cone_fti"]
    done = subprocess.run(
        command, cwd=BENCH.parents[1], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "cone_fti" in done.stderr
    assert "cone_fit" in done.stderr


def test_a_line_that_a_kill_cut_off_does_not_count_and_spoils_no_other(tmp_path):
    file = tmp_path / "frames.jsonl"
    assert lines_in(file) == []
    add_line(file, {"number": 0, "d_mm": 1.5})
    with file.open("a") as killed:
        killed.write('{"number": 1, "d_')
    add_line(file, {"number": 2, "d_mm": 2.5})
    assert lines_in(file) == [{"number": 0, "d_mm": 1.5}, {"number": 2, "d_mm": 2.5}]


def test_a_radius_that_falls_and_grows_belongs_to_two_distances():
    # A parabola about 1 from 0.25 to 3: only distances above 1.75 have no partner in the range.
    grid = np.arange(0.25, 3.0, 0.125)
    radii = 20.0 + (grid - 1.0) ** 2
    distances = np.array([0.3, 0.8, 1.2, 1.7, 1.8, 2.9])
    assert share_a_radius(distances, grid, radii).tolist() == [True] * 4 + [False] * 2


def test_a_pose_without_a_spot_is_not_doubtful():
    pose = Range(distance_mm=2.0, sigma_mm=0.01)
    assert doubt_of_pose(Reading(NoSpot(Reason.OCCLUDED), pose, math.nan)) == ""
    twofold = Range(distance_mm=2.0, sigma_mm=0.01, others_mm=(1.0,))
    assert doubt_of_pose(Reading(NoSpot(Reason.OCCLUDED), twofold, math.nan)) == "ambiguous"
    assert doubt_of_pose(Reading(NoSpot(Reason.OCCLUDED), None, math.nan)) == Reason.OCCLUDED.value
