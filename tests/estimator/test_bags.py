"""ROS bags, ROS 1 and ROS 2, and the robot's poses: written by rosbags, read without ROS."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from eyespot.estimator import SubpixelSettings, track
from eyespot.estimator.run.offline import Ended, track_source
from eyespot.estimator.sources.opening import open_source
from eyespot.estimator.sources.ros import IMAGE_TOPIC, frame_of_message, write_bag
from eyespot.estimator.sources.source import Frame
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import POSE_TOPIC, Pose, PoseTrack, read_poses, turned
from eyespot.formats.spot import Spot
from eyespot.scenes.drawn import Drawing, Truth, frame_of
from tests.support.drawn.drawn_recording import new_reader
from tests.support.rig.ros_messages import (
    EPOCH_S,
    ROS1,
    ROS2,
    compressed_message,
    header,
    image_message,
    message,
    write,
)

CLOCK_S = 2.4e-7  # what float64 resolves of a time in s since 1970


def frames() -> list[Frame]:
    rng = np.random.default_rng(0)
    truths = [Truth(x=70 + 6 * k, y=80, semi_major=33, semi_minor=30 + k) for k in range(4)]
    return [
        Frame(
            index=k, time_s=EPOCH_S + k / 10, image=frame_of(Drawing(truth=truth), rng, (160, 200))
        )
        for k, truth in enumerate(truths)
    ]


def poses() -> list[Pose]:
    """At 200 Hz, from a little before the first frame."""
    return [
        Pose(
            time_s=EPOCH_S - 0.0125 + k / 200,
            position_mm=(1.5, -2.25, k / 8),
            rotation=tuple(Rotation.from_euler("xyz", [0.1, 0.2, k / 100]).as_quat()),
        )
        for k in range(70)
    ]


def known(poses: PoseTrack, time_s: float) -> tuple[Pose, float]:
    found = poses.at(time_s)
    assert found is not None
    return found


def write_ros2(path: Path, storage: rosbag2.StoragePlugin) -> Path:
    times = {frame.time_s: frame.image for frame in frames()}
    images = [(IMAGE_TOPIC, t, image_message(ROS2, x, "rgb8", t)) for t, x in times.items()]
    return write(path, ROS2, images, version=9, storage_plugin=storage)


def write_ours(path: Path) -> Path:
    write_bag(path, frames=frames(), poses=poses())
    return path


BAGS: dict[str, Callable[[Path], Path]] = {
    "ros1.bag": write_ours,
    "sqlite": lambda path: write_ros2(path, rosbag2.StoragePlugin.SQLITE3),
    "mcap": lambda path: write_ros2(path, rosbag2.StoragePlugin.MCAP),
}


def the_file(bag: Path) -> Path:
    """A ROS 1 bag, or the one file of messages in a ROS 2 bag."""
    if bag.is_file():
        return bag
    (found,) = (path for path in bag.iterdir() if path.suffix in (".db3", ".mcap"))
    return found


@pytest.mark.parametrize(
    ("name", "alone"), [*((name, False) for name in BAGS), ("sqlite", True), ("mcap", True)]
)
def test_a_bag_gives_the_spots_of_its_frames_as_does_the_file_in_it(tmp_path, name, alone):
    bag = BAGS[name](tmp_path / name)
    source = open_source(the_file(bag) if alone else bag)
    assert source.length == len(frames())
    for frame, other in zip(source, frames(), strict=True):
        np.testing.assert_array_equal(frame.image, other.image)
        assert frame.index == other.index
        assert frame.time_s == pytest.approx(other.time_s, abs=CLOCK_S, rel=0)
    tracking = track_source(source, new_reader())
    expected = track((frame.image for frame in frames()), SubpixelSettings())
    for record, spot in zip(tracking.records, expected, strict=True):
        assert isinstance(spot, Spot)
        np.testing.assert_equal(vars(record.result), vars(spot))


def test_a_bag_that_is_written_has_the_rigs_topics_as_rosbags_reads_them(tmp_path):
    path = write_ours(tmp_path / "rig.bag")
    with AnyReader([path]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        assert kinds == {
            "/decklink/camera/image_raw": "sensor_msgs/msg/Image",
            "/eye_robot/FrameEE": "geometry_msgs/msg/Transform",
        }
        received: list[tuple[str, int, Any]] = [
            (c.topic, t, reader.deserialize(d, c.msgtype)) for c, t, d in reader.messages()
        ]
    times = [time_ns for _, time_ns, _ in received]
    assert times == sorted(times)
    images = [(t, m) for topic, t, m in received if topic == IMAGE_TOPIC]
    for (time_ns, image), frame in zip(images, frames(), strict=True):
        assert (image.height, image.width, image.encoding) == (160, 200, "rgb8")
        assert image.data.tobytes() == frame.image.tobytes()
        assert image.header.stamp.sec * 10**9 + image.header.stamp.nanosec == time_ns
        assert image.header.seq == frame.index
    transforms = [(t, m) for topic, t, m in received if topic == POSE_TOPIC]
    for (time_ns, transform), pose in zip(transforms, poses(), strict=True):
        assert time_ns == round(pose.time_s * 1e9)
        assert transform.translation.z == pose.position_mm[2]
        assert transform.rotation.w == pose.rotation[3]


def test_frames_are_written_one_by_one(tmp_path):
    """Neither all frames nor all poses are taken before the first is written."""
    taken: list[float] = []

    def noted(items):
        for item in items:
            taken.append(item.time_s)
            yield item

    write_bag(tmp_path / "a.bag", frames=noted(frames()), poses=noted(poses()))
    # A merge holds one of each: what is taken is never further ahead than the other's next.
    assert max(np.diff(taken)) <= 0.1 + CLOCK_S
    assert taken.index(frames()[2].time_s) < taken.index(poses()[-1].time_s)


@pytest.mark.parametrize(
    ("dtype", "channels", "encoding"),
    [("uint8", 1, "mono8"), ("uint16", 1, "mono16"), ("uint8", 3, "rgb8"), ("uint16", 3, "rgb16")],
)
def test_a_frame_of_any_depth_goes_through_a_bag(tmp_path, dtype, channels, encoding):
    shape = (6, 5) if channels == 1 else (6, 5, channels)
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    frame = Frame(index=0, time_s=1.0, image=image)
    write_bag(tmp_path / "a.bag", frames=[frame], poses=[])
    (back,) = open_source(tmp_path / "a.bag")
    assert back.image.dtype == dtype
    np.testing.assert_array_equal(back.image, image)
    with AnyReader([tmp_path / "a.bag"]) as reader:
        ((connection, _, data),) = reader.messages()
        stored: Any = reader.deserialize(data, connection.msgtype)
    assert stored.encoding == encoding


RGB = np.random.default_rng(1).integers(0, 255, (6, 5, 3), dtype=np.uint8)


def test_bytes_as_rospy_gives_them_are_read_too():
    raw = image_message(ROS1, RGB, "rgb8")
    raw.data = raw.data.tobytes()
    np.testing.assert_array_equal(frame_of_message(raw)[0], RGB)


BROKEN: dict[str, tuple[dict[str, Any], str]] = {
    "encoding": ({"encoding": "jpeg"}, "must be mono .* got 'jpeg'"),
    "height": ({"height": 7}, "5x7 px .* cannot be made of 90 bytes"),
    "step": ({"step": 3}, "3 bytes a row"),
    "empty": ({"width": 0, "height": 0}, "cannot be made"),
    "no data": ({"data": np.zeros(0, np.uint8)}, "cannot be made of 0 bytes"),
    "odd": ({"encoding": "yuv422", "step": 15}, "even width"),
    "cut png": ({"data": compressed_message(ROS1, RGB).data[:50]}, r"\('png', 50 bytes\) .*trunc"),
    "empty png": ({"data": np.zeros(0, np.uint8), "format": "png"}, "0 bytes.*is empty"),
    "depth": ({"format": "16UC1; compressedDepth png"}, "depths, not of light"),
}


def bag_of_good_and(path: Path, broken: str, order: str) -> Path:
    """Images of which those that are written "x" have a fault of `BROKEN`."""
    changed, messages = BROKEN[broken][0], []
    for k, letter in enumerate(order):
        compressed = "png" in broken or "format" in changed
        content = compressed_message(ROS1, RGB) if compressed else image_message(ROS1, RGB, "rgb8")
        content.header = header(ROS1, EPOCH_S + k)
        for name, value in changed.items() if letter == "x" else ():
            setattr(content, name, value)
        messages.append((IMAGE_TOPIC, 1.0 + k, content))
    return write(path, ROS1, messages)


@pytest.mark.parametrize("broken", BROKEN)
@pytest.mark.parametrize("order", ["xoox", "ooxxo"])
def test_an_image_that_makes_no_sense_costs_its_frame_alone(tmp_path, broken, order, caplog):
    source = open_source(bag_of_good_and(tmp_path / "a.bag", broken, order))
    tracking = track_source(source, new_reader())
    assert tracking.ended is Ended.COMPLETE
    expected = ["unreadable" if letter == "x" else "none_found" for letter in order]
    assert [record.reason for record in tracking.records] == expected
    assert [record.time_s - EPOCH_S for record in tracking.records] == [*range(len(order))]
    (said,) = caplog.messages
    assert f"a.bag, {IMAGE_TOPIC}: 2 of {len(order)} images" in said
    assert re.search(f"The first, frame {order.index('x')}: .*{BROKEN[broken][1]}", said)


def test_a_bag_without_any_good_image_is_refused(tmp_path):
    source = open_source(bag_of_good_and(tmp_path / "a.bag", "empty", "xxx"))
    words = "none of 3 images .* frame 0: .*cannot be made.*Record again .*another topic"
    with pytest.raises(InputError, match=words):
        track_source(source, new_reader())


@pytest.mark.parametrize("cut", [0, 20])
def test_a_message_that_breaks_off_costs_its_frame_alone(tmp_path, cut, caplog):
    path = tmp_path / "a.bag"
    content = ROS1.serialize_ros1(image_message(ROS1, RGB, "rgb8"), "sensor_msgs/msg/Image")
    with rosbag1.Writer(path) as writer:
        connection = writer.add_connection(IMAGE_TOPIC, "sensor_msgs/msg/Image", typestore=ROS1)
        for time_s, data in ((1, content), (2, content[:cut]), (3, content)):
            writer.write(connection, round(time_s * 1e9), data)
    found = list(open_source(path))
    assert [bool(frame.fault) for frame in found] == [False, True, False]
    assert found[1].time_s == 2.0  # of its arrival
    assert "1 of 3 images could not be decoded" in caplog.text


def test_stamps_that_go_back_are_said_once_and_keep_the_order_of_arrival(tmp_path, caplog):
    stamps = [5.0, 6.0, 4.0, 3.0, 7.0]
    messages = [
        (IMAGE_TOPIC, 10.0 + k, image_message(ROS1, RGB, "rgb8", time_s))
        for k, time_s in enumerate(stamps)
    ]
    frames = list(open_source(write(tmp_path / "a.bag", ROS1, messages)))
    assert [frame.time_s for frame in frames] == stamps
    (said,) = caplog.messages
    assert "the stamp of frame 2, 4.000000 s, is earlier than one before it, 6.000000 s" in said


def test_an_image_without_a_stamp_has_the_time_of_its_arrival(tmp_path):
    image = image_message(ROS1, RGB, "rgb8", time_s=0.0)
    (frame,) = open_source(write(tmp_path / "a.bag", ROS1, [(IMAGE_TOPIC, 12.5, image)]))
    assert frame.time_s == 12.5


def test_the_topic_is_the_rigs_or_the_only_one_or_the_one_that_is_named(tmp_path):
    other = image_message(ROS1, RGB, "rgb8")
    rig = image_message(ROS1, RGB[:, :, 0], "mono8")
    both = write(tmp_path / "both.bag", ROS1, [("/left", 1, other), (IMAGE_TOPIC, 2, rig)])
    assert [frame.image.ndim for frame in open_source(both)] == [2]
    assert [frame.image.ndim for frame in open_source(both, image_topic="/left")] == [3]
    with pytest.raises(ValueError, match=r"no topic /up .*Choose one of /decklink/.*, /left"):
        open_source(both, image_topic="/up")
    strange = write(tmp_path / "two.bag", ROS1, [("/left", 1, other), ("/right", 2, other)])
    with pytest.raises(ValueError, match=r"Choose one of /left, /right"):
        open_source(strange)
    with pytest.raises(ValueError, match="no topic of geometry_msgs"):
        read_poses(strange)


@pytest.mark.parametrize("name", BAGS)
@pytest.mark.parametrize("share", [0.01, 0.5, 0.999])
def test_a_bag_cut_short_is_refused_with_a_remedy(tmp_path, name, share):
    bag = BAGS[name](tmp_path / name)
    data = the_file(bag).read_bytes()
    the_file(bag).write_bytes(data[: int(len(data) * share)])
    with pytest.raises(ValueError, match=rf"{name}.* cannot be read: .*reindex") as caught:
        list(open_source(bag))
    assert "\n" not in str(caught.value)


def test_damage_inside_a_bag_ends_it_at_that_frame(tmp_path):
    path = tmp_path / "a.bag"
    writer = rosbag1.Writer(path)
    writer.set_compression(rosbag1.Writer.CompressionFormat.BZ2)
    writer.chunk_threshold = 1  # every message a chunk of its own
    with writer:
        connection = writer.add_connection(IMAGE_TOPIC, "sensor_msgs/msg/Image", typestore=ROS1)
        for frame in frames():
            content = image_message(ROS1, frame.image, "rgb8", frame.time_s)
            data = ROS1.serialize_ros1(content, connection.msgtype)
            writer.write(connection, round(frame.time_s * 1e9), data)
    damaged = bytearray(path.read_bytes())
    chunks = [at for at in range(len(damaged)) if damaged[at : at + 4] == b"BZh9"]
    damaged[chunks[2] + 200 : chunks[2] + 400] = bytes(200)
    path.write_bytes(damaged)
    tracking = track_source(open_source(path), new_reader())
    assert tracking.ended is Ended.BROKEN
    assert len(tracking.records) == 2
    assert f"{IMAGE_TOPIC}, message 2: cannot be read" in tracking.fault


def test_a_bag_is_not_written_over_and_takes_no_zero_time(tmp_path):
    path = write_ours(tmp_path / "rig.bag")
    before = path.read_bytes()
    with pytest.raises(ValueError, match="already exists"):
        write_bag(path, frames=[], poses=[])
    assert path.read_bytes() == before
    at_zero = Frame(index=0, time_s=0.0, image=RGB)
    with pytest.raises(ValueError, match=r"must be positive.*got 0\.0 s"):
        write_bag(tmp_path / "zero.bag", frames=[at_zero], poses=[])
    assert [entry.name for entry in tmp_path.iterdir()] == ["rig.bag"]


def test_poses_come_back_from_a_bag_in_mm_at_their_arrival(tmp_path):
    track_ = read_poses(write_ours(tmp_path / "rig.bag"))
    assert len(track_) == len(poses())
    for pose in poses():
        back, age_s = known(track_, pose.time_s + CLOCK_S)
        assert age_s <= 2 * CLOCK_S
        assert back.position_mm == pose.position_mm
        assert back.rotation == pytest.approx(pose.rotation, abs=1e-15)


@pytest.mark.parametrize("types", [ROS1, ROS2], ids=["ros1", "ros2"])
def test_a_stamped_pose_is_in_m_at_its_own_time(tmp_path, types):
    point = message(types, "geometry_msgs/msg/Point", x=0.001, y=-0.002, z=0.25)
    turn = message(types, "geometry_msgs/msg/Quaternion", x=0.0, y=1.0, z=0.0, w=0.0)
    pose = message(types, "geometry_msgs/msg/Pose", position=point, orientation=turn)
    stamped = message(
        types, "geometry_msgs/msg/PoseStamped", header=header(types, EPOCH_S), pose=pose
    )
    options = {"version": 9} if types is ROS2 else {}
    path = tmp_path / ("a.bag" if types is ROS1 else "a")
    write(path, types, [("/tool", EPOCH_S + 7, stamped)], **options)
    back, age_s = known(read_poses(path), EPOCH_S + 1)
    assert age_s == 1.0
    assert back.position_mm == pytest.approx((1.0, -2.0, 250.0))
    assert back.axis == pytest.approx((0.0, 0.0, -1.0))


def test_the_pose_at_a_time_is_the_latest_that_was_known():
    track_ = PoseTrack(reversed(poses()))
    times = [pose.time_s for pose in poses()]
    for time_s in np.random.default_rng(0).uniform(times[0], times[-1] + 1, 200):
        pose, age_s = known(track_, time_s)
        assert pose.time_s == max(t for t in times if t <= time_s)
        assert age_s == time_s - pose.time_s >= 0
    assert known(track_, times[0])[1] == 0.0
    assert track_.at(times[0] - 1e-3) is None
    assert track_.at(math.nan) is None


def test_a_pose_is_interpolated_from_the_first_to_the_last():
    first, last = (Pose(time_s=t, position_mm=(t, 0.0, 0.0)) for t in (1.0, 2.0))
    track_ = PoseTrack([first, last])
    assert track_.interpolated(1.25) == Pose(time_s=1.25, position_mm=(1.25, 0.0, 0.0))
    assert [track_.interpolated(pose.time_s) for pose in (first, last)] == [first, last]
    for outside_s in (0.999, 2.001, math.nan):
        assert track_.interpolated(outside_s) is None
    assert PoseTrack(()).interpolated(1.0) is None


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_turns_vectors_as_scipy_does_and_its_axis_is_the_third_column(seed):
    rng = np.random.default_rng(seed)
    turn, vector = Rotation.random(rng=rng), tuple(rng.normal(size=3))
    pose = Pose(time_s=0.0, position_mm=(0, 0, 0), rotation=tuple(turn.as_quat()))
    assert turned(vector, pose.rotation) == pytest.approx(tuple(turn.apply(vector)))
    assert pose.axis == pytest.approx(tuple(turn.as_matrix()[:, 2]), abs=1e-14)
    again = Pose.along(pose.axis, time_s=0.0, position_mm=(0, 0, 0))
    assert again.axis == pytest.approx(pose.axis, abs=1e-14)


@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0, -1), (1e-9, 0, -1), (0.0, 0.6, -0.8)])
def test_a_pose_can_be_made_of_any_axis(axis):
    pose = Pose.along(axis, time_s=0.0, position_mm=(0, 0, 0))
    # Within the 1e-6 below which the turn is taken as half a circle.
    assert pose.axis == pytest.approx(axis, abs=1e-8)
