"""`eyespot study static`: the paper's Tables I and II over many runs, and what adds to their error.

stacks/ has the noise-free frames that all runs photograph.
"""

from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot import scenes
from eyespot.benchmarks import paper
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.reporting import grouped, number, rows_of, where
from eyespot.benchmarks.study import Study
from eyespot.benchmarks.study_command import command
from eyespot.scenes import Scene, SceneError

# The rendered withdrawals, photographed and measured under each set of causes.

FROM_MM = 0.5
"""Least reading that the fits use; nearer, the fibre hides a large part of the spot."""
TOUCH_MM, TILT_DEG, LIGHT, THRESHOLD_DN = 0.1, 5.0, 0.1, 10

CAUSES = {
    "noise": "the camera's",
    "texture": "printed retina in place of an even wall",
    "touch": f"{TOUCH_MM:g} mm, normal, a trial",
    "tilt": f"plane {TILT_DEG:g}° either way, a trial",
    "exposure": f"{100 * LIGHT:g} %, normal, a trial",
    "threshold": f"{THRESHOLD_DN:g} grey levels, normal, a run",
}
"""The causes and their sizes, which are assumptions: the paper does not report them."""
NONE, TOGETHER, ALL = "none", "together", "all"
"""No cause; what all causes together add beyond their sum; all causes."""
SIZES = {NONE: "the light and pixels", **CAUSES, TOGETHER: "beyond their sum", ALL: ""}
EVEN = -1  # number of the even wall among the textures


def check(scene: Scene) -> None:
    """Refuse a scene that is not the paper's static experiment."""
    needed = {"motion.kind": "withdrawal", "motion.start_mm": "contact"}
    Study.demand(scene, needed, "the static experiment withdraws the tip from contact")
    if scene.spot.incidence_deg <= TILT_DEG:
        raise SceneError(
            f"the study tilts the plane by {TILT_DEG:g} deg either way; got spot.incidence_deg = "
            f"{scene.spot.incidence_deg:g}. Raise it."
        )


def rendered(study: Study, *, textures: int, frames: int) -> dict[str, paper.Photographer]:
    """Every trial on the plane, on every wall and with every tilt; and those in the eyeball."""
    wanted = {}
    for trial in paper.PLANES:
        for texture, tilt in product((EVEN, *range(textures)), (-1, 0, 1)):
            scene = plane(study.scene, trial, texture=texture, tilt=tilt, frames=frames)
            wanted[stack_name(trial, texture, tilt)] = scene
    for trial in paper.SPHERES:
        changes = {**paper.to_photograph(trial, frames=frames), "phantom.kind": "eyeball"}
        wanted[stack_name(trial)] = scenes.changed(study.scene, changes)
    return study.photographers(wanted)


def stack_name(trial: str, texture: int = EVEN, tilt: int = 0) -> str:
    """Name of a withdrawal; the eyeballs have one wall and no tilt."""
    name = trial.replace(" ", "-")
    return f"{name}-wall-{texture + 1}-tilt-{tilt + 1}" if trial in paper.PLANES else name


def plane(scene: Scene, trial: str, *, texture: int, tilt: int, frames: int) -> Scene:
    """A trial on the plane; the instrument keeps its direction when the plane tilts under it.

    `texture` is the number of the wall, or EVEN. The plane's normal leans the way the beam travels
    for a `tilt` of 1, against it for -1.
    """
    base, seed = scene.spot, scene.phantom.texture_seed + texture
    travels = paper.PLACES[trial]["spot.azimuth_deg"] + base.incidence_azimuth_deg
    return scenes.changed(
        scene,
        {
            **paper.to_photograph(trial, frames=frames),
            "phantom.kind": "plane",
            "phantom.pupil_radius_mm": 0.0,
            "phantom.tilt_deg": TILT_DEG * abs(tilt),
            "phantom.tilt_azimuth_deg": travels if tilt > 0 else travels + 180.0,
            "spot.incidence_deg": base.incidence_deg + TILT_DEG * tilt,
            **({"phantom.wall": "uniform"} if texture == EVEN else {"phantom.texture_seed": seed}),
        },
    )


