"""`eyespot export`: what a set holds comes back out of each format by that format's own reader."""

import json
import shutil
import sys
import tomllib
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
import tifffile
import webdataset
from PIL import Image
from pycocotools.coco import COCO
from rosbags.highlevel import AnyReader

from eyespot.benchmarks.sets.formats import webdataset as webdataset_format
from eyespot.benchmarks.sets.formats.bags import START_S
from eyespot.benchmarks.sets.formats.export import Format, export
from eyespot.benchmarks.sets.read import stacks_of
from eyespot.estimator import open_source
from eyespot.formats.inputs import InputError
from eyespot.formats.manifest import write_manifest
from eyespot.formats.poses import read_poses
from eyespot.formats.stack import FrameLabels, read_stack
from tests.support.command_line import printed
from tests.support.drawn.drawn_sets import (
    MICROSCOPE,
    SHAPE,
    STACKS,
    digests,
    labels_of,
    write_set,
    write_stack,
)

NAMES = [f"{split}/{name}" for split, names in STACKS.items() for name in names]
FORMATS: list[Format] = ["hdf5", "ome-tiff", "coco", "webdataset", "rosbag1", "rosbag2"]


# The library webdataset does not close the shards that it reads.
LEAVES_FILES_OPEN = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def exported(drawn: Path, out: Path, to: Format) -> Path:
    export(drawn, to=to, out=out)
    return out


def images_of(folder: Path, file: str = "file_name") -> Iterator[tuple[FrameLabels, np.ndarray]]:
    """Labels and pixels of a stack, read by Pillow."""
    for row in read_stack(folder).labels:
        yield row, np.asarray(Image.open(folder / getattr(row, file)))


def test_hdf5_holds_frames_masks_and_labels_with_their_units(drawn, tmp_path):
    with h5py.File(exported(drawn, tmp_path / "set.h5", "hdf5")) as file:
        assert json.loads(file["set.json"].asstr()[()])["licence"] == "CC-BY-4.0"
        for name in NAMES:
            group = file[name]
            for index, (row, image) in enumerate(images_of(drawn / name)):
                np.testing.assert_array_equal(group["frames"][index], image)
                stored = {key: column[index] for key, column in group["labels"].items()}
                assert stored.pop("file_name").decode() == row.file_name
                assert stored.pop("exposure").decode() == row.exposure
                np.testing.assert_array_equal(stored.pop("tip_mm"), row.tip_mm)
                assert stored["half_max_semi_minor_px"] == row.half_max_semi_minor_px
                assert set(row.row()) - set(stored) == {"file_name", "exposure", "tip_mm"}
            for index, (_, mask) in enumerate(images_of(drawn / name, "mask_file_name")):
                np.testing.assert_array_equal(group["masks"][index], mask)
            units = {key: column.attrs.get("unit") for key, column in group["labels"].items()}
            assert units["d_mm"] == "mm"
            assert units["speed_mm_s"] == "mm/s"
            assert units["cone_angle_rad"] == "rad"
            assert units["exposure_s"] == "s"
            assert units["visible_fraction"] == "1"
            assert units["medium"] is None
            scene = tomllib.loads(group.attrs["stack.toml"])
            assert scene == tomllib.loads((drawn / name / "stack.toml").read_text())
            assert json.loads(group.attrs["microscope.json"])["eye_radius_mm"] == 11.5
            poses = list(read_poses(drawn / name / "kinematics.csv"))
            assert list(group["kinematics/z_mm"]) == [pose.position_mm[2] for pose in poses]


def test_one_hdf5_frame_is_read_alone_and_takes_less_than_its_pixels(drawn, tmp_path):
    with h5py.File(exported(drawn, tmp_path / "set.h5", "hdf5")) as file:
        frames, masks = file["train/a/frames"], file["train/a/masks"]
        assert frames.chunks == (1, *SHAPE, 3)
        # Noise of 3 in 256 levels has log2(3 sqrt(2 pi e)) = 3.6 bits of 8.
        assert frames.id.get_storage_size() < 0.7 * frames.nbytes
        assert masks.id.get_storage_size() < 0.1 * masks.nbytes


