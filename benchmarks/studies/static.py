"""`eyespot study static`: the paper's Tables I and II over many runs, and what adds to their error.

stacks/ has the noise-free frames that all runs photograph.
"""

from collections.abc import Collection, Iterator, Mapping
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
from eyespot.benchmarks.reporting import number, rows_of, where
from eyespot.benchmarks.study import Study
from eyespot.benchmarks.study_command import command
from eyespot.calibration import Lines, fit_eccentricity, fit_lines
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

Measured = tuple[np.ndarray, np.ndarray]
"""e1' (px, NaN where no spot counts) and d_r (mm) of runs x trials x frames."""


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
    for trial, place in enumerate(paper.paper_trials(source="lens", quick=True, seed=0)):
        if place.kind == "plane":
            for texture, tilt in product((EVEN, *range(textures)), (-1, 0, 1)):
                scene = plane(study.scene, place, texture=texture, tilt=tilt, frames=frames)
                wanted[on_plane(trial, texture, tilt)] = scene
        else:
            changes = {**paper.at_place(place, frames=frames), "phantom.kind": "eyeball"}
            wanted[place.group.replace(" ", "-")] = scenes.changed(study.scene, changes)
    return study.photographers(wanted)


def on_plane(trial: int, texture: int, tilt: int) -> str:
    """Name of a withdrawal from the plane."""
    return f"plane-{trial + 1}-wall-{texture + 1}-tilt-{tilt + 1}"


def plane(scene: Scene, place: paper.StaticTrial, *, texture: int, tilt: int, frames: int) -> Scene:
    """A trial on the plane; the instrument keeps its direction when the plane tilts under it.

    `texture` is the number of the wall, or EVEN. The plane's normal leans the way the beam travels
    for a `tilt` of 1, against it for -1.
    """
    base, seed = scene.spot, scene.phantom.texture_seed + texture
    travels = place.scene.spot.azimuth_deg + base.incidence_azimuth_deg
    return scenes.changed(
        scene,
        {
            **paper.at_place(place, frames=frames),
            "phantom.kind": "plane",
            "phantom.pupil_radius_mm": 0.0,
            "phantom.tilt_deg": TILT_DEG * abs(tilt),
            "phantom.tilt_azimuth_deg": travels if tilt > 0 else travels + 180.0,
            "spot.incidence_deg": base.incidence_deg + TILT_DEG * tilt,
            **({"phantom.wall": "uniform"} if texture == EVEN else {"phantom.texture_seed": seed}),
        },
    )


_WITHOUT = {
    "noise": 0,
    "texture": EVEN,
    "touch": 0.0,
    "tilt": 0,
    "exposure": 1.0,
    "threshold": paper.Shot().threshold,
}
"""What each cause is where it is left out."""


def drawn(shape: tuple[int, int], *, textures: int, seed: int) -> dict[str, np.ndarray]:
    """The causes by run (rows) and trial (columns).

    Touch: distance since contact minus the reading, mm. Exposure: factors.
    """
    rng = np.random.default_rng(seed)
    run, trial = np.indices(shape)
    return {
        "noise": 1 + 1000 * run + trial,
        "texture": run % textures,
        "touch": TOUCH_MM * rng.standard_normal(shape),
        "tilt": rng.choice((-1, 1), shape),
        "exposure": np.exp(LIGHT * rng.standard_normal(shape)),
        "threshold": np.rint(200 + THRESHOLD_DN * rng.standard_normal((shape[0], 1))).astype(int),
    }


