"""Images of spots on the retinas of many eyes, through viewing paths and through pinholes."""

from collections.abc import Callable, Collection
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from eyespot import optics
from eyespot.calibration.least_squares import GAUSS_NEWTON, least_squares
from eyespot.calibration.spots.cone_trials import (
    NUISANCES,
    RETINA,
    SIZE_PER_MM,
    TrialGroup,
    misfit,
    whitening_of,
)
from eyespot.formats.inputs import read_toml
from eyespot.optics.irradiance import in_batches
from eyespot.optics.viewing.path import viewing_path
from eyespot.optics.viewing.projection import PathCamera, path_camera
from eyespot.optics.viewing.schematic_eye import Eye, load_viewing_lens
from eyespot.optics.viewing.trace import Conic, Element, Medium, Refracting

SCALE_MM_PX = 0.0067
NOMINAL_RADIUS_MM = 12.0  # Models assume it where no eye is calibrated.

CONE = {"half_angle": float(np.arctan(1 / 20.0)), "apex_offset": -5.117}
PINHOLE_ABOVE_MM = 200.0
_CONTOUR_POINTS = 48  # The ellipse of so many is within 1e-6 px of that of 128.
PATHS: dict[str, tuple[str, str]] = {
    "flat, phakic": ("flat", "phakic"),
    "flat, pseudophakic": ("flat", "pseudophakic"),
    "flat, aphakic": ("flat", "aphakic"),
    "wide-field 90 D, phakic": ("wide-field-90", "phakic"),
    "wide-field 130 D, phakic": ("wide-field-130", "phakic"),
}
"""Viewing lens and form of each path."""


class Spots(NamedTuple):
    """Spots on a retina: c and d, mm, and the beam's tilt, rad, as in `optics.beam_at_spot`."""

    eccentricity: Float[Array, "*batch"]
    distance: Float[Array, "*batch"]
    incidence: Float[Array, "*batch"]
    incidence_azimuth: Float[Array, "*batch"]


class Seen(NamedTuple):
    """The images of spots: ellipses (px, rad) and the beams' unit vectors.

    `visible`: the whole contour is inside the pupil and the field.
    """

    ellipse: optics.Ellipse
    axis: Float[Array, "*batch 3"]
    visible: Bool[Array, "*batch"]


class Pinhole(NamedTuple):
    """A pinhole over a sphere, which stands for a path and its retina.

    delta, mm/px at the pole; kappa = 1/(z_F + r), 1/mm, negative behind the retina; and r, mm.
    """

    scale: Float[Array, "*batch"]
    kappa: Float[Array, "*batch"]
    radius: Float[Array, "*batch"]

    @property
    def wall(self) -> optics.Sphere:
        """The sphere."""
        return optics.Sphere(self.radius)

    @property
    def microscope(self) -> optics.Microscope:
        """The pinhole."""
        return optics.Microscope(
            scale=self.scale,
            inverse_working_distance=self.kappa,
            pole_height=-self.radius,
            principal_point=jnp.zeros(2),
            distortion=jnp.zeros(5),
        )


def grid(
    eccentricities: np.ndarray, distances: np.ndarray, tilts_deg: tuple[tuple[float, float], ...]
) -> Spots:
    """All combinations; tilts are pairs of incidence and its azimuth, degrees. n x m x k each."""
    c, d, tilt = np.meshgrid(eccentricities, distances, np.arange(len(tilts_deg)), indexing="ij")
    incidence, azimuth = np.radians(np.asarray(tilts_deg, float)).T
    return Spots(*map(jnp.asarray, (c, d, incidence[tilt], azimuth[tilt])))


def cameras(path: str, eyes: Eye, pupil_radius: Float[Array, ""]) -> PathCamera:
    """The cameras of one path into many eyes, with a leading axis."""
    lens, form = PATHS[path]
    return _cameras(load_viewing_lens(lens), form, eyes, pupil_radius)


@eqx.filter_jit
def _cameras(
    viewing_lens: Element, form: str, eyes: Eye, pupil_radius: Float[Array, ""]
) -> PathCamera:
    # Lenses of one structure differ in numbers only, and are compiled once.
    def camera(eye: Eye) -> PathCamera:
        found = viewing_path(
            eye,
            viewing_lens,
            form=form,
            pupil_radius=pupil_radius,
            pinhole_distance=PINHOLE_ABOVE_MM - viewing_lens.depth,
        )
        # A robot's axes belong to an upright image, so a wide-field lens needs its inverter.
        return path_camera(found, scale=SCALE_MM_PX, upright=True)

    return jax.vmap(camera)(eyes)


@eqx.filter_jit
def spots_through(camera: PathCamera, semi_axes: Float[Array, "3"], spots: Spots) -> Seen:
    """Spots in a row, on one eye's own retina, seen through its path."""
    retina = optics.Ellipsoid(semi_axes)

    def one(spot: Spots) -> Seen:
        return image(camera, retina, spot, sees=camera.sees)

    return jax.vmap(one)(spots)


