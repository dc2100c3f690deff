"""Irradiance of a glue lens; takes half a minute to compute, so it is cached on disk."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import optics
from estimator.files import cache_file, kept_arrays


class LensLight(NamedTuple):
    """Light of a lens in a medium.

    Attributes:
        table: vector irradiance per unit power in the core.
        transmitted: fraction of that power that leaves the cap.
    """

    table: optics.IrradianceTable
    transmitted: float


@functools.lru_cache(maxsize=4)
def lens_light(lens: str, medium_index: float) -> LensLight:
    """Light of a lens, computed once and then read from the user's cache folder.

    Args:
        lens: preset name or path of a lens file.
        medium_index: n0, refractive index of the medium.
    """
    glass = optics.load_lens(lens)

    def compute() -> dict[str, Any]:
        table = optics.irradiance_table(glass, medium_index=medium_index)
        return {
            "values": np.asarray(table.values),
            "medium_index": np.asarray(table.medium_index),
            "contact_radius": np.asarray(table.contact_radius),
            "slope": np.asarray(table.slope),
            "transmitted": np.asarray(optics.transmitted_power(glass, medium_index=medium_index)),
        }

    # The key is made of all that the result depends on: lens, medium and code.
    numbers = {name: x if x is None else float(x) for name, x in vars(glass).items()}
    key = hashlib.sha256(repr((sorted(numbers.items()), medium_index)).encode())
    for source in (Path(__file__), *sorted(Path(optics.__file__).parent.glob("*.py"))):
        key.update(source.read_bytes())
    kept = kept_arrays(cache_file("lens_light", key.hexdigest()), compute)
    table = optics.IrradianceTable(
        values=kept["values"],
        medium_index=kept["medium_index"],
        contact_radius=kept["contact_radius"],
        slope=kept["slope"],
    )
    return LensLight(table, float(kept["transmitted"]))
