"""Records what ROS prints in docs/tutorials/rig.md: `tools/try-rig-node record` runs it.

It follows the page: it makes calibration and recording with the cells of the tutorials, starts the
node under ROS 1 and under ROS 2, plays the recording, and writes the outputs to
docs/tutorials/recorded.
"""

import csv
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from tests.estimator.test_rig_node import RosSession
from tests.estimator.test_rig_ros2 import LOOPBACK

HOME = Path(__file__).resolve().parents[1]
RECORDED = HOME / "docs" / "tutorials" / "recorded"
MADE = HOME / "out" / "docs" / "rig"
TOPICS = [f"/eyespot/{name}" for name in ("spot", "axes", "range", "status")]
_JAZZY = HOME / "build" / "ros2-jazzy" / "bin" / "python"
_SETTLED_S = 3.0  # after the last image


def main() -> None:
    """Make the recording, play it twice, and write what was printed."""
    RECORDED.mkdir(exist_ok=True)
    _run_cells("beam", 2)
    _run_cells("rig", 1)
    with tempfile.TemporaryDirectory() as folder:
        _ros1(Path(folder))
    with tempfile.TemporaryDirectory() as folder:
        _ros2(Path(folder))


def _run_cells(page: str, count: int) -> None:
    """The first cells of commands of a tutorial, which render, fit and write the bags."""
    text = (HOME / "docs" / "tutorials" / f"{page}.md").read_text(encoding="utf-8")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    made = MADE.with_name(page)
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir(parents=True)
    for cell in re.findall(r"%%bash\n(.*?)```", text, flags=re.DOTALL)[:count]:
        subprocess.run(
            ["bash", "-e", "-c", cell], cwd=made, env=os.environ | {"PATH": path}, check=True
        )


def _ros1(folder: Path) -> None:
    bag = next((MADE / "ros1").rglob("*.bag"))
    count, recorded = len(list((MADE / "eye" / "frames").glob("*.png"))), folder / "answers.bag"
    given = [
        f"_rig:={MADE}/eye/rig.toml",
        f"_calibration:={MADE}/beam.json",
    ]
    node = ["eyespot", "node", *given]
    with RosSession(folder) as session:
        session.wait_until(lambda: session.ask(session.uri, "getPid") is not None, "roscore")
        session.start("rosparam", "set", "use_sim_time", "true").wait()
        session.start(sys.executable, "-m", *node)
        recorder = session.start("rosbag", "record", f"--limit={count}", "-O", recorded, *TOPICS)
        session.wait_until(
            lambda: session.published("/eyespot") >= set(TOPICS), "the node and the recorder"
        )
        listed = _output(session, "rostopic", "list")
        player = session.start("rosbag", "play", "--clock", "--wait-for-subscribers", bag)
        session.wait_until(lambda: recorder.poll() is not None, "the answers")
        session.wait_until(lambda: player.poll() is not None, "the end of the bag")
        ranges = _output(session, "rostopic", "echo", "-b", recorded, "-p", "/eyespot/range")
        statuses = _output(session, "rostopic", "echo", "-b", recorded, "/eyespot/status")
    first = statuses.split("\n---\n")[0]
    versions = f"ROS 1 Noetic of Debian (rospy {_rospy_version()})"
    _write(
        "ros1-node.txt",
        versions,
        [
            ("roscore &", ""),
            ("rosparam set use_sim_time true", ""),
            (" \\\n    ".join([" ".join(node[:3]), *map(_short, given)]), ""),
        ],
    )
    own = [name for name in listed.split() if name.startswith(("/eyespot", "/decklink", "/eye_"))]
    record = f"rosbag record --limit={count} -O answers.bag {' '.join(TOPICS)}"
    _write("ros1-topics.txt", versions, [("rostopic list", "\n".join(own)), (record, "")])
    play = f"rosbag play --clock --wait-for-subscribers {_short(bag)}"
    _write("ros1-play.txt", versions, [(play, "")])
    last = "\n".join(_plain_range(ranges))
    _write("ros1-range.txt", versions, [("rostopic echo -b answers.bag -p /eyespot/range", last)])
    echo = "rostopic echo -b answers.bag /eyespot/status"
    _write("ros1-status.txt", versions, [(echo, f"{first}\n---\n(...)")])
    found = [(_stamp_ns(one), one.range) for one in _messages(recorded, "/eyespot/range")]
    _write_distances("ros1", found, bag)


