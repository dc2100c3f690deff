"""`eyespot study design`: which drop of glue, and how little light?

DIR/best.toml      the drop with the smallest error, a lens file
    drops.csv      every drop that was computed, with its error
    sigma.csv      standard deviation of d for the best drop and others, by distance
    dose.csv       the same by dose
    tolerance.csv  the same for drops that are not made exactly
    measured.csv   errors of the best drop and its neighbours in frames of stacks/ (full run)
"""

import itertools
import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float
from matplotlib.axes import Axes
from threadpoolctl import threadpool_limits

from eyespot import optics, scenes
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.paper import withdrawal
from eyespot.benchmarks.statistics import rms
from eyespot.benchmarks.study import Study
from eyespot.benchmarks.study_command import command
from eyespot.estimator import Frame, Reader
from eyespot.formats.inputs import InputError
from eyespot.formats.stack import Stack
from eyespot.optics.wall_light.lens_flux import lens_parameters, lens_toml
from eyespot.optics.wall_light.unknown_wall import distance_sigmas, lit_radii
from eyespot.scenes import Scene
from eyespot.scenes.walls.picture import write_random_wall
from eyespot.scenes.world.unknown_wall_bound import SpotLight, UnknownWallScene

# The question: which drop, within which limits, at which distances.

LIMITS = {
    "sag": (0.0, 0.2),
    "rim_height": (0.0, 1.0),
    "core_radius": (0.05, 0.25),
    "numerical_aperture": (0.05, 0.3),
}
"""What is sought, and how far, mm: sag of the cap; height of its rim over the core's face (both
together are the glue's length); radius of the fibre's core; numerical aperture of its light."""
RANGE_MM = 0.5, 6.0
SMALLEST_RADIUS_PX = 18.0  # Smaller spots have lower bounds, but no lower errors.
PRICE_OF_NO_SPOT = 20.0  # Smaller spots gain less than it costs.
Goal = Literal["worst", "mean"]
POWER_MEAN_EXPONENTS = {"worst": 16.0, "mean": 1.0}


def limits_in(text: str) -> dict[str, tuple[float, float]]:
    """Limits of a search: "sag=0:0.1 core_radius=0.25" narrows one and fixes another."""
    limits = dict(LIMITS)
    for word in text.split():
        name, _, bounds = word.partition("=")
        try:
            low, high = (float(bound) for bound in (bounds.split(":") * 2)[:2])
            if not LIMITS[name][0] <= low <= high <= LIMITS[name][1]:
                raise ValueError
        except (KeyError, ValueError):
            known = ", ".join(f"{n}={a:g}:{b:g}" for n, (a, b) in LIMITS.items())
            rule = f"--limits has NAME=LOW:HIGH or NAME=VALUE, within {known}"
            raise InputError(f"{rule}; got {word!r}.") from None
        limits[name] = low, high
    return limits


# The method: the bound of one frame, made small along its gradient; then rendered frames.


@jax.jit
@partial(jax.value_and_grad, has_aux=True)
def score(
    change: Float[Array, "q"], light: SpotLight, power: float, rest: Mapping[str, Any]
) -> tuple[Float[Array, ""], Float[Array, "2 n"]]:
    """Log of the bounds' power mean, with a price for small spots; beside, bounds and radii."""
    sigmas = jnp.minimum(distance_sigmas(light.spots, change, ambient=light.ambient, **rest), 1e3)
    radii = lit_radii(light.spots, change)
    mean = logsumexp(power * jnp.log(sigmas), b=1 / len(sigmas)) / power
    price = PRICE_OF_NO_SPOT * jnp.sum(jax.nn.relu(1 - radii / SMALLEST_RADIUS_PX))
    return mean + price, jnp.stack([sigmas, radii])


