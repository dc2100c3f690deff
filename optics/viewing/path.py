"""Viewing paths: what lies between the microscope and the retina, as one list of elements.

Lines of sight through a path are smooth, so others take them as Chebyshev series.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int, ScalarLike

from eyespot.formats.inputs import InputError
from eyespot.optics.viewing.schematic_eye import Eye
from eyespot.optics.viewing.trace import Conic, Element, Iris, Medium, Refracting, TracedRays, trace

SERIES_TERMS = 28  # powers of the squared distance t² from the axis, up to the widest t
SCANNED_MM = 14.0 / 400 * (1.0 + np.arange(400))
"""Aims t at which a path is tried for the widest that passes."""


def radial_nodes(widest: Float[Array, ""]) -> tuple[Float[Array, "n"], Float[Array, "n n"]]:
    """Chebyshev's nodes t, and the matrix from values there to coefficients (Trefethen 2013)."""
    angles = np.pi * (np.arange(SERIES_TERMS) + 0.5) / SERIES_TERMS
    matrix = 2.0 / SERIES_TERMS * np.cos(np.outer(np.arange(SERIES_TERMS), angles))
    matrix[0] /= 2.0
    return widest * jnp.sqrt((jnp.asarray(np.cos(angles)) + 1.0) / 2.0), jnp.asarray(matrix)


def radial_place(t2: Float[Array, "*batch"], widest: Float[Array, ""]) -> Float[Array, "*batch"]:
    """Place of t² in the series, at most 1."""
    return jnp.minimum(2.0 * t2 / widest**2 - 1.0, 1.0)


def series(terms: Float[Array, "terms"], place: ScalarLike) -> Float[Array, "*batch"]:
    """A Chebyshev series at places in [-1, 1]."""
    return series_and_slope(list(terms), jnp.asarray(place, float))[0]


