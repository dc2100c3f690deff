"""The light of a fit's lens, to first order about a table that is computed anew if it moves far.

The cap is described by its curvature and chord, in which the light is nearly linear.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eyespot.calibration.least_squares import NormalEquations
from eyespot.calibration.pixels.data import LENS, Footage
from eyespot.optics.wall_light.lens_flux import (
    FLATTEST,
    LensSamples,
    LensTable,
    halvings_for,
    lens_samples,
)

NEAREST_MM = 0.3
"""Least distance from the tip's plane at which a table is valid."""
_MARGIN_MM = 1.0  # the wall is oblique, so parts of it are nearer and farther than on the axis
_REACH = {True: 1.6, False: 1.05}
"""Size of a table over the light's envelope, for coarse and for exact tables."""
_FINEST_PX = 0.17
"""Width of a table's cells, in pixels, below which they are not halved. The model averages over
pixels, but wide cells blur a sharp image of the core. On counted photons (number 1 of
`photon_fits coverage` in v0.2.1) a whole pixel biases NA by a standard error, 0.25 px
by 0.3 and 0.17 px by 0.05, compared with 0.1 px."""
_HALVINGS = 6
"""Least number of halvings of a table's cells: tables of one shape need one compilation for all
lenses of small frames."""
_FAR = 0.05
"""Relative change of a lens's parameter beyond which a table, linear in it, is computed anew while
a fit is on its way. Its result is confirmed with a table that is much nearer."""
_FIRST_ORDER = 0.01
"""The same for the rounds that learn the noise: the light is right to the square, 1e-4."""
_NEAR_BY = 0.002
"""Relative change up to which a table is computed from the last one. Up to 5 % the fit of a sharp
image of the core (`photon_fits examples` in v0.2.1) had a sag ten sigma of the noise
off."""
_KEPT = 4
"""Tables that are kept: a fit goes back to one after a step that went too far, or from a start that
is no better."""
_MIN_SAG_MM = 1e-5  # least sag of a table
ENCLOSED = 1.0 + 1e-4  # least rim of a cap over its core
CLEAR = 1.003
"""Rim over the core from which on the light's derivatives are those of a rim that cuts off nothing.
At 1.0001 an invisible rim seemed known 7 times, at 1.001 twice as well as from 1.002 on (seed 100
of `random_fits lenses` in v0.2.1)."""