class DropSearch:
    """Computes drops at one dose, mJ/mm² a frame, by default `coarse`, and keeps them in `rows`."""

    def __init__(
        self, scene: Scene, *, count: int, goal: Goal, dose: float | None, coarse: bool = False
    ) -> None:
        self.wall, self.goal, self.coarse = UnknownWallScene(scene), goal, coarse
        self.dose = dose or scene.exposures.metered_peak * self.wall.full_dose
        self.fixed = lens_parameters(optics.load_lens(scene.source.lens))  # what no drop changes
        self.distances = np.geomspace(*RANGE_MM, count).tolist()
        self.rows: list[dict[str, Any]] = []

    def light(self, drop: Mapping[str, float], **how: Any) -> SpotLight:
        """Of a drop, as of `UnknownWallScene.of_lens`."""
        how = {"coarse": self.coarse} | how
        return self.wall.of_lens(self.fixed | dict(drop), self.distances, **how)

    def score(self, light: SpotLight, **drop: Any) -> tuple[float, np.ndarray]:
        """Of a light, and its gradient; the drop is kept in `rows`."""
        rest, change = {"dose": self.dose, **self.wall.sensor}, np.zeros(light.ambient.size - 1)
        (value, each), slope = score(change, light, POWER_MEAN_EXPONENTS[self.goal], rest)
        sigmas, radii = np.asarray(each)
        reached = np.max(sigmas) if self.goal == "worst" else np.mean(sigmas)
        found = {"score": float(value), "sigma_mm": reached, "smallest_px": radii.min()}
        self.rows.append(drop | found)
        return found["score"], np.nan_to_num(slope)

    def descend(self, start: np.ndarray, limits: np.ndarray, *, steps: int) -> None:
        """Go from a drop, numbers of `LIMITS`, down the gradient within limits, 2 x 4."""
        span = np.ptp(limits, axis=0) + 1e-9
        adam = optax.adam(0.06)  # the noise of a table stops others
        place = (start - limits[0]) / span
        state = adam.init(place)
        for _ in range(steps):
            drop = dict(zip(LIMITS, (limits[0] + span * place).tolist(), strict=True))
            light = self.light(drop, free=tuple(LIMITS))
            change, state = adam.update(span * self.score(light, **drop, way="gradient")[1], state)
            place = np.clip(place + np.asarray(change), 1e-3, 1 - 1e-3)


def measured(study: Study, lenses: Mapping[str, Path], peak: float) -> pd.DataFrame:
    """Render each lens over walls that nobody knows; read each frame by itself."""
    trials = {}
    for wall in range(8):
        picture = (study.folder / f"wall-{wall}.png").absolute()
        write_random_wall(picture, seed=study.seed + wall, width_mm=12.0)
        # As many frames of the best drop as of its neighbours together.
        for lens, path in itertools.islice(lenses.items(), 1 if wall % 2 else None):
            changes = {
                "seed": study.seed + wall,
                "source.kind": "lens",
                "source.lens": str(path),
                "phantom.wall": "image",
                "phantom.wall_image": str(picture),
                "phantom.wall_image_mm": 12.0,
                "phantom.reflectance": 0.9,
                "instrument.visible": False,
                **withdrawal(start_mm=RANGE_MM[0], travel_mm=float(np.ptp(RANGE_MM)), frames=6),
                "exposures.metered_peak": peak,
            }
            trials[f"{lens}-{wall}"] = scenes.changed(study.scene, changes)

    readers: dict[tuple[str, str], Reader] = {}

    def read(name: str, stack: Stack) -> pd.DataFrame:
        lens, wall = name.rsplit("-", 1)
        rig, distances = UnknownWallScene(trials[name]), [label.d_mm for label in stack.labels]
        light = rig.of_lens(lens_parameters(optics.load_lens(lenses[lens])), distances)
        rows = []
        for mode in ("pixels", "subpixel"):
            sigmas = rig.sigmas(light, peak * rig.full_dose, outline=mode == "subpixel").tolist()
            if (lens, mode) not in readers:
                readers[lens, mode] = study.reader(stack, trials[name], mode)
            for label, sigma in zip(stack.labels, sigmas, strict=True):
                readers[lens, mode].forget()
                reading = readers[lens, mode].read(
                    Frame(index=label.frame, image=stack.image(label))
                )
                error, stated = reading.distance_mm - label.d_mm, reading.sigma_distance_mm
                rows.append((lens, mode, wall, label.d_mm, sigma, stated, error, reading.doubt))
        columns = "lens mode wall d_mm sigma_mm stated_mm error_mm doubt".split()
        return pd.DataFrame(rows, columns=columns)

    return pd.concat(study.measured(trials, read).values(), ignore_index=True)


# The tables.

LIGHTS = {
    "light": page.Column("light"),
    "worst_mm": page.Column("worst σ, µm", 1, 1e3),
    "outline_mm": page.Column("worst by outline, µm", 1, 1e3),
    "for_50_um_mj_mm2": page.Column("dose for 50 µm, µJ/mm²", 3, 1e3),
    "for_20_um_mj_mm2": page.Column("dose for 20 µm, µJ/mm²", 3, 1e3),
    "irradiance_mw_mm2": page.Column("irradiance, mW/mm²", 1),
    "photons": page.Column("10¹² photons a frame", 1, 1e-12),
}
CAPTION = "Irradiance: at the nearest distance. Photons: 550 nm, farthest. Nothing about safety."
RELATIVE_DOSES = np.logspace(-5, 0, 11)  # Drops are sought at a dose of 1.
PHOTONS_PER_MJ = 550e-9 / (6.62607015e-34 * 299792458.0) / 1e3  # at 550 nm
OFF_BY = (-0.2, -0.05, 0.05, 0.2)


