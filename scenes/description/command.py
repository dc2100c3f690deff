"""The commands `eyespot scene init` and `scene schema`, and the options for reading scenes.

eyespot scene init     writes a scene file with every key, its unit and its default
eyespot scene schema   prints the JSON schema of scene files
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

SceneFile = Annotated[Path, Parameter(help="Scene file (TOML).")]
OutputFolder = Annotated[Path, Parameter(alias="-o", help="Output folder; created if missing.")]
Changes = Annotated[
    tuple[str, ...],
    Parameter(
        "--set",
        metavar="KEY=VALUE",
        help="Change a value of the scene, for example camera.bit_depth=12. Repeatable.",
        show_default=False,
    ),
]

SCHEMA_FILE = "scene.schema.json"
"""File name under which `eyespot scene init` looks for the JSON schema."""


def init(
    path: Path = Path("scene.toml"),
    /,
    *,
    microscope: Literal["paper", "real"] = "paper",
    overwrite: bool = False,
) -> None:
    """Write a scene file with every key, its unit and its default.

    Args:
        path: File to write.
        microscope: Pinhole on the eye's sphere as in the paper's equation, or 200 mm above the eye.
        overwrite: Replace the file if it exists.
    """
    from estimator.files import written_whole
    from scenes.description.scene_file import scene_template

    schema_file = f"./{SCHEMA_FILE}" if path.with_name(SCHEMA_FILE).exists() else None
    template = scene_template(schema_file=schema_file)
    if microscope == "real":
        template = template.replace("pinhole_height_mm = 11.5 ", "pinhole_height_mm = 200.0 ")
    with written_whole(path, replace=overwrite) as partial:
        partial.write_text(template, encoding="utf-8")
    print(f"Wrote {path}. Edit it, then: eyespot scene check {path}")


def schema() -> None:
    """Print the JSON schema of scene files, for editors.

    Save it as scene.schema.json: scene files written by `scene init` in that folder refer to it.
    """
    from scenes.description.scene_file import scene_schema

    print(json.dumps(scene_schema(), indent=2))
