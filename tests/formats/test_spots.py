import csv
import math
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from eyespot.formats.spot import NoSpot, OwnHalf, Reason, Spot
from eyespot.formats.spots import SCHEMA_VERSION, SpotRecord, read_spots, write_spots
from tests.support.drawn.made_up import a_spot

_COLUMNS = (
    "frame,file_name,time_s,mode,status,reason,x_px,y_px,semi_major_px,semi_minor_px,angle_rad,"
    "sigma_semi_minor_px,edge_width_px,coverage,inlier_fraction,saturated,"
    "distance_mm,sigma_distance_mm,pose_age_s"
).split(",")


def _spot(**changes: Any) -> Spot:
    root = np.random.default_rng(0).normal(0, 0.1, (5, 5))
    shares = {"coverage": 0.75, "inlier_fraction": 0.9}
    given: dict[str, Any] = {"covariance": root @ root.T, "edge_width_px": 2.1} | shares | changes
    return a_spot(1 / 3, 2e-17, 66.0, 60.0, -1.5, **given)


def _records() -> list[SpotRecord]:
    failures = [
        SpotRecord(frame=k, file_name="", time_s=math.nan, mode="subpixel", result=NoSpot(reason))
        for k, reason in enumerate(Reason)
    ]
    unknown = dict.fromkeys(("edge_width_px", "coverage", "inlier_fraction"), math.nan)
    literal = _spot(covariance=np.full((5, 5), math.nan), **unknown)
    return [
        SpotRecord(
            frame=7,
            file_name="frames/a, b.png",
            time_s=0.7,
            mode="subpixel",
            result=_spot(own_half=OwnHalf(0.05, -0.1, 1.002, -1e-5, 2e-6)),
            distance_mm=2.5,
            sigma_distance_mm=0.01,
            pose_age_s=0.002,
            distance_low_mm=2.4,
            distance_high_mm=2.7,
            largest_cause="touch",
            measured_with="eyespot 0.2.0, OpenCV 4.12.0",
        ),
        SpotRecord(frame=8, file_name="ü.png", time_s=0.8, mode="literal", result=literal),
        *failures,
        SpotRecord(
            frame=9,
            file_name="",
            time_s=0.9,
            mode="pixels",
            result=_spot(),
            doubt=Reason.MISFIT.value,
        ),
    ]


def test_spots_come_back_bit_for_bit(tmp_path):
    path = tmp_path / "spots.csv"
    write_spots(path, _records())
    for before, after in zip(_records(), read_spots(path), strict=True):
        # A file has one column for why there is no spot and for a doubt.
        np.testing.assert_equal(asdict(after), asdict(before) | {"doubt": before.reason})


def test_a_plain_csv_reader_finds_the_columns(tmp_path):
    path = tmp_path / "spots.csv"
    write_spots(path, _records())
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[: len(_COLUMNS)] == _COLUMNS
    assert sum(name.startswith("cov_") for name in rows[0]) == 15
    assert float(rows[0]["sigma_semi_minor_px"]) == math.sqrt(_spot().covariance[3, 3])
    assert rows[1]["edge_width_px"] == ""


def test_no_spots_make_a_readable_file(tmp_path):
    path = tmp_path / "spots.csv"
    write_spots(path, [])
    assert read_spots(path) == []


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: "a,b\n1,2\n", r"line 1: not a spots file: column 'frame'"),
        (
            lambda text: text.replace(f",{SCHEMA_VERSION}\n", ",99\n", 1),
            r"line 2: schema is 99; .* Install a newer eyespot",
        ),
        (lambda text: text.replace("66.0", "wide", 1), r"line 2: semi_major_px .* 'wide'"),
        (lambda text: text.replace("none_found", "tired", 1), r"line 4: reason .* 'tired'"),
        (lambda text: text.replace("no_spot", "maybe", 1), r"line 4: status .* 'maybe'"),
        (lambda text: text + "1,2,3\n", r"line \d+: \d+ cells expected"),
        (lambda text: text.replace("\n7,", "\nseven,", 1), r"line 2: frame .* 'seven'"),
        (lambda text: "", r"line 1: not a spots file"),
        (lambda text: "\0\x01", r"not a spots file"),
    ],
)
def test_a_damaged_file_is_refused_with_its_line(tmp_path, damage, message):
    path = tmp_path / "spots.csv"
    write_spots(path, _records())
    path.write_text(damage(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(ValueError, match=message) as error:
        read_spots(path)
    assert "spots.csv" in str(error.value)
