"""`eyespot study eye`: distances through cornea, crystalline lens and viewing lens."""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot import optics
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.model_error import ECCENTRICITY
from eyespot.benchmarks.reporting import grouped, listed, number, where
from eyespot.benchmarks.statistics import coalitions, first_reached, shapley_values
from eyespot.benchmarks.studies import eye_paths
from eyespot.benchmarks.studies.eye_paths import PATHS, Drawn, Pinhole, Recipe, Seen, Spots
from eyespot.benchmarks.study import Study
from eyespot.benchmarks.study_command import command
from eyespot.optics.irradiance import in_batches
from eyespot.optics.viewing import DILATED_MM, Eye, PathCamera, load_eye

# Errors of every recipe in many eyes behind one viewing path.

_OPEN_PUPIL_MM = 50.0  # It hides nothing.
_EYES_AT_ONCE = 8  # So few that their spots stay in the cache.
CLOSED_FORMS = {
    Recipe.PLANAR: "planar",
    Recipe.SMALL_PLANE: "small_plane",
    Recipe.STEREOGRAPHIC: "stereographic",
    Recipe.FITTED: "corrected",
}


def path_errors(
    path: str,
    eyes: Sequence[Eye],
    spots: Spots,
    *,
    seed: int | None,
    recipes: Sequence[Recipe] = tuple(Recipe),
) -> tuple[dict[Recipe, np.ndarray], np.ndarray]:
    """Look at spots in every eye, calibrate each, and compute distances by every recipe.

    Args:
        eyes: groups of eyes of one structure with a leading axis, to be joined. The first eye is
            the schematic one, which stands for all others where no calibration is made, and is
            calibrated without noise.
        seed: of the noise of the calibrations; None for none.

    Returns:
        Errors by recipe, mm, eyes x c x d x tilts, as if the iris hid nothing, NaN where the optics
        show no whole contour; and kappa fitted in each eye, 1/mm.
    """
    axes = jnp.concatenate([group.retina_semi_axes for group in eyes])
    every = _path_cameras(path, eyes, pupil_radius=_OPEN_PUPIL_MM)
    batches = every, axes, _noise(seed, len(axes))
    seen, fitted = in_batches(lambda eyes: _calibrated(eyes, spots), batches, size=_EYES_AT_ONCE)
    known, schematic = (jax.tree.map(lambda leaf: leaf[0], of) for of in (every, fitted))
    own = jax.tree.map(lambda leaf: leaf[:, None, None, None], fitted)
    unknown = Pinhole(*map(jnp.asarray, (eye_paths.SCALE_MM_PX, 0.0, eye_paths.NOMINAL_RADIUS_MM)))
    shape, minor = seen.visible.shape, seen.ellipse.semi_minor
    in_a_row = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[len(shape) :]), seen)

    def read(recipe: Recipe) -> np.ndarray:
        if recipe is Recipe.EXACT_SCHEMATIC:
            return eye_paths.distance_through_path(in_a_row, known, axes[0])
        if model := CLOSED_FORMS.get(recipe):
            pinhole = own if recipe is Recipe.FITTED else unknown
            return eye_paths.distance_by_closed_form(model, minor, spots, pinhole)
        pinhole = own if recipe is Recipe.AREA else schematic
        each = jax.tree.map(lambda leaf: np.broadcast_to(leaf, shape).ravel(), pinhole)
        return eye_paths.distance_by_area(in_a_row, each)

    def error(recipe: Recipe) -> np.ndarray:
        found = read(recipe).reshape(shape) - np.asarray(spots.distance)
        return np.where(seen.visible, found, np.nan)

    return {recipe: error(recipe) for recipe in recipes}, fitted.kappa


def fields(path: str, eyes: Sequence[Eye]) -> np.ndarray:
    """Largest c that each eye's dilated pupil shows, mm; arguments as for `path_errors`."""
    axes = jnp.concatenate([group.retina_semi_axes for group in eyes])
    every = _path_cameras(path, eyes, pupil_radius=DILATED_MM)
    return in_batches(lambda eyes: _fields(*eyes), (every, axes), size=_EYES_AT_ONCE)