def measured(
    photographers: Mapping[str, paper.Photographer],
    draws: Mapping[str, np.ndarray],
    pool: Executor,
    causes: Collection[str],
    *,
    way: paper.Way = paper.LITERAL,
    wall: str = "plane",
) -> Measured:
    """Photograph and measure all runs and trials with some causes, by the pool's workers.

    No photograph is measured twice. Metered frames have no threshold and no exposure that could be
    wrong, and the eyeballs have one wall and no tilt.
    """
    if way is not paper.LITERAL:
        causes = set(causes) - {"exposure", "threshold"}
    shape = draws["noise"].shape
    of = {
        cause: np.broadcast_to(draws[cause] if cause in causes else without, shape)
        for cause, without in _WITHOUT.items()
    }
    tasks = []
    for run, trial in np.ndindex(shape):
        own = {cause: values[run, trial].item() for cause, values in of.items()}
        name = on_plane(trial, own["texture"], own["tilt"])
        light = {"light": own["exposure"], "threshold": own["threshold"]}
        shot = paper.Shot(own["noise"] or None, **light)
        tasks.append((photographers[name if wall == "plane" else f"sphere-{trial + 1}"], shot))
    shots: dict[paper.Photographer, dict[paper.Shot, None]] = {}
    for photographer, shot in tasks:
        shots.setdefault(photographer, {})[shot] = None
    spots = pool.map(lambda of: of[0].measure(way, list(of[1])), shots.items())
    found = {
        (photographer, shot): semi_minor
        for (photographer, asked), measured in zip(shots.items(), spots, strict=True)
        for shot, semi_minor in zip(asked, measured, strict=True)
    }
    semi_minor = np.reshape([found[task] for task in tasks], (*shape, -1))
    readings = np.reshape([photographer.readings for photographer, _ in tasks], (*shape, -1))
    seen = np.where(readings > FROM_MM - 1e-6, semi_minor, np.nan)
    return seen, readings - of["touch"][..., None]


# Table I's R² and RMSE imply trials of 3.0, 3.5 and 3.7 mm (`eyespot study table-one`).
_DEFAULTS = ("motion.travel_mm=3.5",)
_FEWEST_SPOTS = 3
OWN, POOLED = "each trial", "all trials"
"""Whose mean square error is split: the mean over each trial's own line, or the line of all."""
_WAYS = (paper.LITERAL.name, paper.SUBPIXEL.name)


# Fits.


def _lines(semi_minor: np.ndarray, reading: np.ndarray) -> tuple[Lines, Lines]:
    """Each trial's line (runs x trials), and the line through all trials (runs)."""
    both = np.stack(np.broadcast_arrays(semi_minor, reading))
    return fit_lines(*both), fit_lines(*both.reshape(2, len(semi_minor), -1))


def _tables(way: str, spots: Mapping[tuple[str, str], Measured], scene: Scene) -> pd.DataFrame:
    """Tables I and II of every run: way, run, trial, quantity, value."""
    own, pooled = _lines(*spots["plane", way])
    rows: list[tuple[str, int, str, str, float]] = []
    for quantity in paper.TABLE_I[paper.ALL_PLANES]._fields:
        columns = np.column_stack([getattr(own, quantity), getattr(pooled, quantity)])
        for run, values in enumerate(columns.tolist()):
            rows += [(way, run, t, quantity, v) for t, v in zip(paper.TABLE_I, values, strict=True)]
    semi_minor, readings = spots["sphere", way]
    for run, trial in np.ndindex(semi_minor.shape[:2]):
        axis, reading = semi_minor[run, trial], readings[run, trial]
        seen = np.isfinite(axis)
        if np.count_nonzero(seen) < _FEWEST_SPOTS:
            continue
        fit = fit_eccentricity(
            semi_minor_px=axis[seen],
            distance=reading[seen],
            delta_k=float(pooled.delta_k[run]),
            b=float(pooled.b[run]),
            scale=scene.microscope.scale_mm_px,
            eye_radius=scene.phantom.radius_mm,
        )
        name = list(paper.TABLE_II)[trial]
        rows += [(way, run, name, q, getattr(fit, q)) for q in paper.TABLE_II[name]._fields]
    return pd.DataFrame(rows, columns=["way", "run", "trial", "quantity", "value"])


def _spreads(tables: pd.DataFrame) -> pd.DataFrame:
    """Mean and standard deviation over the runs, and the paper's value.

    For c, `paper` is the value that the paper fitted; it is the true c of the trial here.
    """
    finite = tables[np.isfinite(tables.value)]
    values = finite.groupby(["way", "trial", "quantity"], sort=False).value
    found = values.agg(runs="size", mean="mean", standard_deviation="std")
    found = found[found.runs >= 2].reset_index()
    printed: dict[str, Any] = {**paper.TABLE_I, **paper.TABLE_II}
    found["paper"] = [getattr(printed[row.trial], row.quantity) for row in rows_of(found)]
    return found


