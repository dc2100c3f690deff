"""Eyes: cornea, iris, crystalline lens and retina at one wavelength."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from optics import InputError, in_file, shortened
from optics.viewing.conic import Conic
from optics.viewing.data_file import names_in, read_data_file
from optics.viewing.eye_file import EyeFile, Number
from optics.viewing.medium import Medium
from optics.viewing.trace import Refracting


class Eye(eqx.Module):
    """The optics of an eye at one wavelength, and its retina.

    Depths are zeta of `Conic`, mm below the cornea's vertex.

    Attributes:
        cornea: its front with the cornea's medium, and its back with the aqueous humour.
        iris_depth: depth of the pupil's plane; the lens's front vertex.
        lens: the surfaces of the crystalline lens; the medium behind the last is the vitreous.
        axial_length: depth of the retinal pole.
        retina_semi_axes: semi-axes x, y and z of the retina's ellipsoid, mm.
    """

    cornea: tuple[Refracting, Refracting]
    iris_depth: Float[Array, ""]
    lens: tuple[Refracting, ...]
    axial_length: Float[Array, ""]
    retina_semi_axes: Float[Array, "3"]

    @property
    def vitreous_index(self) -> Float[Array, ""]:
        """Refractive index of the eye's own vitreous."""
        return self.lens[-1].medium.index


def eye_names() -> tuple[str, ...]:
    """Names of the eyes that come with the package."""
    return names_in("eyes")


def load_eye(
    name_or_path: str | Path, *, wavelength_nm: float = 555.0, refraction_d: float = 0.0
) -> Eye:
    """Read an eye from its name or from a TOML file in the same format.

    Args:
        name_or_path: one of `eye_names()`, or the path of a `.toml` file.
        wavelength_nm: of the light, nm.
        refraction_d: spherical refraction, dioptres; only for eyes that depend on it.

    Raises:
        InputError: no such eye, an unknown, missing or wrong key, or a wavelength or refraction
            for which the eye is not defined.
    """
    file = read_data_file(EyeFile, "eyes", name_or_path)
    with in_file(f"eye {shortened(str(name_or_path))}"):
        lowest, highest = file.refractions_d
        if not lowest <= refraction_d <= highest:
            raise InputError(
                f"refraction_d must lie in [{lowest:g}, {highest:g}] D; got {refraction_d:g} D. "
                "The eye atchison depends on the refraction."
            )
        return _eye(file, wavelength_nm, refraction_d)


def _eye(file: EyeFile, wavelength_nm: float, refraction_d: float) -> Eye:
    def number(value: Number) -> float:
        return value[0] + value[1] * refraction_d

    def conic(radius: Number, asphericity: Number, depth: float) -> Conic:
        return Conic(depth=depth, curvature=1.0 / number(radius), asphericity=number(asphericity))

    def medium(indices: list[float], gradient: tuple[float, ...] | None = None) -> Medium:
        index = file.indices.at(indices, wavelength_nm)
        return Medium(index, None if gradient is None else jnp.asarray(gradient))

    cornea, lens, indices = file.cornea, file.lens, file.indices
    thickness, front = number(cornea.thickness_mm), number(lens.depth_mm)
    depths = front + np.cumsum([0.0, *lens.thickness_mm])
    axial_length = number(file.axial_length_mm)
    in_order = [0.0, thickness, *depths, axial_length]
    if not np.all(np.diff(in_order) > 0.0):
        raise InputError(
            "the cornea's back, the lens's surfaces and the retina must follow each other in "
            f"depth; got {', '.join(f'{depth:g}' for depth in in_order[1:])} mm. Correct the "
            "thicknesses."
        )
    surfaces = [
        conic(lens.front_radius_mm, lens.front_asphericity, front),
        *(Conic(depth=depth) for depth in depths[1:-1]),
        conic(lens.back_radius_mm, lens.back_asphericity, depths[-1]),
    ]
    gradients: Any = lens.gradient or [None] * len(lens.thickness_mm)
    media = [*map(medium, indices.lens, gradients), medium(indices.vitreous)]
    return Eye(
        cornea=(
            Refracting(
                conic(cornea.front_radius_mm, cornea.front_asphericity, 0.0),
                medium(indices.cornea),
            ),
            Refracting(
                conic(cornea.back_radius_mm, cornea.back_asphericity, thickness),
                medium(indices.aqueous),
            ),
        ),
        iris_depth=jnp.asarray(front, float),
        lens=tuple(map(Refracting, surfaces, media)),
        axial_length=jnp.asarray(axial_length, float),
        retina_semi_axes=jnp.asarray([number(axis) for axis in file.retina_semi_axes_mm], float),
    )
