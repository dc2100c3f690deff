"""The rig's node: without ROS what it makes of messages, and its proof under a real ROS 1.

`test_rig_ros2` has the proof under ROS 2.

The proof (slow) renders a stack, writes it as a bag with the rig's topics, starts roscore, the node
and `rosbag record`, plays the bag at the camera's 10 Hz, and compares what was recorded with the
same frames measured offline. `tools/try-rig-node` runs it from nothing.
"""

import contextlib
import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Self
from xmlrpc.client import ServerProxy

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from eyespot.benchmarks.bench.load import memory_mb
from eyespot.estimator import LiteralSettings
from eyespot.estimator.distance.ranger import Ranger
from eyespot.estimator.rig import node as rig_node
from eyespot.estimator.rig.messages import Silence
from eyespot.estimator.rig.rig_reader import WAY_FRAMES, ImageReader, Parameters
from eyespot.formats.calibration import read_calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import read_microscope
from eyespot.formats.poses import read_poses
from tests.support.drawn import drawn_spots
from tests.support.drawn.made_up import a_microscope_file
from tests.support.rig.rig_recordings import (
    HOME,
    LITERAL,
    SUBPIXEL,
    calibrated,
    frames_of,
    measured_offline,
    read_as_a_source,
    recording_of,
    rendered_stack,
)
from tests.support.rig.ros_messages import ROS1, image_message, message


def grey_message(image: np.ndarray) -> Any:
    return image_message(ROS1, image, "mono8", time_s=1.0)


