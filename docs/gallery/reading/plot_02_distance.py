"""
Distances of a withdrawal
=========================

A rendered withdrawal 3 mm from the axis, read with the true cone by two models: the small-plane
model is off, the exact geometry is not.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt

from estimator import Ranger, Spot, SubpixelSettings, TrackState, measure, read_microscope
from scenes import load_scene, render_stack
from scenes.world import true_calibration

changes = ["source.kind=cone", "spot.eccentricity_mm=3", "spot.incidence_deg=0"]
view = ["microscope.pinhole_height_mm=200", "motion.frames=13", 'exposures.kinds=["metered"]']
scene = load_scene(None, [*changes, *view])
stack = render_stack(scene, Path(mkdtemp()) / "withdrawal")
spots = [measure(image, TrackState(), SubpixelSettings())[0] for image in stack.images("metered")]
microscope = read_microscope(stack.folder / "microscope.json")
for model in ("small_plane", "exact"):
    ranger = Ranger(true_calibration(scene), microscope, model=model, eccentricity_mm=3.0)
    pairs = [(x.d_mm, s) for x, s in zip(stack.labels, spots, strict=True) if isinstance(s, Spot)]
    errors = [ranger.distance(spot).distance_mm - true for true, spot in pairs]
    plt.plot([true for true, _ in pairs], errors, "o-", label=model)
plt.xlabel("true distance (mm)")
plt.ylabel("error (mm)")
plt.legend()
plt.show()