_WITHOUT: dict[str, Any] = {
    "noise": None,
    "texture": EVEN,
    "touch": 0.0,
    "tilt": 0,
    "exposure": 1.0,
    "threshold": paper.Shot().threshold,
}
"""What each cause is where it is left out."""


def drawn(runs: int, *, textures: int, seed: int) -> pd.DataFrame:
    """The causes of every run and trial; columns run, trial (its number) and those of `CAUSES`.

    Touch: distance since contact minus the reading, mm. Exposure: factors.
    """
    rng, shape = np.random.default_rng(seed), (runs, len(paper.PLANES))
    run, trial = np.indices(shape)
    causes = {
        "noise": 1 + 1000 * run + trial,
        "texture": run % textures,
        "touch": TOUCH_MM * rng.standard_normal(shape),
        "tilt": rng.choice((-1, 1), shape),
        "exposure": np.exp(LIGHT * rng.standard_normal(shape)),
        "threshold": np.rint(200 + THRESHOLD_DN * rng.standard_normal((runs, 1))).astype(int),
    }
    columns = {"run": run, "trial": trial, **causes}
    return pd.DataFrame({n: np.broadcast_to(of, shape).ravel() for n, of in columns.items()})


def measured(
    photographers: Mapping[str, paper.Photographer],
    draws: pd.DataFrame,
    pool: Executor,
    causes: Collection[str],
    *,
    way: paper.Way = paper.LITERAL,
    trials: Sequence[str] = paper.PLANES,
) -> pd.DataFrame:
    """Photograph and measure all runs and trials with some causes, by the pool's workers.

    No photograph is measured twice. Metered frames have no threshold and no exposure that could be
    wrong.

    Returns:
        `draws` with the names of trials, and columns way, d_r_mm and semi_minor_px (NaN where no
        spot counts); a row a frame.
    """
    if way is not paper.LITERAL:
        causes = set(causes) - {"exposure", "threshold"}
    left_out = {cause: none for cause, none in _WITHOUT.items() if cause not in causes}
    tasks = draws.assign(**left_out, way=way.name)
    tasks["trial"] = [trials[number] for number in tasks.trial]
    places = tasks[["trial", "texture", "tilt"]].itertuples(index=False)
    tasks["stack"] = [stack_name(*place) for place in places]
    shot = [*paper.Shot._fields]

    def measure(stack: str, of: pd.DataFrame) -> pd.DataFrame:
        shots = map(paper.Shot._make, of[shot].itertuples(index=False))
        return photographers[stack].measure(way, shots).assign(stack=stack)

    spots = pd.concat(pool.map(measure, *zip(*grouped(tasks, "stack"), strict=True)))
    found = tasks.merge(spots, on=["stack", *shot])
    found = found[found.d_r_mm > FROM_MM - 1e-6]
    return found.assign(d_r_mm=found.d_r_mm - found.touch)


# Table I's R² and RMSE imply trials of 3.0, 3.5 and 3.7 mm (`eyespot study table-one`).
_DEFAULTS = ("motion.travel_mm=3.5",)
OWN, POOLED = "each trial", "all trials"
"""Whose mean square error is split: the mean over each trial's own line, or the line of all."""


def _spreads(tables: pd.DataFrame) -> pd.DataFrame:
    """Mean and standard deviation over the runs, and the paper's value.

    For c, `paper` is the value that the paper fitted; it is the true c of the trial here.
    """
    finite = tables[np.isfinite(tables.value)]
    values = finite.groupby(["way", "trial", "quantity"], sort=False).value
    found = values.agg(runs="size", mean="mean", standard_deviation="std")
    found = found[found.runs >= 2].reset_index()
    printed = {**paper.TABLE_I.stack().to_dict(), **paper.TABLE_II.stack().to_dict()}
    return found.assign(paper=[printed[row.trial, row.quantity] for row in rows_of(found)])