def image(
    camera: optics.Camera,
    wall: optics.Surface,
    spot: Spots,
    *,
    sees: Callable[[Float[Array, "n 3"]], Bool[Array, "n"]] = lambda _: jnp.ones((), bool),
) -> Seen:
    """One spot on a wall; `sees` says which points of the wall are not hidden."""
    beam = optics.beam_at_spot(wall, **spot._asdict(), **CONE)
    contour = optics.cone_contour(beam, wall, points=_CONTOUR_POINTS).point
    ellipse = optics.ellipse_of_contour(camera.project(contour))
    return Seen(ellipse, beam.axis, jnp.all(sees(contour)))


# Eyes of a healthy adult population, drawn from published means and covariances.

_FILE = Path(__file__).with_name("eye_population.toml")


PARTS: dict[str, tuple[str, ...]] = {
    "cornea": ("cornea_",),
    "lens": ("lens_",),
    "axial length": ("axial_",),
    "shape of the retina": ("retina_",),
}
"""The parts in which eyes differ, by the prefix of their parameters."""


def drawn(count: int, seed: int) -> "Drawn":
    """Random eyes (Rozema et al. 2016; `eye_population.toml` says how they were reduced)."""
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
    """The parameters of random eyes (eyes x parameters), and what is the same in all of them."""

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
    every = of | constant

    def surface(name: str, depth: Any, index_behind: str) -> Refracting:
        curvature, asphericity = 1.0 / every[f"{name}_radius"], every[f"{name}_asphericity"]
        conic = Conic(depth=depth, curvature=curvature, asphericity=asphericity)
        return Refracting(conic, Medium(every[index_behind]))

    behind = of["lens_depth"] + of["lens_thickness"]
    return Eye(
        cornea=(
            surface("cornea_front", 0.0, "cornea_index"),
            surface("cornea_back", of["cornea_thickness"], "aqueous_index"),
        ),
        iris_depth=of["lens_depth"],
        lens=(
            surface("lens_front", of["lens_depth"], "lens_index"),
            surface("lens_back", behind, "vitreous_index"),
        ),
        axial_length=of["axial_length"],
        retina_semi_axes=jnp.stack([of["retina_x"], of["retina_y"], of["retina_z"]]),
    )


# Recipes: what a person calibrates at the table, and how a distance is then computed.

_SIGMA_PX = 0.1
"""Standard deviation of a measured semi-axis; the sub-pixel mode's RMS on textured walls is 0.05 to
0.1 px (`eyespot validate`)."""
_TOUCH_MM = 0.05
"""Standard deviation of the distance at which a withdrawal starts: the operator's touch."""
_SPOTS_AT_ONCE = 1024

WITHDRAWALS_C_MM = (0.5, 1.5, 3.0)
_TILT_DEG, _TOWARDS_DEG = 25.0, 90.0
"""Of the withdrawals' beams: sideways. Eyes with a gradient lens bend the spots of beams that lean
towards the axis or away from it as no pinhole does."""


class Recipe(StrEnum):
    """Ways to a distance, from what has to be known least to most; the page says how they work."""

    PLANAR = "planar"
    SMALL_PLANE = "small_plane"
    STEREOGRAPHIC = "stereographic"
    FITTED = "corrected, fitted pinhole"
    EXACT_SCHEMATIC = "exact, schematic eye"
    AREA_SCHEMATIC = "area, schematic pinhole"
    AREA = "area, fitted pinhole"


def withdrawals() -> Spots:
    """The spots of the calibration: three withdrawals through a trocar, nine frames each."""
    c, distance = np.meshgrid(WITHDRAWALS_C_MM, np.linspace(1.0, 5.0, 9), indexing="ij")
    tilt, towards = (np.full(c.shape, np.radians(a)) for a in (_TILT_DEG, _TOWARDS_DEG))
    return Spots(*map(jnp.asarray, (c, distance, tilt, towards)))