_fields = eqx.filter_jit(
    jax.vmap(lambda camera, semi_axes: camera.field(optics.Ellipsoid(semi_axes)))
)


@eqx.filter_jit
def _calibrated(
    eyes: tuple[PathCamera, Float[Array, "n 3"], Float[Array, "n trials frames 5"]], spots: Spots
) -> tuple[Seen, Pinhole]:
    """Images of the spots in every eye, n x c x d x tilts, and the pinhole fitted there."""
    flat, calibration = jax.tree.map(jnp.ravel, spots), eye_paths.withdrawals()
    both = slice(flat.distance.size), slice(flat.distance.size, None)
    # All spots in one batch: XLA compiles the formula once.
    together = jax.tree.map(lambda a, b: jnp.concatenate([a, jnp.ravel(b)]), flat, calibration)

    def shaped(seen: Seen, like: Spots) -> Seen:
        shape = like.distance.shape
        return jax.tree.map(lambda leaf: leaf.reshape(shape + leaf.shape[1:]), seen)

    def in_one(camera: PathCamera, semi_axes: Array, noise: Array) -> tuple[Seen, Pinhole]:
        images = eye_paths.spots_through(camera, semi_axes, together)
        first, last = (jax.tree.map(lambda leaf, at=at: leaf[at], images) for at in both)
        return shaped(first, spots), eye_paths.fitted_pinhole(shaped(last, calibration), noise)

    return jax.vmap(in_one)(*eyes)


def _path_cameras(path: str, eyes: Sequence[Eye], *, pupil_radius: float) -> PathCamera:
    of_batch = partial(eye_paths.cameras, path, pupil_radius=jnp.asarray(pupil_radius))
    groups = [in_batches(of_batch, group, size=_EYES_AT_ONCE) for group in eyes]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *groups)


def _noise(seed: int | None, count: int) -> Float[np.ndarray, "n trials frames 5"]:
    """Noise of each eye's withdrawals; 0 without a seed, and for the schematic eye."""
    noise = np.zeros((count, *eye_paths.withdrawals().distance.shape, 5))
    if seed is not None:
        for eye, own in enumerate(noise[1:], 1):
            own[:] = np.random.default_rng([seed, eye]).standard_normal(own.shape)
    return noise


LIMITS_MM = (0.1, 0.5)
REFRACTIONS_D = (-10.0, -6.0, -3.0, 0.0, 4.0)
"""Of the schematic eyes that depend on it (Atchison 2006)."""

SERVED_SHARE = 0.95  # A recipe must serve so many of the eyes.
_NM = 555.0
_ECCENTRICITIES_MM = np.arange(0.0, 8.1, 1.0)
_INDEX_OF_3_MM = 3
_DISTANCES_MM = np.array([0.5, 2.0, 4.0, 6.0])
_TILTS_DEG = ((0.0, 0.0), (30.0, 0.0), (30.0, 90.0), (30.0, 180.0))
_TILTS = {"square": slice(1), "any": slice(None)}
_QUANTILES = {"median": "median_mm", "within": "p95_mm"}
_QUICK_DISTANCES_MM = np.array([1.0, 3.0, 5.0])
_EYES, _QUICK_EYES = 1000, 47
_CAUSES_EYES, _QUICK_CAUSES_EYES = 95, 31
_CAUSES_PATH = "flat, phakic"
_SHOWN_MM = (2.0, 3.0, 4.0)


def _stacked(eyes: list[Eye]) -> Eye:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *eyes)