def parts(lines: pd.DataFrame, *, texture: pd.Series) -> pd.DataFrame:
    """Split the mean square error by cause, over paired runs with NONE, with each cause, with ALL.

    The error without causes plus all parts and "together" is the error with all causes. Runs that
    share a wall, `texture`, count once in its standard error.

    Args:
        lines: `paper.line_fits` by cause and run.
    """
    squares = lines.pivot(index=["cause", "run"], columns="trial", values="rmse_mm") ** 2
    own = squares.drop(columns=paper.ALL_PLANES).mean(axis=1, skipna=False)
    tables = []
    for scope, each in ((OWN, own), (POOLED, squares[paper.ALL_PLANES])):
        by_run = each.unstack("cause")
        causes = [cause for cause in CAUSES if cause in by_run]
        part = by_run[[NONE, *causes]].sub(by_run[NONE], axis=0).assign(**{NONE: by_run[NONE]})
        part[TOGETHER] = by_run[ALL] - part.sum(axis=1)
        part[ALL] = by_run[ALL]
        error = part.sem()
        if "texture" in part:
            error["texture"] = part.texture.groupby(texture).mean().sem()
        found = {
            "scope": scope,
            "cause": part.columns,
            "size": [SIZES[str(cause)] for cause in part],
            "part_mm2": part.mean(),
            "standard_error_mm2": error,
            "rmse_mm": by_run.mean().reindex(part.columns) ** 0.5,
        }
        tables.append(pd.DataFrame(found))
    return pd.concat(tables, ignore_index=True)


# The figure.


def _causes_figure(causes: pd.DataFrame) -> Figure:
    """Parts of the mean square error, of each trial's line and of all trials' line."""

    def draw(axes: Axes, _: str, scope: str) -> None:
        rows = causes[causes.scope == scope][::-1]
        axes.barh(
            rows.cause,
            1e3 * rows.part_mm2,
            xerr=1e3 * rows.standard_error_mm2.fillna(0),
            color=[page.GREY if cause in (NONE, ALL) else page.BLUE for cause in rows.cause],
            height=0.6,
        )
        printed = paper.PLANES if scope == OWN else [paper.ALL_PLANES]
        for rmse in paper.TABLE_I.rmse_mm[printed]:
            axes.axvline(1e3 * rmse**2, color=page.GREY, lw=0.8, ls=":")

    x = "mean square error of the line (10$^{-3}$ mm²)"
    return page.small_multiples(draw, columns=[OWN, POOLED], x=x, height=3.2, legend_columns=0)


# The page.

_SPREAD = ["way", "quantity", "mean", "standard_deviation", "paper"]