class LinearLensLight:
    """The light of a fit's lens, to first order around the parameters of its last table.

    Args:
        names: names of the fit's free parameters.

    Attributes:
        where: tells the table from every other one.
    """

    def __init__(self, footage: Footage, names: tuple[str, ...]) -> None:
        self.footage = footage
        self.where: tuple[float, ...] = ()
        self.free = tuple(name for name in names if name in LENS)
        # Of a cap whose one part is known, the light is linear in both.
        others = (name for name in CAP if name not in names and set(CAP) & set(names))
        self._by = (*self.free, *others)
        self._table: LensTable | None = None
        self._samples: LensSamples | None = None
        self._coarse = True
        self._at: dict[str, float] = {}
        self._kept: dict[tuple[float, ...], tuple[LensSamples, LensTable]] = {}
        self._halvings: int | None = None

    def tabulate(
        self, values: Mapping[str, float], *, coarse: bool = False, finely: bool = False
    ) -> None:
        """Compute the table at these values of all parameters, unless it is one of the last.

        Args:
            coarse: of a first fit.
            finely: anew and in cells of half the width, to be the last. Where the light has a step,
                its derivatives have a peak, which wide cells place badly.
        """
        at = {name: values[name] for name in (*LENS, "touch")}
        at["sag"], at["rim_height"] = max(at["sag"], _MIN_SAG_MM), max(at["rim_height"], 0.0)
        at["aperture_radius"] = max(at["aperture_radius"], ENCLOSED * at["core_radius"])
        where = (coarse, finely, *at.values())
        if where not in self._kept:
            self._kept = dict([*self._kept.items()][1 - _KEPT :])
            self._kept[where] = self._computed(values, at, coarse=coarse, finely=finely)
        self._samples, self._table = self._kept[where]
        self._at, self._coarse, self.where = at, coarse, where

    def _computed(
        self, values: Mapping[str, float], at: Mapping[str, float], *, coarse: bool, finely: bool
    ) -> tuple[LensSamples, LensTable]:
        """The table at some parameters, from the last one if that is near by."""
        anew = coarse or finely or self._coarse or self._is_beyond(_NEAR_BY, values)
        lens = {name: at[name] for name in LENS}
        farthest = float(self.footage.readings.max() + values["touch"]) + _MARGIN_MM
        least = float(self.footage.readings.min() + values["touch"])
        finest = _FINEST_PX * self.footage.microscope.scale_mm_px
        medium = self.footage.medium_index
        if self._halvings is None:
            # The same for the whole fit: tables of one shape need one compilation.
            needed = halvings_for(lens, medium_index=medium, farthest=farthest, finest=finest)
            self._halvings = max(_HALVINGS, needed)
        samples = lens_samples(
            lens,
            self._by,
            medium_index=medium,
            nearest=max(NEAREST_MM, least - _MARGIN_MM),
            farthest=farthest,
            reach=_REACH[coarse],
            halvings=self._halvings + finely,
            finest=finest / (1 + finely),
            coarse=coarse,
            near=None if anew else self._samples,
        )
        return samples, samples.table()

    def at(self, values: Mapping[str, float]) -> LensTable:
        """The light of a lens near the table's."""
        return eqx.tree_at(lambda table: table.moved, self._table, jnp.asarray(self.moved(values)))

    def reach_mm(self, distance: float) -> float:
        """Radius within which all light is, at a distance from the tip."""
        assert self._table is not None
        return float(np.asarray(self._table.grid.envelope(distance)))

    def follow(self, values: Mapping[str, float], *, learning: bool = False) -> None:
        """Compute the table anew if a free parameter of the lens has changed by much."""
        if self._is_beyond(_FIRST_ORDER if learning else _FAR, values):
            self.tabulate(values, coarse=self._coarse)

    def _is_beyond(self, change: float, values: Mapping[str, float]) -> bool:
        # A rim below the core's face is that of the noise: no table has one.
        values = {**values, "rim_height": max(values["rim_height"], 0.0)}
        sizes = {name: abs(self._at[name]) for name in self._by}
        if "rim_height" in sizes:  # which may be 0
            sizes["rim_height"] = max(sizes["rim_height"], self._at["aperture_radius"])
        rim, flat = values["aperture_radius"], FLATTEST * values["aperture_radius"]
        if "sag" in sizes and sizes["sag"] < flat:
            sizes["sag"] = flat
            # No light shows the rim of a flat end around its core.
            if min(rim, self._at["aperture_radius"]) >= CLEAR * values["core_radius"]:
                sizes["aperture_radius"] = math.inf
        return bool(np.any(np.abs(self.moved(values)) > change * np.array([*sizes.values()])))

    def moved(self, values: Mapping[str, float]) -> Float[np.ndarray, "p"]:
        """Differences of the lens's parameters from those of the table.

        The light is nearly linear in the cap's curvature and chord (see `cap_shape`), so what has
        moved are the changes of sag and rim to first order in these.
        """
        moved = {name: values[name] - self._at[name] for name in self._by}
        if "sag" in moved:
            reshaped = np.subtract(cap_shape(values), cap_shape(self._at))
            moved |= zip(CAP, cap_slopes(self._at) @ reshaped, strict=True)
        return np.array([*moved.values()])

    def slopes(self, values: Mapping[str, float]) -> Float[np.ndarray, "p q"]:
        """Derivatives of what has `moved` by the lens's free parameters."""
        slopes = np.eye(len(self._by))
        if "sag" in self._by:
            cap = [self._by.index(name) for name in CAP]
            slopes[np.ix_(cap, cap)] = cap_slopes(self._at) @ np.linalg.inv(cap_slopes(values))
        return slopes[:, : len(self.free)]


CAP = ("sag", "aperture_radius")


def cap_shape(values: Mapping[str, float]) -> tuple[float, float]:
    """A cap's curvature, 1/mm, and its chord from the apex to the rim, mm.

    Both are regular for every cap, from a flat end to a half ball, whose rim does not change with
    the chord.
    """
    square = values["sag"] ** 2 + values["aperture_radius"] ** 2
    return 2.0 * values["sag"] / square, math.sqrt(square)


def cap_of(shape: Float[np.ndarray, "2"]) -> tuple[float, float]:
    """Sag and rim's radius of a cap with this `cap_shape`; a rim of 0 if there is none."""
    curvature, chord = shape.tolist()
    sag = 0.5 * curvature * chord**2
    return sag, math.sqrt(max(chord**2 - sag**2, 0.0))