def _causes(
    path: str, eyes_drawn: Drawn, schematic: Eye, spots: Spots, *, seed: int
) -> pd.DataFrame:
    """Shares of the parts of the eye, and of the noise, in the 95 % error of the area recipes.

    In a coalition of parts the eyes differ in these parts only; the other parts are the mean of the
    population. What remains with no part is the error in the mean eye. `schematic` has a leading
    axis; `spots` are c x d x tilts.
    """
    players = (*eye_paths.PARTS, "noise of the calibration")
    recipes = {
        Recipe.AREA_SCHEMATIC: "the mean eye is not Navarro's",
        Recipe.AREA: "a pinhole for the mean eye",
    }
    shown = np.isin(np.asarray(spots.eccentricity)[:, 0, 0], _SHOWN_MM)
    worth = np.zeros((len(recipes), len(_SHOWN_MM), 2 ** len(players)))
    for row, members in enumerate(coalitions(len(players))):
        parts = [part for part, inside in zip(eye_paths.PARTS, members, strict=False) if inside]
        eyes, noise = [schematic, eyes_drawn.eyes(parts)], seed if members[-1] else None
        found, _ = path_errors(path, eyes, spots, seed=noise, recipes=tuple(recipes))
        for k, recipe in enumerate(recipes):
            largest = np.abs(found[recipe][1:]).max(axis=(2, 3))
            worth[k, :, row] = np.quantile(largest[:, shown], SERVED_SHARE, axis=0)
    shares, rows = shapley_values(worth), []
    for (k, (recipe, rest)), (j, c) in product(enumerate(recipes.items()), enumerate(_SHOWN_MM)):
        causes = (rest, worth[k, j, 0]), *zip(players, shares[k, j], strict=True)
        rows += [(recipe, c, cause, float(value)) for cause, value in causes]
    return pd.DataFrame(rows, columns=["recipe", "c_mm", "cause", "share_mm"])


# The tables.


def tables_of(
    paths: Mapping[str, tuple[Mapping[Recipe, np.ndarray], np.ndarray]],
    fields: Mapping[str, np.ndarray],
    names: Sequence[str],
    population: int,
) -> dict[str, pd.DataFrame]:
    """The tables of the page and of the CSV files.

    - `eye_errors`: median and 95 % of the largest |error| over the random eyes, if 95 % of them
      show whole spots at that c; `tilt` is "square" for perpendicular beams only, "any" with tilts
      of 30 degrees, too.
    - `limits`: c up to which half or 95 % of the eyes stay within each limit, interpolated.
    - `eyes`: what every eye shows behind every path; the errors are the largest at c = 3 mm over
      distances and tilts, with the ellipse's area.
    - `pinholes`: pinholes and fields (the largest c that a dilated pupil shows, mm) of each path,
      over the random eyes, a `population` between Navarro's and other schematic ones; and the
      median error of small_plane at c = 3 mm and the worst distance, with a perpendicular beam.
    """
    random, errors, eyes, pinholes = slice(1, 1 + population), [], [], []
    for path, (found, kappas) in paths.items():
        for recipe, tilt in product(Recipe, _TILTS):
            # A spot that is not whole at any distance or tilt counts as not seen.
            worst = np.abs(found[recipe][random, ..., _TILTS[tilt]]).max(axis=(2, 3))
            by_c = pd.DataFrame(worst, columns=_ECCENTRICITIES_MM)
            # A quantile of the few eyes that show the spot would not be the eyes'.
            enough = by_c.count() > SERVED_SHARE * population
            of_c = {
                "eyes": by_c.count(),
                "median_mm": by_c.median().where(enough),
                "p95_mm": by_c.quantile(SERVED_SHARE).where(enough),
            }
            about = {"path": path, "recipe": recipe, "tilt": tilt, "c_mm": _ECCENTRICITIES_MM}
            errors.append(pd.DataFrame(about | of_c))
        each = {"kappa_per_mm": kappas, "field_mm": fields[path]}
        for name, recipe in (("fitted", Recipe.AREA), ("schematic", Recipe.AREA_SCHEMATIC)):
            at_three = np.abs(found[recipe][:, _INDEX_OF_3_MM])
            each[f"{name}_error_mm"] = at_three.max(axis=(1, 2))
        eyes.append(pd.DataFrame({"path": path, "eye": names, **each}))
        low, middle, high = np.quantile(fields[path][random], [0.05, 0.5, 0.95])
        small = np.nanmedian(found[Recipe.SMALL_PLANE][random, _INDEX_OF_3_MM, :, 0], axis=0)
        pinholes.append(
            {
                "path": path,
                "schematic": kappas[0],
                "mean": kappas[random].mean(),
                "deviation": kappas[random].std(),
                "field_low": low,
                "field": middle,
                "field_high": high,
                "small_plane_mm": max(small.tolist(), key=abs),
            }
        )
    every, limits = pd.concat(errors, ignore_index=True), []
    for (path, recipe, tilt), curve in grouped(every, "path", "recipe", "tilt"):
        limits.append({"path": path, "recipe": recipe, "tilt": tilt})
        for (part, column), limit in product(_QUANTILES.items(), LIMITS_MM):
            name = f"{part}_{limit:g}_mm".replace(".", "_")
            limits[-1][name] = crossing(curve.c_mm.to_numpy(), curve[column].to_numpy(), limit)
    return {
        "eye_errors": every,
        "limits": pd.DataFrame(limits),
        "eyes": pd.concat(eyes, ignore_index=True),
        "pinholes": pd.DataFrame(pinholes),
    }


