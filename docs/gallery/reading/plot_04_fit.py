"""
Fit a cone to a withdrawal
==========================

Half-angle and apex of a rendered cone from the spots of one withdrawal, with their standard errors.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

from eyespot.calibration import fit_cone
from eyespot.calibration.recorded_trial import recorded_trial
from eyespot.scenes import load_scene, render_stack

changes = ["source.kind=cone", "motion.frames=13", "phantom.wall=uniform"]
scene = load_scene(None, [*changes, 'exposures.kinds=["metered"]'])
stack = render_stack(scene, Path(mkdtemp()) / "withdrawal")
recording = recorded_trial(stack)
fit = fit_cone(
    [recording.trial], recording.microscope.pinhole(), start={"half_angle": 0.06, "b": -4.0}
)
(angle, b), sigma = (fit.values[name] for name in fit.free), np.sqrt(np.diag(fit.covariance))
plt.errorbar(np.degrees(angle), b, np.degrees(sigma[0]), sigma[1], fmt="o", label="fit, 1 σ")
plt.plot(np.degrees(np.arctan(1 / 20)), -5.117, "x", label="rendered")
plt.gca().ticklabel_format(useOffset=False)
plt.xlabel("half-angle (°)")
plt.ylabel("b (mm)")
plt.legend()
plt.show()
