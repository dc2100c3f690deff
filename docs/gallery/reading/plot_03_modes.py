"""
The paper's tracker and the sub-pixel one
=========================================

Errors of the semi-minor axis on a withdrawal over printed paper. The paper's tracker takes a fixed
grey level and whole pixels; for a cone, its radius is off by about half a pixel.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt

from estimator import LiteralSettings, Spot, SubpixelSettings, TrackState, measure
from scenes import load_scene, render_stack

scene = load_scene(None, ["source.kind=cone", "motion.frames=25", 'exposures.kinds=["metered"]'])
stack = render_stack(scene, Path(mkdtemp()) / "withdrawal")
for name, settings in (("literal", LiteralSettings()), ("sub-pixel", SubpixelSettings())):
    errors = []
    for label in stack.labels:
        spot, *_ = measure(stack.image(label), TrackState(), settings)
        if isinstance(spot, Spot):
            errors.append((label.d_mm, spot.semi_minor_px - label.cone_semi_minor_px))
    plt.plot(*zip(*errors, strict=True), "o-", label=name)
plt.xlabel("distance (mm)")
plt.ylabel("error of the semi-minor axis (px)")
plt.legend()
plt.show()