def cap_sag(curvature: float, rim: float) -> float:
    """Sag of a cap with this curvature, 1/mm, and rim's radius, mm, which is below 1/curvature."""
    return curvature * rim**2 / (1.0 + math.sqrt(1.0 - (curvature * rim) ** 2))


def cap_slopes(values: Mapping[str, float]) -> Float[np.ndarray, "2 2"]:
    """Derivatives of sag and rim's radius by curvature and chord."""
    curvature, chord = cap_shape(values)
    sag, rim = (values[name] for name in CAP)
    of_sag = np.array([0.5 * chord**2, curvature * chord])
    return np.array([of_sag, (np.array([0.0, chord]) - sag * of_sag) / rim])


class Coordinates(NamedTuple):
    """What a fit steps in: its free parameters, over the sizes of steps.

    In place of sag and rim it is the cap's `cap_shape` if both are free. The light follows the
    curvature, so the valley of equal light is almost straight.

    Attributes:
        names: of the free parameters.
        steps: their sizes.
        least_rim: over the core, of a cap whose sag is free as well.
    """

    names: tuple[str, ...]
    steps: Float[np.ndarray, "p"]
    least_rim: float = CLEAR

    @classmethod
    def sized(
        cls,
        names: tuple[str, ...],
        sizes: Float[np.ndarray, "p"],
        values: Mapping[str, float],
    ) -> Self:
        """Coordinates whose steps change the parameters by their sizes, at some values."""
        steps = sizes.copy()
        if set(CAP) <= set(names):
            steps[names.index("sag")] /= cap_slopes(values)[0, 0]
        return cls(names, steps)

    @property
    def shapes_cap(self) -> bool:
        """Whether sag and rim are both free."""
        return set(CAP) <= set(self.names)

    def of(self, values: Mapping[str, float]) -> Float[np.ndarray, "p"]:
        """The coordinates of the parameters."""
        own = dict(values)
        if self.shapes_cap:
            own |= zip(CAP, cap_shape(values), strict=True)
        return np.array([own[name] for name in self.names]) / self.steps

    def values(self, at: Float[np.ndarray, "p"], others: Mapping[str, float]) -> dict[str, float]:
        """All parameters at these coordinates; those that are not free are as in `others`."""
        own = dict(zip(self.names, (at * self.steps).tolist(), strict=True))
        if self.shapes_cap:
            curvature, chord = (own[name] for name in CAP)
            sag, rim = cap_of(np.array([curvature, chord]))
            least = self.least_rim * {**others, **own}["core_radius"]
            if rim < least and abs(curvature) * least < 1.0:
                sag, rim = cap_sag(curvature, least), least
            own |= zip(CAP, (sag, rim), strict=True)
        return {**others, **own}

    def slopes(self, values: Mapping[str, float]) -> Float[np.ndarray, "p p"]:
        """Derivatives of the free parameters by their coordinates."""
        slopes = np.eye(len(self.names))
        if self.shapes_cap:
            cap = [self.names.index(name) for name in CAP]
            slopes[np.ix_(cap, cap)] = cap_slopes(values)
        return slopes * self.steps

    def is_at_bound(self, values: Mapping[str, float]) -> bool:
        """Whether the rim of a free cap is the least that it may be."""
        if not self.shapes_cap:
            return False
        return values["aperture_radius"] <= (1.0 + 1e-9) * self.least_rim * values["core_radius"]

    def within_bound(self, found: NormalEquations, values: Mapping[str, float]) -> NormalEquations:
        """The equations of a step that keeps the rim at its bound, where it would go inside.

        A step then changes the chord only as curvature and core demand it.
        """
        if not self.is_at_bound(values):
            return found
        at = self.names.index("aperture_radius")
        if found.gradient[at] <= 0.0:
            return found
        rim = self.slopes(values)[at]
        along = np.eye(len(found.gradient))
        along[at, : len(rim)] = -rim / rim[at]
        if "core_radius" in self.names:
            core = self.names.index("core_radius")
            along[at, core] += self.least_rim * self.steps[core] / rim[at]
        along[at, at] = 0.0
        information = along.T @ found.information @ along
        information[at, at] = 1.0
        return NormalEquations(found.cost, along.T @ found.gradient, information)
