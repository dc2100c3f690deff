"""How far walls scatter light sideways: lengths for each colour, with their sources."""

from __future__ import annotations

import numpy as np

from scenes.description import Phantom

_PAPER_PERIOD_MM = 0.2
"""Period at which paper has half of its modulation, mm.

Arney, Chauvin, Nauman & Anderson, "Kubelka-Munk theory and the MTF of paper", J. Imaging Sci.
Technol. 47, 339 (2003) measure it as kappa_p with projected edges; J. S. Arney gives 0.15-0.35 mm
for all papers that he saw and 0.2 mm as usual. The length hardly depends on the colour (Namedanian,
Gooran & Nystrom 2011).
"""

PRESETS_MM = {
    # The modulation (1 + (2 pi L/period)^2)^(-3/2) is one half there.
    "printed paper": (np.sqrt(4.0 ** (1 / 3) - 1.0) / (2 * np.pi) * _PAPER_PERIOD_MM,) * 3,
}
"""L for red, green and blue, mm.

The retina has no entry: its layers were measured one by one on excised tissue (Hammer et al. 1995),
and no spread of the whole fundus, which the choroid's absorption and the sclera's depth decide, was
found that could be checked.
"""


def wall_spread(phantom: Phantom) -> np.ndarray | None:
    """L for red, green and blue, mm; None if light leaves the wall where it arrives."""
    if phantom.spread == "none":
        return None
    return np.array(PRESETS_MM.get(phantom.spread, phantom.spread_mm))
