"""The commands `scene init`, `scene schema`, `scene check` and `render`."""

import json
import shlex
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
    from eyespot.formats.whole_files import written_whole
    from eyespot.scenes.description.scene_file import scene_template

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
    from eyespot.scenes.description.scene_file import scene_schema

    print(json.dumps(scene_schema(), indent=2))


def render(
    scene: SceneFile,
    /,
    *,
    out: OutputFolder,
    preview: bool = False,
    changes: Changes = (),
    rerun: Annotated[str | None, Parameter(metavar="FILE|live")] = None,
    variant: Literal["llvm_ad_rgb", "cuda_ad_rgb", "scalar_rgb"] = "llvm_ad_rgb",
) -> None:
    """Render a scene file to an image stack with labels; a frame takes 0.1 to 1 s.

    If a run was stopped, the same command continues it.

    Args:
        preview: Render one small frame only, into the image OUT.png.
        rerun: Record the stack with its labels for the viewer rerun (.rrd), or show it there.
        variant: Mitsuba variant: for the CPU (llvm_ad_rgb), for an NVIDIA GPU (cuda_ad_rgb), or
            for a CPU without LLVM (scalar_rgb; ideal cones only, a minute per frame).
    """
    from eyespot.estimator.run.progress_bar import progress, say
    from eyespot.estimator.viewer import check_recording_path, record_stack
    from eyespot.formats.whole_files import refuse_existing
    from eyespot.scenes.description.scene_file import load_scene
    from eyespot.scenes.stacks.rendered_stack import render_stack, write_preview
    from eyespot.scenes.world.motion import frame_count

    settings = load_scene(scene, changes)
    for remark in settings.without_effect:
        say(f"{remark}.")
    if rerun is not None:
        check_recording_path(rerun)
    if preview:
        # Not in the stack's folder, which exists only once the stack is complete.
        image = out.with_name(f"{out.name}.png")
        write_preview(settings, image, variant=variant)
        print(f"Wrote {image}.")
        return
    refuse_existing(out)  # before anything is promised
    frames, kinds = frame_count(settings), settings.exposures.kinds
    print(
        f"Rendering {frames} frames: up to a minute to prepare, then 0.1 to 1 s each.", flush=True
    )
    with progress("Rendering", total=frames) as advance:
        render_stack(settings, out, variant=variant, progress=advance)
    exposures = f"{len(kinds)} exposures" if len(kinds) > 1 else f"1 exposure, {kinds[0]}"
    print(f"Wrote {frames * len(kinds)} images ({frames} frames × {exposures}) to {out}.")
    print(f"Next: eyespot fit {shlex.quote(str(out))} --out beam.json")
    if rerun is not None:
        record_stack(out, rerun)


def check(scene: SceneFile, /, *, changes: Changes = ()) -> None:
    """Check whether a scene file can be rendered."""
    from eyespot.scenes.description.scene_file import load_scene
    from eyespot.scenes.stacks.rendered_stack import check_scene

    settings = load_scene(scene, changes)
    # Each key may be valid, but the spot may still leave the window.
    check_scene(settings)
    print(f"{scene}: fine. Next: eyespot render {shlex.quote(str(scene))} --out stack")
    for remark in settings.without_effect:
        print(f"{remark}.")
    for approximation in settings.approximations:
        print(f"Approximate: {approximation}.")
