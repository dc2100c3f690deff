"""The static experiment of Zhou et al. 2020: what it reports, its places, its readings and fits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import pandas as pd

from eyespot import calibration, optics
from eyespot.benchmarks.reporting import Claim, grouped, listed, where
from eyespot.estimator import (
    LiteralMode,
    LiteralSettings,
    Ranger,
    SubpixelMode,
    SubpixelSettings,
    track,
)
from eyespot.formats.spot import NoSpot, Spot
from eyespot.formats.stack import FrameLabels, Stack
from eyespot.scenes import Scene, SceneError, changed
from eyespot.scenes.sensor import CameraSensor

if TYPE_CHECKING:
    from eyespot.scenes.world.world import World

# What the paper reports.

ALL_PLANES = "all planes"  # All trials of Table I together.
LINE = ["delta_k_mm_px", "b_mm", "r_squared", "rmse_mm"]
TABLE_I = pd.DataFrame.from_dict(
    {
        "plane 1": (0.1496, -6.791, 0.9959, 0.0548),
        "plane 2": (0.1343, -5.069, 0.9909, 0.0974),
        "plane 3": (0.1347, -5.226, 0.9961, 0.0663),
        ALL_PLANES: (0.1321, -5.117, 0.9703, 0.1630),
    },
    orient="index",
    columns=LINE,
)

# The paper's text gives 0.372 mm as the largest of all errors.
ERRORS = ["standard_deviation_mm", "mean_absolute_error_mm", "max_error_mm"]
TABLE_II = pd.DataFrame.from_dict(
    {
        "sphere 1": (5.531, 0.064, 0.146, 0.328),
        "sphere 2": (6.982, 0.097, 0.140, 0.372),
        "sphere 3": (4.584, 0.088, 0.160, 0.396),
    },
    orient="index",
    columns=["c_mm", *ERRORS],
)
PLANES, SPHERES = [*TABLE_I.index.drop(ALL_PLANES)], [*TABLE_II.index]
"""Trials of either table."""

ACCEPTABLE_ERROR_MM = 0.5  # the error that the paper calls acceptable


class Criterion(NamedTuple):
    """The range in which a quantity of Table I must lie, and how its values are written."""

    name: str
    low: float
    high: float
    digits: str
    unit: str = ""


CRITERIA = {
    "delta_k_mm_px": Criterion("δk", 0.126, 0.138, ".4f", " mm/px"),
    "b_mm": Criterion("b", -5.6, -4.6, ".2f", " mm"),
    "r_squared": Criterion("R² of each trial", 0.99, 1.0, ".3f"),
    "rmse_mm": Criterion("RMSE of each trial", 0.05, 0.10, ".3f", " mm"),
}
"""When lines count as those of Table I, by column.

All planes together must have the paper's δk and b, within less than its own trials differ; each
trial must be as straight as the paper's.
"""


def reproduction(lines: pd.DataFrame, *, name: str = "Table I") -> dict[str, Claim]:
    """The criteria, by column, for the lines of one source measured in one way (`line_fits`).

    The claims' names begin with `name`.
    """
    together = lines.trial == ALL_PLANES
    claims = {}
    for column, (quantity, low, high, digits, unit) in CRITERIA.items():
        of_all_planes = column in ("delta_k_mm_px", "b_mm")
        values = tuple(lines[together if of_all_planes else ~together][column])
        claims[column] = Claim(
            name=f"{name}, {quantity}",
            sentence=f"{listed(values, digits)}{unit} (Table I demands {low:g} to {high:g}).",
            value=values,
            low=low,
            high=high,
        )
    return claims


def misses(lines: pd.DataFrame) -> pd.Series:
    """Worst violation of Table I's criteria by each line, in units of their tolerance.

    Up to 1 all are met, except that a line without noise may be straighter than the paper's.
    """
    ideal = pd.Series({"delta_k_mm_px": 0.132, "b_mm": -5.1, "r_squared": 1.0, "rmse_mm": 0.0})
    bounds = pd.DataFrame({column: (of.low, of.high) for column, of in CRITERIA.items()})
    tolerance = (bounds - ideal).abs().max()
    off = (lines[LINE] - ideal).abs() / tolerance
    return off.max(axis=1, skipna=False).fillna(math.inf)


def even_span(*, r_squared: float, rmse_mm: float) -> float:
    """Length of the range over which evenly spaced readings give a line's R² and RMSE, mm."""
    # R² is what the line explains of the readings' variance.
    return math.sqrt(12.0 / (1.0 - r_squared)) * rmse_mm


