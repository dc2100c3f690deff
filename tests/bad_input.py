"""Mutations of files that people exchange, and every reader that may meet such a file.

A case is a name of `TARGETS` and a seed. Most mutations know the format: they replace a value, drop
a key or change a cell, so that the file gets past the parser and meets the rules behind it.
"""

from __future__ import annotations

import copy
import csv
import io
import json
import math
import os
import shutil
import struct
import tomllib
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import tomli_w

from benchmarks import study
from benchmarks.sets.read import read_set, rows, stacks_of, verify_set
from benchmarks.sets.spec import load_spec, plan
from calibration.command.choices import Choices
from estimator import Frame
from estimator.distance.ranger import Ranger
from estimator.run.options import Options
from estimator.sources.opening import open_source
from estimator.sources.ros import write_bag
from formats.calibration import read_calibration
from formats.microscope import read_microscope
from formats.poses import Pose, read_poses
from formats.spots import read_spots
from formats.stack import read_stack
from optics import load_lens
from scenes.description.scene_file import load_scene, scene_toml
from scenes.walls.picture import wall_image
from scenes.world.motion import frame_count, kinematics
from scenes.world.world import World

OLD = Path(__file__).with_name("files-0.1")
"""Files as version 0.1.0 wrote them."""

Rng = np.random.Generator
_LONG = "x" * 200_000
_DEEP: list[Any] = []
for _ in range(100):
    _DEEP = [_DEEP]
ODD: tuple[Any, ...] = (
    *(0, -1, 1, 2**31, 2**32, 2**63, 2**64, -(2**63) - 1, 10**30, 10**400),
    *(0.5, -0.0, math.inf, -math.inf, math.nan, 1e308, -1e308, 5e-324, 1e9, 1e-9, 1e18),
    *("", "0", "1e999", "contact", "lens", _LONG, "a\0b", "\ud800", "größer $x$ [b] {0} %s"),
    *("../../../etc/passwd", "/etc/passwd", "frames\\..\\x", ".", "a" * 255, "nan", "\n\n\n"),
    *([], {}, [[]], [1], [1] * 1000, [None], ["a", 1], _DEEP, None, True, False),
    *({"uniform": [0, 1]}, {"uniform": [1, 0]}, {"choice": []}, {"kind": "scan"}, {"": {}}),
)
"""Values of the wrong type, size or meaning."""


class Target(NamedTuple):
    """A file and the reader that meets it.

    Attributes:
        file: from the folder that `samples` makes; "" if the value is given on a command line.
        form: of the content, a key of `_MUTATIONS`.
        read: reads it, given the folder.
    """

    file: str
    form: str
    read: Callable[[Path], object]


def mutated(data: bytes, form: str, rng: Rng) -> bytes:
    """The content of a file with one to three mutations."""
    if rng.random() < 0.25:
        return _of_bytes(data, rng)
    for _ in range(rng.integers(1, 4)):
        try:
            data = _MUTATIONS[form](data, rng)
        except (ValueError, IndexError, TypeError, RecursionError, AttributeError, csv.Error):
            return _of_bytes(data, rng)  # an earlier mutation made it no such file
    return data


def _of_bytes(data: bytes, rng: Rng) -> bytes:
    """Cut, swapped or overwritten bytes, or those of another format."""
    changed = bytearray(data)
    size = max(1, len(data))
    place = int(rng.integers(size))
    match rng.integers(9):
        case 0:
            return b""
        case 1:
            return data[:place]
        case 2:
            for at in rng.integers(size, size=rng.integers(1, 20)):
                changed[at : at + 1] = bytes([rng.integers(256)])
        case 3:
            end = place + int(rng.integers(1, 9))
            changed[place:end] = rng.choice([b"\xff", b"\0", b"\x7f"]) * (end - place)
        case 4:
            other = int(rng.integers(size))
            changed[place : place + 4], changed[other : other + 4] = (
                changed[other : other + 4],
                changed[place : place + 4],
            )
        case 5:
            return data + data
        case 6:
            return rng.bytes(int(rng.integers(1, 3000)))
        case 7:
            return _FOREIGN[rng.integers(len(_FOREIGN))]
        case 8:
            changed[place:place] = bytes(int(rng.integers(1, 2000)))
    return bytes(changed)


def _odd(rng: Rng) -> Any:
    return copy.deepcopy(ODD[rng.integers(len(ODD))])


