"""The command `eyespot console`."""

from __future__ import annotations

import secrets
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from estimator.files import POSE_TOPIC
from estimator.run import Exposure, ImageTopic, Options, PosesFile, with_options
from optics import InputError

if TYPE_CHECKING:
    from estimator.files import PoseTrack
    from estimator.sources import Source

_TOPIC = "topic:"


@with_options
def console(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="Stack, folder of images, TIFF, video, ROS bag, number of a camera, genicam:NAME, "
            "or topic:/NAME of a running ROS.",
        ),
    ],
    exposure: Exposure = None,
    image_topic: ImageTopic = None,
    poses: PosesFile = None,
    pose_topic: Annotated[
        str | None,
        typer.Option(
            help="Pose topic of a running ROS or of a bag that has several, if not the rig's."
        ),
    ] = None,
    folder: Annotated[
        Path, typer.Option(metavar="DIR", help="Where the page records spots and frames.")
    ] = Path(),
    host: Annotated[
        str,
        typer.Option(help="Address to listen on; other machines can reach 0.0.0.0, with a token."),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port to listen on.")] = 8080,
    **options: Any,
) -> None:
    """Show a source, what is measured in it, and its distance on a page in the browser.

    Ctrl-C ends it.
    """
    from estimator.files import read_poses
    from estimator.sources import open_source

    try:
        from estimator.console.page import serve
    except ModuleNotFoundError as error:
        raise InputError(
            f"the console needs the package {error.name}: pip install 'eyespot[console]'."
        ) from error
    from estimator.console.gate import is_loopback

    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder. Make it, or choose another one.")
    track: Callable[[], PoseTrack] | None
    if source.startswith(_TOPIC):
        opened, track = _topic(source.removeprefix(_TOPIC), poses, pose_topic)
    else:
        if pose_topic is not None and poses is None:
            raise InputError("pose_topic has no effect without poses. Give both, or neither.")
        opened = partial(open_source, source, exposure=exposure, image_topic=image_topic)
        first = opened()
        for note in first.notes:
            print(note, file=sys.stderr, flush=True)
        options["microscope"] = options["microscope"] or first.microscope_file
        known = read_poses(poses, topic=pose_topic) if poses else None
        track = (lambda: known) if known is not None else None
    if options["eye_from_robot"] is not None and track is None:
        raise InputError("eye_from_robot has no effect without poses. Give both, or neither.")
    token = None if is_loopback(host) else secrets.token_urlsafe(9)
    print(f"The console is at http://{host}:{port}. Ctrl-C ends it.", flush=True)
    if token is not None:
        print(f"Other machines need this token: {token}", flush=True)
    serve(
        opened, Options.of(options), folder=folder, host=host, port=port, token=token, poses=track
    )


def _topic(
    topic: str, poses: Path | None, pose_topic: str | None
) -> tuple[Callable[[], Source], Callable[[], PoseTrack]]:
    """The source of a topic, and the poses that arrive."""
    from estimator.rig import RecentPoses, open_topic

    if poses is not None:
        raise InputError("poses are of a recording. Those of a running ROS have a --pose-topic.")
    recent = RecentPoses()
    live = open_topic(topic, poses=recent, pose_topic=pose_topic or POSE_TOPIC)
    return lambda: live, recent.track
