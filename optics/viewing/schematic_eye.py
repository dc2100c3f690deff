"""Eyes at one wavelength, and lenses that the surgeon puts on the cornea or holds above it.

Both are read from files, those of the package and those of a user. An eye's file has its radii,
asphericities, thicknesses and indices, with their source.
"""

import itertools
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from eyespot.formats.inputs import InputError, Strict, check_schema, in_file, shortened, validated
from eyespot.optics.lens import names_in, read_named
from eyespot.optics.viewing.trace import Conic, Element, Medium, Refracting, ThinLens

_HISTORY = {1: "the first format"}
_HERE = Path(__file__).parent

_Format = TypeVar("_Format", bound=Strict)


def read_data_file(format_: type[_Format], folder: str, name_or_path: str | Path) -> _Format:
    """Read a TOML file by the name that it has in the package, or by its path.

    Args:
        format_: of the content; `schema` and `provenance` are checked here.
        folder: of the package's own files, "eyes" or "lenses".
        name_or_path: a name in this folder, or the path of a `.toml` file.

    Raises:
        InputError: no such file, an unknown, missing or wrong key.
    """
    with in_file(f"{folder[:-1]} {shortened(str(name_or_path))}"):
        content = read_named(_HERE / folder, name_or_path, missing="no such file. Known names")
        remedy = f"Compare the file with those in optics/viewing/{folder}."
        check_schema(content.pop("schema", None), _HISTORY, remedy=remedy)
        if not isinstance(content.pop("provenance", None), str):
            raise InputError(f"`provenance`, the source of the numbers, is missing. {remedy}")
        return validated(format_, content, remedy=remedy)


_VISIBLE_NM = (400.0, 700.0)  # where a dispersion formula may be evaluated


def _pair(value: object) -> object:
    """A number alone does not depend on the refraction."""
    return (value, 0.0) if isinstance(value, int | float) else _tuple(value)


def _tuple(value: object) -> object:
    """TOML's lists as the tuples of the models."""
    return tuple(value) if isinstance(value, list) else value


_LARGEST = 1e3
"""Of any number in an eye's file: mm, mm per dioptre, or an asphericity."""
_LONGEST_EYE_MM = 60.0
"""Twice the longest eyes (axial length 36 mm)."""


def _moderate(value: tuple[float, float]) -> tuple[float, float]:
    if not max(map(abs, value)) <= _LARGEST:
        raise InputError(f"must lie within {_LARGEST:g}")
    return value


def _not_flat(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] == 0.0:
        raise InputError("a radius of curvature must not be 0 mm")
    return value


