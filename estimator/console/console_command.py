"""The command `eyespot console`."""

import secrets
import socket
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts.types import Port

from eyespot.estimator.run.options import Options, RecordingOptions
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import POSE_TOPIC

if TYPE_CHECKING:
    from eyespot.estimator.sources.source import Source
    from eyespot.formats.poses import PoseTrack
    from eyespot.formats.rig import Rig

_TOPIC = "topic:"


def console(
    source: str,
    /,
    *,
    folder: Path = Path(),
    host: str = "127.0.0.1",
    port: Port = 8080,
    options: Options = Options(),
    recorded: RecordingOptions = RecordingOptions(),
) -> None:
    """Show a source, what is measured in it, and its distance on a page in the browser.

    Ctrl-C ends it.

    Args:
        source: Stack, folder of images, TIFF, video, ROS bag, number of a camera, genicam:NAME, or
            topic:/NAME of a running ROS.
        folder: Where the page records spots and frames.
        host: Address to listen on; other machines can reach 0.0.0.0, with a token.
        port: Port to listen on.
    """
    try:
        from eyespot.estimator.console.page import serve
    except ModuleNotFoundError as error:
        raise InputError(
            f"the console needs the package {error.name}: pip install 'eyespot[console]'."
        ) from error
    from eyespot.estimator.console.gate import is_loopback

    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder. Make it, or choose another one.")
    track: "Callable[[], PoseTrack] | None"
    rig = options.own_rig()
    if source.startswith(_TOPIC):
        from eyespot.estimator.rig.rig_reader import RecentPoses
        from eyespot.estimator.rig.topic import open_topic

        if recorded.poses is not None:
            raise InputError(
                "poses are of a recording. Those of a running ROS have robot.pose_topic."
            )
        recent, pose_topic = RecentPoses(rig.robot), rig.robot.pose_topic or POSE_TOPIC
        live = open_topic(source.removeprefix(_TOPIC), poses=recent, pose_topic=pose_topic)
        open_, track = (lambda: live), recent.track
        beam = options.beam()
    else:
        recording, options, beam = recorded.opened(source, options)
        for note in recording.source.notes:
            print(note, file=sys.stderr, flush=True)
        rig, known = recording.rig, recording.poses()
        open_ = partial(_again, recorded, source, rig)
        track = (lambda: known) if known is not None else None
    check_free(host, port)
    token = None if is_loopback(host) else secrets.token_urlsafe(9)
    print(f"The console is at http://{host}:{port}. Ctrl-C ends it.", flush=True)
    if token is not None:
        print(f"Other machines need this token: {token}", flush=True)
    reader = options.reader(rig, beam)
    age = options.calibration
    serve(
        open_, reader, rig, beam=age, folder=folder, host=host, port=port, token=token, poses=track
    )


def _again(recorded: RecordingOptions, source: str, rig: "Rig") -> "Source":
    """Open the source once more: a camera was lost, or a recording begins anew."""
    from eyespot.estimator.recording import Recording

    again = Recording.open(source, rig=rig, exposure=recorded.exposure, fps=recorded.fps)
    return again.source


def check_free(host: str, port: int) -> None:
    """Refuse an address on which nothing can listen, before it is announced."""
    try:
        with socket.create_server((host, port)):
            pass
    except OSError as error:
        raise InputError(
            f"the console cannot listen on {host}:{port} ({error.strerror}). Choose another --port "
            "or --host, or end the program that has it."
        ) from error
