"""Frames come out of every kind of source as they went in, or the error says where it breaks."""

import dataclasses
import math
import struct
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import cv2
import h5py
import numpy as np
import pytest
import tifffile
from PIL import Image

from eyespot.estimator import SubpixelSettings, track, track_whole_source
from eyespot.estimator.run.offline import Ended
from eyespot.estimator.run.options import Options
from eyespot.estimator.sources.edit_list import shown_share
from eyespot.estimator.sources.opening import open_source
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import NoSpot, Reason, Spot
from tests.support.drawn.drawn_recording import (
    GONE,
    assert_same,
    opencv_order,
    recorded,
    tracked,
    write_folder,
    write_stack,
    write_video,
)
from tests.support.files.dicom import write_dicom

Results = list[Spot | NoSpot]


@pytest.fixture(scope="module")
def images():
    return recorded(12)


@pytest.fixture(scope="module")
def expected(images):
    results = list(track(images, SubpixelSettings()))
    assert results[GONE] == NoSpot(Reason.NONE_FOUND)
    assert sum(map(bool, results)) == len(images) - 1
    return results


def offline(source: Source) -> Results:
    tracking = tracked(source)
    assert tracking.ended is Ended.COMPLETE
    return [record.result for record in tracking.records]


def write_tiff(path: Path, images: list[np.ndarray]) -> Path:
    tifffile.imwrite(path, np.stack(images), photometric="rgb", compression="zlib")
    return path


LOSSLESS: dict[str, Callable[[Path, list[np.ndarray]], Path]] = {
    "stack": lambda path, images: write_stack(path, images, ("metered",)),
    "folder": write_folder,
    "tiff.tif": write_tiff,
    "ffv1.avi": write_video,
    "ffv1.mkv": write_video,
    "film.dcm": write_dicom,
    "no suffix": write_dicom,
}


@pytest.mark.parametrize("name", LOSSLESS)
def test_a_source_without_loss_gives_the_spots_of_its_frames(tmp_path, images, expected, name):
    source = open_source(LOSSLESS[name](tmp_path / name, images))
    assert source.length == len(images)
    frames = list(source)
    assert [frame.index for frame in frames] == list(range(len(images)))
    for frame, image in zip(frames, images, strict=True):
        np.testing.assert_array_equal(frame.image, image)
    # A source can be read again from its start.
    assert_same(offline(source), expected)


def test_a_lossy_video_moves_spots_by_no_more_than_its_noise_can(tmp_path, images, expected):
    source = open_source(write_video(tmp_path / "mjpg.avi", images, "MJPG"))
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(float) for image in images]
    for frame, image, result, other in zip(source, grey, offline(source), expected, strict=True):
        loss = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY) - image
        if not isinstance(other, Spot):
            assert result == other
            continue
        assert isinstance(result, Spot)
        # Cramér-Rao: std(b) = (noise/step) sqrt(3 edge/(sqrt(pi) B)); profiles reach 3.3 times
        # that, a JPEG's errors are alike within its blocks of 8 px (a factor sqrt 8), and all of
        # 11 frames stay within 4 standard deviations.
        step, edge = 180.0, 2.0
        bound = loss.std() / step * math.sqrt(3 * edge / (math.sqrt(math.pi) * other.semi_minor_px))
        assert abs(result.semi_minor_px - other.semi_minor_px) < 4 * math.sqrt(8) * 3.3 * bound


def test_an_exposure_that_a_source_lacks_is_refused_and_one_alone_needs_no_note(tmp_path, images):
    folder = write_stack(tmp_path / "stack", images, ("paper", "metered"))
    assert not open_source(write_stack(tmp_path / "one", images, ("paper",))).notes
    with pytest.raises(ValueError, match=r"no exposure strong\. Choose metered or paper"):
        open_source(folder, exposure="strong")
    with pytest.raises(ValueError, match="is not a stack"):
        open_source(write_folder(tmp_path / "folder", images), exposure="paper")


def test_images_are_read_in_the_order_in_which_a_person_counts(tmp_path):
    for name in ("a10.png", "a9.png", "A011.png", "b1.png", ".a1.png", "notes.txt"):
        cv2.imwrite(str(tmp_path / "x.png"), np.zeros((4, 4), np.uint8))
        (tmp_path / "x.png").rename(tmp_path / name)
    names = [frame.file_name for frame in open_source(tmp_path)]
    assert names == ["a9.png", "a10.png", "A011.png", "b1.png"]


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(6, 5), (6, 5, 3)])
def test_depth_and_channels_of_an_image_are_kept(tmp_path, suffix, dtype, shape):
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    path = write_folder(tmp_path / "one", [image], f"frame{{}}{suffix}") / f"frame0{suffix}"
    (frame,) = open_source(path)
    assert frame.image.dtype == dtype
    np.testing.assert_array_equal(frame.image, image)


