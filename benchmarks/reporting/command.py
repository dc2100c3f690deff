"""The options that the commands of all studies share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from scenes.description import Changes as Changes
from scenes.description import OutputFolder as OutputFolder

StartingScene = Annotated[
    Path | None,
    typer.Argument(
        metavar="SCENE", help="Scene file (TOML) to start from (default: the study's own scene)."
    ),
]
Quick = Annotated[bool, typer.Option("--quick", help="Run a smaller study, for a first look.")]
Seed = Annotated[int | None, typer.Option(help="Random seed (default: the scene file's).", min=0)]
LightSource = Annotated[
    Literal["both", "lens", "cone"],
    typer.Option(help="The fibre with its glue lens, the ideal sharp cone, or both."),
]
