"""The scan: the threshold and range at which each lens comes nearest to Table I, in closed form.

On the spot's minor axis a tilted plane is as far from the tip as the axis's own wall point, so that
its irradiance is cos(incidence) times that of a square plane at d: the isophote of a level on the
tilted plane is that of level / cos(incidence) on the square one. Wide bells have their widest chord
nearer to the tip than the axis, so that their ellipses come out larger: only rendered stacks show
that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import optics
from benchmarks.evaluation import ALL_PLANES, TABLE_I, Criterion, reproduction
from calibration import Lines, fit_lines
from estimator import LiteralSettings
from scenes import Scene
from scenes.world import World

# Lenses and their isophotes.

FARTHEST_MM = 8.0
"""Largest reading."""
_ROWS, _COLUMNS = 65, 193
_NEAREST_MM = 0.05


class Family(NamedTuple):
    """A lens of a 0.5 mm fibre that is all core, as thin as its cap allows; mm."""

    numerical_aperture: float
    sag: float

    @property
    def name(self) -> str:
        """The name in texts and file names."""
        return f"na-{self.numerical_aperture:.3f}-sag-{self.sag:.3f}"

    @property
    def lens(self) -> dict[str, float]:
        """Content of a lens file; the other values are those of the preset `paper-candidate`."""
        preset = {name: value for name, value in vars(_preset()).items() if value is not None}
        return {name: float(value) for name, value in preset.items()} | {
            "numerical_aperture": self.numerical_aperture,
            "sag": self.sag,
            "glue_length": self.sag,
        }


@dataclass(frozen=True)
class Isophotes:
    """Size of the spot over a fixed threshold, for one lens seen in one scene.

    Attributes:
        light: the lens's.
        contact: d at reading 0, mm.
        incidence: rad.
        peak: irradiance at the level 1, per unit power, 1/mm².
    """

    family: Family
    light: optics.IrradianceTable
    contact: float
    incidence: float
    peak: float

    @classmethod
    def of(cls, family: Family, scene: Scene) -> Isophotes:
        """The isophotes of a lens in place of the scene's."""
        lens = optics.glue_lens(**family.lens)
        light = _light(lens, medium_index=optics.MEDIA[scene.source.medium])
        radius = np.linspace(0.0, float(light.envelope(scene.exposures.paper_distance_mm)), 512)
        at = np.full_like(radius, scene.exposures.paper_distance_mm)
        return cls(
            family,
            light,
            contact=World(scene).contact_distance,
            incidence=math.radians(scene.spot.incidence_deg),
            peak=float(jnp.max(light(radius=radius, distance=at)[1])),
        )

    def radius(
        self, reading: np.ndarray, *, level: np.ndarray, incidence: float | None = None
    ) -> np.ndarray:
        """Semi-minor axis on the wall, mm.

        Args:
            reading: d_r since contact, mm.
            level: broadcasts against it, with as many axes.
            incidence: rad, in place of the scene's, with the same distance at contact.
        """
        cosine = math.cos(self.incidence if incidence is None else incidence)
        return np.asarray(
            optics.isophote_radius(
                self.light, distance=reading + self.contact, level=level * self.peak / cosine
            )
        )

    def half_maximum(self, reading: np.ndarray) -> np.ndarray:
        """Semi-minor axis of half of the peak, mm."""
        return np.asarray(optics.half_maximum_radius(self.light, distance=reading + self.contact))


def paper_candidate() -> Family:
    """The lens proposed as the paper's, the preset `paper-candidate`."""
    lens = _preset()
    return Family(float(lens.numerical_aperture), float(lens.sag))


def families(apertures: Iterable[float], sags: Sequence[float]) -> list[Family]:
    """All lenses of a grid."""
    return [Family(aperture, sag) for aperture in apertures for sag in sags]


def _preset() -> optics.GlueLens:
    return optics.load_lens("paper-candidate")


def _light(lens: optics.GlueLens, *, medium_index: float) -> optics.IrradianceTable:
    """A coarse table: a tenth of the time of `optics.irradiance_table`, for many lenses."""
    field = optics.LensField(lens, medium_index)
    distance = np.geomspace(_NEAREST_MM, FARTHEST_MM + 1.0, _ROWS)
    envelope = np.asarray(field.envelope(distance))
    radius = envelope[:, None] * np.linspace(0.0, 1.0, _COLUMNS)
    light = jnp.stack(field(radius=radius, distance=distance[:, None]), axis=-1)
    contact_radius = field.envelope(0.0)
    return optics.IrradianceTable(
        values=light * np.square(envelope)[:, None, None],
        medium_index=jnp.asarray(medium_index, dtype=float),
        contact_radius=contact_radius,
        slope=field.envelope(1.0) - contact_radius,
        nearest=_NEAREST_MM,
        farthest=FARTHEST_MM + 1.0,
    )


# The scan.