def _report(runs: int, tables: pd.DataFrame, causes: pd.DataFrame) -> page.Report:
    spreads, rmse = _spreads(tables), causes.set_index(["scope", "cause"]).rmse_mm
    alone = where(causes, scope=POOLED).set_index("cause").part_mm2
    most = alone[[*CAUSES]].idxmax()
    printed, together = paper.TABLE_I.rmse_mm[paper.PLANES], paper.TABLE_I.rmse_mm[paper.ALL_PLANES]
    low, high = printed.min(), printed.max()
    return page.Report(
        title="How much do the paper's Tables I and II scatter, and what causes their error?",
        answer=f"With all assumed causes a trial's RMSE is {number(rmse[OWN, ALL], 3)} mm and that "
        f"of all planes together {number(rmse[POOLED, ALL], 3)} mm (the paper's: "
        f"{together:.3f} mm); {most} adds most.",
        lead=f"The paper's static experiment was rendered, photographed and fitted {runs} "
        "times. Each run has its own noise, wall, touch, tilt, exposure and threshold. "
        f"The fits use readings from {FROM_MM:g} mm on, because nearer to contact the fibre hides "
        "a large part of the spot.",
        first=[
            page.Picture(
                "static_causes",
                _causes_figure(causes),
                "What each cause adds alone to the mean square error, and all together beyond "
                "their sum, with standard errors over paired runs; dotted: the paper's mean square "
                "error.",
                data="static_causes.csv",
            ),
            page.Table(
                where(spreads, trial=paper.ALL_PLANES),
                _SPREAD,
                "All planes of Table I with all causes: mean and standard deviation over runs.",
                data="static_spread.csv",
            ),
        ],
        claims=[
            page.Claim(
                name="the paper's RMSE",
                sentence=f"With all causes a trial's RMSE is {rmse[OWN, ALL]:.3f} mm (the paper's "
                f"trials: {low:.3f} to {high:.3f} mm). For all planes together it is "
                f"{rmse[POOLED, ALL]:.3f} mm (the paper's: {together:.3f} mm).",
                value=rmse[OWN, ALL],
                low=low,
                high=high,
            )
        ],
        sections=[
            page.Section(
                "Tables I and II over many runs",
                page.Table(
                    spreads[spreads.trial.isin(paper.SPHERES)],
                    ["trial", *_SPREAD],
                    "Table II with all causes: the small-plane model with each run's own δk "
                    "and b. The paper's c is the one that it fitted, and the true one here.",
                    data="static_spread.csv",
                ),
                "The sizes of the causes are assumptions. A small cause adds an error in "
                "proportion to the square of its size. The error without any cause is not zero, "
                "because a lens's light does not give an exact line.",
            ),
        ],
        data={
            "static_tables.csv": tables,
            "static_spread.csv": spreads,
            "static_causes.csv": causes,
        },
    )


# The command.

VARIED = (
    *("phantom.kind", "phantom.tilt_deg", "phantom.tilt_azimuth_deg"),
    *("spot.eccentricity_mm", "spot.azimuth_deg", "motion.frames"),
    *("exposures.kinds", "exposures.keep_linear"),
)
"""Keys of the scene that the study sets itself."""


@command(defaults=_DEFAULTS, check=check, varies=VARIED)
def static(study: Study) -> pd.DataFrame:
    """Repeat the paper's Tables I and II many times, and split their error by cause."""
    runs, textures, frames = (4, 1, 5) if study.quick else (20, 4, 21)
    with study.timed("render"):
        photographers = rendered(study, textures=textures, frames=frames)
    draws = drawn(runs, textures=textures, seed=study.seed)
    with study.timed("photograph and measure"), ThreadPoolExecutor(max_workers=2) as pool:
        measure = partial(measured, photographers, draws, pool)
        variants = {NONE: (), **{cause: (cause,) for cause in CAUSES}, ALL: tuple(CAUSES)}
        alone = pd.concat(measure(of).assign(cause=cause) for cause, of in variants.items())
        planes = pd.concat([where(alone, cause=ALL), measure(CAUSES, way=paper.SUBPIXEL)])
        in_eyeball = pd.concat(
            measure(CAUSES, way=way, trials=paper.SPHERES)
            for way in (paper.LITERAL, paper.SUBPIXEL)
        )
    with study.timed("fit"):
        lines = paper.line_fits(planes, "way", "run")
        spheres = paper.sphere_fits(in_eyeball, lines, "way", "run", scene=study.scene)
        about = ["way", "run", "trial"]
        tables = pd.concat(
            fits[[*about, *quantities]].melt(about, var_name="quantity")
            for fits, quantities in ((lines, paper.LINE), (spheres, paper.TABLE_II))
        )
        split = paper.line_fits(alone, "cause", "run")
        causes = parts(split, texture=draws.groupby("run").texture.first())
    study.publish(_report, runs, tables, causes)
    return causes
