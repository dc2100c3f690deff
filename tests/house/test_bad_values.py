"""Inputs that once ended in a traceback, a hang or gigabytes of memory; each is a class of them."""

import os
import shutil
import struct
import tracemalloc
import zlib

import pytest

from eyespot.estimator.sources.opening import open_source
from eyespot.formats.calibration import read_calibration
from eyespot.formats.image_files import MOST_PIXELS, decoded_image
from eyespot.formats.inputs import InputError, read_data
from eyespot.formats.microscope import read_microscope
from eyespot.formats.poses import read_poses
from eyespot.formats.stack import read_stack
from eyespot.scenes.description.scene_file import load_scene
from eyespot.scenes.world.motion import frame_count
from eyespot.scenes.world.world import World
from tests.support.files.bad_input import OLD, png_chunk


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("motion=scan", "motion: .*got 'scan'"),
        ("motion.kind=[1]", r"motion.kind: must be one of .* got '\[1\]'"),
        ("microscope.window_offset_px=[nan, 0]", "window_offset_px.0: .*finite"),
        (f"camera.bit_depth={'9' * 5000}", "camera.bit_depth: "),
        (f"camera.bit_depth={'[' * 5000}", "camera.bit_depth: "),
        ("a." * 1000 + "b=1", "a change must have the form"),
        (f"phantom.wall={'x' * 169_000}", "phantom.wall: "),
    ],
)
def test_an_impossible_value_of_a_scene_is_named_and_not_echoed_whole(change, words):
    with pytest.raises(InputError, match=words) as caught:
        load_scene(None, [change])
    assert len(str(caught.value)) < 1000
    assert len(str(caught.value).splitlines()) <= 3


def test_reading_a_small_file_takes_little_memory(tmp_path):
    (tmp_path / "small").write_bytes(bytes(1000))
    tracemalloc.start()
    try:
        assert len(read_data(tmp_path / "small", most_bytes=2**30)) == 1000
        # The content, once more while it is read, and Python's objects.
        assert tracemalloc.get_traced_memory()[1] < 50_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        # 10^9 frames would take 8 GB for their times alone.
        (["motion.kind=scan", "motion.speed_mm_s=1e-5", "clocks.camera_hz=1e4"], "frames; at most"),
        (["motion.speed_mm_s=1e-5", "clocks.kinematics_hz=1e4"], "poses; at most"),
    ],
)
def test_a_motion_without_an_end_is_refused_before_memory_is_taken(changes, words):
    scene = load_scene(None, changes)
    with pytest.raises(InputError, match=words):
        _ = World(scene).motion
    assert frame_count(load_scene(None)) == 61


def test_a_key_with_line_breaks_is_shown_in_one_line(tmp_path):
    shutil.copytree(OLD / "small-v1" / "train" / "0000", tmp_path, dirs_exist_ok=True)
    (tmp_path / "metadata.jsonl").write_text('{"a\\n\\nb": 1}\n')
    with pytest.raises(InputError, match=r"missing or unknown: 'a\\n\\nb', axis"):
        read_stack(tmp_path)


def huge_png(width: int, height: int) -> bytes:
    """A whole PNG of some hundred bytes that announces a size."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    content = {b"IHDR": header, b"IDAT": zlib.compress(bytes(1000)), b"IEND": b""}
    return b"\x89PNG\r\n\x1a\n" + b"".join(map(png_chunk, content, content.values()))


@pytest.mark.parametrize("size", [(30_000, 30_000), (2**16, 2**15), (2**31 - 1, 2**31 - 1)])
def test_an_image_of_too_many_pixels_is_refused_by_its_header(size):
    with pytest.raises(InputError, match=r"pixels|damaged"):
        decoded_image(huge_png(*size))
    assert 30_000**2 > MOST_PIXELS


@pytest.mark.parametrize("number", ["2147483648", "99999", "9" * 5000])
def test_a_camera_of_an_impossible_number_is_refused(number, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((InputError, OSError)) as caught:
        open_source(number)
    assert isinstance(caught.value, OSError) or "at most 4 digits" in str(caught.value)


@pytest.mark.parametrize("suffix", ["csv", "json", "png", "mp4", "bag", "tif"])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, suffix):
    path = tmp_path / f"file.{suffix}"
    os.mkfifo(path)
    with pytest.raises(InputError, match="pipe"):
        match suffix:
            case "csv":
                read_poses(path)
            case "json":
                read_calibration(path)
            case _:
                open_source(path).read().__next__()


def test_a_device_without_an_end_is_refused(tmp_path):
    (tmp_path / "poses.csv").symlink_to("/dev/zero")
    with pytest.raises(InputError, match="device"):
        read_poses(tmp_path / "poses.csv")


def test_a_file_that_is_too_large_is_refused_unread(tmp_path):
    path = tmp_path / "poses.csv"
    with path.open("wb") as file:
        file.truncate(2**40)  # a hole: it takes no disk
    with pytest.raises(InputError, match=r"poses\.csv: larger than"):
        read_poses(path)


@pytest.mark.parametrize("dt", ["'9999999999x'", "d"])
def test_an_odd_matrix_of_opencv_is_refused(tmp_path, dt):
    path = tmp_path / "camera.yml"
    path.write_text(
        "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\nK: !!opencv-matrix\n"
        f"   rows: 1000000\n   cols: 1000000\n   dt: {dt}\n   data: [ 1 ]\n"
    )
    with pytest.raises(InputError, match="1 numbers, but rows and cols"):
        read_microscope(path, pinhole_height_mm=200.0, eye_radius_mm=11.5)
