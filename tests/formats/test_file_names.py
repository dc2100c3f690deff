"""Names of files that are not UTF-8, and terminals that cannot show all letters."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from eyespot.estimator.sources.opening import open_source
from eyespot.formats.spots import read_spots
from tests.support.command_line import run
from tests.support.drawn.drawn_recording import write_video
from tests.support.drawn.drawn_spots import spot_image

ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}


@pytest.fixture(scope="module")
def png():
    image = np.rint(spot_image((96, 128), 62.3, 47.7, 30, 22, 0.4)).astype(np.uint8)
    return cv2.imencode(".png", image)[1].tobytes()


def eyespot(*arguments: str | Path, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "eyespot", *arguments],
        capture_output=True,
        check=False,
        env=os.environ | environment,
    )


@pytest.mark.parametrize("kind", [".csv", ".parquet"])
def test_names_that_are_no_utf8_are_measured_and_written_as_bytes(tmp_path, png, kind):
    if kind == ".parquet":
        pytest.importorskip("pyarrow")
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    folder.mkdir()
    (folder / os.fsdecode(b"spot\xe9.png")).write_bytes(png)
    out = folder / f"spots{kind}"
    ended = eyespot("track", folder, "--out", out)
    assert ended.returncode == 0, ended.stderr
    assert read_spots(out)[0].file_name == r"spot\xe9.png"


def test_a_video_cannot_be_written_where_a_name_is_no_utf8(tmp_path, png):
    (tmp_path / "spot.png").write_bytes(png)
    video = tmp_path / os.fsdecode(b"\xe9.mp4")
    done = run("track", tmp_path, "--out", tmp_path / "spots.csv", "--overlay", video)
    assert "must be UTF-8" in done.stderr
    assert done.exit_code == 2


def test_a_video_whose_name_is_no_utf8_is_read(tmp_path):
    frames = [np.full((48, 64, 3), level, np.uint8) for level in (10, 20)]
    strange = tmp_path / os.fsdecode(b"\xe9.avi")
    write_video(tmp_path / "a.avi", frames).rename(strange)
    assert [frame.image[0, 0, 0] for frame in open_source(strange)] == [10, 20]


def test_a_terminal_without_greek_letters_ends_nothing(tmp_path, png):
    (tmp_path / "é σ.png").write_bytes(png)
    out = tmp_path / "Ω.csv"
    ended = eyespot("track", tmp_path, "--out", out, **ASCII)
    assert ended.returncode == 0, ended.stderr
    assert read_spots(out)[0].file_name == "é σ.png"
