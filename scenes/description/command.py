"""The commands `eyespot scene init` and `scene schema`, and the options for reading scenes.

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
    Path, typer.Option("--out", metavar="DIR", help="Output folder; created if missing.")
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a value of the scene, for example camera.bit_depth=12. Repeatable.",
    ),
]

SCHEMA_FILE = "scene.schema.json"
"""File name under which `eyespot scene init` looks for the JSON schema."""


def init(
    path: Annotated[Path, typer.Argument(help="File to write; it must not exist yet.")] = Path(
        "scene.toml"
    ),
) -> None:
    """Write a scene file with every key, its unit and its default."""
    from estimator.files import written_whole
    from scenes.description.scene_file import scene_template

    schema_file = f"./{SCHEMA_FILE}" if path.with_name(SCHEMA_FILE).exists() else None
    with written_whole(path) as partial:
        partial.write_text(scene_template(schema_file=schema_file), encoding="utf-8")
    typer.echo(f"Wrote {path}. Edit it, then: eyespot scene check {path}")


def schema() -> None:
    """Print the JSON schema of scene files, for editors.

    Save it as scene.schema.json: scene files written by `scene init` in that folder refer to it.
    """
    from scenes.description.scene_file import scene_schema

    typer.echo(json.dumps(scene_schema(), indent=2))
