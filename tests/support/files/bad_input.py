"""Mutations of files that people exchange.

Most know the format: they replace a value, drop a key or change a cell, so that the file gets past
the parser and meets the rules behind it.
"""

import copy
import csv
import hashlib
import io
import json
import math
import os
import struct
import tomllib
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

OLD = Path(__file__).parents[2] / "files-0.1"
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
    *(-3, 7.0, 90.0, 360.0, 1e6, -1e-6, 1.0001, "1_0", "\u0663\u0662", "off", "=1+1", [5, 5, 5]),
    *({"uniform": [0, 1]}, {"uniform": [1, 0]}, {"choice": []}, {"kind": "scan"}, {"": {}}),
)
"""Values of the wrong type, size or meaning."""


def mutated(data: bytes, form: str, rng: Rng) -> bytes:
    """The content of a file with one to three mutations."""
    if rng.random() < 0.25:
        return _of_bytes(data, rng)
    for _ in range(rng.integers(1, 4)):
        try:
            data = _MUTATIONS[form](data, rng)
        except (
            ValueError,
            IndexError,
            TypeError,
            RecursionError,
            AttributeError,
            KeyError,
            csv.Error,
        ):
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


def odd(rng: Rng) -> Any:
    return copy.deepcopy(ODD[rng.integers(len(ODD))])


def _places(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    if len(path) < 12 and isinstance(tree, dict | list):
        items = tree.items() if isinstance(tree, dict) else enumerate(tree)
        for key, value in [*items][:100]:
            yield from _places(value, (*path, key))


def _of_tree(tree: Any, rng: Rng) -> Any:
    """Replace, remove, add or exchange values of a tree of objects and lists."""
    places = [*_places(tree)]
    path = places[rng.integers(len(places))]
    if not path:
        if rng.random() < 0.3 or not isinstance(tree, dict):
            return odd(rng)
        return tree | {str(odd(rng))[:300]: odd(rng)}
    *above, key = path
    parent = tree
    for one in above:
        parent = parent[one]
    match rng.integers(6):
        case 0:
            del parent[key]
        case 1 if isinstance(parent, dict):
            parent[f"{key}_"] = parent.pop(key)
        case 2 if isinstance(parent, list):
            parent.insert(key, copy.deepcopy(parent[key]))
        case 3 if isinstance(parent[key], int | float):
            scale = float(rng.choice([-1.0, 0.0, 1e3, 1e-6, 1e12, 1.5]))
            parent[key] = type(parent[key])(parent[key] * scale)
        case _:
            parent[key] = odd(rng)
    return tree


def _json(data: bytes, rng: Rng) -> bytes:
    return json.dumps(_of_tree(json.loads(data), rng)).encode()


def signed(data: bytes) -> bytes:
    """A plan with the SHA-256 of its content, which whoever changes a plan can compute."""
    content = json.loads(data)
    content.pop("sha256")
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return json.dumps(content | {"sha256": hashlib.sha256(text.encode()).hexdigest()}).encode()


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
            table[row][column] = str(odd(rng))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(table)
    return text.getvalue().encode(errors="surrogatepass")


def _words(data: bytes, rng: Rng) -> bytes:
    """Replace a word of any text format."""
    words = data.decode().split(" ")
    words[rng.integers(len(words))] = str(odd(rng))
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
    return data[:8] + png_chunk(b"IHDR", bytes(header)) + data[33:]


def png_chunk(name: bytes, content: bytes) -> bytes:
    checked = name + content
    return struct.pack(">I", len(content)) + checked + struct.pack(">I", zlib.crc32(checked))


_MUTATIONS: dict[str, Callable[[bytes, Rng], bytes]] = {
    "json": _json,
    "signed": lambda data, rng: signed(_json(data, rng)),
    "jsonl": _json_lines,
    "toml": lambda data, rng: tomli_w.dumps(_of_tree(tomllib.loads(data.decode()), rng)).encode(
        errors="surrogatepass"
    ),
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
                while (changed := mutated(data, form, rng)) == data:
                    pass  # 0 times 1.5
                path.write_bytes(changed)
        yield
    finally:
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        else:
            path.unlink(missing_ok=True)
        path.write_bytes(data)
