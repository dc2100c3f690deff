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

import estimator
from estimator import LiteralSettings, SubpixelSettings, TrackState
from scenes import load_scene, render_stack
from scenes.world import true_calibration

changes = ["source.kind=cone", "spot.eccentricity_mm=3", "spot.incidence_deg=0"]
view = ["microscope.pinhole_height_mm=200", "motion.start_mm=1", "motion.travel_mm=4"]
scene = load_scene(None, [*changes, *view, "motion.frames=9", 'exposures.kinds=["metered"]'])
stack = render_stack(scene, Path(mkdtemp()) / "withdrawal")
microscope = estimator.read_microscope(stack.folder / "microscope.json")
true = np.array([label.d_mm for label in stack.labels])
images = [stack.image(label) for label in stack.labels]
figure, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
literal = LiteralSettings(threshold=60)
for name, settings in (("literal", literal), ("sub-pixel", SubpixelSettings())):
    spots = [estimator.measure(image, TrackState(), settings)[0] for image in images]
    found = np.array([spot.semi_minor_px for spot in spots])
    middle.plot(true, found - [x.cone_semi_minor_px for x in stack.labels], "o-", label=name)
left.imshow(images[3])
turn, at = np.degrees(spots[3].angle_rad), (spots[3].x_px, spots[3].y_px)
axes = (2 * spots[3].semi_major_px, 2 * spots[3].semi_minor_px)
left.add_patch(Ellipse(at, *axes, angle=turn, fill=False, color="w"))
left.set_title(f"{spots[3].semi_minor_px:.2f} ± {spots[3].sigma_semi_minor_px:.2f} px")
left.axis("off")
for model in ("small_plane", "exact"):
    ranger = estimator.Ranger(true_calibration(scene), microscope, model=model, eccentricity_mm=3.0)
    right.plot(true, [ranger.distance(s).distance_mm for s in spots] - true, "o-", label=model)
middle.set(xlabel="true distance (mm)", ylabel="error of the semi-minor axis (px)")
right.set(xlabel="true distance (mm)", ylabel="error of the distance (mm)")
middle.legend()
right.legend()
plt.show()
