"""`eyespot study table-one`: which lenses give the paper's Table I, and what sets trials apart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from eyespot import optics, scenes
from eyespot.benchmarks import paper
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.model_error import MEASURED, READING
from eyespot.benchmarks.reporting import listed, rows_of, where
from eyespot.benchmarks.study import Study
from eyespot.benchmarks.study_command import command
from eyespot.calibration import fit_lines
from eyespot.estimator import LiteralSettings
from eyespot.formats.report_page import PALETTE
from eyespot.formats.whole_files import write_text
from eyespot.optics.wall_light.lens_flux import lens_of, lens_parameters, lens_toml
from eyespot.scenes import Scene
from eyespot.scenes.world.world import World

# The scan: the threshold and range at which each lens comes nearest to Table I, in closed form.

LEVELS = np.geomspace(0.1, 2.0, 31)
"""Thresholds, relative to the peak irradiance at `exposures.paper_distance_mm`."""
NEAR_CONTACT_MM = 0.5
"""First reading of a range from contact: nearer, the shaft hides a part of the spot."""
_STEP_MM, LARGEST_READING_MM = 0.1, 8.0
_SPANS_MM = (3.0, 3.5, 4.0, 5.0, 6.0)
_LENS = ["numerical_aperture", "sag_mm"]
_CHOICE = [*_LENS, "level", "from_mm", "to_mm"]


def lens_values(numerical_aperture: float, sag_mm: float) -> dict[str, float]:
    """What describes a lens of a 0.5 mm fibre that is all core, as thin as its cap allows."""
    own = {"numerical_aperture": numerical_aperture, "sag": sag_mm, "rim_height": 0.0}
    return lens_parameters(optics.load_lens("paper-candidate")) | own


def readings(low: float, high: float) -> np.ndarray:
    """Evenly spaced readings d_r, mm."""
    return np.linspace(low, high, round((high - low) / _STEP_MM) + 1)


def best_choice(world: World) -> pd.DataFrame:
    """The threshold and range from contact at which a lens comes nearest to Table I (`misses`).

    `level` is the threshold over the peak at 5 mm.
    """
    every = readings(0.0, LARGEST_READING_MM)
    axis = paper.thresholded(world, every, level=LEVELS)
    # A spot that the literal tracker would not accept is not seen.
    settings = LiteralSettings()
    small, large = settings.min_component_px, settings.max_minor_axis_px
    axis[(math.pi * axis**2 <= small) | (2.0 * axis >= large)] = np.nan
    tables = []
    for low, span in product((0.0, NEAR_CONTACT_MM), _SPANS_MM):
        inside = (every >= low - 1e-6) & (every <= low + span + 1e-6)
        lines = fit_lines(axis[:, inside], every[inside])
        found = pd.DataFrame(dict(zip(paper.LINE, lines, strict=True)))
        found.loc[np.isnan(axis[:, inside]).any(axis=1)] = np.nan
        tried = pd.DataFrame({"level": LEVELS, "from_mm": low, "to_mm": low + span})
        tables.append(tried.join(found))
    choices = pd.concat(tables, ignore_index=True)
    choices["miss"] = paper.misses(choices)
    return choices.loc[[choices.miss.idxmin()]]


# Lenses of the scan on rendered stacks: three withdrawals from a plane, tracked in both modes.

LIGHTS = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.2)
"""Factors on the fixed exposure: a place of the picture reflects more or less than the mean."""
WIDE_APERTURE = 0.15  # From here on the first scan, by ray binning, found no flat end that fits.
_CURVED_MM = 0.02


class ConfirmedLens(NamedTuple):
    """A row of the scan with the threshold and first reading that fit the rendered spots best.

    `choice.miss` is that of the rendered spots, `spots` are those of literal mode, `lines` rows of
    table_one_rendered.csv.
    """

    choice: Any
    spots: pd.DataFrame
    lines: pd.DataFrame

    @property
    def criteria(self) -> dict[str, page.Claim]:
        """Those of Table I in literal mode, the scatter's lower bound included."""
        literal = where(self.lines, way=paper.LITERAL.name)
        return paper.reproduction(literal, name="Table I by the best lens")

    @property
    def reproduces(self) -> bool:
        """Whether all criteria are met."""
        return all(claim.holds for claim in self.criteria.values())


