"""The commands `eyespot scene init` and `scene schema`, and the options that scenes are read with.

eyespot scene init     writes a scene file with every key, its unit and its default
eyespot scene schema   prints the JSON schema of scene files
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (TOML).")]
OutputFolder = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="Folder for the results; made if missing.")
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a value of the scene, such as camera.bit_depth=12. Repeatable.",
    ),
]

SCHEMA_FILE = "scene.schema.json"
"""Name under which `eyespot scene init` looks for what `eyespot scene schema` prints."""


def init(
    path: Annotated[Path, typer.Argument(help="File to write; must not exist.")] = Path(
        "scene.toml"
    ),
) -> None:
    """Write a scene file with every key, its unit and its default."""
    from scenes.description.scene_file import scene_template

    schema_file = f"./{SCHEMA_FILE}" if path.with_name(SCHEMA_FILE).exists() else None
    with path.open("x", encoding="utf-8") as file:
        file.write(scene_template(schema_file=schema_file))
    typer.echo(f"Wrote {path}. Edit it, then: eyespot scene check {path}")


def schema() -> None:
    """Print the JSON schema of scene files, for editors.

    Save it as scene.schema.json: every scene file that `scene init` writes beside it names it.
    """
    from scenes.description.scene_file import scene_schema

    typer.echo(json.dumps(scene_schema(), indent=2))
