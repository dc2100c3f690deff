"""`eyespot track` when a run is long: what is kept when it is killed, full or meets a bug."""

import json
import math
import os
import re
import resource
import signal
import subprocess
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eyespot.estimator import SubpixelSettings, track, track_source, track_whole_source
from eyespot.estimator.run import reader as reader_module
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.spot import NoSpot, Reason, Spot
from eyespot.formats.spots import SpotRecord, read_spots, spots_stream, write_spots
from eyespot.scenes.drawn import Drawing, Truth, frame_of
from tests.support.command_line import EYESPOT, Called, printed, run
from tests.support.drawn.drawn_recording import SHAPE, assert_same, new_reader, write_folder


@pytest.fixture(scope="module")
def images():
    rng = np.random.default_rng(0)
    places = [Truth(x=70 + 6 * k, y=80, semi_major=33, semi_minor=30) for k in range(8)]
    return [frame_of(Drawing(truth=place, noise=6.0), rng, SHAPE) for place in places]


@pytest.fixture
def frames(tmp_path, images):
    return write_folder(tmp_path / "frames", images, "{}.png")


def lines_of(path: Path) -> list[tuple[Any, ...]]:
    """Number, status and place of each frame of a spots file."""
    return [(r.frame, r.status, getattr(r.result, "x_px", None)) for r in read_spots(path)]


@pytest.fixture(scope="module")
def whole(images):
    """The lines of a run that nothing disturbs."""
    spots = [spot for spot in track(images, SubpixelSettings()) if isinstance(spot, Spot)]
    assert len(spots) == 8
    return [(k, "spot", spot.x_px) for k, spot in enumerate(spots)]


def with_room(frames: Path, *options: str | Path, largest_file: int) -> Called:
    """Run `eyespot track`, for which no file may grow beyond a size: then writing fails."""
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, usual[1]))
    try:
        return run("track", frames, *options)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)


def test_a_frame_that_meets_a_bug_fails_alone_and_the_run_ends_with_1(
    monkeypatch, caplog, tmp_path, frames, whole
):
    measure, number = reader_module.measure, 0

    def with_a_bug(*arguments: Any) -> Any:  # stands in for a bug, of which we know none
        nonlocal number
        number += 1
        if number in (4, 6):
            return math.sqrt(-1)
        return measure(*arguments)

    out = tmp_path / "spots.csv"
    monkeypatch.setattr(reader_module, "measure", with_a_bug)
    ended = run("track", frames, "--out", out, "--json")
    assert ended.exit_code == 1
    assert "2 frames met a bug in eyespot" in ended.stderr
    assert json.loads(ended.stdout)["no_spot"] == {"internal_error": 2}
    assert json.loads(ended.stdout)["ended"] == "complete"
    lines = lines_of(out)
    assert lines[:3] == whole[:3]
    # The next spot is found from another first ellipse: less than the error of a spot, 0.01 px.
    assert [lines[k][2] for k in (4, 6, 7)] == pytest.approx(
        [whole[k][2] for k in (4, 6, 7)], abs=0.01
    )
    assert read_spots(out)[3].result == NoSpot(Reason.INTERNAL_ERROR)
    # One traceback for both, with the frame and the line of code that failed.
    assert caplog.text.count("ValueError: math domain error") == 1
    assert "frame 3 met a bug" in caplog.text
    assert "return math.sqrt(-1)" in caplog.text


def test_a_command_after_one_that_met_a_bug_is_not_to_blame(monkeypatch, tmp_path, frames, images):
    with monkeypatch.context() as patched:
        patched.setattr(reader_module, "measure", lambda *_: 1 / 0)  # stands in for a bug
        assert new_reader().read(Frame(index=0, image=images[0])).doubt == "internal_error"
    printed("track", frames, "--out", tmp_path / "spots.csv")


def begun(frames: Path, out: Path, *options: str | Path) -> subprocess.Popen[str]:
    """A run over 4,000 frames, which would take some twenty seconds, when a few are measured."""
    for index in range(8, 4000):
        os.link(frames / f"{index % 8}.png", frames / f"{index}.png")
    command = [EYESPOT, "track", frames, "--out", out, *options]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    child = subprocess.Popen(command, **pipes)
    latest, partial = time.monotonic() + 60, out.with_name("spots.partial.csv")
    while not (partial.exists() and len(partial.read_bytes().splitlines()) > 9):
        assert child.poll() is None and time.monotonic() < latest
        time.sleep(0.01)
    return child


def test_ctrl_c_keeps_whole_lines_of_the_frames_measured_so_far(tmp_path, frames, images):
    out, overlay = tmp_path / "spots.csv", tmp_path / "overlay.mp4"
    child = begun(frames, out, "--overlay", overlay)
    child.send_signal(signal.SIGINT)
    _, words = child.communicate(timeout=60)
    records = read_spots(out)
    assert child.returncode == 130
    assert 0 < len(records) < 4000
    assert words == f"Stopped. {out} holds the {len(records)} frames measured so far.\n"
    seen = [images[index % 8] for index in range(len(records))]
    assert_same(records, list(track(seen, SubpixelSettings())))
    assert sorted(tmp_path.iterdir()) == [frames, overlay, out]


