"""GlueLens: a drop of glue on the end of a fibre, its shape, its light and its presets.

Frame of the lens: the tip S, the cap's vertex, is the origin; +s runs along the axis away from the
fibre. The cap is s = -sagitta(rho), the core's face is the disc s = -glue_length.
"""

from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from eyespot.formats.inputs import InputError, check_schema, in_file, read_toml, shortened

_PRESETS = Path(__file__).parent / "lenses"
_HISTORY = {1: "the format of eyespot 0.1"}

LIGHT_CODE = tuple(
    Path(__file__).with_name(f"{name}.py")
    for name in ("irradiance", "irradiance_edges", "lens", "lens_table", "refraction")
)
"""The source files on which the light of a lens depends. What is kept of it holds for these."""

_LIMIT_MM = 10.0  # largest length of a lens; a fibre has 0.1 to 1 mm


class GlueLens(eqx.Module):
    """A spherical cap of glue on a fibre's core, lit by the core through a numerical aperture.

    Radiance on the core's face, per unit power, with p the distance from the core's centre and
    theta the angle to the axis inside the glue:

        L(p, theta) ~ exp(-2 (p / launch_radius)^2) exp(-2 (n_g sin theta / launch_aperture)^2)

    for p <= core_radius and n_g sin theta <= numerical_aperture, 0 elsewhere. Without a launch
    radius or aperture the core or the cone is filled uniformly; with them they are the 1/e^2 radii
    of a Gaussian launch. Only light that passes the cap directly counts: light that the cap
    reflects back into the glue, or that meets the drop's side, is lost.

    Attributes:
        core_radius: a_c, mm.
        glue_length: L, from the core's face to the cap's vertex, mm, at least the sag.
        aperture_radius: a, radius of the cap's rim and of the glue's cylinder, mm, at least a_c.
        sag: h, height of the cap over its rim, mm; 0 is a flat end.
        glue_index: n_g.
        numerical_aperture: NA of the light in the core.
        launch_radius: 1/e^2 radius of the radiance on the core's face, mm, or None.
        launch_aperture: 1/e^2 half-width of the radiance in n_g sin theta, or None.
    """

    core_radius: Float[Array, ""]
    glue_length: Float[Array, ""]
    aperture_radius: Float[Array, ""]
    sag: Float[Array, ""]
    glue_index: Float[Array, ""]
    numerical_aperture: Float[Array, ""]
    launch_radius: Float[Array, ""] | None
    launch_aperture: Float[Array, ""] | None

    @property
    def curvature(self) -> Float[Array, ""]:
        """Curvature of the cap, 2h/(a² + h²), 1/mm; 0 for the flat end, where R is infinite."""
        return 2.0 * self.sag / (jnp.square(self.aperture_radius) + jnp.square(self.sag))

    @property
    def face_radius(self) -> Float[Array, ""]:
        """Radius of the lit part of the core's face, mm."""
        return _lit_extent(self.core_radius, self.launch_radius)

    @property
    def sine_limit(self) -> Float[Array, ""]:
        """Largest sine of the light's angle to the axis inside the glue, NA/n_g if filled."""
        return _lit_extent(self.numerical_aperture, self.launch_aperture) / self.glue_index

    def focal_length(self, *, medium_index: ArrayLike) -> Float[Array, ""]:
        """Distance from the vertex to the paraxial focus in the medium, n0 R/(n_g - n0), mm.

        Infinite for a flat end or an index-matched medium, negative for a diverging cap.
        """
        index_step = self.glue_index - medium_index
        return jnp.asarray(medium_index) / (self.curvature * index_step)

    def sagitta(self, radius: ArrayLike) -> Float[Array, "*batch"]:
        """Depth of the cap below its vertex at a radius ρ (mm), κρ²/(1 + √(1 - κ²ρ²)), mm."""
        squared = jnp.square(radius)
        root = jnp.sqrt(1.0 - jnp.square(self.curvature) * squared)
        return self.curvature * squared / (1.0 + root)

    def radiance(
        self, *, face_radius_squared: ArrayLike, sine_squared: ArrayLike
    ) -> Float[Array, "*batch"]:
        """Radiance on the core's face per unit power that leaves it, 1/(mm² sr).

        Args:
            face_radius_squared: squared distance from the core's centre, mm².
            sine_squared: squared sine of the angle to the axis inside the glue.

        Returns:
            The profile in the class's docstring without its limits, which the caller applies.
        """
        launch_sine = (
            None if self.launch_aperture is None else self.launch_aperture / self.glue_index
        )
        decay = _decay(face_radius_squared, self.launch_radius) + _decay(sine_squared, launch_sine)
        etendue = _weight(self.face_radius, self.launch_radius) * _weight(
            self.sine_limit, launch_sine
        )
        return jnp.exp(-decay) / etendue


def _decay(squared: ArrayLike, waist: ArrayLike | None) -> Array:
    """Exponent of a Gaussian launch's decrease, 0 for a uniform one."""
    return jnp.zeros(()) if waist is None else jnp.asarray(2.0 * squared / jnp.square(waist))


def _weight(extent: Array, waist: ArrayLike | None) -> Array:
    """Integral of the launch over its disc."""
    area = jnp.pi * jnp.square(extent)
    if waist is None:
        return area
    edge = _decay(jnp.square(extent), waist)
    return area * -jnp.expm1(-edge) / edge


def _lit_extent(limit: ArrayLike, waist: ArrayLike | None) -> Float[Array, ""]:
    """The limit, or 2.6 waists of a Gaussian launch, beyond which only 1e-6 of its power lies."""
    return jnp.asarray(limit) if waist is None else jnp.minimum(limit, 2.6 * jnp.asarray(waist))


