"""One recording, whatever a lab has: the same spots, times and poses from every kind of source."""

import shutil
from datetime import datetime, timedelta

import cv2
import numpy as np
import pandas as pd
import pytest
from PIL import Image

import eyespot
from eyespot.estimator import Recording
from eyespot.estimator.sources.ros import write_bag
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import Pose
from eyespot.formats.rig import Rig
from eyespot.formats.spot import Spot
from eyespot.formats.stack import read_stack
from tests.support.drawn.drawn_recording import recorded, write_folder, write_stack, write_video
from tests.support.drawn.made_up import microscope_content

MICROSCOPE = microscope_content((200, 160))
SIZE = ("x_px", "y_px", "semi_major_px", "semi_minor_px")


@pytest.fixture(scope="module")
def images():
    return recorded(4)


@pytest.fixture(scope="module")
def folder(images, tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("recording") / "images", images)


def test_every_kind_of_source_has_the_same_spots(images, folder, tmp_path):
    stack = write_stack(tmp_path / "stack", images, ("metered",), **MICROSCOPE)
    video = write_video(tmp_path / "video.avi", images)
    files = sorted(folder.iterdir())
    sources = [
        *(folder, str(folder), stack, read_stack(stack), video, files, images, np.stack(images)),
        *(Recording(np.stack(images)), Recording.open(folder)),
    ]
    tables = [eyespot.track(source, mode="subpixel")[[*SIZE]] for source in sources]
    for table in tables:
        np.testing.assert_array_equal(table, tables[0])
    assert np.isfinite(tables[0]).all(axis=None)


def test_one_image_is_measured_alone(images):
    spot = eyespot.measure(images[0])
    assert isinstance(spot, Spot)
    # Of the drawing: 0.05 px are five of its standard errors.
    assert spot.semi_minor_px == pytest.approx(30.0, abs=0.05)
    assert not eyespot.measure(np.zeros_like(images[0]))


@pytest.mark.parametrize(
    ("column", "values"),
    [
        ("time_s", [5.0, 5.1, 5.2, 5.3]),
        ("time_ms", [5000, 5100, 5200, 5300]),
        ("time_ns", [1_700_000_000_000_000_000 + n * 100_000_000 for n in range(4)]),
        ("time", [f"2026-03-01T10:00:00.{n}00Z" for n in range(4)]),
    ],
)
def test_a_table_beside_the_images_has_their_times(images, tmp_path, column, values):
    folder = write_folder(tmp_path / "images", images)
    names = [path.name for path in sorted(folder.iterdir())]
    table = pd.DataFrame({"file": names, column: values, "exposure_ms": [2.0, 2.0, 2.0, 4.0]})
    table.iloc[::-1].to_csv(folder / "frames.csv", index=False)  # in any order
    frames = list(Recording.open(folder).source)
    times = np.array([frame.time_s for frame in frames])
    np.testing.assert_allclose(np.diff(times), 0.1, atol=1e-6)
    assert [frame.exposure_s for frame in frames] == pytest.approx([0.002, 0.002, 0.002, 0.004])
    assert Recording.open(folder).source.rate_hz == pytest.approx(10.0, rel=1e-5)
    with pytest.raises(InputError, match=r"frames\.csv has the times.*--fps"):
        Recording.open(folder, fps=10.0)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda table: table.drop(columns="file"), "column 'file' is missing; it has 'time_s'"),
        (lambda table: table.rename(columns={"file": "x" * 10**5}), "it has 'x{199}….*Write file"),
        (lambda table: table.drop(columns="time_s"), "column 'time_s' is missing"),
        (lambda table: table.iloc[:3], r"1 of 4 images are not in it, as frame3\.png"),
        (lambda table: table.assign(time_s=[0, 1, 3, 2]), "times must grow.*frame3.png of 2.0"),
        (lambda table: table.assign(time_s=["a", 1, 2, 3]), "line 2: time_s .*got 'a'"),
        (lambda table: pd.concat([table, table]), r"frame0\.png' stands in it twice"),
        (lambda table: table.assign(exposure_s=0.0), "exposures must be positive"),
    ],
)
def test_a_table_that_does_not_fit_the_images_is_refused(images, tmp_path, change, told):
    folder = write_folder(tmp_path / "images", images)
    table = pd.DataFrame({"file": [f"frame{n}.png" for n in range(4)], "time_s": np.arange(4.0)})
    change(table).to_csv(folder / "frames.csv", index=False)
    with pytest.raises(InputError, match=told):
        Recording.open(folder)


