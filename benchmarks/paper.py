"""What Zhou et al. 2020 report, as printed, and whether fits reproduce their Table I."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd

from eyespot.benchmarks.reporting import Claim, listed
from eyespot.estimator import (
    LiteralMode,
    LiteralSettings,
    Ranger,
    SubpixelMode,
    SubpixelSettings,
    track,
)
from eyespot.formats.spots import NoSpot, Spot
from eyespot.formats.stack import FrameLabels, Stack
from eyespot.scenes import Scene, SceneError
from eyespot.scenes.sensor import CameraSensor


class PlaneRow(NamedTuple):
    """Row of Table I: mm/px, mm, 1 and mm."""

    delta_k: float
    b: float
    r_squared: float
    rmse: float


class SphereRow(NamedTuple):
    """Row of Table II; mm."""

    c: float
    standard_deviation: float
    mean_absolute_error: float
    max_error: float


ALL_PLANES = "all planes"  # All trials of Table I together.

TABLE_I = {
    "plane 1": PlaneRow(0.1496, -6.791, 0.9959, 0.0548),
    "plane 2": PlaneRow(0.1343, -5.069, 0.9909, 0.0974),
    "plane 3": PlaneRow(0.1347, -5.226, 0.9961, 0.0663),
    ALL_PLANES: PlaneRow(0.1321, -5.117, 0.9703, 0.1630),
}

TABLE_II = {
    "sphere 1": SphereRow(5.531, 0.064, 0.146, 0.328),
    "sphere 2": SphereRow(6.982, 0.097, 0.140, 0.372),
    "sphere 3": SphereRow(4.584, 0.088, 0.160, 0.396),
}

ACCEPTABLE_ERROR_MM = 0.5  # the error that the paper calls acceptable

PAPERS_PLANES = {name: row for name, row in TABLE_I.items() if name != ALL_PLANES}


class Criterion(StrEnum):
    """A quantity of Table I."""

    DELTA_K = "δk"
    B = "b"
    R_SQUARED = "R² of each trial"
    RMSE = "RMSE of each trial"


def plane_rows(lines: pd.DataFrame) -> dict[str, PlaneRow]:
    """Rows of a table of lines, as those of Table I, by trial."""
    columns = lines[["delta_k_mm_px", "b_mm", "r_squared", "rmse_mm"]].to_numpy().tolist()
    return {trial: PlaneRow(*row) for trial, row in zip(lines.trial, columns, strict=True)}


STRAIGHT = 0.99
"""R² of a straight line; each trial of Table I has more."""


def reproduction(fits: Mapping[str, PlaneRow], *, name: str = "Table I") -> dict[Criterion, Claim]:
    """The criteria for fits of one source measured in one way.

    The fit of all planes must be the paper's, within the differences between its own trials; each
    trial must be as straight as the paper's. The claims' names begin with `name`.
    """
    trials = [fits[trial] for trial in PAPERS_PLANES if trial in fits]
    r_squared, rmse = tuple(f.r_squared for f in trials), tuple(f.rmse for f in trials)
    pooled, printed = fits[ALL_PLANES], TABLE_I[ALL_PLANES]
    slope, b = round(printed.delta_k, 3), round(printed.b, 1)
    bounds = {
        Criterion.DELTA_K: ((pooled.delta_k,), slope - 0.006, slope + 0.006, ".4f", " mm/px"),
        Criterion.B: ((pooled.b,), b - 0.5, b + 0.5, ".2f", " mm"),
        Criterion.R_SQUARED: (r_squared, STRAIGHT, 1.0, ".3f", ""),
        Criterion.RMSE: (rmse, 0.05, 0.10, ".3f", " mm"),
    }
    return {
        criterion: Claim(
            name=f"{name}, {criterion}",
            sentence=f"{listed(values, spec)}{unit} (Table I demands {low:g} to {high:g}).",
            value=values,
            low=low,
            high=high,
        )
        for criterion, (values, low, high, spec, unit) in bounds.items()
    }


# The trials of the main job: the paper's six, and a grid over eccentricity.

# Places on the printed plane, so far apart that they share no wall texture.
_PLANE_ECCENTRICITIES_MM = (1.5, 3.0, 4.5)
_AZIMUTHS_DEG = (0.0, 120.0, 240.0)
MICROSCOPE_HEIGHT_MM = 200.0  # z_F of a real microscope.
PINHOLE_HEIGHTS_MM = (11.5, MICROSCOPE_HEIGHT_MM)
"""On the eyeball's sphere (equation 8 of Zhou et al. 2020), and a real microscope."""
TILT_AZIMUTHS_DEG = (0.0, 90.0, 180.0)
"""Of a tilted beam: towards growing c, across the meridian, and towards the axis."""
_SMALLEST_RADIUS_MM = 10.0

TrialKind = Literal["plane", "sphere", "grid"]