def test_ome_tiff_holds_the_recording_with_times_and_the_size_of_a_pixel(drawn, tmp_path):
    out = exported(drawn, tmp_path / "tiff", "ome-tiff")
    assert {path.name for path in (out / "train" / "b").glob("*.tif")} == {
        "paper.ome.tif",
        "metered.ome.tif",
    }
    for name in NAMES:
        for exposure in {row.exposure for row in read_stack(drawn / name).labels}:
            rows, frames = zip(
                *(pair for pair in images_of(drawn / name) if pair[0].exposure == exposure),
                strict=True,
            )
            with tifffile.TiffFile(out / name / f"{exposure}.ome.tif") as file:
                assert file.is_ome
                recording, masks = file.series
                assert (recording.axes, masks.axes) == ("TYXS", "TYX")
                np.testing.assert_array_equal(recording.asarray(), frames)
                stack = read_stack(drawn / name)
                np.testing.assert_array_equal(masks.asarray(), [stack.mask(row) for row in rows])
                assert file.ome_metadata is not None
                document = ElementTree.fromstring(file.ome_metadata)
            ome = {"ome": "http://www.openmicroscopy.org/Schemas/OME/2016-06"}
            pixels = document.findall("ome:Image/ome:Pixels", ome)[0].attrib
            assert float(pixels["PhysicalSizeX"]) == 1e3 * MICROSCOPE["scale_mm_px"]  # type: ignore[operator]
            assert pixels["PhysicalSizeXUnit"] == "µm"
            assert pixels["SizeT"] == str(len(rows))
            planes = document.findall("ome:Image", ome)[0].findall("ome:Pixels/ome:Plane", ome)
            middle = [
                float(p.attrib["DeltaT"]) + float(p.attrib["ExposureTime"]) / 2 for p in planes
            ]
            assert middle == pytest.approx([row.time_s for row in rows], abs=1e-12)
        labels = (out / name / "metadata.jsonl").read_bytes()
        assert labels == (drawn / name / "metadata.jsonl").read_bytes()


def test_what_is_exported_as_ome_tiff_is_read_as_a_recording(drawn, tmp_path):
    out = exported(drawn, tmp_path / "tiff", "ome-tiff")
    for name in NAMES:
        stack = read_stack(drawn / name)
        rows = stack.exposed("metered")
        frames = list(open_source(out / name / "metered.ome.tif"))
        assert len(frames) == len(rows)
        for frame, row in zip(frames, rows, strict=True):
            np.testing.assert_array_equal(frame.image, stack.image(row))


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools's
def test_coco_holds_each_visible_spot_as_the_mask_it_was_labelled_with(drawn, tmp_path):
    out = exported(drawn, tmp_path / "coco", "coco")
    assert json.loads((out / "set.json").read_text())["licence"] == "CC-BY-4.0"
    for split, names in STACKS.items():
        coco = COCO(str(out / "annotations" / f"{split}.json"))
        truth = {
            f"{split}/{name}/{row.file_name}": (row, mask, drawn / split / name)
            for name in names
            for row, mask in images_of(drawn / split / name, "mask_file_name")
        }
        assert {entry["file_name"] for entry in coco.imgs.values()} == set(truth)
        assert not any("mask_file_name" in entry for entry in coco.imgs.values())
        assert [entry["name"] for entry in coco.cats.values()] == ["spot"]
        for number, entry in coco.imgs.items():
            row, mask, stack = truth[entry["file_name"]]
            assert (entry["height"], entry["width"]) == mask.shape
            assert entry["d_mm"] == row.d_mm
            assert (out / entry["file_name"]).read_bytes() == (stack / row.file_name).read_bytes()
            annotations = coco.loadAnns(coco.getAnnIds(imgIds=[number]))
            if row.visible_fraction == 0:
                assert annotations == []
                continue
            (annotation,) = annotations
            np.testing.assert_array_equal(coco.annToMask(annotation) * 255, mask)
            v, u = np.nonzero(mask)
            box = [u.min(), v.min(), np.ptp(u) + 1, np.ptp(v) + 1]
            assert annotation["bbox"] == box
            assert annotation["area"] == v.size
            assert annotation["half_max_semi_major_px"] == row.half_max_semi_major_px
            assert annotation["cone_angle_rad"] == row.cone_angle_rad


