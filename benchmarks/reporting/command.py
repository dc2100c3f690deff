"""The options that the commands of all studies share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.types import NonNegativeInt

from scenes.description import Changes as Changes
from scenes.description import OutputFolder as OutputFolder

StartingScene = Annotated[
    Path | None,
    Parameter(help="Scene file (TOML) to start from (default: the study's own scene)."),
]
Quick = Annotated[bool, Parameter(help="Run a smaller study, for a first look.")]
Seed = Annotated[NonNegativeInt | None, Parameter(help="Random seed (default: the scene file's).")]
LightSource = Annotated[
    Literal["both", "lens", "cone"],
    Parameter(help="The fibre with its glue lens, the ideal sharp cone, or both."),
]
