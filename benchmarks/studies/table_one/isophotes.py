"""Lenses, and the size of their spots over a fixed threshold, in closed form.

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
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import optics
from scenes import Scene
from scenes.world import World

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
        family: the lens.
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