# Its withdrawals, rendered.

# Places on the printed plane, so far apart that they share no wall texture.
_ECCENTRICITIES_MM = (1.5, 3.0, 4.5, *TABLE_II.c_mm.tolist())
_AZIMUTHS_DEG = (0.0, 120.0, 240.0)
PLACES: dict[str, dict[str, float]] = {
    trial: {"spot.eccentricity_mm": c, "spot.azimuth_deg": azimuth}
    for trial, c, azimuth in zip(
        [*PLANES, *SPHERES], _ECCENTRICITIES_MM, 2 * _AZIMUTHS_DEG, strict=True
    )
}
"""Changes of a scene that put it at the place of a trial of Table I or II."""
MICROSCOPE_HEIGHT_MM = 200.0  # z_F of a real microscope.
PINHOLE_HEIGHTS_MM = (11.5, MICROSCOPE_HEIGHT_MM)
"""On the eyeball's sphere (equation 8 of Zhou et al. 2020), and a real microscope."""
TILT_AZIMUTHS_DEG = (0.0, 90.0, 180.0)
"""Of a tilted beam: towards growing c, across the meridian, and towards the axis."""
_SMALLEST_RADIUS_MM = 10.0


def withdrawals(sources: Iterable[str], *, quick: bool, seed: int) -> pd.DataFrame:
    """The paper's six withdrawals with each kind of source, and a grid of ideal cones.

    The grid has each eccentricity from 0 to 7 mm, for both pinholes, tilted three ways.

    Returns:
        Columns source, trial (a row of Table I or II, or the grid's pinhole) and scene, by name.
    """
    rows = []
    for source, (number, trial) in product(sources, enumerate(PLACES)):
        own: dict[str, object] = {
            **PLACES[trial],
            "seed": seed + number,
            "source.kind": source,
            "phantom.kind": "plane" if trial in PLANES else "eyeball",
            "motion.frames": 9 if quick else 61,
        }
        rows.append((f"{source}-{trial.replace(' ', '-')}", source, trial, own))
    eccentricities = (0.0, 3.0, 5.0, 7.0) if quick else map(float, range(8))
    for height, azimuth, c in product(PINHOLE_HEIGHTS_MM, TILT_AZIMUTHS_DEG, eccentricities):
        own = {
            "seed": seed,
            "source.kind": "cone",
            "spot.eccentricity_mm": c,
            "spot.incidence_azimuth_deg": azimuth,
            "microscope.pinhole_height_mm": height,
            **withdrawal(start_mm=0.5, travel_mm=5.5, frames=4 if quick else 12),
        }
        name = f"grid-pinhole-{height:g}-azimuth-{azimuth:g}-c-{c:g}"
        rows.append((name, "cone", f"pinhole {height:g} mm", own))
    base = changed(Scene(), {"phantom.texture_seed": seed})
    made = [(*about, changed(base, own)) for *about, own in rows]
    return pd.DataFrame(made, columns=["name", "source", "trial", "scene"]).set_index("name")


def to_photograph(trial: str, *, frames: int) -> dict[str, object]:
    """Changes of a scene that make it a trial whose frames a `Photographer` takes again."""
    return {
        **PLACES[trial],
        "motion.frames": frames,
        "exposures.kinds": ["paper", "metered"],
        "exposures.keep_linear": True,
    }


def withdrawal(*, start_mm: float, travel_mm: float, frames: int) -> dict[str, object]:
    """Changes of a scene that make it metered frames of a withdrawal."""
    return {
        "motion.kind": "withdrawal",
        "motion.start_mm": start_mm,
        "motion.travel_mm": travel_mm,
        "motion.frames": frames,
        "exposures.kinds": ["metered"],
    }


def require_roomy_eyeball(scene: Scene, reach: str) -> None:
    """Raise SceneError if a scene's wall ends before a study's spots do.

    Args:
        reach: what reaches how far, for the message.
    """
    if scene.phantom.kind != "eyeball" or scene.phantom.radius_mm < _SMALLEST_RADIUS_MM:
        raise SceneError(
            f"the study's {reach} in an eyeball of {_SMALLEST_RADIUS_MM:g} mm radius or more; got "
            f"phantom.kind '{scene.phantom.kind}' with radius_mm = {scene.phantom.radius_mm:g}. "
            "Set phantom.kind=eyeball and raise phantom.radius_mm."
        )