def tables_of(search: DropSearch, best: Mapping[str, float]) -> dict[str, pd.DataFrame]:
    """What the best drop and others reach: by distance, by dose, and if not made exactly."""
    wall, free = search.wall, {"free": tuple(LIMITS)}  # compiled for the search
    reached = np.max if search.goal == "worst" else np.mean
    lights = {"best drop": search.light(best, **free)}
    for name in ("dome", "paper-candidate"):
        lights[name] = search.light(lens_parameters(optics.load_lens(name)), **free)
    lights["sharp cone"] = wall.of_cone(search.distances)
    sigma, dose, summary, tolerance = [], [], [], []
    for name, light in lights.items():
        mine, outline = (wall.sigmas(light, search.dose, outline=how) for how in (False, True))
        own = {"d_mm": search.distances, "sigma_mm": mine, "outline_mm": outline}
        sigma.append(pd.DataFrame({"light": name, **own}))
        doses = search.dose * RELATIVE_DOSES
        scores = np.array([reached(wall.sigmas(light, x)) for x in doses.tolist()])
        dose.append(pd.DataFrame({"light": name, "dose_mj_mm2": doses, "sigma_mm": scores}))
        wanted, reach = np.log([0.05, 0.02]), np.log(scores[::-1])
        least = np.exp(np.interp(wanted, reach, np.log(doses[::-1]), left=np.nan))
        brightest = wall.brightest(light)
        photons = search.dose / brightest[-1] * wall.scene.source.power_mw * PHOTONS_PER_MJ
        summary.append((name, mine.max(), outline.max(), *least, brightest[0], photons))
    for name in ("sag", "numerical_aperture"):
        made = [search.light({**best, name: best[name] * (1 + x)}, **free) for x in OFF_BY]
        off = [reached(wall.sigmas(light, search.dose)) for light in made]
        tolerance.append((name.replace("_", " "), *off))
    return {
        "sigma": pd.concat(sigma),
        "dose": pd.concat(dose),
        "lights": pd.DataFrame(summary, columns=list(LIGHTS)),
        "tolerance": pd.DataFrame(tolerance, columns=["number", *map(str, OFF_BY)]),
    }


# The page.


def _report(
    tables: Mapping[str, pd.DataFrame], drop: Mapping[str, float], dose: float
) -> page.Report:
    best = tables["lights"].iloc[0]
    numbers = ", ".join(f"{name.replace('_', ' ')} {x:.3f}" for name, x in drop.items())
    shown = {  # table, abscissa and its label, ordinate
        "all light": ("sigma", "d_mm", "d (mm)", "sigma_mm"),
        "outline": ("sigma", "d_mm", "d (mm)", "outline_mm"),
        "less light": ("dose", "dose_mj_mm2", "dose (mJ/mm² a frame)", "sigma_mm"),
    }

    def draw(axes: Axes, _: str, column: str) -> None:
        table, x, _, y = shown[column]
        for light, mine in tables[table].groupby("light", sort=False):
            axes.plot(mine[x], 1e3 * mine[y], label=light)
        axes.set(yscale="log", xscale="log" if table == "dose" else "linear")

    x, y = (lambda column: shown[column][2]), "standard deviation of d (µm)"
    figure = page.small_multiples(draw, columns=list(shown), x=x, y=y)
    scores = tables["drops"].groupby("way").score
    gain = math.exp(scores.min()["gradient"] - scores.min()["best random"])
    optimum = page.Claim(
        name="optimum",
        sentence=f"The optimum's σ is {gain:.2f} of that of the best of "
        f"{scores.size()['random']} random drops.",
        value=gain,
        high=1.0,
    )
    claims, blind = [optimum], tables.get("measured", pd.DataFrame({"lens": [], "mode": []}))
    for (lens, mode), rows in blind.groupby(["lens", "mode"], sort=False):
        found = rows[rows.doubt == ""]
        ratio = rms(found.error_mm / found.sigma_mm)
        claim = page.Claim(
            name=f"{lens}, {mode}".replace("_", " "),
            sentence=f"In {len(found)} of {len(rows)} frames read blind, d is off by "
            f"{ratio:.2f} times its bound (RMS), {1e3 * rms(found.error_mm):.1f} µm.",
            value=ratio,
            low=0.8 if mode == "pixels" else 0.0,
            high=1.2 if mode == "pixels" else math.inf,
        )
        claims.append(claim)
    made = {str(x): page.Column(f"{100 * x:+g} %: σ, µm".replace("-", "−"), 1, 1e3) for x in OFF_BY}
    made, otherwise = {"number": page.Column("number")} | made, "One number of it, made otherwise."
    tolerance = page.Table(tables["tolerance"], made, otherwise, data="tolerance.csv")
    return page.Report(
        title="Which drop of glue measures the distance best, and how little light does it need?",
        answer=f"The best drop measures every distance to {1e3 * best.worst_mm:.1f} µm (standard "
        f"deviation) in one frame of an unknown wall with {1e3 * dose:.1f} µJ/mm² on the retina, "
        f"and to 50 µm with {1e3 * best.for_50_um_mj_mm2:.3f} µJ/mm².",
        lead=f"The drop: {numbers} (lengths in mm). The bound of one frame was made small along "
        "its gradient.",
        first=[
            page.Picture(
                "sigma", figure, "All light, outline alone, less light.", data="sigma.csv"
            ),
            page.Table(tables["lights"], LIGHTS, CAPTION, data="lights.csv"),
        ],
        claims=claims,
        sections=[page.Section("How exactly must the drop be made?", tolerance)],
        data={f"{name}.csv": table for name, table in tables.items()},
    )