def series_and_slope(
    terms: list[Float[Array, "*batch"]], place: Float[Array, "*batch"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """A Chebyshev series and its derivative by Clenshaw's recurrence."""
    after, last = jnp.zeros_like(place), jnp.zeros_like(place)
    slope_after, slope_last = after, last
    for term in reversed(terms[1:]):
        slope_after, slope_last = slope_last, 2.0 * (last + place * slope_last) - slope_after
        after, last = last, term + 2.0 * place * last - after
    return terms[0] + place * last - after, last + place * slope_last - slope_after


FORMS = ("phakic", "aphakic", "pseudophakic")
"""What is behind the iris: the crystalline lens, nothing, or an artificial lens."""

DILATED_MM = 3.5
"""Radius of a dilated pupil: 7 mm across, as in surgery."""

_IMPLANT_INDEX, _IMPLANT_THICKNESS_MM = 1.55, 0.8
"""An artificial lens of hydrophobic acrylic, with faces of equal curvature (assumed), in the middle
of the crystalline lens's place (assumed). Its power is what makes the eye emmetropic."""
_START_MM = 1.0  # height of a ray's start above the first element; it is straight there


class ViewingPath(eqx.Module):
    """Everything between the microscope and the retina, centred on the microscope's axis.

    Attributes:
        elements: in the order in which lines of sight meet them.
        pinhole_closeness: 1/distance of the microscope's pinhole from the cornea's vertex, 1/mm;
            0 is telecentric.
        pole_depth: zeta of the retinal pole, mm.
        retina_semi_axes: x, y and z of the retina's ellipsoid, mm.
    """

    elements: tuple[Element, ...]
    pinhole_closeness: Float[Array, ""]
    pole_depth: Float[Array, ""]
    retina_semi_axes: Float[Array, "3"]

    @property
    def medium_index(self) -> Float[Array, ""]:
        """Refractive index of the medium in front of the retina."""
        return last_medium(self.elements)[0].index


class LinesOfSight(NamedTuple):
    """Lines of sight inside the eye, in the meridional plane.

    Attributes:
        height: distance from the axis at the depth of the pole, mm; negative across the axis.
        slope: growth of the height with the depth.
        status: as in `TracedRays`.
    """

    height: Float[Array, "*batch"]
    slope: Float[Array, "*batch"]
    transmittance: Float[Array, "*batch"]
    status: Int[Array, "*batch"]


def viewing_path(
    eye: Eye,
    viewing_lens: Element | None = None,
    *,
    form: str = "phakic",
    fill_index: ScalarLike | None = None,
    pupil_radius: ScalarLike = DILATED_MM,
    pinhole_distance: ScalarLike = 200.0,
) -> ViewingPath:
    """The path from a microscope through a viewing lens into an eye.

    Args:
        eye: at the wavelength of the light.
        viewing_lens: on or above the cornea (`load_viewing_lens`), or None.
        form: one of `FORMS`. An aphakic eye is filled with one medium from the cornea on.
        fill_index: refractive index of what fills the vitreous cavity; None for the eye's vitreous.
        pupil_radius: of the iris, mm.
        pinhole_distance: of the microscope's pinhole above the cornea's vertex, mm; may be inf.

    Raises:
        InputError: an unknown form, an index below 1, a pupil or pinhole that cannot be.
    """
    if form not in FORMS:
        raise InputError(f"viewing_path(form=...) must be one of {', '.join(FORMS)}; got {form!r}.")
    rules = (
        (fill_index, lambda value: 1.0 <= value <= 4.0, "fill_index", "lie in [1, 4]", ""),
        (pupil_radius, lambda value: value > 0.0, "pupil_radius", "be positive", " mm"),
        (pinhole_distance, lambda x: x > 0.0, "pinhole_distance", "be positive, or inf", " mm"),
    )
    for value, holds, name, rule, unit in rules:
        # Traced values have no known size.
        if value is not None and not isinstance(value, jax.core.Tracer) and not holds(value):
            raise InputError(f"viewing_path({name}=...) must {rule}; got {value}{unit}.")
    fill = eye.vitreous_index if fill_index is None else jnp.asarray(fill_index, float)
    iris = Iris(depth=eye.iris_depth, radius=jnp.asarray(pupil_radius, float))
    front, back = eye.cornea
    inside: tuple[Element, ...]
    match form:
        case "aphakic":
            inside = (Refracting(back.surface, Medium(fill)), iris)
        case "pseudophakic":
            inside = (back, iris, *_implant(eye, fill))
        case _:
            behind = Refracting(eye.lens[-1].surface, Medium(fill))
            inside = (back, iris, *eye.lens[:-1], behind)
    return ViewingPath(
        elements=(*(() if viewing_lens is None else (viewing_lens,)), front, *inside),
        pinhole_closeness=1.0 / jnp.asarray(pinhole_distance, float),
        pole_depth=eye.axial_length,
        retina_semi_axes=eye.retina_semi_axes,
    )


def lines_of_sight(path: ViewingPath, aim: Float[Array, "*batch"]) -> LinesOfSight:
    """Trace lines of sight from the microscope to the retina.

    Args:
        aim: distance from the axis at which the line, before any refraction, would cross the plane
            of the cornea's vertex, mm.
    """
    meridional = jnp.stack([aim, jnp.zeros_like(aim)], axis=-1)
    at_pole, slope, rays = skew_lines(path, meridional, path.pinhole_closeness * meridional)
    return LinesOfSight(at_pole[..., 0], slope[..., 0], rays.transmittance, rays.status)


def skew_lines(
    path: ViewingPath, aim: Float[Array, "*batch 2"], slope: Float[Array, "*batch 2"]
) -> tuple[Float[Array, "*batch 2"], Float[Array, "*batch 2"], TracedRays]:
    """Trace lines that need not meet the axis.

    Args:
        path: the viewing path; its pinhole does not matter.
        aim: where the lines, before any refraction, cross the plane of the cornea's vertex, mm.
        slope: their growth per mm of depth there.

    Returns:
        X and Y at the depth of the pole, mm, their growth per mm of depth inside the eye, and the
        rays behind the last surface.
    """
    rays = trace(path.elements, *before_path(path, aim, slope))
    slope = rays.direction[..., :2] / rays.direction[..., 2:]
    below = path.pole_depth - rays.point[..., 2:]
    return rays.point[..., :2] + below * slope, slope, rays


def before_path(
    path: ViewingPath, aim: Float[Array, "*batch 2"], slope: Float[Array, "*batch 2"]
) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
    """Points of lines above the first element, and unit directions; as `skew_lines` has them."""
    depth = (path.elements[0].depth if path.elements else 0.0) - _START_MM
    one = jnp.ones_like(aim[..., :1])
    direction = jnp.concatenate([slope, one], axis=-1)
    return (
        jnp.concatenate([aim + depth * slope, depth * one], axis=-1),
        direction / jnp.linalg.norm(direction, axis=-1, keepdims=True),
    )


def parallel_ray(elements: tuple[Element, ...]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Height and slope behind the last surface, per unit of height of a paraxial parallel ray.

    The derivative of the trace on the axis is the paraxial trace, gradients included.
    """

    def end(height: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        start = jnp.stack([height, 0.0 * height, -100.0 + 0.0 * height])
        rays = trace(elements, start, jnp.array([0.0, 0.0, 1.0]))
        slope = rays.direction[0] / rays.direction[2]
        behind = rays.point[2] - last_medium(elements)[1]
        return rays.point[0] - behind * slope, slope

    return jax.jvp(end, (jnp.zeros(()),), (jnp.ones(()),))[1]


def last_medium(elements: tuple[Element, ...]) -> tuple[Medium, Float[Array, ""]]:
    """The medium behind elements, and the depth at which it begins; air in front of all."""
    for element in reversed(elements):
        if isinstance(element, Refracting):
            return element.medium, element.depth
    return Medium(1.0), jnp.zeros(())


def check_finite(path: ViewingPath, needs: str) -> None:
    """Refuse a pinhole at infinity; `needs` names what cannot have it there."""
    closeness = path.pinhole_closeness
    if not isinstance(closeness, jax.core.Tracer) and not closeness > 0.0:
        raise InputError(
            f"{needs} needs a pinhole at a finite height; got a path with pinhole_distance inf. "
            "Give viewing_path(pinhole_distance=...) in mm."
        )


def _implant(eye: Eye, fill: ScalarLike) -> tuple[Refracting, Refracting]:
    """An artificial lens that makes the eye, filled with its vitreous, emmetropic."""
    middle = (eye.lens[0].depth + eye.lens[-1].depth) / 2
    half = _IMPLANT_THICKNESS_MM / 2

    def lens(curvature: Float[Array, ""], behind: ScalarLike) -> tuple[Refracting, Refracting]:
        front = Conic(depth=middle - half, curvature=curvature)
        back = Conic(depth=middle + half, curvature=-curvature)
        return Refracting(front, Medium(_IMPLANT_INDEX)), Refracting(back, Medium(behind))

    def defocus(curvature: Float[Array, ""], _: None) -> Float[Array, ""]:
        elements = (*eye.cornea, *lens(curvature, eye.vitreous_index))
        height, slope = parallel_ray(elements)
        return height + slope * (eye.axial_length - last_medium(elements)[1])

    newton: optx.AbstractRootFinder = optx.Newton(rtol=1e-12, atol=1e-12)
    curvature = optx.root_find(defocus, newton, jnp.asarray(0.05), throw=False).value
    return lens(curvature, fill)