@eqx.filter_jit
def fitted_pinhole(seen: Seen, noise: Float[Array, "trials frames 5"]) -> Pinhole:
    """Fit a pinhole over a sphere to the ellipses of three withdrawals in one eye.

    As `eyespot fit --model eye`, with the same residuals and the same priors of the retina's radius
    and of the spots' sizes: the place on the retina is known only from the image. Where each
    withdrawal starts is known to 0.05 mm, the beams' axes and the cone exactly. Hidden contours do
    not count.

    Args:
        seen: images of `withdrawals()`.
        noise: of the ellipses' parameters, in standard deviations of the sub-pixel mode.
    """
    distance, count = withdrawals().distance[0], len(WITHDRAWALS_C_MM)
    measured = jnp.concatenate([seen.ellipse.centre, jnp.stack(seen.ellipse[1:], axis=-1)], axis=-1)
    # A hidden contour may have no values, and its weight is 0.
    measured = jnp.where(seen.visible[..., None], measured, jnp.array([0.0, 0.0, 1.0, 1.0, 0.0]))
    _, _, major, minor, _ = jnp.moveaxis(measured, -1, 0)
    # Noise turns an outline that is nearly round by much.
    sigma = jnp.full(measured.shape, _SIGMA_PX)
    sigma = sigma.at[..., 4].divide(jnp.maximum(major - minor, _SIGMA_PX))
    x, y, *others = jnp.moveaxis(measured + sigma * noise, -1, 0)
    ellipses = optics.Ellipse(jnp.stack([x, y], axis=-1), *others)
    covariances = sigma[..., None] ** 2 * jnp.eye(5)
    nothing = jnp.zeros(count)
    whitening = jax.vmap(whitening_of)(ellipses, covariances, nothing)
    every = TrialGroup(
        ellipses=ellipses,
        whitening=jnp.where(seen.visible[..., None, None], whitening, 0.0),
        readings=jnp.broadcast_to(distance - distance[0], minor.shape),
        motions=seen.axis[:, 0],
        axes=seen.axis[:, 0],
        principal_points=jnp.zeros((count, 2)),
        touch_means=jnp.full(count, distance[0]),
        touch_sigmas=jnp.full(count, _TOUCH_MM),
        lean_sigmas=nothing,
        boresight_sigmas=nothing,
        size_sigmas=SIZE_PER_MM * jnp.array(WITHDRAWALS_C_MM),
        kind="eyeball",
    )

    def pinhole(unknown: Float[Array, "3"]) -> Pinhole:
        scale = SCALE_MM_PX * jnp.exp(unknown[0])
        return Pinhole(scale, unknown[1], RETINA.mean + RETINA.sigma * unknown[2])

    def residuals(unknown: Float[Array, "x"]) -> Array:
        eye, own = unknown[:3], unknown[3:].reshape(count, len(_FREE))
        found = pinhole(eye)
        values = _NO_TILT | {
            "half_angle": CONE["half_angle"],
            "b": CONE["apex_offset"],
            "eye_radius": found.radius,
        }
        # The robot's axis is known, so only these nuisances are free.
        nuisances = jnp.zeros((count, len(NUISANCES))).at[:, _FREE].set(own)
        missed = misfit(every, found.microscope, values, nuisances)
        # Without a visible frame the place would have no value.
        return jnp.concatenate([missed, jnp.ravel(own[:, 1:3]) / _ANYWHERE_PX, eye[2:]])

    start = jnp.zeros(3 + count * len(_FREE))
    solution = least_squares(residuals, start, count=5 * minor.size, solver=GAUSS_NEWTON)
    return pinhole(solution.parameters[:3])


_ANYWHERE_PX = 1e4
_FREE = np.array([NUISANCES.index(name) for name in ("touch", "u", "v", "size")])
_NO_TILT = {"tilt_x": 0.0, "tilt_y": 0.0}


def distance_by_area(seen: Seen, pinhole: Pinhole) -> Float[np.ndarray, "n"]:
    """Distances at which exact spots have the measured centres and areas, mm.

    Each spot is seen by its own pinhole over its own sphere; the robot knows the beams' axes.
    """
    return in_batches(lambda of: _through_pinholes(*of), (seen, pinhole), size=_SPOTS_AT_ONCE)


def distance_through_path(
    seen: Seen, camera: PathCamera, semi_axes: Float[ArrayLike, "3"]
) -> Float[np.ndarray, "n"]:
    """As `distance_by_area`, with all spots seen through one path onto one retina, mm."""
    retina = optics.Ellipsoid(jnp.asarray(semi_axes))
    return in_batches(lambda spots: _through_path(spots, retina, camera), seen, size=_SPOTS_AT_ONCE)


def _by_area(seen: Seen, wall: optics.Surface, camera: optics.Camera) -> Float[Array, ""]:
    return optics.distance_by_area(seen.ellipse, wall, camera, axis=seen.axis, **CONE)


_through_pinholes = eqx.filter_jit(
    jax.vmap(lambda seen, pinhole: _by_area(seen, pinhole.wall, pinhole.microscope))
)
_through_path = eqx.filter_jit(jax.vmap(_by_area, in_axes=(0, None, None)))


def distance_by_closed_form(
    model: str, semi_minor: np.ndarray, spots: Spots, pinhole: Pinhole
) -> np.ndarray:
    """Distance by one of `optics.CLOSED_FORMS` for one pinhole, or for one an eye, mm."""
    known: Any = jax.tree.map(np.asarray, pinhole)
    found = optics.closed_form_distance(
        model,
        semi_minor_px=semi_minor,
        scale=known.scale,
        k=1.0 / np.tan(CONE["half_angle"]),
        b=CONE["apex_offset"],
        eccentricity=np.asarray(spots.eccentricity),
        eye_radius=known.radius,
        inverse_working_distance=known.kappa,
    )
    return np.asarray(found)
