"""A stack photographed anew from its noise-free frames, without rendering."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from estimator.files import Stack, StackWriter, read_stack
from scenes.description import Scene, SceneError
from scenes.stacks.photography import Photography
from scenes.stacks.stack import dumped, microscope_file
from scenes.world import World

_ANEW = ("camera", "exposures", "seed")
"""Parts of a scene that no rendering depends on."""
_PHOTOGRAPHED = (
    "file_name",
    "mask_file_name",
    "exposure",
    "exposure_s",
    "saturated_fraction",
    "seed",
)
"""Labels that depend on the photograph and not on the scene's geometry."""


def expose_again(stack: Stack, scene: Scene, out: Path) -> Stack:
    """Take the photographs of a stack again with another camera, exposure or noise.

    Nothing is rendered: the noise-free frames that the stack has kept are exposed. The blur of a
    moving tip stays that of the exposure it was rendered with, and `metered` meters on it; where
    the tip hardly moved, the new stack is that which `render_stack` makes of the scene.

    Args:
        stack: rendered with `exposures.keep_linear`.
        scene: the stack's scene, but for `camera`, `exposures` and `seed`.
        out: the new stack's folder; must not exist.

    Returns:
        The new stack.

    Raises:
        SceneError: the scene differs elsewhere, or wants a kind of exposure that the stack lacks.
        StackError: `out` exists, or the stack has no linear frames.
    """
    _check_anew(stack, scene)
    world = World(scene)
    world.wall_colour = np.array(stack.description["wall_colour"])  # needs no picture file
    photography = Photography(world)
    with StackWriter(Path(out)) as writer:
        writer.describe(
            stack={**stack.description, "scene": dumped(scene)},
            microscope=microscope_file(world, photography.paper_exposure_s),
            kinematics=np.loadtxt(stack.folder / "kinematics.csv", delimiter=",", skiprows=1),
        )
        for order, kind in enumerate(scene.exposures.kinds):
            for row in stack.exposed(kind):
                light, mask = stack.linear(row), stack.mask(row) > 0
                kept = {
                    name: value for name, value in asdict(row).items() if name not in _PHOTOGRAPHED
                }
                photography.write(
                    writer,
                    light,
                    order=order,
                    exposure_s=photography.exposure_s(kind, light, mask),
                    mask=mask,
                    labels={**kept, "seed": scene.seed},
                )
    return read_stack(out)


def _check_anew(stack: Stack, scene: Scene) -> None:
    was, now = stack.description["scene"], dumped(scene)
    for name in now:
        if name not in _ANEW and now[name] != was.get(name):
            raise SceneError(
                f"{stack.folder} was rendered with another [{name}]; only {', '.join(_ANEW)} can "
                "change without rendering. Render the scene."
            )
    if missing := set(scene.exposures.kinds) - {row.exposure for row in stack.labels}:
        raise SceneError(
            f"{stack.folder} holds no frames of exposure {missing.pop()!r}. Take it out of "
            "exposures.kinds, or render the scene."
        )