def test_a_tiff_whose_images_share_one_page_is_refused_with_a_way_out(tmp_path):
    path = tmp_path / "large.tif"
    images = np.zeros((3, 6, 5), np.uint8)
    tifffile.imwrite(path, images, imagej=True, truncate=True)  # as ImageJ writes above 4 GB
    with pytest.raises(ValueError, match=r"holds 3 images in 1 pages.*BigTIFF"):
        open_source(path)


def cut(path: Path, share: float) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


def frames_until_it_breaks(path: Path) -> tuple[list[Frame], str]:
    frames: list[Frame] = []
    with pytest.raises(ValueError) as caught:
        frames.extend(open_source(path))  # extends frame by frame, so that the first ones stay
    return frames, str(caught.value)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("video.avi", write_video),
        ("video.mkv", write_video),
        ("compressed.tif", write_tiff),
        ("plain.tif", lambda path, images: tifffile.imwrite(path, np.stack(images)) or path),
    ],
)
def test_a_file_cut_short_gives_its_frames_and_says_where_it_ends(tmp_path, images, name, write):
    whole = [frame.image for frame in open_source(write(tmp_path / name, images))]
    frames, message = frames_until_it_breaks(cut(tmp_path / name, 0.6))
    assert 0 < len(frames) < len(images)
    for frame, image in zip(frames, whole, strict=False):
        np.testing.assert_array_equal(frame.image, image)
    assert name in message
    assert f"frame {len(frames)}" in message or f"after frame {len(frames) - 1}" in message
    assert "again" in message


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_an_image_cut_short_is_refused_by_its_name(tmp_path, images, suffix, share):
    folder = write_folder(tmp_path / "folder", images, f"frame{{}}{suffix}")
    cut(folder / f"frame7{suffix}", share)
    frames, message = frames_until_it_breaks(folder)
    assert len(frames) == 7
    assert f"frame7{suffix} (frame 7)" in message
    assert "Record, copy or convert it again." in message


@pytest.mark.parametrize("name", ["a.avi", "a.mp4", "a.tif", "a.png", "a.bag", "a.db3", "a.mcap"])
@pytest.mark.parametrize("content", [b"", b"\x00\x01 no such format " * 400])
def test_what_is_no_recording_is_refused_with_its_name(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    frames, message = frames_until_it_breaks(path)
    assert frames == []
    assert str(path) in message


def test_missing_and_empty_places_are_refused(tmp_path):
    with pytest.raises(ValueError, match="there is no such file or folder"):
        open_source(tmp_path / "missing.avi")
    with pytest.raises(ValueError, match="holds no images"):
        open_source(tmp_path)
    (tmp_path / "stack.toml").write_text("schema = 1\n")
    with pytest.raises(ValueError, match=r"is not a stack: metadata\.jsonl is missing"):
        open_source(tmp_path)
    (tmp_path / "metadata.jsonl").touch()
    with pytest.raises(ValueError, match="holds no frames"):
        open_source(tmp_path)


@pytest.fixture
def camera(monkeypatch):
    """Stands in for cv2.VideoCapture of a camera, which no test machine has."""
    camera = mock.Mock()
    camera.get.return_value = 30.0
    monkeypatch.setattr(cv2, "VideoCapture", lambda number: camera)
    return camera


def test_a_camera_runs_until_it_is_stopped(camera, images, expected):
    frames = [(True, np.ascontiguousarray(opencv_order(image))) for image in images]
    camera.read.side_effect = [*frames, KeyboardInterrupt]
    source = open_source("0")
    assert source.live
    assert source.length is None
    assert_same(offline(source), expected)


def test_a_camera_that_stops_by_itself_is_a_fault(camera, images):
    camera.read.side_effect = [*((True, image) for image in images[:2]), (False, None)]
    tracking = tracked(open_source("0"))
    assert tracking.ended is Ended.BROKEN
    assert "camera 0 stopped at frame 2" in tracking.fault


def test_a_camera_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="camera 63 cannot be opened"):
        open_source("63")