def pose_message(qw: float = 1.0, z_mm: float = 0.0) -> Any:
    """A `geometry_msgs/Transform`."""
    place = message(ROS1, "geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=z_mm)
    turn = message(ROS1, "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=qw)
    return message(ROS1, "geometry_msgs/msg/Transform", translation=place, rotation=turn)


disc = partial(drawn_spots.disc, (240, 320))
DARK = np.full((240, 320), 20, np.uint8)


def microscope_in(folder: Path) -> Path:
    return a_microscope_file(folder, (320, 240), scale_mm_px=0.0134, pinhole_height_mm=11.5)


def test_a_disc_in_an_image_message_is_read_where_it_was_drawn():
    reading = ImageReader(Parameters()).output(grey_message(disc(150.25, 110.5, 40.0)), 1.0, 0)
    # Clean sub-pixel edges: the estimator's own tests hold 0.02 px; 8-bit rounding adds no more.
    assert reading.centre == pytest.approx((150.25, 110.5, 1.0), abs=0.05)
    assert reading.axes[:2] == pytest.approx((40.0, 40.0), abs=0.05)
    assert reading.doubt == ""
    assert math.isnan(reading.distance_m)


def test_a_dark_image_is_no_spot_and_says_why():
    reading = ImageReader(Parameters()).output(grey_message(DARK), 1.0, 0)
    np.testing.assert_equal(reading.centre, (math.nan, math.nan, 0.0))
    np.testing.assert_equal(reading.axes, (math.nan,) * 3)
    assert reading.doubt == "none_found"
    assert math.isnan(reading.distance_m)


def test_a_spot_that_jumps_is_doubted_once_as_it_is_offline():
    rig = ImageReader(Parameters())
    images = [disc(80, 120, 40), disc(240, 120, 40), disc(240, 120, 40)]
    doubts = [rig.output(grey_message(image), float(n), 0).doubt for n, image in enumerate(images)]
    assert doubts == ["", "ambiguous", ""]


# At contact the spot has -b/(delta k) = 19.1 px; the smaller one's tip is behind the wall.
@pytest.mark.parametrize(("radius_px", "doubt"), [(30.0, ""), (17.0, "out_of_range")])
def test_the_distance_is_in_metres_and_doubted_behind_the_wall(tmp_path, radius_px, doubt):
    microscope = microscope_in(tmp_path)
    parameters = Parameters(rig=microscope, calibration=calibrated(tmp_path, "planar"))
    reading = ImageReader(parameters).output(grey_message(disc(159.5, 119.5, radius_px)), 1.0, 0)
    # d = delta k e1' + b; an error of 0.05 px is one of 13 um.
    truth_mm = 0.0134 * 20 * radius_px - 5.117
    assert reading.distance_m == pytest.approx(truth_mm / 1e3, abs=13e-6)
    assert float(reading.details["sigma_distance_mm"]) > 0
    assert reading.doubt == doubt


@pytest.mark.parametrize(
    ("received_s", "image_s", "age_s"),
    [
        ((), 5.0, math.nan),
        ((4.97, 4.98, 5.01), 5.0, 0.02),
        ((5.00, 5.01, 1.00), 5.02, 4.02),  # the recording is played again
    ],
)
def test_the_pose_of_an_image_is_the_last_of_its_run_that_came_before(received_s, image_s, age_s):
    rig = ImageReader(Parameters())
    for moment_s in received_s:
        rig.poses.take(pose_message(), moment_s)
    details = rig.output(grey_message(disc(150, 110, 40)), image_s, 0).details
    assert float(details["pose_age_s"]) == pytest.approx(age_s, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize("robot_scale", [pytest.param(1.0, marks=pytest.mark.slow), 1.3])
def test_a_robot_whose_travel_is_not_that_of_the_distances_is_said(tmp_path, robot_scale):
    parameters = Parameters(rig=microscope_in(tmp_path), calibration=calibrated(tmp_path, "planar"))
    rig = ImageReader(parameters)
    for number, radius_px in enumerate(np.linspace(22.0, 45.0, WAY_FRAMES + 30)):
        withdrawn_mm = 0.0134 * 20 * (radius_px - 22.0)
        rig.poses.take(pose_message(z_mm=-robot_scale * withdrawn_mm), float(number))
        last = rig.output(grey_message(disc(159.5, 119.5, radius_px)), float(number), number)
    assert ("The tip withdrew by" in last.doubt) == (robot_scale != 1.0)
    assert last.level == ("OK" if robot_scale == 1.0 else "WARN")


def test_a_topic_of_compressed_images_is_looked_for_as_such():
    silence = Silence("/camera/compressed", clock=iter([0.0, 10.0]).__next__)
    said = silence.change(lambda: ["sensor_msgs/msg/Image"])
    assert said is not None
    assert "a topic of this name is read as sensor_msgs/CompressedImage" in said[0]


@pytest.mark.parametrize(
    ("types", "said"),
    [
        ([], "nobody publishes it"),
        (["sensor_msgs/msg/CompressedImage"], "published as sensor_msgs/CompressedImage"),
        (["sensor_msgs/msg/Image"], "nothing arrives"),
    ],
)
def test_images_that_stop_are_reported_once_with_the_cause_and_so_is_their_return(types, said):
    now_s = 0.0
    silence = Silence("/camera", clock=lambda: now_s)
    changes = []
    for now_s in np.arange(0.5, 20.0, 0.5):  # a second's call, a silence from 5 s to 10 s
        if not 5 < now_s < 10:
            silence.end()
        changes.append(silence.change(lambda: types))
    (lost, is_fault), back = filter(None, changes)
    assert is_fault and lost.startswith("no image on /camera: ") and said in lost
    assert back == ("images arrive on /camera.", False)


def test_a_pose_that_is_none_is_refused():
    with pytest.raises(ValueError, match="unit quaternion"):
        ImageReader(Parameters()).poses.take(pose_message(qw=0.0), 1.0)


def test_parameters_are_taken_as_ros_hands_them_over():
    # What `_start:=320,240 _settings:="{threshold: 180}"` becomes on the parameter server.
    parameters = Parameters.of({"start": "320,240", "settings": {"threshold": 180}})
    assert parameters.start == (320.0, 240.0)
    assert parameters.settings == {"threshold": 180}
    assert Parameters.of({"start": "auto"}).start is None


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"image_topik": "/camera"}, "image_topik is unknown.*image_topic"),
        ({"mode": "fast"}, "mode: .*'literal'.*'pixels'; got 'fast'"),
        ({"start": "left"}, "start: must be X,Y in px.*'left'"),
        ({"start": 3}, "start: must be X,Y in px.*3"),
        ({"exposure_s": 0.0}, "exposure_s: .*greater than 0; got 0.0"),
        ({"pinhole_height_mm": 200.0}, "is the key microscope.pinhole_height_mm of the rig file"),
        ({"settings": {"response": "srgb"}}, "settings are numbers.*microscope"),
        ({"settings": {"min_contrast": "high"}}, "settings: "),
        ({"changes": ["robot.unit=km"]}, "robot.unit: .*'um'; got 'km'"),
        ({"mode": "literal", "settings": {"treshold": 180}}, "treshold"),
    ],
)
def test_parameters_that_make_no_sense_are_named(given, told):
    with pytest.raises(ValueError, match=told):
        ImageReader(Parameters.of(given))