@LEAVES_FILES_OPEN
def test_webdataset_holds_image_mask_and_labels_of_each_sample(drawn, tmp_path):
    out = exported(drawn, tmp_path / "shards", "webdataset")
    for split, names in STACKS.items():
        reader = webdataset.WebDataset(
            str(out / f"{split}-000000.tar"), shardshuffle=False, empty_check=False
        )
        samples = {sample["__key__"]: sample for sample in reader.decode("rgb8")}
        assert len(samples) == sum(len(read_stack(drawn / split / name).labels) for name in names)
        for name in names:
            masks = dict(images_of(drawn / split / name, "mask_file_name"))
            for row, image in images_of(drawn / split / name):
                sample = samples[f"{split}/{name}/{Path(row.file_name).stem}"]
                np.testing.assert_array_equal(sample["png"], image)
                np.testing.assert_array_equal(sample["mask.png"][:, :, 0], masks[row])
                assert sample["json"] == json.loads(json.dumps(row.row()))


@LEAVES_FILES_OPEN
def test_shards_are_the_same_bytes_each_time_and_no_larger_than_asked(drawn, tmp_path):
    outs = [tmp_path / "first", tmp_path / "second"]
    for out in outs:
        out.mkdir()
        webdataset_format.write(stacks_of(drawn), out, lambda: None, shard_bytes=150_000)
    whole, again = map(digests, outs)
    assert whole == again
    assert len(whole) > len(STACKS)
    shards = sorted(map(str, outs[0].glob("train-*.tar")))
    reader = webdataset.WebDataset(shards, shardshuffle=False, empty_check=False)
    keys = [sample["__key__"] for sample in reader]
    assert len(keys) == len(set(keys)) == 12
    assert keys == sorted(keys)


@pytest.mark.parametrize("to", ["rosbag1", "rosbag2"])
def test_a_bag_holds_the_recording_as_the_rig_makes_it(drawn, tmp_path, to):
    out = exported(drawn, tmp_path / "bags", to)
    ending = ".bag" if to == "rosbag1" else ""
    assert {path.stem for path in (out / "train" / "b").iterdir()} >= {"paper", "metered"}
    for name in NAMES:
        for exposure in {row.exposure for row in read_stack(drawn / name).labels}:
            bag = out / name / f"{exposure}{ending}"
            stack = open_source(drawn / name, exposure=exposure)
            reported = list(read_poses(drawn / name / "kinematics.csv"))
            with AnyReader([bag]) as reader:
                kinds = {topic: (t.msgtype, t.msgcount) for topic, t in reader.topics.items()}
            assert kinds == {
                "/decklink/camera/image_raw": ("sensor_msgs/msg/Image", stack.length),
                "/eye_robot/FrameEE": ("geometry_msgs/msg/Transform", len(reported)),
            }
            for frame, other in zip(open_source(bag), stack, strict=True):
                np.testing.assert_array_equal(frame.image, other.image)
                assert frame.time_s == pytest.approx(START_S + other.time_s, abs=1e-9)
            for pose, said in zip(read_poses(bag), reported, strict=True):
                assert pose.time_s == pytest.approx(START_S + said.time_s, abs=1e-9)
                assert pose.position_mm == said.position_mm
                assert pose.axis == pytest.approx(said.axis, abs=1e-12)


@pytest.fixture(scope="module")
def lengths(tmp_path_factory):
    """Stacks of 24 and of 60 images of the same spot."""

    def stack(count: int) -> Path:
        labels = [labels_of(0, frame=n, file_name=f"frames/{n:06d}.png") for n in range(count)]
        return write_stack(tmp_path_factory.mktemp("length") / "stack", labels)

    return stack(24), stack(60)


@pytest.mark.parametrize("to", FORMATS)
def test_memory_does_not_grow_with_the_number_of_frames(lengths, tmp_path, to):
    short, long = lengths
    peaks: list[int] = []
    for stack in (short, short, long, long):  # the first run loads what the format needs
        tracemalloc.start()
        export(stack, to=to, out=tmp_path / f"out-{len(peaks)}")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    frame = SHAPE[0] * SHAPE[1] * 3
    # 36 frames more: their labels take a twentieth of a frame each, and bags are written in pieces
    # of 1 MiB, 18 frames, which the shorter stack fills too.
    # Threads that tests before this one have left may allocate during one of the runs.
    assert min(peaks[2:]) - peaks[1] < 8 * frame


