"""The commands `eyespot render` and `eyespot scene check`."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from scenes.description import Changes, OutputFolder, SceneFile


def render(
    scene: SceneFile,
    out: OutputFolder,
    preview: Annotated[
        bool, typer.Option("--preview", help="Render one small frame only, into the image DIR.png.")
    ] = False,
    changes: Changes = None,
    rerun: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|live",
            help="Record the stack with its labels for the viewer rerun (.rrd), or show it there.",
        ),
    ] = None,
    variant: Annotated[
        Literal["llvm_ad_rgb", "cuda_ad_rgb", "scalar_rgb"],
        typer.Option(
            help="Mitsuba variant: for the CPU (llvm_ad_rgb), for an NVIDIA GPU (cuda_ad_rgb), or "
            "for a CPU without LLVM (scalar_rgb; ideal cones only, a minute per frame)."
        ),
    ] = "llvm_ad_rgb",
) -> None:
    """Render a scene file to an image stack with labels.

    If a run was stopped, the same command continues it.
    """
    from estimator.run import progress
    from estimator.viewer import check_recording_path, record_stack
    from scenes.description import load_scene
    from scenes.stacks.preview import write_preview
    from scenes.stacks.stack import render_stack
    from scenes.world import frame_count

    settings = load_scene(scene, changes or ())
    if rerun is not None:
        check_recording_path(rerun)
    if preview:
        # Not in the stack's folder, which exists only once the stack is complete.
        image = out.with_name(f"{out.name}.png")
        write_preview(settings, image, variant=variant)
        typer.echo(f"Wrote {image}.")
        return
    with progress("Rendering", total=frame_count(settings)) as advance:
        render_stack(settings, out, variant=variant, progress=advance)
    typer.echo(f"Wrote the stack {out}.")
    if rerun is not None:
        record_stack(out, rerun)


def check(scene: SceneFile, changes: Changes = None) -> None:
    """Check whether a scene file can be rendered."""
    from scenes.description import load_scene
    from scenes.stacks.stack import check_scene

    settings = load_scene(scene, changes or ())
    # Each key may be valid, but the spot may still leave the window.
    check_scene(settings)
    typer.echo(f"{scene}: fine.")
    for approximation in settings.approximations:
        typer.echo(f"Approximate: {approximation}.")