def glue_lens(
    *,
    core_radius: ArrayLike,
    glue_length: ArrayLike,
    aperture_radius: ArrayLike,
    sag: ArrayLike,
    glue_index: ArrayLike,
    numerical_aperture: ArrayLike,
    launch_radius: ArrayLike | None = None,
    launch_aperture: ArrayLike | None = None,
) -> GlueLens:
    """Make a lens and check its values, except under tracing.

    Args: the attributes of `GlueLens`.

    Raises:
        InputError: a value outside its range; the message says which, and what to change.
    """
    drop = core_radius, glue_length, aperture_radius, sag, glue_index, numerical_aperture
    launch = (
        None if x is None else jnp.asarray(x, float) for x in (launch_radius, launch_aperture)
    )
    lens = GlueLens(*(jnp.asarray(x, float) for x in drop), *launch)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(lens)):
        return lens
    known = map(float, jax.tree.leaves(lens)[: len(drop)])
    core_radius, glue_length, aperture_radius, sag, glue_index, numerical_aperture = known
    rules = (
        (
            0.0 < core_radius <= _LIMIT_MM,
            "core_radius",
            f"must lie in (0, {_LIMIT_MM:g}] mm; got {core_radius:g} mm. Give the radius of the "
            "fibre's core",
        ),
        (
            core_radius <= aperture_radius <= _LIMIT_MM,
            "aperture_radius",
            f"must be at least the core's radius and at most {_LIMIT_MM:g} mm; got "
            f"aperture_radius={aperture_radius:g} mm, core_radius={core_radius:g} mm. "
            "Raise aperture_radius or lower core_radius",
        ),
        (
            0.0 <= sag <= aperture_radius,
            "sag",
            f"must lie in [0, aperture_radius]; got sag={sag:g} mm, "
            f"aperture_radius={aperture_radius:g} mm. Lower sag or raise aperture_radius",
        ),
        (
            sag <= glue_length <= _LIMIT_MM,
            "glue_length",
            f"must be at least the sag (the core's face is below the cap's rim) and at most "
            f"{_LIMIT_MM:g} mm; got "
            f"glue_length={glue_length:g} mm, sag={sag:g} mm. Raise glue_length or lower sag",
        ),
        (
            1.0 <= glue_index <= 4.0,
            "glue_index",
            f"must lie in [1, 4]; got {glue_index:g}. Cyanoacrylate has 1.48 to 1.50",
        ),
        (
            0.0 < numerical_aperture < glue_index,
            "numerical_aperture",
            f"must lie in (0, glue_index); got numerical_aperture={numerical_aperture:g}, "
            f"glue_index={glue_index:g}. Lower numerical_aperture",
        ),
        (
            lens.launch_radius is None or 0.0 < lens.launch_radius <= _LIMIT_MM,
            "launch_radius",
            f"must lie in (0, {_LIMIT_MM:g}] mm; got {lens.launch_radius} mm. Leave it out for a "
            "uniform core",
        ),
        (
            lens.launch_aperture is None or 0.0 < lens.launch_aperture <= 4.0,
            "launch_aperture",
            f"must lie in (0, 4]; got {lens.launch_aperture}. Leave it out for a uniform cone",
        ),
    )
    for holds, name, rule in rules:
        if not holds:
            raise InputError(f"GlueLens({name}=...) {rule}.")
    return lens


def names_in(folder: Path) -> tuple[str, ...]:
    """Names of the TOML files in a folder."""
    return tuple(sorted(path.stem for path in folder.glob("*.toml")))


def read_named(folder: Path, name_or_path: str | Path, *, missing: str) -> dict[str, Any]:
    """Content of a TOML file by its name in a folder, or by its path, which ends in `.toml`.

    Raises:
        InputError: no such file; the message begins with `missing`.
    """
    path = Path(name_or_path)
    try:
        return read_toml(path if path.suffix == ".toml" else folder / f"{name_or_path}.toml")
    except FileNotFoundError as error:
        names = ", ".join(names_in(folder))
        raise InputError(f"{missing}: {names}; or give the path of a .toml file.") from error


def lens_names() -> tuple[str, ...]:
    """Names of the lenses that come with the package."""
    return names_in(_PRESETS)


def load_lens(name_or_path: str | Path) -> GlueLens:
    """Read a lens from a preset's name or from a TOML file in the presets' format.

    Args:
        name_or_path: one of `lens_names()`, or the path of a `.toml` file.

    Raises:
        InputError: no such preset or file, another schema, an unknown, missing or wrong key.

    Example:
        >>> dome = load_lens("dome")
        >>> round(float(dome.focal_length(medium_index=1.336)), 2)  # mm, in vitreous
        2.78
    """
    with in_file(f"lens {shortened(str(name_or_path))}"):
        content = read_named(_PRESETS, name_or_path, missing="no such lens. Presets")
        again = "Compare the file with the presets in optics/lenses."
        check_schema(content.get("schema"), _HISTORY, remedy=again)
        values = content.get("lens", {})
        known = [*GlueLens.__annotations__]
        required = known[:-2]
        if not isinstance(values, dict):
            raise InputError(f"[lens] must be a table; got {shortened(values)}.")
        wrong = [key for key in values if key not in known or type(values[key]) not in (int, float)]
        missing = [key for key in required if key not in values]
        if wrong or missing:
            raise InputError(
                f"[lens] must contain the numbers {', '.join(required)}; {', '.join(known[-2:])} "
                f"are optional; wrong: {_listed(wrong)}, missing: {_listed(missing)}."
            )
        return glue_lens(**values)


def _listed(names: list[str]) -> str:
    return shortened(", ".join(names))[1:-1] or "none"