def _ros2(folder: Path) -> None:
    bag = next(path.parent for path in (MADE / "ros2").rglob("metadata.yaml"))
    profile, answers = folder / "loopback.xml", folder / "answers.json"
    profile.write_text(LOOPBACK)
    environment = {
        **os.environ,
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
        "FASTDDS_DEFAULT_PROFILES_FILE": str(profile),
        "ROS_DOMAIN_ID": "77",
        "ROS_HOME": str(folder),
        "PYTHONPATH": str(HOME),
    }
    given = [
        f"-p rig:={MADE}/eye/rig.toml",
        f"-p calibration:={MADE}/beam.json",
        "-p use_sim_time:=true",
    ]
    command = "eyespot node --ros-args"
    words = " ".join(given).split()
    node = subprocess.Popen(
        [_JAZZY, *command.split()[1:], *words],
        cwd=HOME,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        player = [_JAZZY, HOME / "tests/support/rig/ros2_player.py", bag, answers, "1.0"]
        subprocess.run(list(map(str, player)), env=environment, check=True)
        time.sleep(_SETTLED_S)
    finally:
        node.terminate()
        node.wait()
    heard = json.loads(answers.read_text())["answers"]
    ranges = [(stamp, content[0]) for name, stamp, _, content in heard if name == "range"]
    versions = f"ROS 2 Jazzy (rclpy {_jazzy_version()}), Fast DDS over loopback"
    shown = " \\\n    ".join([command, *map(_short, given)])
    _write("ros2-node.txt", versions, [(shown, "")])
    table = [f"{'image of':>14}  {'range, m':>12}"]
    table += [f"{stamp / 1e9:>12.3f} s  {metres:>12.9f}" for stamp, metres in ranges]
    table[4:-3] = ["(...)"]
    _write("ros2-range.txt", versions, [("(a subscriber of /eyespot/range)", "\n".join(table))])
    _write_distances("ros2", ranges, bag)


def _output(session: RosSession, *command: str | Path) -> str:
    """What a program of a session prints before it ends."""
    process = session.start(*command)
    process.wait(60)
    log = max(session._home.glob(f"output-*-{Path(command[0]).name}.log"), key=_number)
    return log.read_text().strip()


def _number(log: Path) -> int:
    return int(log.name.split("-")[1])


def _plain_range(echoed: str) -> list[str]:
    """Time and distance of each line that `rostopic echo -p` prints, and of the first two all."""
    lines = echoed.splitlines()
    return [*lines[:2], "(...)", *lines[-3:]]


def _write(name: str, versions: str, steps: Sequence[tuple[str, str]]) -> None:
    """A transcript: each command after a `$`, then what it printed."""
    today = datetime.now(UTC).date().isoformat()
    head = [
        f"# Recorded by `tools/try-rig-node record` on {today}:",
        f"# {versions}, Python {platform.python_version()}.",
    ]
    body = [part for command, said in steps for part in (f"$ {command}", said) if part]
    (RECORDED / name).write_text("\n".join([*head, *body]) + "\n", encoding="utf-8")


def _messages(bag: Path, topic: str) -> Iterator[Any]:
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            if connection.topic == topic:
                yield reader.deserialize(data, connection.msgtype)


def _stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec * 10**9 + stamp.nanosec)


def _write_distances(ros: str, ranges: Sequence[tuple[int, float]], bag: Path) -> None:
    """The distances as a table, by the number of the image in the bag."""
    images = _messages(bag, "/decklink/camera/image_raw")
    number = {_stamp_ns(image): n for n, image in enumerate(images)}
    with (RECORDED / f"{ros}-distances.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["image", "distance_mm"])
        for stamp, metres in ranges:
            known = metres == metres  # NaN is not
            table.writerow([number[stamp], f"{1e3 * metres:.6f}" if known else ""])


def _short(text: str | Path) -> str:
    """A path as it is typed in the folder of the recording."""
    return str(text).replace(f"{MADE}/", "")


def _rospy_version() -> str:
    asked = ["dpkg-query", "--show", "--showformat=${Version}", "python3-rospy"]
    return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()


def _jazzy_version() -> str:
    asked = "import importlib.metadata as m; print(m.version('ros-jazzy-rclpy'))"
    done = subprocess.run([_JAZZY, "-c", asked], capture_output=True, text=True, check=True)
    return done.stdout.strip()


if __name__ == "__main__":
    if shutil.which("rostopic") is None:
        sys.exit("rostopic is missing; tools/install-ros installs it.")
    main()
