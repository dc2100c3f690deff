"""A program: reads a topic as a source until images stop, and writes what it has read.

python tests/support/rig/topic_reader.py TOPIC OUT.json
"""

import hashlib
import json
import os
import sys
from pathlib import Path

from eyespot.estimator.rig.rig_reader import RecentPoses
from eyespot.estimator.rig.topic import open_topic
from eyespot.formats.inputs import InputError


def main(topic: str, out: Path) -> None:
    """Read until the images that have come stop; note images' times and digests, and the poses.

    Print what is missing when it is missed.
    """
    poses = RecentPoses()
    source = open_topic(topic, poses=poses)
    digests: dict[int, str] = {}
    faults: list[str] = []
    while not digests:
        try:
            for frame in source:
                digests[round(frame.time_s * 1e9)] = hashlib.sha256(
                    frame.image.tobytes()
                ).hexdigest()
        except InputError as error:
            faults.append(f"{error}")
            print(error, flush=True)
    out.write_text(json.dumps({"digests": digests, "faults": faults, "poses": len(poses.track())}))
    os._exit(0)  # ROS's threads go on


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
