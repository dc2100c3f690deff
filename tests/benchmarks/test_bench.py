"""The command `python -m benchmarks.bench` and what its benchmarks compute."""

from __future__ import annotations

import inspect

import numpy as np
import pandas as pd
import pytest

from benchmarks.bench.__main__ import LONG, benchmarks, main, table
from benchmarks.bench.pixels import doubt_of_pose, share_a_radius
from estimator import Range, Reading
from formats.spots import NoSpot, Reason


class Counted:
    """A benchmark of two parameters."""

    params = ([1, 2], ["a", "b"])
    param_names = ("number", "letter")

    def setup_cache(self) -> int:
        return 10

    def setup(self, cached: int, number: int, letter: str) -> None:
        self.letters = letter * number

    def track_sum(self, cached: int, number: int, letter: str) -> int:
        return cached + len(self.letters)

    def time_nothing(self, cached: int, number: int, letter: str) -> None:
        pass


def test_every_combination_of_parameters_is_a_row_and_every_method_a_column():
    found = table(Counted)
    shown = found[["number", "letter", "sum"]].values.tolist()
    assert shown == [[1, "a", 11], [1, "b", 11], [2, "a", 12], [2, "b", 12]]
    assert (found.nothing_ms >= 0).all()
    assert isinstance(found, pd.DataFrame)


def test_every_benchmark_takes_its_parameters():
    """`setup` and the measuring methods take what asv passes: the cache, then the parameters."""
    every = benchmarks()
    assert LONG <= {name.partition(".")[2] for name in every}
    for name, kind in every.items():
        values = [None] * hasattr(kind, "setup_cache") + [p[0] for p in getattr(kind, "params", ())]
        assert len(getattr(kind, "params", ())) == len(getattr(kind, "param_names", ())), name
        for method in dir(kind):
            if method == "setup" or method.startswith(("time_", "track_")):
                inspect.signature(getattr(kind, method)).bind(None, *values)


def test_an_unknown_bench_is_refused():
    with pytest.raises(SystemExit, match=r"no benchmark ConeFti; .*fits\.ConeWithdrawals"):
        main("ConeFti")


def test_a_radius_that_falls_and_grows_belongs_to_two_distances():
    # A parabola about 1 from 0.25 to 3: only distances above 1.75 have no partner in the range.
    grid = np.arange(0.25, 3.0, 0.125)
    radii = 20.0 + (grid - 1.0) ** 2
    distances = np.array([0.3, 0.8, 1.2, 1.7, 1.8, 2.9])
    assert share_a_radius(distances, grid, radii).tolist() == [True] * 4 + [False] * 2


def test_a_pose_without_a_spot_is_not_doubtful():
    pose = Range(distance_mm=2.0, sigma_mm=0.01)
    assert doubt_of_pose(Reading("pixels", NoSpot(Reason.OCCLUDED), pose)) == ""
    twofold = Range(distance_mm=2.0, sigma_mm=0.01, others_mm=(1.0,))
    assert doubt_of_pose(Reading("pixels", NoSpot(Reason.OCCLUDED), twofold)) == "ambiguous"
    assert doubt_of_pose(Reading("pixels", NoSpot(Reason.OCCLUDED))) == Reason.OCCLUDED.value