def test_times_without_a_table_are_those_of_exif_or_of_a_rate(images, folder, tmp_path):
    times = [frame.time_s for frame in Recording.open(folder, fps=20.0).source]
    assert times == pytest.approx([0.0, 0.05, 0.1, 0.15])
    pages = [Image.fromarray(image) for image in images]
    pages[0].save(tmp_path / "pages.tif", save_all=True, append_images=pages[1:])
    source = Recording.open(tmp_path / "pages.tif", fps=20.0).source
    assert [frame.time_s for frame in source] == pytest.approx(times)
    write_video(tmp_path / "video.avi", images)
    with pytest.raises(InputError, match=r"video\.avi has its own times.*--fps"):
        Recording.open(tmp_path / "video.avi", fps=20.0)
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    begin = datetime(2026, 3, 1, 10)
    for n, image in enumerate(images):
        exif = Image.Exif()
        at = begin + timedelta(seconds=0.25 * n)
        exif.get_ifd(0x8769).update({0x9003: f"{at:%Y:%m:%d %H:%M:%S}", 0x9291: f"{at:%f}"})
        Image.fromarray(image).save(photographs / f"{n}.jpg", exif=exif, quality=95)
    times = [frame.time_s for frame in Recording.open(photographs).source]
    assert np.diff(times) == pytest.approx([0.25, 0.25, 0.25], abs=1e-6)


def test_poses_come_as_a_table_a_file_or_with_the_recording(images, folder, tmp_path):
    table = pd.DataFrame(
        {
            "stamp": np.arange(4) / 10,
            **dict.fromkeys(("px", "py"), 0.0),
            "pz": np.arange(4) / 1000,
            **dict.fromkeys(("rx", "ry", "rz"), 0.0),
        }
    )
    table.to_csv(tmp_path / "robot.csv", index=False)
    columns = {"time_s": "stamp", "x": "px", "y": "py", "z": "pz"}
    changes = {"robot.unit": "m", "robot.columns": columns}
    bag = tmp_path / "rig.bag"
    frames = [frame for frame in Recording(np.stack(images), times=1 + np.arange(4) / 10).source]
    poses = [Pose(time_s=1 + n / 10, position_mm=(0.0, 0.0, float(n))) for n in range(4)]
    write_bag(bag, frames=frames, poses=poses)
    for recording in (
        Recording.open(folder, poses=table, changes=changes),
        Recording.open(folder, poses=tmp_path / "robot.csv", changes=changes),
        Recording(np.stack(images), poses=table, rig=Rig().changed(changes)),
        Recording.open(bag),
    ):
        places = [pose.position_mm[2] for pose in recording.robot()]
        assert places == pytest.approx([0.0, 1.0, 2.0, 3.0])
    with pytest.raises(InputError, match=r"contains no poses of the robot.*--poses"):
        Recording.open(folder).robot()


def test_frames_that_are_repeated_count_once(images):
    twice = [image for image in images for _ in range(2)]
    kept = [frame.image for frame in Recording(twice).without_repeats().source]
    np.testing.assert_array_equal(kept, images)


def test_what_is_no_recording_is_refused():
    with pytest.raises(InputError, match=r"frames x height x width.*got shape"):
        Recording(np.zeros(5))
    with pytest.raises(InputError, match="4 frames, but 3 times"):
        Recording(np.zeros((4, 8, 8)), times=[0.0, 1.0, 2.0])


def test_a_rig_is_laid_over_that_of_a_stack(images, tmp_path):
    stack = write_stack(tmp_path / "stack", images, ("metered",), **MICROSCOPE)
    (tmp_path / "lab.toml").write_text("[wall]\nradius_sigma_mm = 0.3\n")
    (tmp_path / "stated.toml").write_text("eye_radius_sigma_mm = 0.3\n")  # of eyespot 0.2
    for file in ("lab.toml", "stated.toml"):
        recording = Recording.open(stack, rig=tmp_path / file)
        assert recording.rig.stated.eye_radius_sigma_mm == 0.3
        assert recording.view is not None
        assert recording.view.scale_mm_px == MICROSCOPE["scale_mm_px"]
    moved = shutil.copytree(stack, tmp_path / "moved")
    cv2.imwrite(str(moved / "frames" / "more.png"), images[0])  # a damaged stack is no stack
    with pytest.raises(InputError, match=r"has no line in metadata\.jsonl"):
        Recording.open(moved)
