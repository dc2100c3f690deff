"""What is known of an eye and its viewing lens before they are calibrated."""

from calibration.spots.cone_trials import Prior

RETINA = Prior(13.0, 1.0)
"""Radius of curvature of the retina, mm: a horizontal semi-axis squared over the axial one, 13.4 ±
1.2 mm in a healthy population (Rozema et al. 2016), 12.9 mm in emmetropes (Atchison 2006)."""

SIZE_PER_MM = 0.00065
"""Part by which the best pinhole over a sphere misses the size of a spot, per mm of c.

Root mean square over random eyes behind a flat contact lens, c from 0.5 to 3.5 mm, tilts of 0 and
25 degrees. Most of it comes from the retina, which is no sphere."""

OUTLINE_PER_MM = 0.0001
"""Part of a spot's size by which that pinhole then misses its outline in each frame, per mm of c.

Root mean square over random eyes, perpendicular beams, withdrawals at c = 1, 3 and 5 mm. It is a
tenth of the noise of real frames, and all that is left in frames without noise."""
