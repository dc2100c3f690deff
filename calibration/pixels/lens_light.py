"""The table of a lens's light in a running fit: when it is computed anew, and how finely."""

from __future__ import annotations

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from calibration.pixels.data import Footage
from calibration.pixels.parameters import LENS
from optics.wall_light import LensSamples, LensTable, halvings_for, lens_samples

NEAREST_MM = 0.3
"""Least distance from the tip's plane at which a table is valid."""
_MARGIN_MM = 1.0  # the wall is oblique, so parts of it are nearer and farther than on the axis
_REACH = {True: 1.6, False: 1.05}
"""Size of a table over the light's envelope, for coarse and for exact tables."""
_FINEST_PX = 0.17
"""Width of a table's cells, in pixels, below which they are not halved. The model averages over
pixels, but wide cells blur a sharp image of the core. On counted photons (number 1 of
`tests.photon_fits coverage`) a whole pixel biases NA by a standard error, 0.25 px by 0.3 and 0.17
px by 0.05, compared with 0.1 px."""
_HALVINGS = 6
"""Least number of halvings of a table's cells: tables of one shape need one compilation for all
lenses of small frames."""
_FAR = 0.05
"""Relative change of a lens's parameter beyond which a table, linear in it, is computed anew while
a fit is on its way. Its result is confirmed with a table that is much nearer."""
_NEAR_BY = 0.002
"""Relative change up to which a table is computed from the last one. Up to 5 % the fit of a sharp
image of the core (`tests.photon_fits examples`) had a sag ten sigma of the noise off."""
FLATTEST = 0.02
"""Sag over the aperture's radius below which the end is nearly flat, and changes of the sag count
as parts of this. The light is then linear in the sag, through zero, where the cap turns hollow."""
_FLAT_MM = 1e-5  # least sag of a table


class LensLight:
    """The light of a fit's lens, to first order around the parameters of its last table.

    Args:
        footage: the frames.
        names: names of the fit's free parameters.
    """

    def __init__(self, footage: Footage, names: tuple[str, ...]) -> None:
        self.footage = footage
        self.free = tuple(name for name in names if name in LENS)
        self._table: LensTable | None = None
        self._samples: LensSamples | None = None
        self._coarse = True
        self._at: dict[str, float] = {}
        self._halvings: int | None = None

    def tabulate(self, values: Mapping[str, float], *, coarse: bool) -> None:
        """Compute the table at these values of all parameters, unless it is the last one."""
        at = {name: values[name] for name in (*LENS, "touch")}
        at["sag"] = max(at["sag"], _FLAT_MM)
        if (at, coarse) == (self._at, self._coarse):
            return
        anew = coarse or self._coarse or self._is_beyond(_NEAR_BY, values)
        lens = {name: at[name] for name in LENS}
        farthest = float(self.footage.readings.max() + values["touch"]) + _MARGIN_MM
        least = float(self.footage.readings.min() + values["touch"])
        finest = _FINEST_PX * self.footage.microscope.scale_mm_px
        medium = self.footage.medium_index
        if self._halvings is None:
            # The same for the whole fit: tables of one shape need one compilation.
            needed = halvings_for(lens, medium_index=medium, farthest=farthest, finest=finest)
            self._halvings = max(_HALVINGS, needed)
        self._samples = lens_samples(
            lens,
            self.free,
            medium_index=medium,
            nearest=max(NEAREST_MM, least - _MARGIN_MM),
            farthest=farthest,
            reach=_REACH[coarse],
            halvings=self._halvings,
            finest=finest,
            coarse=coarse,
            near=None if anew else self._samples,
        )
        self._table = self._samples.table()
        self._at, self._coarse = at, coarse

    def at(self, values: Mapping[str, float]) -> LensTable:
        """The light of a lens near the table's."""
        return eqx.tree_at(lambda table: table.moved, self._table, jnp.asarray(self.moved(values)))

    def reach_mm(self, distance: float) -> float:
        """Radius within which all light is, at a distance from the tip."""
        assert self._table is not None
        grid = self._table.grid
        return float(np.asarray(grid.contact_radius) + np.asarray(grid.slope) * distance)

    def follow(self, values: Mapping[str, float]) -> None:
        """Compute the table anew if a free parameter of the lens has changed by much."""
        if self._is_beyond(_FAR, values):
            self.tabulate(values, coarse=self._coarse)

    def _is_beyond(self, change: float, values: Mapping[str, float]) -> bool:
        least = {"sag": FLATTEST * values["aperture_radius"]}
        at = np.array([max(abs(self._at[name]), least.get(name, 0.0)) for name in self.free])
        return bool(np.any(np.abs(self.moved(values)) > change * at))

    def moved(self, values: Mapping[str, float]) -> Float[np.ndarray, "p"]:
        """Differences of the lens's free parameters from those of the table."""
        return np.array([values[name] - self._at[name] for name in self.free])
