"""ROS 1 and ROS 2 bags, opened without ROS: their topics and messages.

`pose_files` reads the robot's poses from them, `estimator.sources` the images.
"""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eyespot.formats.inputs import InputError, check_regular, in_file, inside
from eyespot.formats.whole_files import damage_reported

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


_MAX_YAML_BYTES = 2**16  # largest metadata.yaml; that of a bag of fifty topics has 40 kB
_REMEDY = "Repair a truncated bag with `rosbag reindex`, `ros2 bag reindex` or `mcap recover`."


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS 1 bag, or a ROS 2 bag: a folder, or its file alone."""
    return (path / "metadata.yaml").is_file() or path.suffix in (".bag", ".db3", ".mcap")


@contextmanager
def opened_bag(path: Path) -> Iterator["AnyReader"]:
    """A bag, opened for the `with` block.

    Raises:
        InputError: the file is not a bag, is damaged, or is a folder with a link that leads out.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    # Old ROS 2 bags contain no message definitions; those of the messages used here have never
    # changed.
    types = get_typestore(Stores.ROS2_HUMBLE)
    # rosbags takes the last part of a name in metadata.yaml, so only a link leads out of a bag.
    with in_file(path):
        files = [inside(path, file.name) for file in path.iterdir()] if path.is_dir() else [path]
    for file in files:
        most = _MAX_YAML_BYTES if file.suffix == ".yaml" else None
        with in_file(file):
            check_regular(file, most_bytes=most, remedy=_REMEDY)
    with _damage_reported(f"{path}"):
        reader = AnyReader([path], default_typestore=types)
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


@contextmanager
def _damage_reported(where: str) -> Iterator[None]:
    with damage_reported(where, _REMEDY):
        try:
            yield
        except MemoryError as error:  # sizes that damage announces are asked for at once
            raise InputError("it announces more data than fit into memory") from error


def topic_in(
    reader: "AnyReader", path: Path, name: str | None, *, kinds: tuple[str, ...], usual: str
) -> str:
    """Choose a topic of a bag.

    Args:
        name: of the topic; None takes the usual one, or else the only one of these kinds.

    Raises:
        InputError: the bag has no such topic, or several and none was named.
    """
    found = sorted(t for t, info in reader.topics.items() if info.msgtype in kinds)
    wanted = name or (usual if usual in found else None)
    if wanted is None and len(found) == 1:
        return found[0]
    if wanted in found:
        return wanted
    content = kinds[0].rpartition("/")[2].lower()
    asked = f"no topic {name} of" if name else "no one topic of" if found else "no topic of"
    choice = f"Choose one of {', '.join(found)}." if found else "Check that it is the right bag."
    raise InputError(f"{path} holds {asked} {' or '.join(kinds)} for the {content}s. {choice}")


def messages_of(reader: "AnyReader", path: Path, topic: str) -> Iterator[tuple[float, Any]]:
    """Time of arrival (s) and content of each message of a topic, in the order of arrival.

    The content of a message that cannot be decoded is the InputError that says why.

    Raises:
        InputError: the bag is damaged.
    """
    messages = reader.messages([c for c in reader.connections if c.topic == topic])
    for index in itertools.count():
        with _damage_reported(f"{path}, {topic}, message {index}"):
            item = next(messages, None)
        if item is None:
            return
        connection, time_ns, data = item
        try:
            with _damage_reported(connection.msgtype):
                message = reader.deserialize(data, connection.msgtype)
        except InputError as error:
            message = error
        yield time_ns / 1e9, message


def stamp_s(header: Any) -> float:
    """Time stamp of a message's header, s; 0 if the header has none."""
    return (header.stamp.sec * 10**9 + header.stamp.nanosec) / 1e9