def _length(value: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 < value[0] <= _LONGEST_EYE_MM:
        raise InputError(f"a length in an eye must lie in (0, {_LONGEST_EYE_MM:g}] mm")
    return value


Number = Annotated[
    tuple[float, float],
    BeforeValidator(_pair, json_schema_input_type=float | tuple[float, float]),
    AfterValidator(_moderate),
]
"""A number, or [at 0 D, change per dioptre of refraction]."""

Radius = Annotated[Number, AfterValidator(_not_flat)]
Length = Annotated[Number, AfterValidator(_length)]
Pair = Annotated[tuple[float, float], BeforeValidator(_tuple)]
Terms = Annotated[tuple[float, float, float], BeforeValidator(_tuple)]
Index = Annotated[float, Field(ge=1.0, le=4.0)]
Layers = Annotated[list[Annotated[float, Field(gt=0.0, le=_LONGEST_EYE_MM)]], Field(min_length=1)]
Wavelength = Annotated[float, Field(ge=100.0, le=2000.0)]


class CorneaFile(Strict):
    """The cornea's two surfaces."""

    front_radius_mm: Radius = Field(description="Radius of curvature of the front surface.")
    front_asphericity: Number = Field(description="Q of the front surface; 0 is a sphere.")
    thickness_mm: Length = Field(description="On the axis.")
    back_radius_mm: Radius = Field(description="Radius of curvature of the back surface.")
    back_asphericity: Number = Field(description="Q of the back surface.")


class LensFile(Strict):
    """The crystalline lens; layers of a gradient lens meet in planes."""

    depth_mm: Length = Field(description="Of the front vertex below the cornea's.")
    front_radius_mm: Radius = Field(description="Radius of curvature of the front surface.")
    front_asphericity: Number = Field(description="Q of the front surface; 0 is a sphere.")
    thickness_mm: Layers = Field(description="Of each layer, on the axis.")
    back_radius_mm: Radius = Field(description="Radius of curvature of the back surface.")
    back_asphericity: Number = Field(description="Q of the back surface.")
    gradient: list[Terms] | None = Field(
        None, description="Per layer the change of the index with z, z² and r²."
    )


class IndicesFile(Strict):
    """Indices at wavelengths, or at one wavelength with a dispersion common to all media."""

    wavelength_nm: list[Wavelength] = Field(
        min_length=1, description="Where the indices are known; they are interpolated."
    )
    dispersion: Pair = Field((0.0, 0.0), description="Change of all indices per µm and µm².")
    cornea: list[Index] = Field(description="Index at each wavelength.")
    aqueous: list[Index] = Field(description="Index at each wavelength.")
    lens: list[list[Index]] = Field(description="Of each layer the index at each wavelength.")
    vitreous: list[Index] = Field(description="Index at each wavelength.")

    @model_validator(mode="after")
    def _one_index_for_each_of_rising_wavelengths(self) -> Self:
        if any(b <= a for a, b in itertools.pairwise(self.wavelength_nm)):
            raise InputError("wavelength_nm must increase from one wavelength to the next")
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

    refractions_d: Pair = Field(
        (0.0, 0.0), description="Least and largest refraction that the eye may have, D."
    )
    axial_length_mm: Length = Field(description="From the cornea's vertex to the retina.")
    retina_semi_axes_mm: Annotated[tuple[Length, Length, Length], BeforeValidator(_tuple)] = Field(
        description="Across (x, y) and along the axis (z)."
    )
    cornea: CorneaFile = Field(description="Two conic surfaces.")
    lens: LensFile = Field(description="The crystalline lens.")
    indices: IndicesFile = Field(description="Refractive indices.")

    @model_validator(mode="after")
    def _one_entry_a_layer(self) -> Self:
        gradients = self.lens.gradient or self.lens.thickness_mm
        if not len(self.lens.thickness_mm) == len(gradients) == len(self.indices.lens):
            raise InputError(
                "lens.thickness_mm, lens.gradient and indices.lens need one entry for each layer"
            )
        return self


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
    return names_in(_HERE / "eyes")


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
    cornea_front = conic(cornea.front_radius_mm, cornea.front_asphericity, 0.0)
    cornea_back = conic(cornea.back_radius_mm, cornea.back_asphericity, thickness)
    gradients: Any = lens.gradient or [None] * len(lens.thickness_mm)
    media = [*map(medium, indices.lens, gradients), medium(indices.vitreous)]
    return Eye(
        cornea=(
            Refracting(cornea_front, medium(indices.cornea)),
            Refracting(cornea_back, medium(indices.aqueous)),
        ),
        iris_depth=jnp.asarray(front, float),
        lens=tuple(map(Refracting, surfaces, media)),
        axial_length=jnp.asarray(axial_length, float),
        retina_semi_axes=jnp.asarray([number(axis) for axis in file.retina_semi_axes_mm], float),
    )


class _ContactLensFile(Strict):
    kind: Literal["contact"]
    front_curvature_per_mm: float = Field(ge=-0.5, le=0.5)
    thickness_mm: float = Field(gt=0.0, le=50.0)
    index: float = Field(ge=1.0, le=4.0)


class _WideFieldFile(Strict):
    kind: Literal["wide-field"]
    power_d: float = Field(ge=20.0, le=300.0)


class _ViewingLensFile(Strict):
    lens: _ContactLensFile | _WideFieldFile = Field(discriminator="kind")


def load_viewing_lens(name_or_path: str | Path) -> Element:
    """Read a viewing lens from its name or from a TOML file in the same format.

    Args:
        name_or_path: name of a lens that comes with the package, or the path of a `.toml` file.

    Returns:
        The front of a contact lens with its material, whose back fits the cornea's front without a
        gap; or an ideal thin lens, which is held one focal length above the cornea and inverts the
        image.

    Raises:
        InputError: no such lens, or an unknown, missing or wrong key.
    """
    file = read_data_file(_ViewingLensFile, "lenses", name_or_path).lens
    if isinstance(file, _WideFieldFile):
        power = file.power_d / 1000.0
        return ThinLens(depth=jnp.asarray(-1.0 / power), power=jnp.asarray(power))
    front = Conic(depth=-file.thickness_mm, curvature=file.front_curvature_per_mm)
    return Refracting(front, Medium(file.index))