def parts(variants: Mapping[str, Measured], *, texture: np.ndarray) -> pd.DataFrame:
    """Split the mean square error by cause, over paired runs with NONE, with each cause, with ALL.

    The error without causes plus all parts and "together" is the error with all causes. Runs that
    share a wall, `texture`, count once in its standard error.
    """
    both = {name: _lines(*measured) for name, measured in variants.items()}
    squares = {
        OWN: {name: (own.rmse**2).mean(axis=1) for name, (own, _) in both.items()},
        POOLED: {name: pooled.rmse**2 for name, (_, pooled) in both.items()},
    }
    rows = []
    for scope, of in squares.items():
        alone = {name: of[name] - of[NONE] for name in CAUSES if name in of}
        together = of[ALL] - of[NONE] - sum(alone.values())
        for cause, part in {NONE: of[NONE], **alone, TOGETHER: together, ALL: of[ALL]}.items():
            sample = pd.Series(part)
            if cause == "texture":
                sample = sample.groupby(texture).mean()
            whole = of[cause].mean() ** 0.5 if cause in of else np.nan
            rows.append((scope, cause, SIZES[cause], part.mean(), sample.sem(), whole))
    columns = ["scope", "cause", "size", "part_mm2", "standard_error_mm2", "rmse_mm"]
    return pd.DataFrame(rows, columns=columns)


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
        for line in (
            [paper.TABLE_I[paper.ALL_PLANES]] if scope == POOLED else paper.PAPERS_PLANES.values()
        ):
            axes.axvline(1e3 * line.rmse**2, color=page.GREY, lw=0.8, ls=":")

    x = "mean square error of the line (10$^{-3}$ mm²)"
    return page.small_multiples(draw, columns=[OWN, POOLED], x=x, height=3.2, legend_columns=0)


# The page.

_SPREAD = ["way", "quantity", "mean", "standard_deviation", "paper"]


def _report(runs: int, tables: pd.DataFrame, causes: pd.DataFrame) -> page.Report:
    spreads, rmse = _spreads(tables), causes.set_index(["scope", "cause"]).rmse_mm
    alone = where(causes, scope=POOLED).set_index("cause").part_mm2
    most = alone[[cause for cause in CAUSES if cause in alone]].idxmax()
    return page.Report(
        title="How much do the paper's Tables I and II scatter, and what causes their error?",
        answer=f"With all assumed causes a trial's RMSE is {number(rmse[OWN, ALL], 3)} mm and that "
        f"of all planes together {number(rmse[POOLED, ALL], 3)} mm (the paper's: "
        f"{paper.TABLE_I[paper.ALL_PLANES].rmse:.3f} mm); {most} adds most.",
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
                "All planes of Table I with all causes: mean and standard deviation over runs; "
                "delta_k in mm/px, b and rmse in mm.",
                data="static_spread.csv",
            ),
        ],
        claims=list(_claims(causes)),
        sections=[
            page.Section(
                "Tables I and II over many runs",
                page.Table(
                    spreads[spreads.trial.isin([*paper.TABLE_II])],
                    ["trial", *_SPREAD],
                    "Table II with all causes, mm: the small-plane model with each run's own δk "
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


def _claims(causes: pd.DataFrame) -> Iterator[page.Claim]:
    rmse = where(causes, cause=ALL).set_index("scope").rmse_mm
    printed = [row.rmse for row in paper.PAPERS_PLANES.values()]
    low, high, pooled = min(printed), max(printed), paper.TABLE_I[paper.ALL_PLANES].rmse
    yield page.Claim(
        name="the paper's RMSE",
        sentence=f"With all causes a trial's RMSE is {rmse[OWN]:.3f} mm (the paper's trials: "
        f"{low:.3f} to {high:.3f} mm). For all planes together it is {rmse[POOLED]:.3f} mm (the "
        f"paper's: {pooled:.3f} mm).",
        value=rmse[OWN],
        low=low,
        high=high,
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
    draws = drawn((runs, len(paper.TABLE_II)), textures=textures, seed=study.seed)
    with study.timed("photograph and measure"), ThreadPoolExecutor(max_workers=2) as pool:
        measure = partial(measured, photographers, draws, pool)
        variants = {cause: measure([cause]) for cause in CAUSES}
        variants |= {NONE: measure([]), ALL: measure(CAUSES)}
        spots = {
            ("plane", paper.LITERAL.name): variants[ALL],
            ("plane", paper.SUBPIXEL.name): measure(CAUSES, way=paper.SUBPIXEL),
        }
        for way in (paper.LITERAL, paper.SUBPIXEL):
            spots["sphere", way.name] = measure(CAUSES, way=way, wall="sphere")
    with study.timed("fit"):
        tables = pd.concat([_tables(way, spots, study.scene) for way in _WAYS], ignore_index=True)
        causes = parts(variants, texture=draws["texture"][:, 0])
    study.publish(_report, runs, tables, causes)
    return causes
