"""The commands `eyespot render` and `eyespot scene check`."""

from __future__ import annotations

import shlex
from typing import Annotated, Literal

from cyclopts import Parameter

from scenes.description import Changes, OutputFolder, SceneFile


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
    from estimator.run import progress, say
    from estimator.viewer import check_recording_path, record_stack
    from scenes.description import load_scene
    from scenes.stacks.preview import write_preview
    from scenes.stacks.stack import render_stack
    from scenes.world import frame_count

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
    with progress("Rendering", total=frame_count(settings)) as advance:
        render_stack(settings, out, variant=variant, progress=advance)
    frames, kinds = frame_count(settings), settings.exposures.kinds
    exposures = f"{len(kinds)} exposures" if len(kinds) > 1 else f"1 exposure, {kinds[0]}"
    print(f"Wrote {frames * len(kinds)} images ({frames} frames × {exposures}) to {out}.")
    print(f"Next: eyespot fit {shlex.quote(str(out))} --out beam.json")
    if rerun is not None:
        record_stack(out, rerun)


def check(scene: SceneFile, /, *, changes: Changes = ()) -> None:
    """Check whether a scene file can be rendered."""
    from scenes.description import load_scene
    from scenes.stacks.stack import check_scene

    settings = load_scene(scene, changes)
    # Each key may be valid, but the spot may still leave the window.
    check_scene(settings)
    print(f"{scene}: fine. Next: eyespot render {shlex.quote(str(scene))} --out stack")
    for remark in settings.without_effect:
        print(f"{remark}.")
    for approximation in settings.approximations:
        print(f"Approximate: {approximation}.")