# Its fits.

_FEWEST_SPOTS = 3
_STEP_MM, _SHORTEST_MM = 0.5, 2.0  # Parts of the range that are tried begin at steps.


def line_fits(spots: pd.DataFrame, *by: str) -> pd.DataFrame:
    """Table I: the lines d_r = δk e1' + b of every trial and of all together, for each `by`.

    Args:
        spots: on planes; columns `trial`, `semi_minor_px` (NaN for none), `d_r_mm` and `by`.

    Returns:
        Columns `by`, `trial`, those of `LINE` (NaN below three spots), spots and contact_radius_px
        (−b/δk, e1' at contact).
    """
    rows = []
    for key, own in spots.groupby(list(by), sort=False):
        for trial, part in [*grouped(own, "trial"), (ALL_PLANES, own)]:
            e, d_r = part[["semi_minor_px", "d_r_mm"]].to_numpy(float).T
            line = map(float, calibration.fit_lines(e, d_r))
            rows.append((*key, trial, *line, np.isfinite(e).sum()))
    found = pd.DataFrame(rows, columns=[*by, "trial", *LINE, "spots"])
    return found.assign(contact_radius_px=-found.b_mm / found.delta_k_mm_px)


def sphere_fits(spots: pd.DataFrame, lines: pd.DataFrame, *by: str, scene: Scene) -> pd.DataFrame:
    """Table II: c of the small-plane model for every trial in the eyeball, for each `by`.

    δk and b are those of all planes.

    Args:
        spots: in the eyeball; columns as for `line_fits`, whose result is `lines`.
        scene: its microscope and eyeball.

    Returns:
        Columns `by`, `trial`, those of `TABLE_II`, c_error_mm, spots, converged, at_bound,
        c_true_mm, and c_expected_mm, the c whose factor cos(phi) equals the correct first-order
        factor of the true c, or 0 if that is above 1; for trials with three spots or more.
    """
    known = where(lines, trial=ALL_PLANES)[[*by, "delta_k_mm_px", "b_mm"]]
    seen = spots.dropna(subset="semi_minor_px").merge(known, on=list(by))
    rows = []
    for key, of in seen.groupby(list(by), sort=False):
        for trial, own in grouped(of, "trial"):
            if len(own) < _FEWEST_SPOTS:
                continue
            fit = calibration.fit_eccentricity(
                semi_minor_px=own.semi_minor_px.to_numpy(float),
                distance=own.d_r_mm.to_numpy(float),
                delta_k=own.delta_k_mm_px.iloc[0],
                b=own.b_mm.iloc[0],
                scale=scene.microscope.scale_mm_px,
                eye_radius=scene.phantom.radius_mm,
            )
            errors = fit.standard_deviation, fit.mean_absolute_error, fit.max_error
            about = fit.c_error, fit.spots, fit.converged, fit.at_bound
            rows.append((*key, trial, fit.c, *errors, *about))
    columns = [*by, "trial", *TABLE_II, "c_error_mm", "spots", "converged", "at_bound"]
    found = pd.DataFrame(rows, columns=columns)
    c, r = found.trial.map(TABLE_II.c_mm).to_numpy(float), scene.phantom.radius_mm
    kappa = 1.0 / (scene.microscope.pinhole_height_mm + r)
    right = optics.corrected_factor(eccentricity=c, eye_radius=r, inverse_working_distance=kappa)
    expected = r * np.sqrt(np.maximum(0.0, 1.0 - np.asarray(right) ** 2))
    return found.assign(c_true_mm=c, c_expected_mm=expected)