@dataclass(frozen=True, kw_only=True)
class StaticTrial:
    """A withdrawal of the static experiment; `group` is a row of the paper's tables, or a grid."""

    name: str
    kind: TrialKind
    group: str
    scene: Scene

    @property
    def source(self) -> str:
        """Kind of light: "lens" or "cone"."""
        return self.scene.source.kind


def paper_trials(*, source: str, quick: bool, seed: int) -> list[StaticTrial]:
    """Three withdrawals on the plane and three in the eyeball, with one kind of source."""
    places: list[tuple[str, TrialKind, float]] = [
        *((f"plane {n}", "plane", c) for n, c in enumerate(_PLANE_ECCENTRICITIES_MM, start=1)),
        *((name, "sphere", row.c) for name, row in TABLE_II.items()),
    ]
    trials = []
    for number, (group, kind, c) in enumerate(places):
        wall = "eyeball" if kind == "sphere" else "plane"
        azimuth = _AZIMUTHS_DEG[number % len(_AZIMUTHS_DEG)]
        scene = {
            "schema": 1,
            "seed": seed + number,
            "phantom": {"kind": wall, "texture_seed": seed},
            "source": {"kind": source},
            "spot": {"eccentricity_mm": c, "azimuth_deg": azimuth},
            "motion": {"frames": 9 if quick else 61},
        }
        name, own = f"{source}-{group.replace(' ', '-')}", Scene.model_validate(scene)
        trials.append(StaticTrial(name=name, kind=kind, group=group, scene=own))
    return trials


def at_place(place: StaticTrial, *, frames: int) -> dict[str, object]:
    """Changes of a scene that put a withdrawal at a trial's place, to be photographed again."""
    return {
        "spot.eccentricity_mm": place.scene.spot.eccentricity_mm,
        "spot.azimuth_deg": place.scene.spot.azimuth_deg,
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


def grid_trials(*, quick: bool, seed: int) -> list[StaticTrial]:
    """Ideal cones at each eccentricity from 0 to 7 mm, for both pinholes, tilted three ways."""
    eccentricities, trials = (0.0, 3.0, 5.0, 7.0) if quick else map(float, range(8)), []
    for height, azimuth, c in product(PINHOLE_HEIGHTS_MM, TILT_AZIMUTHS_DEG, eccentricities):
        scene = {
            "schema": 1,
            "seed": seed,
            "phantom": {"texture_seed": seed},
            "source": {"kind": "cone"},
            "spot": {"eccentricity_mm": c, "incidence_azimuth_deg": azimuth},
            "motion": {"start_mm": 0.5, "travel_mm": 5.5, "frames": 4 if quick else 12},
            "microscope": {"pinhole_height_mm": height},
            "exposures": {"kinds": ["metered"]},
        }
        name = f"grid-pinhole-{height:g}-azimuth-{azimuth:g}-c-{c:g}"
        about: dict[str, Any] = {"kind": "grid", "group": f"pinhole {height:g} mm"}
        trials.append(StaticTrial(name=name, scene=Scene.model_validate(scene), **about))
    return trials


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


# Spots of a rendered trial, measured in the ways that the report compares.

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

    seed: int | None = None
    light: float = 1.0
    threshold: int = LiteralSettings().threshold


@dataclass(frozen=True, kw_only=True, eq=False)
class Photographer:
    """Takes a rendered withdrawal's photographs and measures their spots."""

    scene: Scene
    stack: Stack

    @property
    def readings(self) -> np.ndarray:
        """d_r since contact of every frame, mm."""
        d = np.array([row.d_mm for row in self.stack.exposed(LITERAL.exposure)])
        return d - d[0]

    def measure(self, way: Way, shots: Sequence[Shot]) -> list[np.ndarray]:
        """e1' of every frame, px, for each shot; NaN where no spot counts."""
        rows, found = self.stack.exposed(way.exposure), []
        light = [self.stack.linear(row) for row in rows]  # read once for all shots
        for shot in shots:
            settings = way.settings
            if isinstance(settings, LiteralSettings):
                settings = replace(settings, threshold=shot.threshold)
            spots = track(self._images(rows, shot, light), settings, start=way.click(rows))
            seen = spots_of(rows, list(spots))
            found.append(seen.semi_minor_px.where(seen.used).to_numpy())
        return found

    def _images(
        self, rows: Sequence[FrameLabels], shot: Shot, light: Sequence[np.ndarray]
    ) -> Iterator[np.ndarray]:
        quiet, seed = None, shot.seed or 0
        if shot.seed is None:  # so many electrons that their number has no noise
            none = dict.fromkeys(("read_noise_e", "dark_signal_e", "prnu", "dsnu_e"), 0.0)
            quiet = self.scene.camera.model_copy(update={"full_well_e": 1e12, **none})
        camera = CameraSensor(self.scene, seed=seed, settings=quiet)
        for row, linear in zip(rows, light, strict=True):
            raw = camera.raw(
                linear, exposure_s=shot.light * row.exposure_s, noise_seed=[seed, row.frame]
            )
            yield camera.written(raw)
