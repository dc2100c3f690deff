"""The light source of a rendered stack."""

from __future__ import annotations

import functools

from estimator import Calibration, Stack
from optics import InputError
from scenes import Scene
from scenes.world import true_calibration


def true_beam(stack: Stack) -> Calibration:
    """The beam of a stack's scene, as a perfect calibration would give it.

    Stacks of one source share one object, whose light is traced once.

    Raises:
        InputError: the stack was not rendered, so that nothing says what its source is.
    """
    scene = stack.description.get("scene")
    if not isinstance(scene, dict):
        raise InputError(
            f"{stack.folder} has no scene, so its light source is not known. Give --calibration."
        )
    return _beam(Scene.model_validate(scene).model_dump_json(include={"source"}))


@functools.cache
def _beam(source: str) -> Calibration:
    return true_calibration(Scene.model_validate_json(source))