def nearest_part(spots: pd.DataFrame) -> tuple[float, float, dict[str, Claim]] | None:
    """The widest of those parts of the range that meet most criteria of Table I.

    The paper does not state the distances of its fits. This tries all parts of 2 mm or more that
    begin and end at multiples of 0.5 mm.

    Args:
        spots: on planes, of one `source`, as for `line_fits`.

    Returns:
        The first and the last reading (mm) and the criteria; None if no part has three spots of
        each trial.
    """
    parts = []
    ends = np.arange(0.0, max(spots.d_r_mm, default=0.0) + 1e-6, _STEP_MM).tolist()
    for low, high in product(ends, repeat=2):
        inside = spots[spots.d_r_mm.between(low - 1e-6, high + 1e-6, inclusive="neither")]
        count = inside.trial.value_counts().reindex(PLANES, fill_value=0)
        if high >= low + _SHORTEST_MM and count.min() >= _FEWEST_SPOTS:
            parts.append((low, high, reproduction(line_fits(inside, "source"))))
    return max(parts, key=lambda part: (met(part[2]), part[1] - part[0]), default=None)


def met(criteria: Mapping[str, Claim]) -> int:
    """How many criteria of Table I are met."""
    return sum(bool(claim.holds) for claim in criteria.values())


# Spots of a rendered trial, measured in the ways that the studies compare.

VISIBLE_ENOUGH = 0.5  # part of the half-maximum contour that must be visible for a spot to count
USED = "used"  # The frame enters the fits.


@dataclass(frozen=True)
class Way:
    """An estimator, whose mode is the type of the settings, and the exposure that it is given."""

    name: str
    exposure: Literal["paper", "metered"]
    settings: LiteralSettings | SubpixelSettings

    @property
    def slug(self) -> str:
        """The name for use in file names."""
        return self.name.replace(",", "").replace(" ", "-")

    def click(self, labels: Sequence[FrameLabels]) -> tuple[float, float] | None:
        """Where the paper's operator clicks in the first frame, px; None in sub-pixel mode."""
        if not isinstance(self.settings, LiteralSettings):
            return None
        return labels[0].half_max_x_px, labels[0].half_max_y_px

    def reader(self, ranger: Ranger | None = None, **more: Any) -> LiteralMode | SubpixelMode:
        """A reader with these settings."""
        if isinstance(self.settings, LiteralSettings):
            return LiteralMode(self.settings, ranger, **more)
        return SubpixelMode(self.settings, ranger, **more)


LITERAL = Way("literal, paper exposure", "paper", LiteralSettings())
"""The paper's own way: a threshold in frames of one exposure."""

LITERAL_METERED = Way("literal, metered", "metered", LiteralSettings())

SUBPIXEL = Way("sub-pixel, metered", "metered", SubpixelSettings())
"""The best way: the half-maximum edge in frames that are metered one by one."""

WAYS = (LITERAL, LITERAL_METERED, SUBPIXEL)


ELLIPSE = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad")


def spots_of(labels: Sequence[FrameLabels], results: Sequence[Spot | NoSpot]) -> pd.DataFrame:
    """The labels of frames, and what was measured in them; a row a frame.

    Besides the labels' columns: `result`; the ellipse's five parameters, NaN without a spot;
    `d_r_mm`, the robot's reading since the first frame; `outcome`, `USED` or why the frame does not
    enter the fits; `used`: a spot was found, and half of its contour can be seen.
    """
    found = pd.DataFrame([vars(row) for row in labels])
    found["result"] = pd.Series(list(results), dtype=object)
    for name in ELLIPSE:
        found[name] = [getattr(result, name, math.nan) for result in results]
    found["d_r_mm"] = found.d_mm - found.d_mm.iloc[0]
    found["outcome"] = [
        result.reason.value.replace("_", " ")
        if isinstance(result, NoSpot)
        else USED
        if row.visible_fraction >= VISIBLE_ENOUGH
        else "less than half of the contour in view"
        for row, result in zip(labels, results, strict=True)
    ]
    return found.assign(used=found.outcome == USED)


def track_stack(stack: Stack, way: Way) -> pd.DataFrame:
    """Measure every frame of a stack in one way; see `spots_of`."""
    labels = stack.exposed(way.exposure)
    found = track(stack.images(way.exposure), way.settings, start=way.click(labels))
    return spots_of(labels, tuple(found))


# Photographs of kept linear frames, taken and measured again without rendering or files.


class Shot(NamedTuple):
    """Seed of the camera's noise (None: no noise), factor on the light, literal threshold (DN)."""

    noise: int | None = None
    exposure: float = 1.0
    threshold: int = LiteralSettings().threshold