LEVELS = np.geomspace(0.1, 2.0, 31)
"""Thresholds, relative to the peak irradiance at `exposures.paper_distance_mm`."""
SCALES_MM_PX = (0.005, 0.016)
"""Those of a view of 10 mm on 2000 and on 640 pixels; the paper does not give its scale."""
NEAR_CONTACT_MM = 0.5
"""First reading of a range from contact: nearer, the shaft hides a part of the spot."""
_STEP_MM = 0.1
_STARTS_MM = np.arange(0.0, 5.1, 0.5)
_SPANS_MM = (3.0, 3.5, 4.0, 5.0, 6.0)


class Demand(StrEnum):
    """Which of the paper's unknown conditions are free for a lens."""

    AT_SCALE = "from contact, at the scene's scale"
    ANYWHERE = "at any distance and scale"


class LensChoice(NamedTuple):
    """Row of table_one_scan.csv: a lens, a threshold and a range, and the resulting line.

    `level` is the threshold over the peak at 5 mm. `scale_mm_px` is the scale of the comparison.
    `miss` is the worst deviation from Table I in units of its tolerance; up to 1, all criteria are
    met.
    """

    numerical_aperture: float
    sag_mm: float
    asked: Demand
    level: float
    from_mm: float
    to_mm: float
    scale_mm_px: float
    delta_k_mm_px: float
    b_mm: float
    r_squared: float
    rmse_mm: float
    miss: float

    @property
    def family(self) -> Family:
        """The lens."""
        return Family(self.numerical_aperture, self.sag_mm)


def readings(low: float, high: float) -> np.ndarray:
    """Evenly spaced readings d_r, mm."""
    return np.linspace(low, high, round((high - low) / _STEP_MM) + 1)


def misses(lines: Lines, *, scale: float | np.ndarray) -> np.ndarray:
    """Worst violation of `reproduction` by lines with slopes in mm/mm, in units of its tolerance.

    A line without noise may be straighter than the paper's.
    """
    asked = reproduction(TABLE_I)
    delta_k, b = asked[Criterion.DELTA_K], asked[Criterion.B]
    parts = [
        np.abs(lines.delta_k * scale - 0.5 * (delta_k.low + delta_k.high))
        / (0.5 * (delta_k.high - delta_k.low)),
        np.abs(lines.b - 0.5 * (b.low + b.high)) / (0.5 * (b.high - b.low)),
        (1.0 - lines.r_squared) / (1.0 - asked[Criterion.R_SQUARED].low),
        lines.rmse / asked[Criterion.RMSE].high,
    ]
    return np.nan_to_num(np.max(parts, axis=0), nan=np.inf)


def best_choices(isophotes: Isophotes, *, scale: float) -> list[LensChoice]:
    """The threshold and range at which a lens comes nearest to Table I, by each way of asking.

    Args:
        scale: delta, mm/px.
    """
    every = readings(0.0, FARTHEST_MM)
    radius = isophotes.radius(every[None, :], level=LEVELS[:, None])
    radius = np.where(_seen(radius / scale), radius, np.nan)
    ranges = [(a, a + span) for a in _STARTS_MM for span in _SPANS_MM if a + span <= FARTHEST_MM]
    found: dict[Demand, LensChoice] = {}
    for low, high in ranges:
        inside = (every >= low - 1e-6) & (every <= high + 1e-6)
        lines = fit_lines(radius[:, inside], every[inside])
        whole = np.isfinite(radius[:, inside]).all(axis=1)
        lines = Lines(*(np.where(whole, value, np.nan) for value in lines))
        with np.errstate(divide="ignore"):
            own = np.clip(TABLE_I[ALL_PLANES].delta_k / lines.delta_k, *SCALES_MM_PX)
        asked = {Demand.ANYWHERE: own}
        if low <= NEAR_CONTACT_MM:
            asked[Demand.AT_SCALE] = np.full(LEVELS.size, scale)
        for way, scales in asked.items():
            miss = misses(lines, scale=scales)
            n = int(np.argmin(miss))
            if way not in found or miss[n] < found[way].miss:
                found[way] = LensChoice(
                    *isophotes.family,
                    asked=way,
                    level=float(LEVELS[n]),
                    from_mm=float(low),
                    to_mm=float(high),
                    scale_mm_px=float(scales[n]),
                    delta_k_mm_px=float(lines.delta_k[n] * scales[n]),
                    b_mm=float(lines.b[n]),
                    r_squared=float(lines.r_squared[n]),
                    rmse_mm=float(lines.rmse[n]),
                    miss=float(miss[n]),
                )
    return [found[way] for way in Demand]


def _seen(semi_minor_px: np.ndarray) -> np.ndarray:
    """Whether the literal tracker accepts a spot of that size."""
    settings = LiteralSettings()
    large = math.pi * semi_minor_px**2 > settings.min_component_px
    return large & (2 * semi_minor_px < settings.max_minor_axis_px)
