"""Lenses that the surgeon puts on the cornea or holds above it, read from files."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from pydantic import Field

from optics import Strict
from optics.viewing.data_file import names_in, read_data_file


class ContactLens(eqx.Module):
    """A lens on the cornea; its back fits the cornea's front without a gap.

    Attributes:
        front_curvature: 1/R, 1/mm; positive if it converges, 0 for a plane.
        thickness: on the axis, mm.
        index: of its material.
    """

    front_curvature: Float[Array, ""]
    thickness: Float[Array, ""]
    index: Float[Array, ""]

    @property
    def above_cornea(self) -> Float[Array, ""]:
        """Height of its front above the cornea's vertex, mm."""
        return self.thickness


class WideFieldLens(eqx.Module):
    """An ideal thin lens above the cornea; it inverts the image.

    Attributes:
        power: 1/f, 1/mm.
        height: above the cornea's vertex, mm.
    """

    power: Float[Array, ""]
    height: Float[Array, ""]

    @property
    def above_cornea(self) -> Float[Array, ""]:
        """Height above the cornea's vertex, mm."""
        return self.height


ViewingLens = ContactLens | WideFieldLens


class _ContactLensFile(Strict):
    kind: Literal["contact"]
    front_curvature_per_mm: float = Field(ge=-0.5, le=0.5)
    thickness_mm: float = Field(gt=0.0, le=50.0)
    index: float = Field(ge=1.0, le=4.0)


class _WideFieldFile(Strict):
    kind: Literal["wide-field"]
    power_d: float = Field(ge=20.0, le=300.0)


class _LensFile(Strict):
    lens: _ContactLensFile | _WideFieldFile = Field(discriminator="kind")


def viewing_lens_names() -> tuple[str, ...]:
    """Names of the viewing lenses that come with the package."""
    return names_in("lenses")


def load_viewing_lens(name_or_path: str | Path) -> ViewingLens:
    """Read a viewing lens from its name or from a TOML file in the same format.

    A wide-field lens is held one focal length above the cornea.

    Args:
        name_or_path: one of `viewing_lens_names()`, or the path of a `.toml` file.

    Raises:
        InputError: no such lens, or an unknown, missing or wrong key.
    """
    file = read_data_file(_LensFile, "lenses", name_or_path).lens
    if isinstance(file, _WideFieldFile):
        power = file.power_d / 1000.0
        return WideFieldLens(power=jnp.asarray(power), height=jnp.asarray(1.0 / power))
    return ContactLens(
        front_curvature=jnp.asarray(file.front_curvature_per_mm),
        thickness=jnp.asarray(file.thickness_mm),
        index=jnp.asarray(file.index),
    )