@dataclass(frozen=True, kw_only=True, eq=False)
class Photographer:
    """Takes a rendered withdrawal's photographs and measures their spots."""

    scene: Scene
    stack: Stack

    def measure(self, way: Way, shots: Iterable[Shot]) -> pd.DataFrame:
        """Columns of `Shot`, d_r_mm and semi_minor_px (NaN where no spot counts); a row a frame.

        Equal shots are taken once.
        """
        rows, tables = self.stack.exposed(way.exposure), []
        light = [self.stack.linear(row) for row in rows]  # read once for all shots
        for shot in dict.fromkeys(shots):
            settings = way.settings
            if isinstance(settings, LiteralSettings):
                settings = replace(settings, threshold=shot.threshold)
            spots = track(self._images(rows, shot, light), settings, start=way.click(rows))
            seen = spots_of(rows, list(spots))
            seen["semi_minor_px"] = seen.semi_minor_px.where(seen.used)
            tables.append(seen[["d_r_mm", "semi_minor_px"]].assign(**shot._asdict()))
        return pd.concat(tables, ignore_index=True)

    def _images(
        self, rows: Sequence[FrameLabels], shot: Shot, light: Sequence[np.ndarray]
    ) -> Iterator[np.ndarray]:
        quiet, seed = None, shot.noise or 0
        if shot.noise is None:  # so many electrons that their number has no noise
            none = dict.fromkeys(("read_noise_e", "dark_signal_e", "prnu", "dsnu_e"), 0.0)
            quiet = self.scene.camera.model_copy(update={"full_well_e": 1e12, **none})
        camera = CameraSensor(self.scene, seed=seed, settings=quiet)
        for row, linear in zip(rows, light, strict=True):
            raw = camera.raw(
                linear, exposure_s=shot.exposure * row.exposure_s, noise_seed=[seed, row.frame]
            )
            yield camera.written(raw)


# The fixed threshold on a lens's light in closed form, without a stack. It alone needs JAX.
#
# On the spot's minor axis a tilted plane is as far from the tip as the axis's own wall point, so
# that its irradiance is cos(incidence) times that of a square plane at d: the isophote of a level
# on the tilted plane is that of level / cos(incidence) on the square one. Wide bells have their
# widest chord nearer to the tip than the axis, so that their ellipses come out larger: only
# rendered stacks show that.

_ROWS, _COLUMNS = 65, 193
_NEAREST_MM, _FARTHEST_MM = 0.05, 9.0


def world_of(lens: optics.GlueLens, scene: Scene) -> World:
    """A scene's world with the light of another lens.

    Its table is coarse: a tenth of the time of `optics.irradiance_table`, for many lenses.
    """
    import jax.numpy as jnp

    from eyespot.scenes.world.world import LensLight, World

    world, medium_index = World(scene), jnp.asarray(optics.MEDIA[scene.source.medium])
    field = optics.LensField(lens, medium_index)
    distance = np.geomspace(_NEAREST_MM, _FARTHEST_MM, _ROWS)
    envelope = np.asarray(field.envelope(distance))[:, None]
    radius = envelope * np.linspace(0.0, 1.0, _COLUMNS)
    light = np.stack(field(radius=radius, distance=distance[:, None]), axis=-1)
    contact_radius = field.envelope(0.0)
    table = optics.IrradianceTable(
        values=light * np.square(envelope)[..., None],
        medium_index=medium_index,
        contact_radius=contact_radius,
        slope=field.envelope(1.0) - contact_radius,
        nearest=_NEAREST_MM,
        farthest=_FARTHEST_MM,
    )
    world.light = LensLight(table, transmitted=math.nan)  # No stack is rendered of this world.
    return world


def thresholded(world: World, reading: np.ndarray, *, level: np.ndarray) -> np.ndarray:
    """e1' over a fixed threshold, px, at readings since contact, mm; a row for each level.

    A level is the threshold over the peak irradiance at `exposures.paper_distance_mm`.
    """
    from eyespot.scenes.world.exposure import peak_irradiance

    scene, table = world.scene, world.table
    assert table is not None  # World.table is None only for a cone.
    peak = peak_irradiance(world, distance=scene.exposures.paper_distance_mm)
    square = peak / scene.source.power_mw / math.cos(math.radians(scene.spot.incidence_deg))
    distance = (reading + world.contact_distance)[None]
    radius = optics.isophote_radius(table, distance=distance, level=level[:, None] * square)
    return np.asarray(radius) / scene.microscope.scale_mm_px