def crossing(c: np.ndarray, error: np.ndarray, limit: float) -> float:
    """Last c before the error first exceeds a limit, linear; NaN if it does at once."""
    beyond = np.flatnonzero(~(error <= limit))
    first = int(beyond[0]) if beyond.size else len(c)
    if first == 0:
        return math.nan
    if first == len(c) or np.isnan(error[first]):
        return float(c[first - 1])
    return first_reached(c, error, limit)


Tables = Mapping[str, pd.DataFrame]
"""Of `tables_of`, and `causes`: shares of the parts of the eye behind `_CAUSES_PATH`."""

# Figures.

_STYLES = {
    Recipe.PLANAR: (page.VERMILION, ":"),
    Recipe.SMALL_PLANE: (page.VERMILION, "-"),
    Recipe.STEREOGRAPHIC: (page.VERMILION, "--"),
    Recipe.FITTED: (page.SKY, "-"),
    Recipe.EXACT_SCHEMATIC: (page.GREEN, "--"),
    Recipe.AREA_SCHEMATIC: (page.GREEN, "-"),
    Recipe.AREA: (page.BLUE, "-"),
}
"""Colour and line; recipes that know the same have one colour."""
_SHOWN_ERRORS_MM = 0.002, 8.0


def error_figure(tables: Tables, paths: Sequence[str]) -> Figure:
    """95 % of the eyes' largest errors against c: a row for each path, a column for the tilts."""
    curves = tables["eye_errors"].set_index(["path", "recipe", "tilt"]).p95_mm
    pinholes = tables["pinholes"].set_index("path")[["field_low", "field", "field_high"]]

    def draw(axes: Axes, path: str, tilt: str) -> None:
        low, middle, high = map(float, pinholes.loc[path])
        axes.axvspan(low, high, color="#EEEEEE", zorder=0)
        axes.axvline(middle, color=page.GREY, lw=0.8, label="largest c that a 7 mm pupil shows")
        for limit in LIMITS_MM:
            axes.axhline(limit, color=page.BLACK, lw=0.8, ls="--")
        for recipe, (colour, line) in _STYLES.items():
            curve = curves.loc[path, recipe, tilt]
            style: dict[str, Any] = {"color": colour, "ls": line, "label": recipe}
            axes.plot(_ECCENTRICITIES_MM, curve, marker="o", ms=3, **style)
        axes.set(yscale="log", xlim=(-0.2, _ECCENTRICITIES_MM[-1] + 0.2), ylim=_SHOWN_ERRORS_MM)

    return page.small_multiples(
        draw,
        rows=paths,
        columns=["square", "any"],
        title=lambda path, tilt: f"{path}; {'square' if tilt == 'square' else 'tilted up to 30°'}",
        x=ECCENTRICITY,
        y="95 % of eyes, |error| (mm)",
        height=2.5,
        sharex=True,
        sharey=True,
    )


