"""`eyespot study design`: which drop of glue, and how little light?

DIR/best.toml      the drop with the smallest error, a lens file
    drops.csv      every drop that was computed, with its error
    sigma.csv      standard deviation of d for the best drop and others, by distance
    dose.csv       the same by dose
    tolerance.csv  the same for drops that are not made exactly
    measured.csv   errors of the best drop and its neighbours in rendered frames (stacks/)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd
from jaxtyping import Array, Float
from matplotlib.axes import Axes

import optics
import scenes
from benchmarks.paper import rms
from benchmarks.reporting import Claim, Column, Picture, Report, Table, small_multiples
from benchmarks.study import Changes, OutputFolder, Quick, Seed, StartingScene, Study
from estimator import Reader
from formats.inputs import InputError
from formats.stack import Stack
from formats.whole_files import written_whole
from optics.wall_light.lens import lens_parameters, lens_toml
from optics.wall_light.unknown_wall import distance_sigmas
from scenes import Scene
from scenes.walls.picture import write_random_wall
from scenes.world.unknown_wall import SpotLight, UnknownWall

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
Goal = Literal["worst", "mean"]


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
            raise InputError(
                f"--limits has NAME=LOW:HIGH or NAME=VALUE, within {known}; got {word!r}."
            ) from None
        limits[name] = low, high
    return limits


# The method: the bound of one frame, made small along its gradient; then rendered frames.


@partial(jax.jit, static_argnames="goal")
@jax.value_and_grad
def score(
    change: Float[Array, "q"], light: SpotLight, *, goal: Goal, **rest: Any
) -> Float[Array, ""]:
    """The worst or mean bound of d over the distances, mm, and its gradient by the drop."""
    sigmas = distance_sigmas(light.spots, change, ambient=light.ambient, **rest)
    return jnp.max(sigmas) if goal == "worst" else jnp.mean(sigmas)


class Search:
    """Scores drops at one dose, mJ/mm² a frame; `fixed` is what no drop changes."""

    def __init__(self, scene: Scene, *, count: int, goal: Goal, dose: float | None) -> None:
        self.wall, self.goal = UnknownWall(scene), goal
        self.summary: Callable[[np.ndarray], float] = np.max if goal == "worst" else np.mean
        self.dose = dose or scene.exposures.metered_peak * self.wall.full_dose
        self.fixed = lens_parameters(optics.load_lens(scene.source.lens))
        self.distances = np.geomspace(*RANGE_MM, count).tolist()

    def light(self, drop: Mapping[str, float], **how: Any) -> SpotLight:
        """Of a drop, as of `UnknownWall.of_lens`."""
        return self.wall.of_lens(self.fixed | dict(drop), self.distances, **how)

    def score(self, light: SpotLight) -> tuple[float, np.ndarray]:
        """Of a light, and its gradient."""
        rest = {"goal": self.goal, "dose": self.dose, **self.wall.sensor}
        value, slope = score(np.zeros(light.ambient.size - 1), light, **rest)
        return float(value), np.asarray(slope)

    def ways(self, places: np.ndarray, limits: np.ndarray, *, steps: int) -> pd.DataFrame:
        """Drops on the ways from some places to a smaller error, by Adam on its logarithm.

        Numbers are logistic functions, which keep the limits (2 x 4). Places, n x 4, are relative
        to them; a way of one step is the place itself.
        """
        (low, high), adam, rows = limits, optax.adam(0.6), []
        free = tuple(LIMITS) if steps > 1 else ()
        for place in places:
            at = np.log(place / (1 - place))
            state = adam.init(at)
            for step in range(steps):
                share = 1 / (1 + np.exp(-at))
                drop = dict(zip(LIMITS, (low + (high - low) * share).tolist(), strict=True))
                value, slope = self.score(self.light(drop, free=free, coarse=True))
                rows.append({**drop, "sigma_mm": value})
                if step + 1 == steps or not np.isfinite([value, *slope]).all():
                    break
                by_place = slope / value * (high - low) * share * (1 - share)
                change, state = adam.update(by_place, state)
                at = at + np.asarray(change)
        return pd.DataFrame(rows)


def measured(study: Study, lenses: Mapping[str, Path], peak: float) -> pd.DataFrame:
    """Render each lens over walls that nobody knows; read each frame by itself."""
    modes, trials = ("pixels",) if study.quick else ("pixels", "subpixel"), {}
    for wall in range(2 if study.quick else 8):
        picture = (study.folder / f"wall-{wall}.png").absolute()
        write_random_wall(picture, seed=study.seed + wall, width_mm=12.0)
        for lens, path in lenses.items():
            changes = {
                "seed": study.seed + wall,
                "source.kind": "lens",
                "source.lens": str(path),
                "phantom.wall": "image",
                "phantom.wall_image": str(picture),
                "phantom.wall_image_mm": 12.0,
                "phantom.reflectance": 0.9,
                "instrument.visible": False,
                "motion.kind": "withdrawal",
                "motion.start_mm": RANGE_MM[0],
                "motion.travel_mm": RANGE_MM[1] - RANGE_MM[0],
                "motion.frames": 6,
                "exposures.kinds": ["metered"],
                "exposures.metered_peak": peak,
            }
            trials[f"{lens}-{wall}"] = scenes.changed(study.scene, changes)

    readers: dict[tuple[str, str], Reader] = {}

    def read(name: str, stack: Stack) -> pd.DataFrame:
        lens, wall = name.rsplit("-", 1)
        rig, distances = UnknownWall(trials[name]), [label.d_mm for label in stack.labels]
        light = rig.of_lens(lens_parameters(optics.load_lens(lenses[lens])), distances)
        rows = []
        for mode in modes:
            sigmas = rig.sigmas(light, peak * rig.full_dose, outline=mode == "subpixel").tolist()
            if (lens, mode) not in readers:
                readers[lens, mode] = study.reader(stack, trials[name], mode)
            for label, sigma in zip(stack.labels, sigmas, strict=True):
                readers[lens, mode].forget()
                reading = readers[lens, mode].read(stack.image(label))
                error, doubt = reading.distance_mm - label.d_mm, reading.doubt
                rows.append((lens, mode, int(wall), label.d_mm, sigma, error, doubt))
        return pd.DataFrame(rows, columns="lens mode wall d_mm sigma_mm error_mm doubt".split())

    return pd.concat(study.measured(trials, read).values(), ignore_index=True)


# The tables.

LIGHTS = {
    "light": Column("light"),
    "worst_mm": Column("worst σ, µm", 1, 1e3),
    "outline_mm": Column("worst by outline, µm", 1, 1e3),
    "for_50_um_mj_mm2": Column("dose for 50 µm, µJ/mm²", 3, 1e3),
    "for_20_um_mj_mm2": Column("dose for 20 µm, µJ/mm²", 3, 1e3),
    "irradiance_mw_mm2": Column("irradiance, mW/mm²", 1),
    "photons": Column("10¹² photons a frame", 1, 1e-12),
}
DOSES = np.logspace(-5, 0, 31)  # over the one at which drops are sought
PHOTONS_PER_MJ = 550e-9 / (6.62607015e-34 * 299792458.0) / 1e3  # at 550 nm


def tables_of(search: Search, best: Mapping[str, float]) -> dict[str, pd.DataFrame]:
    """What the best drop and others reach: by distance, by dose, and if not made exactly."""
    lights = {"best drop": search.light(best)}
    for name in ("dome", "paper-candidate"):
        lights[name] = search.light(lens_parameters(optics.load_lens(name)))
    lights["sharp cone"] = search.wall.of_cone(search.distances)
    sigma, dose, summary, tolerance = [], [], [], []
    for name, light in lights.items():
        mine = search.wall.sigmas(light, search.dose)
        outline = search.wall.sigmas(light, search.dose, outline=True)
        by_distance = {"d_mm": search.distances, "sigma_mm": mine, "outline_mm": outline}
        sigma.append(pd.DataFrame({"light": name, **by_distance}))
        doses = search.dose * DOSES
        scores = np.array([search.summary(search.wall.sigmas(light, x)) for x in doses.tolist()])
        dose.append(pd.DataFrame({"light": name, "dose_mj_mm2": doses, "sigma_mm": scores}))
        enough = [doses[scores <= wanted] for wanted in (0.05, 0.02)]
        least = [some.min() if some.size else np.nan for some in enough]
        brightest = search.wall.brightest(light)
        photons = search.dose / brightest[-1] * search.wall.scene.source.power_mw * PHOTONS_PER_MJ
        summary.append((name, mine.max(), outline.max(), *least, brightest[0], photons))
    for changed in ("sag", "numerical_aperture"):
        for off_by in (-0.2, -0.05, 0.05, 0.2):
            value, _ = search.score(search.light({**best, changed: best[changed] * (1 + off_by)}))
            tolerance.append((changed.replace("_", " "), off_by, value))
    return {
        "sigma": pd.concat(sigma),
        "dose": pd.concat(dose),
        "lights": pd.DataFrame(summary, columns=list(LIGHTS)),
        "tolerance": pd.DataFrame(tolerance, columns=["number", "off_by", "sigma_mm"]),
    }


# The page.


def _report(tables: Mapping[str, pd.DataFrame], dose: float) -> Report:
    best = tables["lights"].iloc[0]

    shown = {  # table, abscissa and its label, ordinate
        "all light": ("sigma", "d_mm", "d (mm)", "sigma_mm"),
        "outline": ("sigma", "d_mm", "d (mm)", "outline_mm"),
        "less light": ("dose", "dose_mj_mm2", "dose (mJ/mm² a frame)", "sigma_mm"),
    }

    def draw(axes: Axes, _: str, column: str) -> None:
        table, x, _, y = shown[column]
        for light, mine in tables[table].groupby("light", sort=False):
            axes.loglog(mine[x], 1e3 * mine[y], label=light)

    figure = small_multiples(
        draw,
        rows=[""],
        columns=list(shown),
        x=lambda column: shown[column][2],
        y="standard deviation of d (µm)",
    )
    return Report(
        title="Which drop of glue measures the distance best, and how little light does it need?",
        answer=f"The best drop measures every distance to {1e3 * best.worst_mm:.1f} µm (standard "
        f"deviation) in one frame of an unknown wall, and to 50 µm with "
        f"{1e3 * best.for_50_um_mj_mm2:.3f} instead of {1e3 * dose:.1f} µJ/mm² on the retina.",
        lead="The bound of one frame is made small along its gradient; rendered frames prove it.",
        first=[
            Picture("sigma", figure, "The best drop against others.", data="sigma.csv"),
            Table.of(
                tables["lights"],
                LIGHTS,
                "Irradiance: of the brightest place at the nearest distance. Photons: of 550 nm, "
                "from the core, for a frame at the farthest. This says nothing about safety.",
                data="lights.csv",
            ),
        ],
        claims=list(_claims(tables)),
        sections=[],
        data={f"{name}.csv": table for name, table in tables.items()},
    )


def _claims(tables: Mapping[str, pd.DataFrame]) -> Iterator[Claim]:
    drops = tables["drops"].groupby("way").sigma_mm
    yield Claim(
        name="optimum",
        sentence="The optimum's score is {value:.2f} of that of the best of {count} random drops.",
        value=drops.min()["gradient"] / drops.min()["random"],
        high=1.0,
        numbers={"count": int(drops.size()["random"])},
    )
    for number, off_by, sigma in tables["tolerance"].itertuples(index=False, name=None):
        made = "Made so and calibrated: {value:.4f} mm."
        yield Claim(name=f"{number}, {100 * off_by:+g} %", sentence=made, value=sigma)
    for (lens, mode), rows in tables["measured"].dropna().groupby(["lens", "mode"], sort=False):
        yield Claim(
            name=f"{lens}, {mode}",
            sentence="Read blind in {frames} rendered frames, d is off by {value:.2f} times its "
            "bound (RMS), which is {error:.4f} mm.",
            value=rms(rows.error_mm / rows.sigma_mm),
            low=0.8 if mode == "pixels" else 0.0,
            high=1.2 if mode == "pixels" else math.inf,
            numbers={"frames": len(rows), "error": rms(rows.error_mm)},
        )


# The command.


def design(
    scene: StartingScene = None,
    /,
    *,
    out: OutputFolder,
    goal: Goal = "worst",
    dose: float | None = None,
    limits: str = "",
    changes: Changes = (),
    quick: Quick = False,
    seed: Seed = None,
) -> pd.DataFrame:
    """Seek the drop of glue that measures distances best, and how little light it needs.

    To continue a run that was stopped, start it again with the same folder.

    Args:
        goal: Make the worst or the mean standard deviation over the distances small.
        dose: Radiant exposure of the brightest place, mJ/mm² a frame (default: as metered).
        limits: Limits of the drop, such as "sag=0:0.1 core_radius=0.25".
    """
    asked = np.array([*limits_in(limits).values()]).T
    study = Study(
        "design",
        out=out,
        scene=scene,
        changes=changes,
        quick=quick,
        seed=seed,
        options={"goal": goal, "limits": limits} | ({} if dose is None else {"dose": dose}),
        defaults=("source.medium=vitreous", "microscope.height_px=600"),
    )
    search = Search(study.scene, count=4 if quick else 8, goal=goal, dose=dose)
    tried, rivals, starts, steps = (6, 6, 1, 5) if quick else (40, 500, 3, 16)
    places = np.random.default_rng(study.seed).uniform(size=(tried + rivals, len(LIMITS)))
    with study.timed("search"):
        drawn = search.ways(places, asked, steps=1)
        first = drawn[:tried].nsmallest(starts, "sigma_mm").index
        ways = search.ways(places[first], asked, steps=steps)
        drops = pd.concat([drawn[tried:].assign(way="random"), ways.assign(way="gradient")])
    (winner,) = ways.nsmallest(1, "sigma_mm")[list(LIMITS)].to_numpy(float)
    best = dict(zip(LIMITS, winner.tolist(), strict=True))
    changed = () if quick else ("sag", "numerical_aperture")
    made = {"best": best} | {f"more {x}": {**best, x: 1.2 * best[x]} for x in changed}
    lenses = {name: (study.folder / f"{name}.toml").absolute() for name in made}
    for name, path in lenses.items():
        text = lens_toml(search.fixed | made[name], provenance=study.command)
        with written_whole(path, replace=True) as unfinished:
            unfinished.write_text(text)
    with study.timed("render and read"):
        read = measured(study, lenses, search.dose / search.wall.full_dose)
    tables = tables_of(search, best) | {"drops": drops, "measured": read}
    study.publish(_report, tables, search.dose)
    return tables["lights"]
