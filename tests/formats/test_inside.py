"""Names that a file contains: none of them leads out of the file's folder."""

import os
import shutil
from pathlib import Path

import pytest

from eyespot.benchmarks.sets.formats import hdf5
from eyespot.benchmarks.sets.formats.export import export
from eyespot.benchmarks.sets.read import read_set, stacks_of
from eyespot.benchmarks.sets.spec import load_spec
from eyespot.estimator.sources.ros import write_bag
from eyespot.formats.inputs import InputError, inside
from eyespot.formats.poses import Pose, read_poses
from eyespot.formats.stack import read_stack
from tests.support.files.bad_input import OLD


@pytest.fixture
def stack(tmp_path):
    shutil.copytree(OLD / "small-v1", tmp_path / "small-v1")
    return tmp_path / "small-v1" / "train" / "0000"


@pytest.fixture
def secret(tmp_path):
    path = tmp_path / "secret.png"
    shutil.copyfile(OLD / "small-v1" / "train" / "0000" / "masks" / "000000.png", path)
    return path


def replaced(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    "name",
    ["../x", "a/../../x", "/etc/passwd", "", ".", "a//b", "a/", "a\\b", "a\0b", "..", "a" * 101],
)
def test_a_name_that_leads_elsewhere_is_refused(tmp_path, name):
    with pytest.raises(InputError, match="within its folder"):
        inside(tmp_path, name)


def test_a_link_is_followed_within_the_folder_only(tmp_path):
    folder = tmp_path / "stack"
    folder.mkdir()
    (folder / "file").write_text("ours")
    (tmp_path / "other").write_text("not ours")
    (folder / "in").symlink_to("file")
    (folder / "out").symlink_to("../other")
    (folder / "above").symlink_to("..")
    (folder / "round").symlink_to("round")
    os.mkfifo(folder / "pipe")
    assert inside(folder, "in").read_text() == "ours"
    assert inside(folder, "new/name") == folder / "new" / "name"
    for name, words in {
        "out": "leads out",
        "above/other": "leads out",
        "round": "without an end",
        "pipe": "pipe",
    }.items():
        with pytest.raises(InputError, match=words):
            inside(folder, name)
    # The folder itself may be reached by a link.
    (tmp_path / "link").symlink_to(folder)
    assert inside(tmp_path / "link", "file").read_text() == "ours"


@pytest.mark.parametrize("name", ["../../../secret.png", "/etc/hostname"])
def test_a_mask_outside_of_its_stack_is_refused(stack, secret, name):
    replaced(stack / "metadata.jsonl", "masks/000000.png", name)
    with pytest.raises(InputError, match=r"metadata\.jsonl, line 1: .*within its folder"):
        read_stack(stack)


@pytest.mark.parametrize("to", ["webdataset", "coco", "hdf5", "ome-tiff"])
def test_no_export_packs_a_file_from_elsewhere(stack, secret, tmp_path, to):
    mask = stack / "masks" / "000000.png"
    mask.unlink()
    mask.symlink_to(secret)  # of the same content, so that its checksum is right
    with pytest.raises(InputError, match=r"masks/000000\.png"):
        export(stack, to=to, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"split": "train"', '"split": "../../out"'),
        ('"split": "train"', '"split": "other"'),
        ('"name": "0000"', '"name": "../0000"'),
        ('"name": "0000"', '"name": ".."'),
        ('"condition": "dim"', '"condition": "../x"'),
    ],
)
def test_a_stack_outside_of_its_set_is_refused(stack, old, new):
    folder = stack.parents[1]
    replaced(folder / "set.json", old, new)
    with pytest.raises(InputError, match=r"set\.json: stacks\.\d\."):
        read_set(folder)


@pytest.mark.parametrize("name", ["../../x", "a b", ".hidden", "", "x" * 61, "ä"])
def test_a_condition_that_cannot_name_a_folder_is_refused(tmp_path, name):
    path = tmp_path / "spec.toml"
    shutil.copyfile(OLD / "spec.toml", path)
    replaced(path, "[adverse.conditions.dim]", f'[adverse.conditions."{name}"]')
    with pytest.raises(InputError, match=r"spec\.toml: adverse\.conditions"):
        load_spec(path)


def test_a_bag_reads_no_file_from_elsewhere(tmp_path):
    bag = tmp_path / "bag"
    poses = [Pose(time_s=1.0, position_mm=(0.0, 0.0, 1.0))]
    write_bag(bag, frames=[], poses=poses, ros=2)
    (data,) = bag.glob("*.mcap")
    secret = data.rename(tmp_path / data.name)
    metadata = (bag / "metadata.yaml").read_text()
    for name in (f"../{secret.name}", str(secret)):
        (bag / "metadata.yaml").write_text(metadata.replace(secret.name, name))
        with pytest.raises(InputError, match="missing"):
            read_poses(bag)
    (bag / "metadata.yaml").write_text(metadata)
    (bag / secret.name).symlink_to(secret)
    with pytest.raises(InputError, match=rf"bag: '{secret.name}' is a link that leads out"):
        read_poses(bag)


def test_hdf5_packs_no_poses_from_elsewhere(stack, tmp_path):
    poses = stack / "kinematics.csv"
    poses.symlink_to(poses.rename(tmp_path / "kinematics.csv"))
    with pytest.raises(InputError, match="leads out"):
        hdf5.write(stacks_of(stack), tmp_path / "out.h5", lambda: None)
