"""The rig's node under a real ROS 2: what it measures live is what is measured offline.

`tools/try-rig-node` runs these. They play a bag, written without ROS, to the node over loopback.
"""

import contextlib
import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from eyespot.estimator import LiteralSettings, SubpixelSettings
from eyespot.estimator.distance.ranger import Ranger
from eyespot.formats.calibration import read_calibration
from eyespot.formats.microscope import read_microscope
from eyespot.formats.poses import read_poses
from tests.support.rig.rig_recordings import (
    HOME,
    LITERAL,
    RATE_HZ,
    SUBPIXEL,
    calibrated,
    frames_of,
    measured_offline,
    read_as_a_source,
    recording_of,
    rendered_stack,
)

pytestmark = pytest.mark.ros2

ROUNDS = 5  # of the stack: 60 frames
IMAGES = "/decklink/camera/image_raw"
# Fast DDS on loopback only. An image of 0.2 to 1 MB is sent in packets of 64 kB, and Linux's usual
# buffers of 0.2 MB lose some of them.
LOOPBACK = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>loopback</transport_id>
      <type>UDPv4</type>
      <sendBufferSize>4194304</sendBufferSize>
      <receiveBufferSize>4194304</receiveBufferSize>
      <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="loopback" is_default_profile="true">
    <rtps>
      <userTransports><transport_id>loopback</transport_id></userTransports>
      <useBuiltinTransports>false</useBuiltinTransports>
    </rtps>
  </participant>
