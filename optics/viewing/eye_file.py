"""The format of eye files: radii, asphericities, thicknesses and indices, with their source."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from optics import InputError, Strict

_VISIBLE_NM = (400.0, 700.0)  # where a dispersion formula may be evaluated


def _pair(value: object) -> object:
    """A number alone does not depend on the refraction."""
    return (value, 0.0) if isinstance(value, int | float) else _tuple(value)


def _tuple(value: object) -> object:
    """TOML's lists as the tuples of the models."""
    return tuple(value) if isinstance(value, list) else value


def _not_flat(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] == 0.0:
        raise InputError("a radius of curvature must not be 0 mm")
    return value


Number = Annotated[
    tuple[float, float],
    BeforeValidator(_pair, json_schema_input_type=float | tuple[float, float]),
]
"""A number, or [at 0 D, change per dioptre of refraction]."""

Radius = Annotated[Number, AfterValidator(_not_flat)]
Pair = Annotated[tuple[float, float], BeforeValidator(_tuple)]
Terms = Annotated[tuple[float, float, float], BeforeValidator(_tuple)]
Index = Annotated[float, Field(ge=1.0, le=4.0)]
Layers = Annotated[list[float], Field(min_length=1)]


class CorneaFile(Strict):
    """The cornea's two surfaces."""

    front_radius_mm: Radius
    front_asphericity: Number
    thickness_mm: Number
    back_radius_mm: Radius
    back_asphericity: Number


class LensFile(Strict):
    """The crystalline lens; layers of a gradient lens meet in planes."""

    depth_mm: Number
    front_radius_mm: Radius
    front_asphericity: Number
    thickness_mm: Layers
    back_radius_mm: Radius
    back_asphericity: Number
    gradient: list[Terms] | None = None


class IndicesFile(Strict):
    """Indices at wavelengths, or at one wavelength with a dispersion common to all media."""

    wavelength_nm: list[float] = Field(min_length=1)
    dispersion: Pair = (0.0, 0.0)
    cornea: list[Index]
    aqueous: list[Index]
    lens: list[list[Index]]
    vitreous: list[Index]

    @model_validator(mode="after")
    def _one_index_a_wavelength(self) -> Self:
        for indices in (self.cornea, self.aqueous, *self.lens, self.vitreous):
            if len(indices) != len(self.wavelength_nm):
                raise InputError("each medium needs one index for each wavelength")
        return self

    def at(self, indices: list[float], wavelength_nm: float) -> float:
        """Index at a wavelength: the polynomial through the table, or with the dispersion.

        Raises:
            InputError: the wavelength lies outside the table, or outside the visible.
        """
        known = np.asarray(self.wavelength_nm)
        shortest, longest = (known.min(), known.max()) if len(known) > 1 else _VISIBLE_NM
        if not shortest <= wavelength_nm <= longest:
            raise InputError(
                f"the indices are known from {shortest:g} to {longest:g} nm; got wavelength_nm="
                f"{wavelength_nm:g} nm. Choose another wavelength or another eye."
            )
        first, here = known[0] * 1e-3, wavelength_nm * 1e-3
        if len(known) == 1:
            linear, square = self.dispersion
            return float(indices[0] + linear * (here - first) + square * (here**2 - first**2))
        polynomial = np.polyfit(known * 1e-3 - first, indices, len(known) - 1)
        return float(np.polyval(polynomial, here - first))


class EyeFile(Strict):
    """An eye; lengths in mm, depths from the cornea's vertex."""

    refractions_d: Pair = (0.0, 0.0)
    axial_length_mm: Number
    retina_semi_axes_mm: Annotated[tuple[Number, Number, Number], BeforeValidator(_tuple)]
    cornea: CorneaFile
    lens: LensFile
    indices: IndicesFile

    @model_validator(mode="after")
    def _one_entry_a_layer(self) -> Self:
        gradients = self.lens.gradient or self.lens.thickness_mm
        if not len(self.lens.thickness_mm) == len(gradients) == len(self.indices.lens):
            raise InputError(
                "lens.thickness_mm, lens.gradient and indices.lens need one entry for each layer"
            )
        return self