# The page.


def _report(tables: Tables, population: int) -> page.Report:
    names = tables["pinholes"].path.tolist()
    first = where(tables["limits"], path=names[0], tilt="any")
    reached = first.set_index("recipe").within_0_5_mm
    return page.Report(
        title="How wrong is the distance when the microscope looks through the eye's own optics?",
        answer=f"Through {names[0]}, 95 % of the eyes stay within 0.5 mm up to c = "
        f"{number(reached[Recipe.AREA], 1)} mm with a pinhole fitted in the eye and the ellipse's "
        f"area, and up to c = {number(reached[Recipe.SMALL_PLANE], 1)} mm with the paper's model.",
        lead=f"Exact spots of a cone (k 20, b −5.117 mm) in {population} random eyes of a "
        "healthy adult population (Rozema et al. 2016) and in schematic eyes, seen by a microscope "
        "through a viewing lens, the cornea and the crystalline or an artificial lens. Each recipe "
        "says what has to be known of the eye. Errors are the largest over the distances and, "
        "where tilted, over tilts of 30° in three directions; the beam's direction is known.",
        first=[
            page.Picture(
                "error",
                error_figure(tables, names[:1] + names[3:4]),
                "Fitting one pinhole in the eye and using the spot's area keeps the error small. "
                "Largest error of 95 % of the eyes. Left: perpendicular beams; right: tilted, "
                "too. Grey: the largest c that a pupil of 7 mm shows (5 to 95 % of the eyes); "
                "spots beyond it are computed as if the iris were open. Dashed: 0.1 and "
                "0.5 mm. A line ends where fewer than 95 % of the eyes show a whole spot.",
                data="eye_errors.csv",
            ),
            page.Table(
                first[::-1],
                {
                    "recipe": page.Column("recipe"),
                    "within_0_1_mm": page.Column("within 0.1 mm", 1),
                    "within_0_5_mm": page.Column("within 0.5 mm", 1),
                },
                f"c in mm up to which 95 % of the eyes stay within 0.1 and 0.5 mm, through "
                f"{names[0]}, tilted beams included.",
                data="limits.csv",
            ),
        ],
        claims=list(_claims(tables)),
        sections=[
            page.Section("Recipes", _RECIPES),
            page.Section(
                "The pinhole that stands for an eye",
                page.Table(
                    tables["pinholes"],
                    tables["pinholes"].columns,
                    "Reciprocal working distance κ = 1/(z_F + r) fitted in Navarro's eye and in "
                    "each random eye, the largest c that a dilated pupil of 7 mm shows, and the "
                    "median error of small_plane at c = 3 mm, at the worst distance. Negative κ: "
                    "the pinhole lies behind the retina.",
                    data="eyes.csv",
                ),
            ),
            page.Section(
                "Why",
                page.Table(
                    tables["causes"],
                    tables["causes"].columns,
                    f"Shapley's shares in the error of 95 % of the eyes, {_CAUSES_PATH}, "
                    "tilted beams included. The first row of each block is the error in the mean "
                    "eye without noise, which the shares add to.",
                    data="causes.csv",
                ),
            ),
        ],
        data={f"{name}.csv": table for name, table in tables.items() if name != "pinholes"},
    )


_RECIPES = (
    f"“{Recipe.SMALL_PLANE}” is the paper's; like “{Recipe.PLANAR}” and “{Recipe.STEREOGRAPHIC}” "
    f"it knows nothing of the eye but a sphere of {eye_paths.NOMINAL_RADIUS_MM:g} mm. "
    f"“{Recipe.FITTED}” and “{Recipe.AREA}” fit δ, κ and the radius of a sphere in the eye itself, "
    f"from three withdrawals at c = {listed(eye_paths.WITHDRAWALS_C_MM, 'g')} mm with nine frames "
    "each, like `eyespot fit --model eye`: the robot's axis known, 25° from the retina's normal "
    "and sideways; 0.1 px of noise on the centre and each semi-axis and 0.05 mm on each touch. "
    f"“{Recipe.EXACT_SCHEMATIC}” traces the spot through Navarro's eye onto its retina. "
    f"“{Recipe.AREA_SCHEMATIC}” uses the pinhole and the sphere that this fit finds in Navarro's "
    "eye. The recipes with “area” or “exact” look for the exact spot that has the ellipse's centre "
    "and area. The others use the semi-minor axis, know c and assume a perpendicular beam."
)