def to_render(scan: pd.DataFrame, *, quick: bool) -> list[Any]:
    """Rows of the scan: the best, the preset `paper-candidate`, and the nearest kinds that fail.

    Only the best, and the nearest with a round cap, if quick.
    """
    ranked = scan.sort_values("miss", kind="stable")
    candidate = lens_parameters(optics.load_lens("paper-candidate"))
    own = where(ranked, numerical_aperture=candidate["numerical_aperture"], sag_mm=candidate["sag"])
    curved = ranked.sag_mm >= _CURVED_MM
    wide = (ranked.numerical_aperture >= WIDE_APERTURE) & (ranked.sag_mm == 0)
    failing = [ranked[kind & (ranked.miss > 1)][:1] for kind in (curved, wide)]
    chosen = [ranked[:1], failing[0]] if quick else [ranked[:2], own, *failing]
    return list(dict.fromkeys(rows_of(pd.concat(chosen))))


def confirm(study: Study, choices: Sequence[Any], *, frames: int) -> list[ConfirmedLens]:
    """Render, track and fit rows of the scan; lens files go into the study's folder.

    The lenses that fit best are the first.
    """
    folder = (study.folder / "lenses").absolute()  # stacks name files; a run may resume elsewhere
    folder.mkdir(exist_ok=True)
    wanted, names = {}, {}
    for choice in choices:
        lens = f"na-{choice.numerical_aperture:.3f}-sag-{choice.sag_mm:.3f}"
        values = lens_values(choice.numerical_aperture, choice.sag_mm)
        content = lens_toml(values, provenance="eyespot study table-one")
        write_text(folder / f"{lens}.toml", content, replace=True)
        names[choice] = {trial: f"{lens}-{trial.replace(' ', '-')}" for trial in paper.PLANES}
        for number, trial in enumerate(paper.PLANES):
            own = {
                "seed": study.seed + number,
                "source.kind": "lens",
                "source.lens": str(folder / f"{lens}.toml"),
                "motion.travel_mm": choice.to_mm,
                "exposures.paper_level": choice.level,
            }
            changes = {**paper.to_photograph(trial, frames=frames), **own}
            wanted[names[choice][trial]] = scenes.changed(study.scene, changes)
    taken = study.photographers(wanted)
    found = (_confirmed(one, {t: taken[n] for t, n in of.items()}) for one, of in names.items())
    return sorted(found, key=lambda one: (not one.reproduces, one.choice.miss > 1))


def _confirmed(choice: Any, trials: Mapping[str, paper.Photographer]) -> ConfirmedLens:
    def spots(way: paper.Way, lights: Sequence[float]) -> pd.DataFrame:
        tables = []
        for trial, own in trials.items():
            shots = [paper.Shot(noise=own.scene.seed, exposure=light) for light in lights]
            tables.append(own.measure(way, shots).assign(way=way.name, trial=trial))
        return pd.concat(tables)

    literal, by = spots(paper.LITERAL, LIGHTS), ["exposure", "from_mm"]
    tried = pd.concat(
        literal[literal.d_r_mm > start - 1e-6].assign(from_mm=start)
        for start in {choice.from_mm, NEAR_CONTACT_MM}
    )
    lines = paper.line_fits(tried, *by)
    # The slope of Table I is that of all trials together, its scatter that of each.
    slope = ["delta_k_mm_px", "b_mm"]
    together = where(lines, trial=paper.ALL_PLANES).set_index(by)[slope]
    asked = lines[lines.trial != paper.ALL_PLANES].drop(columns=slope).join(together, on=by)
    worst = asked.assign(miss=paper.misses(asked)).groupby(by, as_index=False).miss.max()
    light, start, miss = worst.loc[worst.miss.idxmin()]
    choice = choice._replace(level=choice.level / light, from_mm=start, miss=miss)
    literal = where(literal, exposure=light)
    seen = pd.concat([literal, spots(paper.SUBPIXEL, (1.0,))])
    about = {name: getattr(choice, name) for name in _CHOICE}
    lines = paper.line_fits(seen[seen.d_r_mm > start - 1e-6].assign(**about), *_CHOICE, "way")
    return ConfirmedLens(choice, literal, lines)


# Why trials differ.


def moved_by_light(world: World, choice: Any) -> float:
    """How far a fifth more or less light moves −b/δk, the radius at contact, of a choice, px.

    More light lowers the level that the threshold stands for. A wrong touch would shift b alone.
    """
    reading = readings(choice.from_mm, choice.to_mm)
    levels = choice.level / np.array([1.0, 1.2, 0.8])
    lines = fit_lines(paper.thresholded(world, reading, level=levels), reading)
    own, *others = (-lines.b / lines.delta_k).tolist()
    return max(abs(other - own) for other in others)


