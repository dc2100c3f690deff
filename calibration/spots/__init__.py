"""Fits to the ellipses of spots.

cone_fit      Fit of the exact geometry to measured ellipses, with nuisances per trial
cone_trials   Data, nuisances and residuals of the exact geometry
eye_priors    What is known of an eye and its viewing lens before they are calibrated
lines         The paper's line d_r = delta k e1' + b for many trials at once, without errors
plane_fit     delta k and b of one withdrawal from a plane: Table I of Zhou et al. 2020
plane_trials  One line through several trials, with touches and the plane's tilt as nuisances
sphere_fit    c of one withdrawal in an eyeball: Table II of Zhou et al. 2020
tool_pose     The pose of a tool with one or several cones of light, from all spots together
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
