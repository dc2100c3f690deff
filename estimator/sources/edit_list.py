"""How many samples of an MP4 or MOV file its edit list shows (ISO/IEC 14496-12, 8.6.6).

Phones and editors cut a video without encoding it again: all samples from the last key frame on
stay in the file, and a list says which of them are shown.
"""

import struct
from collections.abc import Iterator
from pathlib import Path

_MOST_BYTES = 2**26
"""Largest box `moov` that is read: the tables of some 3 million frames."""
_NOTHING = -1
"""Media time of an entry that shows nothing for a while."""


def shown_share(path: Path) -> float:
    """Part of a video's duration that its edit list shows; 1 without such a list."""
    try:
        return min(1.0, _share(_movie(path)))
    # Of an empty generator, of none where one is expected, of cut numbers, of no duration.
    except (RuntimeError, StopIteration, ValueError, struct.error, ZeroDivisionError):
        return 1.0  # another format, or damage that the decoder will report


def _movie(path: Path) -> bytes:
    """The content of the box `moov`."""
    with path.open("rb") as file:
        while True:
            size, kind = struct.unpack(">I4s", file.read(8))
            head = 8
            if size == 1:
                size, head = struct.unpack(">Q", file.read(8))[0], 16
            if kind == b"moov":
                return file.read(min(size - head, _MOST_BYTES))
            if size < head:
                return b""  # it goes on to the end of the file, or is damaged
            file.seek(size - head, 1)


def _boxes(data: bytes, kind: bytes) -> Iterator[bytes]:
    """The contents of all boxes of one kind in a box."""
    at = 0
    while at + 8 <= len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        if size < 8:
            return
        if name == kind:
            yield data[at + 8 : at + size]
        at += size


def _inner(data: bytes, *path: bytes) -> bytes:
    """The content of the first box with this path."""
    for kind in path:
        data = next(_boxes(data, kind))
    return data


def _timescale_and_duration(header: bytes) -> tuple[int, int]:
    """Of the boxes `mvhd` and `mdhd`: units a second, and duration in them."""
    layout, at = (">IQ", 20) if header[0] else (">II", 12)  # version 1 has longer times
    scale, duration = struct.unpack_from(layout, header, at)
    return scale, duration


def _share(movie: bytes) -> float:
    (video,) = (
        track
        for track in _boxes(movie, b"trak")
        if _inner(track, b"mdia", b"hdlr")[8:12] == b"vide"
    )
    edits = _inner(video, b"edts", b"elst")
    count = struct.unpack_from(">I", edits, 4)[0]
    entry = ">QqI" if edits[0] else ">IiI"
    size = struct.calcsize(entry)
    entries = [struct.unpack_from(entry, edits, 8 + size * i) for i in range(min(count, 1000))]
    shown = sum(duration for duration, media_time, _ in entries if media_time != _NOTHING)
    scale, _ = _timescale_and_duration(_inner(movie, b"mvhd"))
    own_scale, whole = _timescale_and_duration(_inner(video, b"mdia", b"mdhd"))
    return shown / scale / (whole / own_scale)