@pytest.mark.parametrize("name", ["spots.csv", "spots.parquet"])
def test_a_killed_run_leaves_whole_lines_and_the_next_says_where(tmp_path, frames, whole, name):
    out, partial = tmp_path / name, tmp_path / "spots.partial.csv"
    child = begun(frames, out)
    child.kill()
    child.communicate()
    for index in range(8, 4000):
        (frames / f"{index}.png").unlink()
    before = partial.read_bytes()
    assert before.endswith(b"\n")
    assert lines_of(partial)[:8] == whole
    refused = run("track", frames, "--out", out)
    assert refused.exit_code == 2
    assert f"{partial} exists" in refused.stderr
    assert "remove it" in refused.stderr
    assert partial.read_bytes() == before
    partial.unlink()
    assert run("track", frames, "--out", out).exit_code == 0
    assert lines_of(out) == whole


def test_a_place_that_cannot_be_written_is_noticed_before_the_first_frame(tmp_path, frames):
    (frames / "0.png").write_bytes(b"damaged")  # would be reported first if it were read first
    out = tmp_path / "spots.csv"
    done = with_room(frames, "--out", out, largest_file=0)
    assert done.exit_code == 2
    assert done.stderr.startswith(f"eyespot: {out}: File too large")
    assert list(tmp_path.iterdir()) == [frames]


@pytest.mark.parametrize("largest_file", [2500, 2700])
def test_a_disk_that_fills_up_keeps_what_was_measured_and_says_what_is_needed(
    tmp_path, frames, whole, largest_file
):
    out = tmp_path / "spots.csv"
    done = with_room(frames, "--out", out, "--json", largest_file=largest_file)
    lines = lines_of(out)
    assert 0 < len(lines) < 8
    assert lines == whole[: len(lines)]
    assert done.exit_code == 2
    assert json.loads(done.stdout)["ended"] == "disk_full"
    assert f"{out} holds the {len(lines)} frames before that. Free some space" in done.stderr
    assert f"The other {8 - len(lines)} need about 0.0 MB" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frames", "spots.csv"]


def test_parquet_that_does_not_fit_leaves_its_lines_and_says_where(tmp_path, frames, whole):
    # The lines have 5.9 KB, a Parquet file of so many columns has 20 KB.
    done = with_room(frames, "--out", tmp_path / "spots.parquet", largest_file=6_000)
    assert done.exit_code == 2
    assert f"What was measured is in {tmp_path / 'spots.partial.csv'}" in done.stderr
    assert lines_of(tmp_path / "spots.partial.csv") == whole
    assert not (tmp_path / "spots.parquet").exists()


@pytest.mark.parametrize("name", ["overlay.mp4", "overlay.avi"])
def test_a_video_that_loses_frames_is_an_error_and_the_spots_stay(tmp_path, frames, whole, name):
    out, overlay = tmp_path / "spots.csv", tmp_path / name
    options = ("--out", out, "--overlay", overlay, "--json")
    done = with_room(frames, *options, largest_file=6_000)  # the spots have 5.9 KB, a video 30 KB
    assert done.exit_code == 2
    assert re.search(rf"{overlay}: only [0-7] of 8 frames could be written", done.stderr)
    assert f"{out} holds the 8 frames" in done.stderr
    assert json.loads(done.stdout)["overlay"] is None
    assert lines_of(out) == whole
    assert not overlay.exists()


def test_pictures_that_do_not_fit_are_named_and_none_is_left_in_part(tmp_path, frames):
    overlay = tmp_path / "overlay"
    options = ("--out", tmp_path / "spots.csv", "--overlay", overlay)
    done = with_room(frames, *options, largest_file=20_000)
    assert done.exit_code == 2
    assert f"{overlay / '000000.png'}: File too large" in done.stderr
    assert list(tmp_path.iterdir()) == [frames]


def test_a_run_whose_records_are_written_elsewhere_does_not_grow(tmp_path):
    dark, sizes = np.zeros((9, 9), "u1"), []
    frames = (Frame(index=index, image=dark) for index in range(3000))
    source = Source(name="darkness", read=lambda: frames, length=3000)

    def note(record: SpotRecord) -> None:
        if record.frame in (500, 2999):
            sizes.append(tracemalloc.get_traced_memory()[0])

    tracemalloc.start()
    try:
        with spots_stream(tmp_path / "spots.csv") as write:
            tracking = track_source(source, new_reader(), write=write, progress=note)
    finally:
        tracemalloc.stop()
    assert tracking.frames == 3000
    assert tracking.records == []
    # A record without a spot has 0.26 KB: 2,500 of them would be 650 KB.
    assert sizes[1] - sizes[0] < 20_000


def test_names_that_look_like_missing_values_come_back_from_parquet(tmp_path):
    names = ["NA", "null", "", "a,b", 'q"', "n\nl", "nan.png"]
    plain: dict[str, Any] = {
        "time_s": math.nan,
        "mode": "subpixel",
        "result": NoSpot(Reason.CLIPPED),
    }
    records = [SpotRecord(frame=k, file_name=name, **plain) for k, name in enumerate(names)]
    write_spots(tmp_path / "whole.parquet", records)
    with spots_stream(tmp_path / "stream.parquet") as write:
        for record in records:
            write(record)
    for path in (tmp_path / "whole.parquet", tmp_path / "stream.parquet"):
        assert [record.file_name for record in read_spots(path)] == names
    assert sorted(path.name for path in tmp_path.iterdir()) == ["stream.parquet", "whole.parquet"]


def test_ctrl_c_stops_a_fit_and_a_score_that_need_every_frame(images):
    def read() -> Iterator[Frame]:
        yield Frame(index=0, time_s=0.0, image=images[0])
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track_whole_source(Source(name="frames", read=read), new_reader())