def test_an_image_that_does_not_fit_the_parameters_is_refused(tmp_path):
    microscope = microscope_in(tmp_path)
    turned = ImageReader(Parameters(rig=microscope)).output(grey_message(DARK.T.copy()), 1.0, 0)
    assert "240x320 px" in turned.doubt
    outside = ImageReader(Parameters(start=(320.0, 10.0))).output(grey_message(DARK), 1.0, 0)
    assert "start (320, 10) px lies outside" in outside.doubt
    unknown = grey_message(DARK)
    unknown.encoding = "jpeg"
    third = ImageReader(Parameters()).output(unknown, 1.0, 0)
    assert "encoding" in third.doubt
    for output in (turned, outside, third):
        assert output.level == "ERROR"
        np.testing.assert_equal(output.centre, (math.nan, math.nan, 0.0))


def test_images_between_two_measured_ones_are_counted_as_skipped():
    rig, counts = ImageReader(Parameters()), []
    for number in (7, 8, 11, 11, 2, 4):  # the publisher begins again at 2
        details = rig.output(grey_message(DARK), 1.0, number).details
        counts.append((int(details["images"]), int(details["skipped_images"])))
    assert counts == [(1, 0), (2, 0), (3, 2), (4, 2), (5, 2), (6, 3)]


def test_without_ros_the_node_says_what_to_install(monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    for library in ("rospy", "rclpy"):  # stands in for a machine without ROS
        monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delenv("ROS_VERSION", raising=False)
    with pytest.raises(InputError, match="tools/install-ros"):
        rig_node.node()


PATIENCE_S = 300.0  # before what should take seconds is given up
TOPICS = {name: f"/eyespot/{name}" for name in ("spot", "axes", "range", "status")}


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    return rendered_stack(tmp_path_factory.mktemp("rendered"))


@pytest.fixture(scope="module")
def ros():
    """ROS 1, installed where this is root's Debian."""
    done = subprocess.run([HOME / "tools" / "install-ros"], capture_output=True, text=True)
    if done.returncode:
        pytest.fail(f"no ROS 1 to try the node with: {done.stderr.strip()}", pytrace=False)


class RosSession:
    """A roscore of its own on a free port; what is started in it ends with it.

    `home` is an empty folder for ROS's files and the processes' output.
    """

    def __init__(self, home: Path) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self._port, self.uri = port, f"http://127.0.0.1:{port}"
        self._home = home
        self._environment = {
            **os.environ,
            "ROS_MASTER_URI": self.uri,
            "ROS_HOSTNAME": "127.0.0.1",
            "ROS_HOME": str(home),
            "ROS_LOG_DIR": str(home / "log"),
        }
        self._started: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Self:
        self.start("roscore", "-p", str(self._port))
        return self

    def __exit__(self, *error: object) -> None:
        for process in reversed(self._started):
            process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(15)
        # Children of what did not go: roscore and rosbag start others in groups of their own.
        mark = f"ROS_HOME={self._home}\0".encode()
        for entry in Path("/proc").glob("[0-9]*/environ"):
            with contextlib.suppress(OSError):
                if mark in entry.read_bytes():
                    os.kill(int(entry.parent.name), signal.SIGKILL)
        for process in self._started:
            process.wait()

    def start(self, *command: str | Path) -> subprocess.Popen[bytes]:
        """Start a program; its output goes into a file of the home folder."""
        name = f"output-{len(self._started)}-{Path(command[0]).name}.log"
        with (self._home / name).open("wb") as output:
            process = subprocess.Popen(
                command,
                cwd=HOME,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        self._started.append(process)
        return process

    def wait_until(self, done: Callable[[], bool], what: str) -> None:
        """Poll; fail with what the programs have said if it takes too long or one of them fails."""
        deadline = time.monotonic() + PATIENCE_S
        while not done():
            failed = any(process.poll() for process in self._started)
            if failed or time.monotonic() > deadline:
                said = "\n".join(
                    f"== {path.name}\n{path.read_text(errors='replace')[-2000:]}"
                    for path in sorted(self._home.glob("output-*.log"))
                )
                pytest.fail(f"{what}: waited in vain.\n{said}", pytrace=False)
            time.sleep(0.1)

    def ask(self, uri: str, question: str, *arguments: str) -> Any:
        """Call the XML-RPC interface of the master or of a node; None where nothing answers."""
        with contextlib.suppress(OSError), ServerProxy(uri) as proxy:
            code, _, answer = getattr(proxy, question)("/proof", *arguments)
            return answer if code == 1 else None

    def published(self, node: str) -> set[str]:
        """Topics that a node sends to somebody at this moment."""
        uri = self.ask(self.uri, "lookupNode", node)
        links = self.ask(uri, "getBusInfo") if uri else None
        return {link[4] for link in links or [] if link[2] == "o"}


def node_output(bag: Path, folder: Path, count: int, *parameters: str) -> dict[str, list[Any]]:
    """Play a bag to the node; the messages of each of its topics, in order of arrival."""
    recorded = folder / "recorded.bag"
    with RosSession(folder) as session:
        session.wait_until(lambda: session.ask(session.uri, "getPid") is not None, "roscore")
        # Poses carry no time: the node takes that of their arrival, on the bag's clock.
        session.start("rosparam", "set", "use_sim_time", "true").wait()
        session.start(sys.executable, "-m", "eyespot", "node", *parameters)
        limit = f"--limit={count}"  # messages a topic, after which it ends by itself
        recorder = session.start("rosbag", "record", limit, "-O", recorded, *TOPICS.values())
        session.wait_until(
            lambda: session.published("/eyespot") >= set(TOPICS.values()), "node and recorder"
        )
        session.start("rosbag", "play", "--clock", "--wait-for-subscribers", bag)
        session.wait_until(lambda: recorder.poll() is not None, f"{count} messages on each topic")
    messages: dict[str, list[Any]] = {name: [] for name in TOPICS}
    with AnyReader([recorded]) as reader:
        for connection, _, data in reader.messages():
            name = connection.topic.rpartition("/")[2]
            messages[name].append(reader.deserialize(data, connection.msgtype))
    return messages


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "start", "model", "with_axis"),
    [(*SUBPIXEL, True), (*LITERAL, False)],
    ids=["subpixel", "literal"],
)
def test_under_a_real_roscore_the_node_measures_what_is_measured_offline(
    ros, stack, tmp_path, settings, start, model, with_axis
):
    microscope, calibration = stack / "microscope.json", calibrated(tmp_path, model)
    rig = stack / "rig.toml" if with_axis else microscope  # the former knows the robot's frame
    parameters = [f"_rig:={rig}", f"_calibration:={calibration}"]
    if isinstance(settings, LiteralSettings):
        given = f"{{threshold: {settings.threshold}, max_minor_axis_px: 60}}"
        parameters += ["_mode:=literal", f"_settings:={given}"]
    if start is not None:
        parameters += ["_start:={:g},{:g}".format(*start)]
    bag = tmp_path / "rig.bag"
    stamps = recording_of(stack, bag)
    live = node_output(bag, tmp_path, len(stamps), *parameters)

    ranger = Ranger(read_calibration(calibration), read_microscope(microscope))
    poses = read_poses(bag) if with_axis else None
    numbers, doubts = measured_offline(frames_of(stack), settings, start, ranger, poses)
    received = [
        [*(getattr(part, n) for part in (spot.point, axes.vector) for n in "xyz"), distance.range]
        for spot, axes, distance in zip(live["spot"], live["axes"], live["range"], strict=True)
    ]
    # The same code ran on the same pixels: not a bit differs.
    np.testing.assert_array_equal(received, numbers)
    assert [message.status[0].message for message in live["status"]] == doubts
    for messages in live.values():
        times = (message.header.stamp for message in messages)
        assert [time.sec * 10**9 + time.nanosec for time in times] == stamps
    # At 200 Hz the last pose is 5 ms old; the bound leaves room for a machine that is busy.
    details = ({item.key: item.value for item in m.status[0].values} for m in live["status"])
    ages = [float(one["pose_age_s"]) for one in details]
    assert 0 <= min(ages) <= max(ages) < 1.0
    spots = int(np.sum(numbers, axis=0)[2])
    assert 0 < spots < len(numbers)
    print(
        f"{model}: of {len(numbers)} frames {spots} with a spot; equal: {np.size(numbers)} numbers,"
        f" {len(doubts)} statuses, {len(stamps) * len(live)} stamps"
    )


