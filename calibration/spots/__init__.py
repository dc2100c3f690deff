"""Fits to the ellipses of spots.

cone_fit      The exact geometry fitted to measured ellipses: cone, scale, eye, and each trial's
              nuisances
cone_trials   Trials whose ellipses the exact geometry is fitted to, and how far they are from its
              contours
lines         The paper's line d_r = delta k e1' + b through many trials at once
plane_fit     delta k and b of one withdrawal from a plane: Table I of Zhou et al. 2020
plane_trials  The paper's line through several trials at once, with what makes trials differ as
              nuisances
sphere_fit    c of one withdrawal in an eyeball: Table II of Zhou et al. 2020
tool_pose     The pose of a tool with one or several cones of light, from all their spots at once
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
