"""Positions and sizes of fovea and optic disc on the map of a fundus.

The map is flat and metric: the point (x, y) lies at the arc length hypot(x, y) mm from the retinal
pole, in the direction atan2(y, x) (azimuthal-equidistant coordinates). On the sphere they are
undistorted at the pole; on a plane they are plain coordinates. +x is the eye frame's +X, +y its +Y.
The first row of an image has the largest y. So the image is a right eye's fundus photograph: the
disc lies right of the pole (nasal), the fovea left of it (temporal) and slightly lower.
"""

from __future__ import annotations

import math

FOVEA_MM = (-1.5, -0.2)
"""1.5 mm temporal of the pole: angle alpha, 5 degrees (Atchison & Smith 2000)."""
DISC_MM = (
    FOVEA_MM[0] + 4.76 * math.cos(math.radians(5.6)),
    FOVEA_MM[1] + 4.76 * math.sin(math.radians(5.6)),
)
"""4.76 mm from the fovea, 5.6 degrees up (Jonas et al. 2015; Rohrschneider 2004)."""
DISC_SEMI_AXES_MM = (1.77 / 2, 1.88 / 2)
"""Quigley et al. 1990."""
CUP_TO_DISC = 0.43
"""Diameter of the cup over that of the disc (Healey et al. 1997)."""