@pytest.mark.slow
def test_under_a_real_roscore_a_topic_is_a_source_that_says_when_images_stop(ros, stack, tmp_path):
    bag, out = tmp_path / "rig.bag", tmp_path / "read.json"
    recording_of(stack, bag)
    with RosSession(tmp_path) as session:
        session.wait_until(lambda: session.ask(session.uri, "getPid") is not None, "roscore")
        program = HOME / "tests/support/rig/topic_reader.py"
        reader = session.start(sys.executable, program, "/decklink/camera/image_raw", out)
        only_images = "--topics", "/decklink/camera/image_raw", "--bags", bag
        session.start("rosbag", "play", "--wait-for-subscribers", *only_images)
        session.wait_until(lambda: reader.poll() is not None, "the end of the images")
    read_as_a_source(out, frames_of(stack))


@pytest.mark.slow
@pytest.mark.usefixtures("ros")
def test_a_camera_twice_as_fast_as_the_node_gets_the_newest_images_measured(tmp_path):
    """The delay stays, the memory stays, and what was skipped is counted."""
    seconds, answers, memory = 60.0, tmp_path / "answers.json", []
    with RosSession(tmp_path) as session:
        session.wait_until(lambda: session.ask(session.uri, "getPid") is not None, "roscore")
        node = session.start(sys.executable, "-m", "eyespot", "node")
        camera = session.start(
            sys.executable, HOME / "tests/support/rig/ros_camera.py", answers, f"{seconds}"
        )

        def ended() -> bool:
            memory.append(memory_mb(node.pid))
            return camera.poll() is not None

        session.wait_until(ended, "camera")
    written = json.loads(answers.read_text())
    numbers, delays, measured, skipped = np.array(written["answers"]).T
    third = len(delays) // 3
    print(
        f"published {written['published']} in {seconds:.0f} s; the node reads "
        f"{written['reads_hz']:.0f} Hz at most; measured {len(delays)}, skipped "
        f"{skipped[-1] - skipped[0]:.0f}; delay {1e3 * np.median(delays):.1f} ms (median), "
        f"{1e3 * delays.max():.1f} ms (largest); memory "
        f"{memory[len(memory) // 3]:.1f}, {memory[len(memory) // 2]:.1f}, {memory[-2]:.1f} MB"
    )
    # It was too fast, so images were skipped; and the counts say how many.
    assert len(delays) < 0.8 * written["published"]
    assert (measured + skipped == numbers + 1).all()
    assert (np.diff(numbers) > 0).all()
    # A queue of old images would delay each answer more than the one before.
    assert np.median(delays[-third:]) < 2 * np.median(delays[:third]) + 0.02
    assert delays.max() < 2.0  # of a loaded machine
    assert memory[-2] < memory[len(memory) // 3] + 5