</profiles>
"""


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    return rendered_stack(tmp_path_factory.mktemp("rendered"))


@pytest.fixture(scope="module", params=["jazzy", "kilted"])
def python(request):
    """The interpreter of an environment with ROS 2."""
    done = subprocess.run(
        [HOME / "tools" / "install-ros2", request.param], capture_output=True, text=True
    )
    if done.returncode:
        pytest.fail(f"no ROS 2 to try the node with: {done.stderr.strip()}", pytrace=False)
    return str(HOME / "build" / f"ros2-{request.param}" / "bin" / "python")


@pytest.fixture
def environment(tmp_path):
    """A ROS 2 of its own, on loopback."""
    profile = tmp_path / "loopback.xml"
    profile.write_text(LOOPBACK)
    return {
        **os.environ,
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),  # Jazzy's name of it
        "FASTDDS_DEFAULT_PROFILES_FILE": str(profile),
        "ROS_DOMAIN_ID": str(os.getpid() % 100),
        "ROS_HOME": str(tmp_path),
        "PYTHONPATH": str(HOME),
    }


@contextlib.contextmanager
def node(
    python: str, environment: dict[str, str], log: Path, *arguments: str
) -> Iterator[psutil.Popen]:
    """The node, which must end by Ctrl-C as a well-behaved program does."""
    command = [python, "-m", "eyespot", "node", "--ros-args", *arguments]
    with log.open("wb") as output:
        process = psutil.Popen(
            command, cwd=HOME, env=environment, stdout=output, stderr=subprocess.STDOUT
        )
    try:
        yield process
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0, log.read_text()
        assert "Traceback" not in log.read_text()
    finally:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()


def given(**parameters: object) -> list[str]:
    return [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]


@pytest.mark.parametrize(
    ("settings", "start", "model", "rate_hz", "reliable"),
    [
        (*SUBPIXEL, 10, False),
        (*SUBPIXEL, 30, False),
        (*SUBPIXEL, 30, True),
        (*LITERAL, 30, False),
    ],
    ids=["subpixel-10Hz", "subpixel-30Hz", "subpixel-30Hz-reliable", "literal-30Hz"],
)
def test_under_ros_2_the_node_measures_what_is_measured_offline(
    python, environment, stack, tmp_path, settings, start, model, rate_hz, reliable
):
    bag, microscope = tmp_path / "bag", stack / "microscope.json"
    calibration = calibrated(tmp_path, model)
    speed = rate_hz / RATE_HZ
    # The robot's 200 Hz, when the bag is played at this speed.
    stamps = recording_of(stack, bag, ros=2, rounds=ROUNDS, pose_rate_hz=200 / speed)
    arguments = given(use_sim_time="true", calibration=calibration)
    if isinstance(settings, LiteralSettings):
        arguments += given(mode="literal", start="159.0,119.0", rig=microscope)
        arguments += ["-p", f"settings.threshold:={settings.threshold}"]
        arguments += ["-p", "settings.max_minor_axis_px:=60"]
    else:
        arguments += given(rig=stack / "rig.toml")
    if reliable:
        override = f"qos_overrides.{IMAGES}.subscription"
        arguments += ["-p", f"{override}.reliability:=reliable", "-p", f"{override}.depth:=100"]
    with node(python, environment, tmp_path / "node.log", *arguments) as process:
        answers = played(python, environment, bag, tmp_path, speed=speed)
        # Nothing of it can be reached from another machine: 239.x.x.x is a group on loopback.
        addresses = {link.laddr.ip for link in process.net_connections("udp")}
        assert addresses <= {"127.0.0.1", "239.255.0.1"}

    by_topic: dict[str, dict[int, Any]] = {name: {} for name in ("spot", "axes", "range", "status")}
    for name, stamp, _, content in answers["answers"]:
        by_topic[name].setdefault(stamp, content)  # later statuses may say that images have ended
    arrived = sorted(by_topic["spot"])
    assert all(sorted(answered) == arrived for answered in by_topic.values())

    frames = [frame for frame in frames_of(stack, ROUNDS) if round(frame.time_s * 1e9) in arrived]
    ranger = Ranger(read_calibration(calibration), read_microscope(microscope))
    poses = read_poses(bag) if isinstance(settings, SubpixelSettings) else None
    numbers, doubts = measured_offline(frames, settings, start, ranger, poses)
    received = [
        [*by_topic["spot"][at], *by_topic["axes"][at], by_topic["range"][at][0]] for at in arrived
    ]
    # The same code ran on the same pixels: not a bit differs.
    np.testing.assert_array_equal(received, numbers)
    assert [by_topic["status"][at][0] for at in arrived] == doubts
    spots = int(np.sum(numbers, axis=0)[2])
    assert 0 < spots < len(numbers)

    # The variance is that of the distance, in single precision; 0 means unknown.
    details = [by_topic["status"][at][1] for at in arrived]
    sigmas_mm = [float(one.get("sigma_distance_mm", 0)) for one in details]
    variances = [by_topic["range"][at][1] for at in arrived]
    np.testing.assert_allclose(variances, np.nan_to_num(np.array(sigmas_mm) / 1e3) ** 2, rtol=1e-6)

    # What did not arrive was counted, up to the last image that did.
    published = 1 + stamps.index(arrived[-1]) - stamps.index(arrived[0])
    assert int(details[-1]["images"]) == len(arrived)
    assert int(details[-1]["skipped_images"]) == published - len(arrived)
    assert len(arrived) == len(stamps) if reliable else len(arrived) > len(stamps) / 2
    delays = [
        at - answers["sent"][str(stamp)]
        for name, stamp, at, _ in answers["answers"]
        if name == "spot"
    ]
    print(
        f"{Path(python).parts[-3]}, {model}, {rate_hz} Hz, reliable: {reliable}:"
        f" of {len(stamps)} frames {len(arrived)} arrived, {spots} with a spot; equal:"
        f" {np.size(numbers)} numbers, {len(doubts)} statuses; delay"
        f" {1e3 * np.median(delays):.0f} ms (median), {1e3 * max(delays):.0f} ms (largest)"
    )


def played(
    python: str, environment: dict[str, str], bag: Path, folder: Path, *, speed: float
) -> dict[str, Any]:
    answers = folder / "answers.json"
    player = [
        python,
        f"{HOME}/tests/support/rig/ros2_player.py",
        str(bag),
        str(answers),
        f"{speed}",
    ]
    done = subprocess.run(player, env=environment, capture_output=True, text=True)
    said = (folder / "node.log").read_text()[-2000:]
    assert done.returncode == 0, f"{done.stderr}\n== node\n{said}"
    return json.loads(answers.read_text())


def test_a_topic_is_a_source_that_says_when_images_stop(python, environment, stack, tmp_path):
    bag, out = tmp_path / "bag", tmp_path / "read.json"
    recording_of(stack, bag, ros=2, rounds=ROUNDS)
    with subprocess.Popen(
        [python, f"{HOME}/tests/support/rig/topic_reader.py", IMAGES, out],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    ) as reader:
        assert reader.stdout is not None
        assert "nobody publishes it" in reader.stdout.readline()  # before anybody does
        with node(python, environment, tmp_path / "node.log", *given(use_sim_time="true")):
            played(python, environment, bag, tmp_path, speed=1.0)
        assert reader.wait(30) == 0
    assert read_as_a_source(out, frames_of(stack, ROUNDS))["poses"] > 0


@pytest.mark.parametrize(
    ("parameter", "said"),
    [
        ("image_topik:=/camera", "image_topik is unknown"),
        ("mode:=fast", "mode: .*'pixels'; got 'fast'"),
        ("settings.min_contrast:=high", "settings: "),
        ("image_topic:=two words", "two words"),
    ],
)
def test_a_wrong_parameter_ends_the_node_with_one_message(python, environment, parameter, said):
    command = [python, "-m", "eyespot", "node", "--ros-args", "-p", parameter]
    done = subprocess.run(command, cwd=HOME, env=environment, capture_output=True, text=True)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("eyespot: ")]
    assert re.search(said, line)
