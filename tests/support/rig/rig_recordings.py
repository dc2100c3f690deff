"""A rendered stack as the rig would record it, and what is measured in it offline."""

import hashlib
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from eyespot.estimator import LiteralSettings, SubpixelSettings, track
from eyespot.estimator.distance.ranger import Ranger
from eyespot.estimator.sources.opening import open_source
from eyespot.estimator.sources.ros import IMAGE_TOPIC, write_bag
from eyespot.estimator.sources.source import Frame
from eyespot.formats.calibration import write_calibration
from eyespot.formats.poses import Pose, PoseTrack
from eyespot.formats.spot import Spot
from eyespot.formats.stack import read_stack
from tests.support.command_line import run_process
from tests.support.drawn.made_up import a_calibration

HOME = Path(__file__).resolve().parents[3]
START_S = 1_600_000_000.0  # of the recording; ROS reads 0 as no time
RATE_HZ = 10.0  # of the rig's camera
SUBPIXEL = SubpixelSettings(), None, "exact"
LITERAL = LiteralSettings(threshold=60, max_minor_axis_px=60.0), (159.0, 119.0), "corrected"
"""The grey of the spot stays below the paper's threshold; the last spots are too large."""
SCENE = """
schema = 1
seed = 5
[source]
kind = "cone"
[motion]
kind = "withdrawal"
travel_mm = 4.0
frames = 12
speed_mm_s = 3.6363636363636362  # 12 frames at 10 Hz
[microscope]
scale_mm_px = 0.0134
width_px = 320
height_px = 240
[exposures]
kinds = ["metered"]
"""


def rendered_stack(folder: Path) -> Path:
    """A tip that withdraws: the instrument hides the first spots, so some frames have none."""
    (folder / "scene.toml").write_text(SCENE)
    rendered = run_process("render", folder / "scene.toml", "--out", folder / "stack")
    assert rendered.exit_code == 0, rendered.stderr
    return folder / "stack"


def calibrated(folder: Path, model: str) -> Path:
    """A calibration file of the cone that default scenes have."""
    calibration = a_calibration(model=model, covariance=np.diag([0.01**2, 0.005**2]))
    write_calibration(folder / "calibration.json", calibration)
    return folder / "calibration.json"


def frames_of(stack: Path, rounds: int = 1) -> list[Frame]:
    """The frames of a stack, again and again, at the camera's rate."""
    images = [frame.image for frame in open_source(stack)] * rounds
    return [
        Frame(index=index, time_s=START_S + index / RATE_HZ, image=image)
        for index, image in enumerate(images)
    ]


def recording_of(
    stack: Path, bag: Path, *, ros: Literal[1, 2] = 1, rounds: int = 1, pose_rate_hz: float = 200.0
) -> list[int]:
    """Write a stack as the rig records it: images at 10 Hz, poses; the images' time stamps, ns."""
    frames, labels = frames_of(stack, rounds), read_stack(stack).labels
    # From a second before the first image, while clocks and topics come to life.
    at = np.arange(-1.0, len(frames) / RATE_HZ, 1 / pose_rate_hz)
    tips = [
        np.interp(at * RATE_HZ % len(labels), range(len(labels)), [row.tip_mm[i] for row in labels])
        for i in range(3)
    ]
    poses = (
        Pose.along(labels[0].axis, time_s=START_S + moment, position_mm=(x, y, z))
        for moment, x, y, z in zip(at.tolist(), *(axis.tolist() for axis in tips), strict=True)
    )
    write_bag(bag, frames=frames, poses=poses, ros=ros)
    return [round(frame.time_s * 1e9) for frame in frames]


def measured_offline(
    frames: Iterable[Frame],
    settings: LiteralSettings | SubpixelSettings,
    start: tuple[float, float] | None,
    ranger: Ranger,
    poses: PoseTrack | None,
) -> tuple[list[list[float]], list[str]]:
    """For each frame x, y, valid, the axes and the distance in m, and what its status says."""
    numbers, doubts = [], []
    frames = list(frames)
    results = track((frame.image for frame in frames), settings, start)
    for frame, spot in zip(frames, results, strict=True):
        if not isinstance(spot, Spot):
            numbers.append([math.nan, math.nan, 0.0, math.nan, math.nan, math.nan, math.nan])
            doubts.append(spot.reason.value)
            continue
        known = poses.at(frame.time_s) if poses else None
        axis = known[0].axis if known else None
        distance = ranger.distance(spot, axis=axis, frame=frame.image)
        ellipse = [spot.semi_major_px, spot.semi_minor_px, spot.angle_rad]
        metres = float(np.float32(distance.distance_mm / 1e3))  # as sensor_msgs/Range holds it
        numbers.append([spot.x_px, spot.y_px, 1.0, *ellipse, metres])
        doubts.append("ok" if distance.flag is None else distance.flag.value)
    return numbers, doubts


def read_as_a_source(out: Path, frames: Iterable[Frame]) -> dict[str, Any]:
    """What `topic_reader` has written: most of the frames, as they were, and their end."""
    read: dict[str, Any] = json.loads(out.read_text())
    true = {
        f"{round(frame.time_s * 1e9)}": hashlib.sha256(frame.image.tobytes()).hexdigest()
        for frame in frames
    }
    assert read["digests"].items() <= true.items()
    assert len(read["digests"]) > len(true) / 2
    assert read["faults"][-1].startswith(f"no image on {IMAGE_TOPIC}: ")
    return read
