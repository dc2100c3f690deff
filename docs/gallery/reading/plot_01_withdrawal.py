"""
Measure spots, read distances
=============================

A withdrawal 3 mm from the axis of a microscope 200 mm above the eye. Left: the semi-minor axis by
the sub-pixel estimator, and by the paper's tracker, which takes a fixed grey level and whole
pixels. Right: the distance by the small-plane model, and by the exact geometry.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import eyespot
from eyespot.formats.calibration import write_calibration
from eyespot.scenes.world.true_calibration import true_calibration

folder = Path(mkdtemp())
place = ["source.kind=cone", "spot.eccentricity_mm=3", "spot.incidence_deg=0", "motion.frames=9"]
view = ["microscope.pinhole_height_mm=200", "motion.start_mm=1", "motion.travel_mm=4"]
scene = eyespot.load_scene(None, [*place, *view])
stack = eyespot.render(scene, folder / "stack")
write_calibration(folder / "cone.json", true_calibration(scene))
true = np.array([(label.d_mm, label.cone_semi_minor_px) for label in stack.exposed("metered")]).T

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
literal = eyespot.track(stack.folder, mode="literal", settings={"threshold": 60})
for name, spots in (("literal", literal), ("sub-pixel", eyespot.track(stack.folder))):
    left.plot(true[0], spots.semi_minor_px - true[1], "o-", label=name)
for model in ("small_plane", "exact"):
    spots = eyespot.track(stack.folder, calibration=folder / "cone.json", model=model)
    right.plot(true[0], spots.distance_mm - true[0], "o-", label=model)
for panel, name in ((left, "semi-minor axis (px)"), (right, "distance (mm)")):
    panel.set(xlabel="true distance (mm)", ylabel=f"error of the {name}")
    panel.legend()
plt.show()
