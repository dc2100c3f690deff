"""The command `eyespot console`."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from estimator.run import Options, with_options
from optics import InputError

if TYPE_CHECKING:
    from estimator.sources import Source

_TOPIC = "topic:"


@with_options
def console(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="Stack, folder of images, TIFF, video, ROS bag, number of a camera, or "
            "topic:/NAME of a running ROS.",
        ),
    ],
    exposure: Annotated[
        Literal["paper", "metered"] | None,
        typer.Option(help="Which exposure to use if the stack has two."),
    ] = None,
    image_topic: Annotated[
        str | None,
        typer.Option(help="Image topic of a bag that has several, none of them the rig's."),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Robot poses (CSV or ROS bag), on the clock of SOURCE."),
    ] = None,
    pose_topic: Annotated[
        str | None,
        typer.Option(help="Pose topic of a bag that has several, none of them the rig's."),
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
    if poses is None:
        for name, value in (
            ("pose_topic", pose_topic),
            ("eye_from_robot", options["eye_from_robot"]),
        ):
            if value is not None:
                raise InputError(f"{name} has no effect without poses. Give both, or neither.")
    elif source.startswith(_TOPIC):
        raise InputError("poses are of a recording; of a topic the console shows images only.")
    track = read_poses(poses, topic=pose_topic) if poses else None
    if source.startswith(_TOPIC):
        from estimator.rig import open_topic

        live = open_topic(source.removeprefix(_TOPIC))
        opened: Callable[[], Source] = lambda: live  # noqa: E731
    else:
        opened = partial(open_source, source, exposure=exposure, image_topic=image_topic)
        options["microscope"] = options["microscope"] or opened().microscope_file
    token = None if is_loopback(host) else secrets.token_urlsafe(9)
    print(f"The console is at http://{host}:{port}. Ctrl-C ends it.", flush=True)
    if token is not None:
        print(f"Other machines need this token: {token}", flush=True)
    serve(
        opened, Options.of(options), folder=folder, host=host, port=port, token=token, poses=track
    )
