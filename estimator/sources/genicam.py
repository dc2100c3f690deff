"""GenICam cameras as live sources, through harvesters and their vendors' GenTL producers."""

import os
import re
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from eyespot.estimator.sources.ros import frame_of_message
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.inputs import InputError, shortened
from eyespot.formats.whole_files import damage_reported

GENICAM = "genicam:"
"""What the name of such a source begins with."""
_NAMES = ("serial_number", "id_", "user_defined_name")
_PATIENCE_S = 10.0  # time to wait for a frame, longer than exposures are
_ENCODINGS = {
    **{f"bayer{pattern[:2]}": f"bayer_{pattern}" for pattern in ("rggb", "grbg", "gbrg", "bggr")},
    **dict.fromkeys(("yuv422_8_uyvy", "ycbcr422_8_cbycry"), "uyvy"),
    **dict.fromkeys(("yuv422_8", "ycbcr422_8"), "yuyv"),
}
"""Names of GenICam's pixel formats, or their beginnings, as ROS names them."""


def open_genicam(name: str) -> Source:
    """A GenICam camera; the time of a frame is that of its arrival, s since 1970.

    Args:
        name: its number among the cameras that are found, its serial number, its identifier, or the
            name that somebody gave it.

    Raises:
        InputError: harvesters or a producer is missing, or there is no such camera. Reading raises
            it where the camera stops, or its pixel format is none of light.
    """
    with _acquiring(name):
        pass  # what is wrong is said before the first frame

    def read() -> Iterator[Frame]:
        with _acquiring(name) as camera:
            for index in count():
                with damage_reported(f"{GENICAM}{name}, frame {index}", "Check its cable."):
                    with camera.fetch(timeout=_PATIENCE_S) as buffer:
                        message = _message(buffer.payload.components[0])
                image, full_scale = frame_of_message(message)
                yield Frame(index=index, time_s=time.time(), image=image, full_scale=full_scale)

    return Source(name=f"{GENICAM}{name}", read=read, live=True)


@contextmanager
def _acquiring(name: str) -> Iterator[Any]:
    """The camera, which sends frames until the block ends."""
    try:
        from harvesters.core import Harvester
    except ModuleNotFoundError as error:
        raise InputError(
            "a GenICam camera needs the package harvesters: pip install 'eyespot[genicam]'."
        ) from error
    folders = os.environ.get("GENICAM_GENTL64_PATH", "").split(os.pathsep)
    producers = [file for one in folders if one for file in sorted(Path(one).glob("*.cti"))]
    if not producers:
        raise InputError(
            "the folders of GENICAM_GENTL64_PATH hold no GenTL producer (.cti). Install the "
            "software of the camera's vendor, or set the variable to its folder."
        )
    where, remedy = f"{GENICAM}{name}", "Check that it is plugged in, and free."
    harvester = Harvester()
    try:
        with damage_reported(where, remedy):
            for producer in producers:
                harvester.add_file(str(producer))
            harvester.update()
            about = [one.property_dict for one in harvester.device_info_list]
        found = [(str(n), *(one.get(key) for key in _NAMES)) for n, one in enumerate(about)]
        chosen = [number for number, names in enumerate(found) if name in names]
        if not chosen:
            known = "; ".join(", ".join(filter(None, names)) for names in found) or "none"
            raise InputError(
                f"there is no camera {GENICAM}{shortened(name)}. Found (number, serial number, "
                f"identifier, name): {known}. {remedy}"
            )
        ours = signal.getsignal(signal.SIGINT)
        with damage_reported(where, remedy):
            camera = harvester.create(chosen[0])
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, ours)  # harvesters takes Ctrl-C for itself
        try:
            with damage_reported(where, remedy):
                camera.start()
            yield camera
        finally:
            camera.destroy()
    finally:
        harvester.reset()


def _message(image: Any) -> SimpleNamespace:
    """An image of harvesters as a `sensor_msgs/Image`; it has unpacked what its format says."""
    name = image.data_format.lower()
    if image.data.itemsize == 2:
        name = re.sub("p(acked)?$", "", name)
    bayer = name[:7]
    return SimpleNamespace(
        encoding=_ENCODINGS.get(name) or _ENCODINGS.get(bayer, bayer) + name[7:],
        height=image.height,
        width=image.width,
        step=image.data.nbytes // image.height,
        is_bigendian=False,
        data=image.data.tobytes(),
    )
