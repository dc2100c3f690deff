"""The command `python -m eyespot.benchmarks.bench` and what its benchmarks compute."""

import numpy as np
import pandas as pd
import pytest

from eyespot.benchmarks.bench import __main__ as bench
from eyespot.benchmarks.bench.pixels import share_a_radius
from eyespot.benchmarks.bench.speed import Outlines
from eyespot.estimator import Range, Reading, track
from eyespot.formats.spot import NoSpot, Reason, Spot


def test_every_file_has_benchmarks_and_those_named_long_exist():
    every = [name.split(".") for name in bench.benchmarks()]
    assert {file for file, _ in every} == set(bench.FILES)
    assert {name for _, name in every} >= bench.LONG


def test_a_benchmark_is_run_by_its_name_and_its_table_is_shown(monkeypatch, capsys):
    def counted(full: bool = False) -> pd.DataFrame:
        """Counts.

        And more.
        """
        return pd.DataFrame({"sum": [11, 12]}, index=["a", "b"]) * (10 if full else 1)

    monkeypatch.setattr(bench, "benchmarks", lambda: {"fits.counted": counted})
    bench.main("fits.counted", full=True)
    title, names, sums = capsys.readouterr().out.strip().splitlines()[:3]
    assert title == "== fits.counted: Counts."
    assert (names.split(), sums.split()) == (["a", "b"], ["sum", "110", "120"])


@pytest.mark.parametrize("mode", Outlines.params[0])
def test_asv_times_a_class_as_it_stands(mode):
    bench = Outlines()
    bench.setup(mode)
    bench.time_thirty_frames(mode)
    spots = list(track(bench.frames, bench.settings, start=bench.start))
    assert all(isinstance(spot, Spot) for spot in spots)  # What is timed is the measurement.


def test_an_unknown_bench_is_refused():
    with pytest.raises(SystemExit, match=r"no benchmark cone_fti; .*fits\.cone_withdrawals"):
        bench.main("cone_fti")


def test_a_radius_that_falls_and_grows_belongs_to_two_distances():
    # A parabola about 1 from 0.25 to 3: only distances above 1.75 have no partner in the range.
    grid = np.arange(0.25, 3.0, 0.125)
    radii = 20.0 + (grid - 1.0) ** 2
    distances = np.array([0.3, 0.8, 1.2, 1.7, 1.8, 2.9])
    assert share_a_radius(distances, grid, radii).tolist() == [True] * 4 + [False] * 2


def test_a_pose_without_a_spot_is_not_doubtful():
    pose = Range(distance_mm=2.0, sigma_mm=0.01)
    assert Reading("pixels", NoSpot(Reason.OCCLUDED), pose).doubt == ""
    twofold = Range(distance_mm=2.0, sigma_mm=0.01, others_mm=(1.0,))
    assert Reading("pixels", NoSpot(Reason.OCCLUDED), twofold).doubt == "ambiguous"
    assert Reading("pixels", NoSpot(Reason.OCCLUDED)).doubt == Reason.OCCLUDED.value