@pytest.mark.parametrize("to", ["hdf5", "coco"])
def test_a_failure_leaves_nothing(drawn, tmp_path, to, monkeypatch):
    broken = write_set(tmp_path / "broken", images=2)
    damaged = broken / "train" / "b" / "frames" / "000003.png"
    damaged.write_bytes(damaged.read_bytes()[:100])
    with pytest.raises(ValueError, match=r"000003\.png differs"):
        export(broken, to=to, out=tmp_path / "out")

    stopped = MagicMock()
    stopped.return_value.__enter__.return_value.side_effect = KeyboardInterrupt
    monkeypatch.setattr("eyespot.benchmarks.sets.formats.export.progress", stopped)
    with pytest.raises(KeyboardInterrupt):
        export(drawn, to=to, out=tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["broken"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("kinematics.csv", "time_s,x_mm\n0,1\n", r"kinematics\.csv, line 1: its columns must be"),
        ("kinematics.csv", "{},x", r"kinematics\.csv, line \d+: 7 cells"),
        ("kinematics.csv", "{}0,0,0,0,0,0,one\n", r"line \d+: axis_z must be a finite number"),
        ("kinematics.csv", "{}0,0,0,0,0,0,\n", r"line \d+: axis_z must be a finite number"),
        ("microscope.json", "\0", r"microscope\.json: text must be Unicode without NUL"),
        ("frames/000001.png", "", r"000001\.png: size or depth differ from the first"),
    ],
)
def test_hdf5_refuses_a_stack_that_was_changed_with_its_manifest(
    drawn, tmp_path, name, content, words
):
    stack = shutil.copytree(drawn / "train" / "a", tmp_path / "a")
    path = stack / name
    if path.suffix == ".png":
        Image.open(path).crop((0, 0, 80, 60)).save(path)
    elif path.name == "kinematics.csv" and not path.exists():
        path.write_text(content.replace("{}", "time_s,x_mm,y_mm,z_mm,axis_x,axis_y,axis_z\n"))
    else:
        path.write_text(content.replace("{}", path.read_text()))
    write_manifest(stack, schema=1)
    with pytest.raises(InputError, match=words):
        export(stack, to="hdf5", out=tmp_path / "out.h5")
    assert [found.name for found in tmp_path.iterdir()] == ["a"]


def test_a_folder_that_is_no_set_or_not_whole_is_refused(drawn, tmp_path):
    with pytest.raises(ValueError, match=r"neither a set \(set.json.*nor a stack"):
        export(tmp_path, to="coco", out=tmp_path / "out")
    shutil.copy(drawn / "set.json", tmp_path)
    with pytest.raises(ValueError, match="3 of 3 stacks are missing"):
        export(tmp_path, to="coco", out=tmp_path / "out")


def test_a_missing_library_names_the_extra(drawn, tmp_path, monkeypatch):
    for name in ("eyespot.benchmarks.sets.formats.hdf5", "eyespot.benchmarks.sets.formats"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "h5py", None)  # stands in for a machine without it
    with pytest.raises(ValueError, match=r"hdf5 needs the package h5py: .*eyespot\[export\]"):
        export(drawn, to="hdf5", out=tmp_path / "set.h5")


def test_the_command_exports_a_stack_by_itself(drawn, tmp_path):
    out = tmp_path / "shards"
    printed("export", drawn / "train" / "a", "--to", "webdataset", "--out", out)
    assert [path.name for path in out.glob("*.tar")] == ["a-000000.tar"]


@pytest.mark.slow
def test_datasets_reads_a_stack_as_an_image_folder(drawn, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    import datasets

    stack: Any = drawn / "train" / "a"
    found = datasets.load_dataset("imagefolder", data_dir=str(stack), split="train")
    assert len(found) == 4
    for entry, (row, image) in zip(found, images_of(stack), strict=True):
        np.testing.assert_array_equal(np.asarray(entry["image"]), image)
        assert entry["half_max_semi_minor_px"] == row.half_max_semi_minor_px
