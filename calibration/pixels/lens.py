"""A glue lens as the parameters of a fit, and back."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
from jaxtyping import ScalarLike

import optics

PARAMETERS = (
    "core_radius",
    "aperture_radius",
    "rim_height",
    "sag",
    "glue_index",
    "numerical_aperture",
)
"""A lens's shape and light; `rim_height` is that of the cap's rim over the core, mm, so that a
drop stays possible when its sag alone moves."""


def lens_of(values: Mapping[str, ScalarLike]) -> optics.GlueLens:
    """The lens with given `PARAMETERS`, evenly launched; they may be traced."""
    length = jnp.asarray(values["rim_height"], float) + values["sag"]
    fields = {name: jnp.asarray(values[name], float) for name in PARAMETERS if name != "rim_height"}
    return optics.GlueLens(**fields, glue_length=length, launch_radius=None, launch_aperture=None)


def lens_parameters(lens: optics.GlueLens) -> dict[str, float]:
    """`PARAMETERS` of a lens.

    Raises:
        ValueError: a Gaussian launch, which the image fit does not know.
    """
    if lens.launch_radius is not None or lens.launch_aperture is not None:
        raise ValueError(
            "the image fit knows evenly filled cores only; this lens has a launch_radius or a "
            "launch_aperture. Leave them out."
        )
    fields = {name: getattr(lens, name) for name in PARAMETERS if name != "rim_height"}
    fields["rim_height"] = lens.glue_length - lens.sag
    return {name: float(fields[name]) for name in PARAMETERS}