def test_a_video_that_was_cut_without_encoding_it_again_is_whole(tmp_path):
    """Of 12 samples at 25 Hz an edit list shows 7, from the sixth on."""
    path = tmp_path / "cut.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (64, 48))
    for k in range(12):
        writer.write(np.full((48, 64, 3), 20 * k, np.uint8))
    writer.release()
    data = bytearray(path.read_bytes())
    entry = data.find(b"elst") + 12
    assert struct.unpack_from(">IiI", data, entry) == (480, 0, 65536)  # 0.48 s of 1,000 Hz, all
    own_scale = struct.unpack_from(">I", data, data.find(b"mdhd") + 16)[0]
    struct.pack_into(">Ii", data, entry, 280, 5 * own_scale // 25)
    path.write_bytes(data)
    assert shown_share(path) == pytest.approx(7 / 12)
    frames = list(open_source(path))
    assert len(frames) == 7
    levels = [float(frame.image.mean()) for frame in frames]
    # The encoding changes a level by a few units, and frames differ by 20.
    np.testing.assert_allclose(levels, 100 + 20 * np.arange(7), atol=6)


def test_a_dicom_file_states_times_and_bits_and_may_be_inverted(tmp_path):
    ramps = [np.arange(12, dtype=np.uint16).reshape(3, 4) * 300 + n for n in range(3)]
    source = open_source(write_dicom(tmp_path / "grey.dcm", ramps, "MONOCHROME2"))
    inverted = write_dicom(
        tmp_path / "inverted.dcm", [4095 - ramp for ramp in ramps], "MONOCHROME1"
    )
    assert source.rate_hz == pytest.approx(25)
    for index, (frame, other) in enumerate(zip(source, open_source(inverted), strict=True)):
        assert (frame.file_name, frame.full_scale) == (f"grey.dcm#{index}", 4095)
        assert frame.time_s == pytest.approx(0.04 * index)
        np.testing.assert_array_equal(frame.image, ramps[index])
        np.testing.assert_array_equal(other.image, ramps[index])
    whole = inverted.read_bytes()
    inverted.write_bytes(whole[:-30])
    with pytest.raises(InputError, match=r"inverted\.dcm, frame .* Record, copy or convert"):
        list(open_source(inverted))


def test_files_that_people_bring_are_named_with_what_to_do(tmp_path):
    contents = {
        "eye.dcm": (b"\0" * 128 + b"DICM", "eye.dcm has no images"),
        "eye": (b"\0" * 128 + b"DICM", "eye has no images"),
        "sky.fits": (b"SIMPLE  =                    T", "a FITS file"),
        "photo.nef": (b"MM\0*", "a camera's raw file.*Convert it to TIFF"),
        "photo.heic": (b"\0\0\0\x18ftypheic", "as phones write it. Convert it to PNG"),
        "pointer.png": (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
    }
    for name, (content, words) in contents.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=words):
            list(open_source(tmp_path / name))
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "a.nef").write_bytes(b"MM\0*")
    with pytest.raises(InputError, match=r"holds no images .* a\.nef is a camera's raw file"):
        open_source(tmp_path / "raw")


@pytest.mark.parametrize("name", ["frames.npy", "frames.npz", "frames.h5"])
@pytest.mark.parametrize("shape", [(3, 40, 50), (3, 40, 50, 3), (40, 50)])
def test_arrays_are_read_frame_by_frame(tmp_path, name, shape):
    frames = np.random.default_rng(1).integers(0, 4096, shape).astype(np.uint16)
    path = tmp_path / name
    if name.endswith("npy"):
        np.save(path, frames)
    elif name.endswith("npz"):
        np.savez(path, frames=frames, times=np.arange(3.0))
    else:
        with h5py.File(path, "w") as file:
            file["eye/frames"] = frames
            file["eye/times"] = np.arange(3.0)
    source = open_source(path)
    found = np.stack([frame.image for frame in source])
    np.testing.assert_array_equal(found, frames if len(shape) > 2 else frames[None])
    assert source.length == len(found)


@pytest.mark.parametrize("array", [np.array(["a"]), np.zeros((0, 4, 4)), np.zeros(5)])
def test_an_array_without_frames_is_refused_with_its_shape(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(InputError, match=r"must hold one array of frames.*it holds a\.npy"):
        open_source(tmp_path / "a.npy")


def test_a_damaged_image_among_unrelated_ones_is_one_row_with_its_reason(tmp_path):
    for name in ("red.png", "tall.png", "wide.png"):
        cv2.imwrite(str(tmp_path / name), np.full((40, 50), 90, np.uint8))
    whole = (tmp_path / "tall.png").read_bytes()
    (tmp_path / "tall.png").write_bytes(whole[: len(whole) // 2])
    source = open_source(tmp_path)
    assert source.unrelated
    assert [bool(frame.fault) for frame in source] == [False, True, False]
    records = track_whole_source(source, Options().reader())
    assert [record.reason for record in records] == ["none_found", "unreadable", "none_found"]
    with pytest.raises(InputError, match=r"tall\.png \(frame 1\)"):  # a sequence ends there
        list(dataclasses.replace(source, unrelated=False))


def test_pixels_that_are_not_square_are_said(tmp_path):
    image = Image.fromarray(np.full((40, 50), 90, np.uint8))
    image.save(tmp_path / "wide.png", dpi=(300, 150))
    image.save(tmp_path / "square.png", dpi=(300, 300))
    (note,) = open_source(tmp_path / "wide.png").notes
    assert "0.500 times as wide as high" in note
    assert not open_source(tmp_path / "square.png").notes
