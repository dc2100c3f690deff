"""
What makes a distance uncertain
===============================

The parts of the uncertainty of one distance, for a calibration, an eye and a robot that are known
as well as stated.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

from estimator import Budgets, Ranger, Spot, Stated, SubpixelSettings, TrackState, measure
from estimator.files import read_microscope
from scenes import load_scene, render_stack
from scenes.world import true_calibration

changes = ["source.kind=cone", "spot.eccentricity_mm=3", "motion.start_mm=3", "motion.frames=2"]
scene = load_scene(None, [*changes, 'exposures.kinds=["metered"]'])
stack = render_stack(scene, Path(mkdtemp()) / "stack")
spot, *_ = measure(next(stack.images("metered")), TrackState(), SubpixelSettings())
assert isinstance(spot, Spot)
known = Stated(eye_radius_sigma_mm=0.2, inverse_working_distance_sigma=0.001, touch_sigma_mm=0.02)
ranger = Ranger(
    true_calibration(scene), read_microscope(stack.folder / "microscope.json"), model="corrected"
)
budget = Budgets(ranger, known).of(spot, ranger.distance(spot), axis=np.array(stack.labels[0].axis))
assert budget
names = [part.cause.meaning for part in budget.parts]
plt.barh(names, [1e3 * part.sigma_mm for part in budget.parts])
plt.xlabel("standard uncertainty (µm)")
low, high = budget.interval_mm
plt.title(f"true {stack.labels[0].d_mm:.3f} mm, 95 % interval {low:.3f} to {high:.3f} mm")
plt.tight_layout()
plt.show()
