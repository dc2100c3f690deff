"""What the commands of all studies share: their first options, and how a study is opened."""

import functools
import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from cyclopts import Parameter
from cyclopts.types import NonNegativeInt

from eyespot.scenes import Scene
from eyespot.scenes.commands import Changes

OutputFolder = Annotated[
    Path,
    Parameter(
        alias="-o", help="Output folder; created if missing. A stopped run is continued there."
    ),
]
StartingScene = Annotated[
    Path | None,
    Parameter(help="Scene file (TOML) to start from (default: the study's own scene)."),
]
RigFile = Annotated[
    Path | None,
    Parameter(
        "--rig",
        help="Rig file (TOML): its microscope, eye, beam, camera and tilt replace the scene's.",
    ),
]
Quick = Annotated[bool, Parameter(help="Run a smaller study, for a first look.")]
Seed = Annotated[NonNegativeInt | None, Parameter(help="Random seed (default: the scene file's).")]
LightSource = Annotated[
    Literal["both", "lens", "cone"],
    Parameter(help="The fibre with its glue lens, the ideal sharp cone, or both."),
]

T = TypeVar("T")


def command(
    *,
    defaults: Sequence[str] = (),
    check: Callable[[Scene], None] = lambda scene: None,
    varies: Sequence[str] = (),
    in_workspace: bool = False,
    with_scene: bool = True,
    check_options: Callable[..., object] = lambda **given: None,
) -> Callable[[Callable[..., T]], Callable[..., T]]:
    """Make a function of a study its command, which takes what every study takes and opens it.

    The function's own parameters follow those of every study, and are its options. The arguments
    are as of `Study`; a study may have no scene that could be given or changed, and `check_options`
    raises if its options are wrong.
    """

    def made(function: Callable[..., T]) -> Callable[..., T]:
        own = [*inspect.signature(function).parameters.values()][1:]
        name = function.__name__.replace("_", "-")

        def run(
            scene: StartingScene = None,
            /,
            *,
            rig: RigFile = None,
            out: OutputFolder,
            changes: Changes = (),
            quick: Quick = False,
            seed: Seed = None,
            **given: Any,
        ) -> T:
            given = {option.name: option.default for option in own} | given
            check_options(**given)  # before a folder is made
            about: dict[str, Any] = {
                "options": {key.replace("_", "-"): value for key, value in given.items()},
                "rig": rig,
                "varies": varies,
                "in_workspace": in_workspace,
            }
            from eyespot.benchmarks.study import Study  # 6 s, too long to wait for --help

            study = Study(name, out, scene, changes, quick, seed, defaults, check, **about)
            return function(study, **given)

        shared = [*inspect.signature(run).parameters.values()][:-1]
        if not with_scene:
            shared = [one for one in shared if one.name in ("out", "quick", "seed")]
        functools.update_wrapper(run, function)
        run.__signature__ = inspect.Signature([*shared, *own])  # type: ignore[attr-defined]
        return run

    return made