def _places(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    if len(path) < 12:
        items = tree.items() if isinstance(tree, dict) else enumerate(tree)
        if isinstance(tree, dict | list):
            for key, value in [*items][:100]:
                yield from _places(value, (*path, key))


def _of_tree(tree: Any, rng: Rng) -> Any:
    """Replace, remove, add or exchange values of a tree of objects and lists."""
    places = [*_places(tree)] if isinstance(tree, dict | list) else [()]
    path = places[rng.integers(len(places))]
    if not path:
        return _odd(rng) if rng.random() < 0.3 else _of_tree_at(tree, (), rng)
    return _of_tree_at(tree, path, rng)


def _of_tree_at(tree: Any, path: tuple[Any, ...], rng: Rng) -> Any:
    if not path:
        if isinstance(tree, dict):
            tree[str(_odd(rng))[:300]] = _odd(rng)
        return tree
    above = tree
    for key in path[:-1]:
        above = above[key]
    key = path[-1]
    match rng.integers(6):
        case 0:
            del above[key]
        case 1 if isinstance(above, dict):
            above[f"{key}_"] = above.pop(key)
        case 2 if isinstance(above, list):
            above.insert(key, copy.deepcopy(above[key]))
        case 3 if isinstance(above[key], int | float):
            scale = rng.choice([-1.0, 0.0, 1e3, 1e-6, 1e12, 1.5])
            above[key] = type(above[key])(above[key] * scale)
        case _:
            above[key] = _odd(rng)
    return tree


def _json(data: bytes, rng: Rng) -> bytes:
    tree = _of_tree(json.loads(data), rng)
    return json.dumps(tree).encode()


def _json_lines(data: bytes, rng: Rng) -> bytes:
    lines = data.splitlines()
    at = int(rng.integers(len(lines)))
    match rng.integers(5):
        case 0:
            lines[at] = [b"5", b"null", b"", b"[]", b'"x"', b"{}", b"["][rng.integers(7)]
        case 1:
            lines.insert(at, lines[at])
        case _:
            lines[at] = _json(lines[at], rng)
    return b"\n".join(lines) + b"\n"


def _toml(data: bytes, rng: Rng) -> bytes:
    tree = _of_tree(tomllib.loads(data.decode()), rng)
    return tomli_w.dumps(tree).encode(errors="surrogatepass")


def _csv(data: bytes, rng: Rng) -> bytes:
    table = [*csv.reader(io.StringIO(data.decode()))]
    row = int(rng.integers(len(table)))
    column = int(rng.integers(len(table[row])))
    match rng.integers(6):
        case 0:
            del table[row][column]
        case 1:
            table[row].append("1")
        case 2:
            table = [[*line[:column], *line[column + 1 :]] for line in table]
        case 3:
            table.insert(row, table[row])
        case _:
            table[row][column] = str(_odd(rng))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(table)
    return text.getvalue().encode(errors="surrogatepass")


def _words(data: bytes, rng: Rng) -> bytes:
    """Replace a word of any text format."""
    words = data.decode().split(" ")
    words[rng.integers(len(words))] = str(_odd(rng))
    return " ".join(words).encode(errors="surrogatepass")


def _png(data: bytes, rng: Rng) -> bytes:
    """Another size, depth or kind of colours in a header whose checksum is right."""
    header = bytearray(data[16:29])
    sides = [0, 1, 30_000, 2**31 - 1, 2**32 - 1, 65_536, 79, 81]
    if rng.random() < 0.7:
        at = 4 * int(rng.integers(2))
        header[at : at + 4] = struct.pack(">I", sides[rng.integers(len(sides))])
    else:
        header[8 + rng.integers(5)] = rng.integers(256)
    checked = b"IHDR" + bytes(header)
    return data[:12] + checked + struct.pack(">I", zlib.crc32(checked)) + data[33:]


_MUTATIONS: dict[str, Callable[[bytes, Rng], bytes]] = {
    "json": _json,
    "jsonl": _json_lines,
    "toml": _toml,
    "csv": _csv,
    "words": _words,
    "png": _png,
    "bytes": _of_bytes,
}
_FOREIGN = (
    b'{"schema": 2}',
    b"[]",
    b"5",
    b"[" * 100_000,
    b'{"a":' * 100_000,
    b"schema = 1\n" + b"a." * 50_000 + b"a = 1\n",
    b"a = " + b"[" * 100_000,
    b"%YAML:1.0\n---\nK: !!opencv-matrix\n rows: 1000000\n cols: 1000000\n dt: d\n data: []\n",
    b"%YAML:1.0\n---\n" + b"- " * 20_000,
    b"<?xml version='1.0'?><opencv_storage>" + b"<a>" * 20_000,
    b"\x89PNG\r\n\x1a\n",
    b"\xff\xd8\xff\xe0",
    b"II*\0\x08\0\0\0\xff\xff",
    b"PAR1" + bytes(50) + b"PAR1",
    b"#ROSBAG V2.0\n" + b"\xff" * 100,
    b"\x89MCAP0\r\n" + b"\xff" * 100,
    b"P5 100000 100000 255\n",
    b"RIFF\xff\xff\xff\xffAVI LIST",
    bytes(10_000),
    b'"' * 200_000,
    b"frame," * 40_000,
)
"""Contents of other formats, and content that is made to hurt a parser."""


def _scene(folder: Path) -> None:
    scene = load_scene(folder / "scene.toml")
    scene_toml(scene)
    world = World(scene)
    if frame_count(scene) <= 1000:
        kinematics(scene, world.motion)


def _stack(folder: Path) -> None:
    stack = read_stack(folder / "small-v1" / "train" / "0000")
    for frame in open_source(stack.folder):
        assert frame.image.size
    for labels in stack.labels:
        stack.mask(labels)
    read_microscope(stack.folder / "microscope.json")
    read_poses(stack.folder / "kinematics.csv")
    stack.verify()


def _set(folder: Path) -> None:
    labelled = read_set(folder / "small-v1")
    stacks_of(labelled.folder)
    for row in rows(labelled):
        row.line()
    verify_set(labelled.folder)


def _frames(name: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        for index, frame in enumerate(open_source(folder / name)):
            assert frame.image.size
            if index > 200:
                break

    return read


def _bag(name: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        _frames(name)(folder)
        read_poses(folder / name)

    return read


def _run(folder: Path) -> None:
    os.close(study.claim(folder / "run", _SETTINGS, command="eyespot validate"))


def _calibration(folder: Path) -> None:
    calibration = read_calibration(folder / "calibration.json")
    # The file of 0.1 was calibrated under a microscope of this scale.
    microscope = replace(read_microscope(folder / "microscope.json"), scale_mm_px=0.0067)
    Ranger(calibration, microscope)


def _opencv(name: str) -> Callable[[Path], object]:
    return lambda folder: read_microscope(
        folder / name, pinhole_height_mm=200.0, eye_radius_mm=11.5
    ).camera()


def _wall(folder: Path) -> None:
    wall_image(folder / "image.png", width_mm=24.0, white=0.5, extent_mm=24.0, pixels=64)


_SETTINGS = {"schema": 1, "quick": True, "seed": 0, "source": "cone", "spec": {"frames": [3, 4]}}
_STACK = "small-v1/train/0000"
TARGETS = {
    "microscope": Target(
        "microscope.json", "json", lambda f: read_microscope(f / "microscope.json")
    ),
    "opencv yaml": Target("camera.yml", "words", _opencv("camera.yml")),
    "opencv xml": Target("camera.xml", "words", _opencv("camera.xml")),
    "opencv json": Target("camera.json", "json", _opencv("camera.json")),
    "calibration": Target("calibration.json", "json", _calibration),
    "lens calibration": Target(
        "calibration-lens.json", "json", lambda f: read_calibration(f / "calibration-lens.json")
    ),
    "scene": Target("scene.toml", "toml", _scene),
    "spec": Target("spec.toml", "toml", lambda f: plan(load_spec(f / "spec.toml"))),
    "lens": Target("lens.toml", "toml", lambda f: load_lens(f / "lens.toml")),
    "stack": Target(f"{_STACK}/stack.toml", "toml", _stack),
    "labels": Target(f"{_STACK}/metadata.jsonl", "jsonl", _stack),
    "manifest": Target(f"{_STACK}/manifest.json", "json", _stack),
    "stack's microscope": Target(f"{_STACK}/microscope.json", "json", _stack),
    "stack's poses": Target(f"{_STACK}/kinematics.csv", "csv", _stack),
    "frame": Target(f"{_STACK}/frames/000000.png", "png", _stack),
    "mask": Target(f"{_STACK}/masks/000000.png", "png", _stack),
    "set": Target("small-v1/set.json", "json", _set),
    "set's manifest": Target("small-v1/manifest.json", "json", _set),
    "set's stack": Target(f"{_STACK}/stack.toml", "toml", _set),
    "run": Target("run/run.json", "json", _run),
    "spots": Target("spots.csv", "csv", lambda f: read_spots(f / "spots.csv")),
    "parquet": Target("spots.parquet", "bytes", lambda f: read_spots(f / "spots.parquet")),
    "poses": Target("poses.csv", "csv", lambda f: read_poses(f / "poses.csv")),
    "wall image": Target("image.png", "png", _wall),
    "png": Target("image.png", "png", _frames("image.png")),
    **{
        kind: Target(f"image.{kind}", "bytes", _frames(f"image.{kind}"))
        for kind in ("jpg", "bmp", "webp", "pgm", "jp2", "tif")
    },
    "video": Target("video.mp4", "bytes", _frames("video.mp4")),
    "avi": Target("video.avi", "bytes", _frames("video.avi")),
    "ros 1": Target("ros1.bag", "bytes", _bag("ros1.bag")),
    "ros 2": Target("ros2/ros2.mcap", "bytes", _bag("ros2")),
    "ros 2 metadata": Target("ros2/metadata.yaml", "words", _bag("ros2")),
}
"""Every kind of file that people exchange."""

_KEYS = ("motion.kind", "motion", "camera.bit_depth", "spot", "microscope.width_px", "a.b.c", "")


def given_value(name: str, rng: Rng) -> None:
    """Give an odd value on a command line, to the function that reads it."""
    value = str(_odd(rng)) if rng.random() < 0.5 else _toml_value(_odd(rng))
    number = ",".join(str(_odd(rng))[:1000] for _ in range(rng.integers(1, 5)))
    match name:
        case "--set":
            key = _KEYS[rng.integers(len(_KEYS))] if rng.random() < 0.9 else "a." * 1000
            load_scene(None, [f"{key}={value}"])
        case "--set of a spec":
            load_spec("static-v1", [f"{_KEYS[rng.integers(len(_KEYS))]}={value}"])
        case "--prior":
            given = (f"eye_radius={number}", f"{value}=1,1")
            assert Choices(prior=given[: rng.integers(1, 3)]).priors
        case "--eye-from-robot":
            assert Choices(eye_from_robot=number).rotation
        case "options":
            names = [*Options.model_fields, "more"]
            Options.of({names[rng.integers(len(names))]: _odd(rng)})
        case "source":
            open_source(value.replace("\0", ""))


VALUES = ("--set", "--set of a spec", "--prior", "--eye-from-robot", "options", "source")


def _toml_value(value: Any) -> str:
    try:
        return tomli_w.dumps({"v": value}).removeprefix("v = ").strip()
    except (TypeError, RecursionError):
        return str(value)


def samples(folder: Path) -> Path:
    """A folder with a good file for every target."""
    shutil.copytree(OLD, folder, dirs_exist_ok=True)
    shutil.copyfile(folder / _STACK / "microscope.json", folder / "microscope.json")
    shutil.copyfile(folder / _STACK / "kinematics.csv", folder / "poses.csv")
    (folder / "lens.toml").write_text(
        "schema = 1\n[lens]\ncore_radius = 0.25\nglue_length = 0.12\naperture_radius = 0.25\n"
        "sag = 0.12\nglue_index = 1.49\nnumerical_aperture = 0.2\n"
    )
    matrix = np.array([[3432.8, 0, 330.5], [0, 3432.8, 224.25], [0, 0, 1]])
    _run(folder)
    for suffix in ("yml", "xml", "json"):
        storage = cv2.FileStorage(str(folder / f"camera.{suffix}"), cv2.FILE_STORAGE_WRITE)
        storage.write("camera_matrix", matrix)
        storage.write("distortion_coefficients", np.zeros((1, 5)))
        storage.write("image_width", 640)
        storage.write("image_height", 480)
        storage.release()
    image = cv2.imread(str(folder / _STACK / "frames" / "000000.png"))
    assert image is not None
    for suffix in ("png", "jpg", "bmp", "webp", "jp2", "tif"):
        assert cv2.imwrite(str(folder / f"image.{suffix}"), image)
    assert cv2.imwrite(str(folder / "image.pgm"), image[:, :, 0])
    for name, codec in (("video.mp4", "mp4v"), ("video.avi", "MJPG")):
        video = cv2.VideoWriter(
            str(folder / name), cv2.VideoWriter.fourcc(*codec), 10, image.shape[1::-1]
        )
        for _ in range(4):
            video.write(image)
        video.release()
    frames = [Frame(index=n, time_s=1.0 + n, image=image) for n in range(2)]
    poses = [Pose(time_s=0.5 + n, position_mm=(0.0, 0.0, float(n))) for n in range(3)]
    write_bag(folder / "ros1.bag", frames=frames, poses=poses, ros=1)
    write_bag(folder / "ros2", frames=frames, poses=poses, ros=2)
    return folder


@contextmanager
def spoilt(path: Path, rng: Rng, form: str) -> Iterator[None]:
    """The file mutated or, once in twenty, replaced by something else, for the `with` block."""
    data = path.read_bytes()
    path.unlink()
    try:
        match rng.integers(100):
            case 0:
                os.mkfifo(path)
            case 1:
                path.mkdir()
            case 2:
                path.symlink_to("/dev/zero")
            case 3:
                path.symlink_to("/etc/hostname")
            case 4:
                pass  # missing
            case _:
                path.write_bytes(mutated(data, form, rng))
        yield
    finally:
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        else:
            path.unlink(missing_ok=True)
        path.write_bytes(data)
