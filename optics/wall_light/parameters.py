"""Conversion between a glue lens and fit parameters."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
from jaxtyping import ScalarLike

import optics
from optics import InputError

PARAMETERS = (
    "core_radius",
    "aperture_radius",
    "rim_height",
    "sag",
    "glue_index",
    "numerical_aperture",
)
"""A lens's shape and light. `rim_height` is the height of the cap's rim over the core, mm. It
replaces the glue's length, so that a change of the sag alone keeps the lens possible."""


def lens_of(values: Mapping[str, ScalarLike]) -> optics.GlueLens:
    """The lens with the given `PARAMETERS` (may be traced) and a uniform launch."""
    length = jnp.asarray(values["rim_height"], float) + values["sag"]
    fields = {name: jnp.asarray(values[name], float) for name in PARAMETERS if name != "rim_height"}
    return optics.GlueLens(**fields, glue_length=length, launch_radius=None, launch_aperture=None)


def lens_parameters(lens: optics.GlueLens) -> dict[str, float]:
    """`PARAMETERS` of a lens.

    Raises:
        InputError: a Gaussian launch, which the image fit does not support.
    """
    if lens.launch_radius is not None or lens.launch_aperture is not None:
        raise InputError(
            "the image fit supports uniformly filled cores only; this lens has a launch_radius or "
            "a launch_aperture. Leave them out."
        )
    fields = {name: getattr(lens, name) for name in PARAMETERS if name != "rim_height"}
    fields["rim_height"] = lens.glue_length - lens.sag
    return {name: float(fields[name]) for name in PARAMETERS}
