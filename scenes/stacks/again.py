"""A new stack from the noise-free frames of an old one, without rendering."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from estimator.files import Stack, StackError, StackWriter, read_stack
from optics import shortened
from scenes.description import Scene, SceneError
from scenes.stacks.photography import Photography
from scenes.stacks.stack import dumped, microscope_file
from scenes.world import World

_ANEW = ("camera", "exposures", "seed")
"""Parts of a scene that do not affect rendering."""
_PHOTOGRAPHED = (
    "file_name",
    "mask_file_name",
    "exposure",
    "exposure_s",
    "saturated_fraction",
    "seed",
    "bound_x_px",
    "bound_y_px",
    "bound_semi_major_px",
    "bound_semi_minor_px",
    "bound_d_mm",
)
"""Labels that depend on the exposure, not on the scene's geometry."""


def expose_again(stack: Stack, scene: Scene, out: Path) -> Stack:
    """Expose the noise-free frames of a stack with another camera, exposure or noise.

    Motion blur stays as it was rendered, for the exposure times of the old stack, and `metered`
    measures the blurred frame. If the tip hardly moves during an exposure, the new stack equals the
    one that `render_stack` makes from the scene.

    Args:
        stack: a stack rendered with `exposures.keep_linear`.
        scene: the stack's scene; only `camera`, `exposures` and `seed` may differ.
        out: the new stack's folder; it must not exist.

    Returns:
        The new stack.

    Raises:
        SceneError: another part of the scene differs, or the stack lacks a kind of exposure.
        StackError: the stack has no linear frames, or its stack.toml is damaged.
        InputError: `out` exists, or kinematics.csv is damaged.
    """
    _check_anew(stack, scene)
    world = World(scene)
    world.wall_colour = _wall_colour(stack)  # needs no picture file
    photography = Photography(world)
    with StackWriter(Path(out)) as writer:
        writer.describe(
            stack={**stack.description, "scene": dumped(scene)},
            microscope=microscope_file(world, photography.paper_exposure_s),
            kinematics=np.column_stack([*stack.kinematics().values()]),
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


def _wall_colour(stack: Stack) -> np.ndarray:
    found = stack.described("wall_colour", list)
    if len(found) != 3 or not all(type(part) in (int, float) and 0 <= part <= 1 for part in found):
        raise StackError(
            f"{stack.folder / 'stack.toml'}: wall_colour must be three reflectances from 0 to 1; "
            f"got {shortened(found)}. Render the stack again."
        )
    return np.array(found, dtype=float)


def _check_anew(stack: Stack, scene: Scene) -> None:
    was, now = stack.described("scene", dict), dumped(scene)
    for name in now:
        if name not in _ANEW and now[name] != was.get(name):
            raise SceneError(
                f"{stack.folder} was rendered with another [{name}]; only {', '.join(_ANEW)} can "
                "change without rendering. Render the scene."
            )
    if missing := set(scene.exposures.kinds) - {row.exposure for row in stack.labels}:
        raise SceneError(
            f"{stack.folder} has no frames of exposure {missing.pop()!r}. Remove it from "
            "exposures.kinds, or render the scene."
        )