# The page.

Worlds = Mapping[tuple[float, float], World]
"""By numerical aperture and sag of the lens."""


def _figure(worlds: Worlds, scan: pd.DataFrame, confirmed: Sequence[ConfirmedLens]) -> Figure:
    """Misfit of each lens; spots of the rendered ones, measured and in closed form."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    miss = scan.pivot(index="sag_mm", columns="numerical_aperture", values="miss")
    left.set_prop_cycle(color=PALETTE)
    left.plot(miss, marker="o", ms=3, label=[f"NA {aperture:.2f}" for aperture in miss])
    left.axhline(1.0, color=page.GREY, lw=0.8, ls=":")
    left.set(xlabel="sag of the cap (mm)", ylabel="worst violation / tolerance", yscale="log")
    for (choice, spots, _), colour in zip(confirmed, PALETTE, strict=False):
        d_r, world = readings(0.0, choice.to_mm), worlds[choice.numerical_aperture, choice.sag_mm]
        (axis,) = paper.thresholded(world, d_r, level=np.array([choice.level]))
        label = f"NA {choice.numerical_aperture:.2f}, sag {choice.sag_mm:g} mm"
        right.plot(axis[axis > 0], d_r[axis > 0], color=colour, label=label)
        right.plot(spots.semi_minor_px, spots.d_r_mm, ".", ms=3, color=colour)
    for row in rows_of(paper.TABLE_I.loc[paper.PLANES]):
        d_r = np.array([0.0, paper.even_span(r_squared=row.r_squared, rmse_mm=row.rmse_mm)])
        axis = (d_r - row.b_mm) / row.delta_k_mm_px
        right.plot(axis, d_r, color=page.GREY, lw=2, alpha=0.5, zorder=0)
    right.set(xlabel=MEASURED, ylabel=READING, xlim=(0.0, None))
    for axes in (left, right):
        axes.legend()
    return figure


def report(
    worlds: Worlds, scan: pd.DataFrame, confirmed: Sequence[ConfirmedLens], *, scale: float
) -> page.Report:
    """The report of a run; `scale` is the scene's, mm/px."""
    lines = pd.concat([one.lines for one in confirmed], ignore_index=True)
    fits = scan[scan.miss <= 1]
    return page.Report(
        title="Which lens gives the paper's Table I, and why do its trials differ?",
        answer=f"{len(fits)} of {len(scan)} lenses give Table I's line by a fixed threshold"
        f"{', so the table does not identify the lens' if len(fits) > 1 else ''}; "
        f"{sum(one.reproduces for one in confirmed)} of {len(confirmed)} rendered ones meet all "
        "its criteria.",
        lead="A scan of glue lenses, thresholds and distances in closed form, then the best lenses "
        "and some that fail on rendered stacks, tracked as in the paper and in sub-pixel mode.",
        first=[
            page.Picture(
                "table_one",
                _figure(worlds, scan, confirmed),
                "How near lenses come to Table I. Left: the worst violation of its criteria, in "
                "units of their tolerance, at each lens's best threshold and range near contact; "
                "below 1 the lens fits. Right: spots on rendered planes (marks) by the fixed "
                "threshold, and the same in closed form (lines). Grey: the paper's three lines "
                "from contact, over the spans that their R² and RMSE imply.",
                data="table_one_scan.csv",
            ),
            page.Table(
                scan.sort_values("miss", kind="stable"),
                [*_CHOICE, *paper.LINE, "miss"],
                "The lenses that come nearest to Table I, in closed form, at the scene's scale. "
                "Level: the threshold over the peak at 5 mm. Miss: the worst violation, as above.",
                data="table_one_scan.csv",
            ),
        ],
        claims=[
            *confirmed[0].criteria.values(),
            page.Claim(
                name="lenses",
                sentence=f"{len(fits)} of {len(scan)} lenses give Table I's line from contact at "
                f"{scale:g} mm/px, a scale that the paper does not state: NA "
                f"{listed(fits.numerical_aperture, '.2f')}, sag {listed(fits.sag_mm, '.3f')} mm, "
                f"threshold {listed(fits.level, '.2f')}, readings up to {listed(fits.to_mm, 'g')} "
                f"mm. Of {len(confirmed)} lenses rendered, "
                f"{sum(one.choice.miss > 1 for one in confirmed)} fail at their best threshold "
                "and range.",
                value=len(fits),
            ),
            _effect_of_light(worlds, confirmed[0]),
        ],
        sections=[
            page.Section(
                "Rendered",
                page.Table(
                    lines,
                    [*_LENS, "way", "trial", *paper.LINE, "contact_radius_px", "spots"],
                    "Lines through the spots of rendered trials, those of the best lens first.",
                    data="table_one_rendered.csv",
                ),
            ),
        ],
        data={"table_one_scan.csv": scan, "table_one_rendered.csv": lines},
    )


