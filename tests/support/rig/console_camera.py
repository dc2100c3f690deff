"""A program: the console before a camera at 10 Hz that can be unplugged.

    python tests/support/rig/console_camera.py PORT UNPLUGGED

The camera is lost while the file UNPLUGGED exists. Its image is a disc of 40 px at (150, 110) px.
"""

import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path

from eyespot.estimator import Frame, Source
from eyespot.estimator.console.page import serve
from eyespot.estimator.run.options import Options
from eyespot.formats.inputs import InputError
from eyespot.formats.rig import Rig
from tests.support.drawn.drawn_spots import disc


def camera(unplugged: Path) -> Source:
    image = disc((240, 320), 150, 110, 40)

    def read() -> Iterator[Frame]:
        for index in count():
            if unplugged.exists():
                raise InputError("the camera stopped. Check its cable.")
            time.sleep(0.1)
            yield Frame(index=index, time_s=time.time(), image=image)

    return Source(name="camera", read=read, live=True)


if __name__ == "__main__":
    port, unplugged = int(sys.argv[1]), Path(sys.argv[2])
    with suppress(KeyboardInterrupt):
        serve(
            lambda: camera(unplugged),
            Options().reader(),
            Rig(),
            beam=None,
            folder=unplugged.parent,
            host="127.0.0.1",
            port=port,
            token=None,
        )
