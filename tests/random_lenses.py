"""Random lenses from the whole range of drops that people make."""

from __future__ import annotations

import numpy as np

import optics


def random_lens(rng: np.random.Generator, *, margin: float = 0.0) -> optics.GlueLens:
    """A lens from a flat end to half a ball, with or without a rim.

    Args:
        rng: the generator.
        margin: by how much the core is smaller than the range allows, mm.
    """
    aperture = rng.uniform(0.2, 0.35)
    core = rng.uniform(0.15, min(0.3, aperture)) - margin
    sag, rim = rng.uniform(0.001, aperture), rng.uniform(0.0, 0.4)
    return optics.glue_lens(
        core_radius=core,
        aperture_radius=aperture,
        sag=sag,
        glue_length=sag + rim,
        glue_index=rng.uniform(1.45, 1.55),
        numerical_aperture=rng.uniform(0.05, 0.3),
    )