def _effect_of_light(worlds: Worlds, best: ConfirmedLens) -> page.Claim:
    lens = best.choice.numerical_aperture, best.choice.sag_mm
    light = moved_by_light(worlds[lens], best.choice)
    rendered = where(best.lines, way=paper.LITERAL.name).set_index("trial").delta_k_mm_px
    # Light moves δk and b in proportion, so that −b/δk stays; a missed touch moves b alone.
    slope, b = paper.TABLE_I.delta_k_mm_px[paper.PLANES], paper.TABLE_I.b_mm[paper.PLANES]
    contact, ratio = -b / slope, slope / slope["plane 2"]
    touch = (b - ratio * b["plane 2"]).abs()
    others = ["plane 1", "plane 3"]
    return page.Claim(
        name="light moves −b/δk less than the paper's trials differ",
        sentence=f"A fifth more or less light moves −b/δk by {light:.1f} px at most; a third "
        f"of the paper's differences is {np.ptp(contact) / 3:.1f} px. Light, tilt and the "
        "picture on the wall change δk and b in proportion; a missed touch changes b only. "
        f"Points 1 and 3 differ from point 2 by {listed(100 * (ratio[others] - 1), '+.1f')} % in "
        f"δk and by {listed(contact[others] - contact['plane 2'], '+.1f')} px in −b/δk, "
        f"which a missed touch of {listed(touch[others], '.2f')} mm explains. The rendered trials "
        "of the best lens, at three places of one picture and touched exactly, have δk of "
        f"{listed(rendered[paper.PLANES], '.4f')} mm/px.",
        value=light,
        high=float(np.ptp(contact)) / 3,
    )


# The command.

VARIED = (
    *("spot.eccentricity_mm", "spot.azimuth_deg", "motion.frames", "motion.travel_mm"),
    *("exposures.kinds", "exposures.keep_linear", "exposures.paper_level", "source.lens"),
)
"""Keys of the scene that the study sets itself."""


def check(scene: Scene) -> None:
    """Refuse a scene that cannot be compared with Table I."""
    plane = {"phantom.kind": "plane", "phantom.tilt_deg": 0}
    Study.demand(scene, plane, "Table I is of a plane square to the microscope")
    lens = {"source.kind": "lens", "motion.kind": "withdrawal", "motion.start_mm": "contact"}
    Study.demand(scene, lens, "the study compares lenses on withdrawals from contact")


@command(defaults=("phantom.kind=plane",), check=check, varies=VARIED)
def table_one(study: Study) -> list[ConfirmedLens]:
    """Find the lenses that give the paper's Table I, and why its trials differ."""
    base, quick = study.scene, study.quick
    apertures, sags = [0.05, 0.10, 0.15, 0.20], [0.0, 0.04]
    if not quick:
        apertures = [0.05, 0.08, 0.10, 0.12, 0.15, 0.20]
        sags = [0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.12]
    lenses = [*product(apertures, sags)]
    with study.timed("scan of lenses"), ThreadPoolExecutor(max_workers=2) as pool:
        made = pool.map(lambda lens: paper.world_of(lens_of(lens_values(*lens)), base), lenses)
        worlds = dict(zip(lenses, made, strict=True))
        scan = pd.concat(
            best_choice(world).assign(numerical_aperture=aperture, sag_mm=sag)
            for (aperture, sag), world in worlds.items()
        )[[*_CHOICE, *paper.LINE, "miss"]]
    with study.timed("render and measure"):
        choices, frames = to_render(scan, quick=quick), 7 if quick else 31
        confirmed = confirm(study, choices, frames=frames)
    study.publish(report, worlds, scan, confirmed, scale=base.microscope.scale_mm_px)
    return confirmed
