"""
Measure spots, read distances
=============================

A withdrawal 3 mm from the axis of a microscope 200 mm above the eye: a spot with its ellipse, the
semi-minor axis by the sub-pixel estimator and by the paper's tracker, which takes a fixed grey
level and whole pixels, and the distance by the small-plane model and by the exact geometry.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

import eyespot
from formats.calibration import write_calibration
from scenes.world.labels import true_calibration

folder = Path(mkdtemp())
changes = ["source.kind=cone", "spot.eccentricity_mm=3", "spot.incidence_deg=0"]
motion = ["motion.start_mm=1", "motion.travel_mm=4", "motion.frames=9"]
view = ["microscope.pinhole_height_mm=200", 'exposures.kinds=["metered"]']
scene = eyespot.load_scene(None, [*changes, *motion, *view])
stack = eyespot.render(scene, folder / "stack")
write_calibration(folder / "cone.json", true_calibration(scene))
true = np.array([(label.d_mm, label.cone_semi_minor_px) for label in stack.labels]).T

figure, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
literal = eyespot.track(stack.folder, mode="literal", settings={"threshold": 60})
spots = eyespot.track(stack.folder)
for name, found in (("literal", literal), ("sub-pixel", spots)):
    middle.plot(true[0], found.semi_minor_px - true[1], "o-", label=name)
spot = spots.to_dict("records")[3]
at, axes = (spot["x_px"], spot["y_px"]), (2 * spot["semi_major_px"], 2 * spot["semi_minor_px"])
left.imshow(stack.image(stack.labels[3]))
left.add_patch(Ellipse(at, *axes, angle=np.degrees(spot["angle_rad"]), fill=False, color="w"))
left.set_title(f"{axes[1] / 2:.2f} ± {spot['sigma_semi_minor_px']:.2f} px")
left.axis("off")
for model in ("small_plane", "exact"):
    read = eyespot.track(stack.folder, calibration=folder / "cone.json", model=model)
    right.plot(true[0], read.distance_mm - true[0], "o-", label=model)
middle.set(xlabel="true distance (mm)", ylabel="error of the semi-minor axis (px)")
right.set(xlabel="true distance (mm)", ylabel="error of the distance (mm)")
middle.legend()
right.legend()
plt.show()