# The command.


@threadpool_limits.wrap(limits=1, user_api="blas")  # for matrices this small, two take longer
@command(
    defaults=("source.medium=vitreous", "microscope.height_px=600"),
    check_options=lambda limits, **others: limits_in(limits),
)
def design(
    study: Study, *, goal: Goal = "worst", dose: float | None = None, limits: str = ""
) -> pd.DataFrame:
    """Seek the drop of glue that measures distances best, and how little light it needs.

    To continue a run that was stopped, start it again with the same folder.

    Args:
        goal: Make the worst or the mean standard deviation over the distances small.
        dose: Radiant exposure of the brightest place, mJ/mm² a frame (default: as metered).
        limits: Limits of the drop, such as "sag=0:0.1 core_radius=0.25".
    """
    asked, quick = np.array([*limits_in(limits).values()]).T, study.quick
    count, random, starts, steps = (4, 12, 1, 5) if quick else (6, 500, 2, 25)
    search = DropSearch(study.scene, count=count, goal=goal, dose=dose, coarse=quick)
    free = tuple(LIMITS) if quick else ()  # a quick run compiles the derivatives only
    with study.timed("search"):
        rng = np.random.default_rng(study.seed)
        for numbers in rng.uniform(asked[0], asked[1], (random, len(LIMITS))).tolist():
            drop = dict(zip(LIMITS, numbers, strict=True))
            search.score(search.light(drop, free=free, coarse=True), **drop, way="random")
        drawn = pd.DataFrame(search.rows)[[*LIMITS, "score"]]
        for start in drawn.nsmallest(starts, "score")[list(LIMITS)].to_numpy():
            search.descend(start, asked, steps=steps)
        for numbers in drawn.nsmallest(3, "score")[list(LIMITS)].to_numpy().tolist():  # finer
            drop = dict(zip(LIMITS, numbers, strict=True))
            search.score(search.light(drop, free=free), **drop, way="best random")
    drops = pd.DataFrame(search.rows)
    found = drops[drops.way == "gradient"].nsmallest(1, "score")[list(LIMITS)].to_numpy(float)
    best = dict(zip(LIMITS, found[0].tolist(), strict=True))
    others = () if quick else ("sag", "numerical_aperture")
    made = {"best": best} | {f"more {name}": {**best, name: 1.2 * best[name]} for name in others}
    lenses = {name: (study.folder / f"{name}.toml").absolute() for name in made}
    for name, path in lenses.items():
        path.write_text(lens_toml(search.fixed | made[name], provenance=study.command))
    with study.timed("tables"):
        tables = tables_of(search, best) | {"drops": drops}
    if not quick:
        with study.timed("render and read"):
            tables["measured"] = measured(study, lenses, search.dose / search.wall.full_dose)
    study.publish(_report, tables, best, search.dose)
    return tables["lights"]