def _claims(tables: Tables) -> Iterator[page.Claim]:
    tilted = where(tables["limits"], tilt="any").set_index(["path", "recipe"])
    within = tilted.within_0_1_mm.fillna(0.0)  # exceeded at c = 0: it is kept up to 0
    for path, field in tables["pinholes"][["path", "field"]].itertuples(index=False):
        area, schematic, small = (
            within[path, recipe]
            for recipe in (Recipe.AREA, Recipe.AREA_SCHEMATIC, Recipe.SMALL_PLANE)
        )
        yield page.Claim(
            name=f"within {LIMITS_MM[0]:g} mm, {path}",
            sentence=f"Through {path}, 95 % of the eyes stay within {LIMITS_MM[0]:g} mm up to c = "
            f"{area:.1f} mm with a pinhole fitted in the eye and the ellipse's area, up to "
            f"{schematic:.1f} mm with the pinhole of Navarro's eye, and up to {small:.1f} mm with "
            f"small_plane. A pupil of 7 mm shows c = {field:.1f} mm (median).",
            value=area,
            low=small,
        )
    eyes = tables["eyes"]
    others = eyes[~eyes.eye.str.startswith("random") & (eyes.eye != "navarro")]
    for path, gradient in grouped(others, "path"):
        own, navarros = gradient.fitted_error_mm.max(), gradient.schematic_error_mm.max()
        yield page.Claim(
            name=f"other schematic eyes, {path}",
            sentence=f"Through {path}, at c = 3 mm, the schematic eyes with a gradient lens (Liou "
            f"and Brennan, Atchison from {min(REFRACTIONS_D):g} to {max(REFRACTIONS_D):g} D) are "
            f"off by up to {own:.3f} mm with their own pinhole and the area, and by up to "
            f"{navarros:.2f} mm with Navarro's pinhole.",
            value=own,
        )


# The command.


@command(with_scene=False)
def eye(study: Study) -> Tables:
    """Look through contact and wide-field lenses into many eyes: the error of each model.

    Exact contours only; nothing is rendered. To repeat a run, start it again with a new folder.
    """
    quick = study.quick
    random = eye_paths.drawn(_QUICK_EYES if quick else _EYES, study.seed)
    distances = _QUICK_DISTANCES_MM if quick else _DISTANCES_MM
    spots = eye_paths.grid(_ECCENTRICITIES_MM, distances, _TILTS_DEG)
    navarro = _stacked([load_eye("navarro", wavelength_nm=_NM)])
    groups, count = [navarro, random.eyes()], len(random.values)
    names = ["navarro", *(f"random {k}" for k in range(count))]
    if not quick:
        gradient = [load_eye("liou-brennan", wavelength_nm=_NM)]
        gradient += [load_eye("atchison", wavelength_nm=_NM, refraction_d=d) for d in REFRACTIONS_D]
        groups.append(_stacked(gradient))
        names += ["liou-brennan", *(f"atchison {d:+g} D" for d in REFRACTIONS_D)]
    with study.timed("errors in all eyes"):
        paths = {path: path_errors(path, groups, spots, seed=study.seed) for path in PATHS}
    with study.timed("fields"):
        seen = {path: fields(path, groups) for path in PATHS}
    some = random._replace(values=random.values[: _QUICK_CAUSES_EYES if quick else _CAUSES_EYES])
    with study.timed("causes"):
        shares = _causes(_CAUSES_PATH, some, navarro, spots, seed=study.seed)
    tables = tables_of(paths, seen, names, count) | {"causes": shares}
    study.publish(_report, tables, count)
    return tables
