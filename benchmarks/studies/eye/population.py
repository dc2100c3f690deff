"""Eyes of a healthy adult population, drawn from published means and covariances."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from optics import read_toml
from optics.viewing import Conic, Eye, Medium, Refracting

_FILE = Path(__file__).with_name("population.toml")


PARTS: dict[str, tuple[str, ...]] = {
    "cornea": ("cornea_",),
    "lens": ("lens_",),
    "axial length": ("axial_",),
    "shape of the retina": ("retina_",),
}
"""The parts in which eyes differ, by the prefix of their parameters."""


def drawn(count: int, seed: int) -> Drawn:
    """Random eyes (Rozema et al. 2016; `population.toml` says how they were reduced)."""
    content = read_toml(_FILE)
    mean = np.array([*content["mean"].values()])
    spread = np.array([*content["standard_deviation"].values()])
    correlation = np.eye(len(mean))
    for row, values in enumerate(content["correlation"]["rows"], start=1):
        correlation[row, :row] = correlation[:row, row] = values
    # Two radii are proportional, so rounding can make the smallest eigenvalue negative.
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    standard = np.random.default_rng(seed).standard_normal((count, len(mean)))
    return Drawn([*content["mean"]], mean, mean + spread * (standard @ root.T), content)


class Drawn(NamedTuple):
    """The parameters of random eyes.

    Attributes:
        values: eyes x parameters.
        constant: what is the same in all eyes.
    """

    names: list[str]
    mean: np.ndarray
    values: np.ndarray
    constant: dict[str, float]

    def eyes(self, parts: Collection[str] = tuple(PARTS)) -> Eye:
        """The eyes, with a leading axis on every leaf; only the named parts are not the mean."""
        own = [any(name.startswith(PARTS[part]) for part in parts) for name in self.names]
        rows = jnp.asarray(np.where(own, self.values, self.mean))
        return jax.vmap(lambda row: _eye(dict(zip(self.names, row, strict=True)), self.constant))(
            rows
        )


def _eye(of: dict[str, Float[Array, ""]], constant: dict[str, float]) -> Eye:
    cornea = Conic(
        depth=0.0,
        curvature=1.0 / of["cornea_front_radius"],
        asphericity=of["cornea_front_asphericity"],
    )
    back = Conic(
        depth=of["cornea_thickness"],
        curvature=1.0 / of["cornea_back_radius"],
        asphericity=of["cornea_back_asphericity"],
    )
    lens_front = Conic(
        depth=of["lens_depth"],
        curvature=1.0 / of["lens_front_radius"],
        asphericity=constant["lens_front_asphericity"],
    )
    lens_back = Conic(
        depth=of["lens_depth"] + of["lens_thickness"],
        curvature=1.0 / of["lens_back_radius"],
        asphericity=constant["lens_back_asphericity"],
    )
    return Eye(
        cornea=(
            Refracting(cornea, Medium(constant["cornea_index"])),
            Refracting(back, Medium(constant["aqueous_index"])),
        ),
        iris_depth=of["lens_depth"],
        lens=(
            Refracting(lens_front, Medium(of["lens_index"])),
            Refracting(lens_back, Medium(constant["vitreous_index"])),
        ),
        axial_length=of["axial_length"],
        retina_semi_axes=jnp.stack([of["retina_x"], of["retina_y"], of["retina_z"]]),
    )
