"""
A hand moves the tip
====================

A hand with tremor moves the tip; the exposure blurs the spot. Four moments of one scene.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    ["motion.kind=hand", "motion.duration_s=2", "motion.distance_mm=2", "source.kind=cone"],
)
figure, panels = plt.subplots(2, 2, layout="constrained")
for panel, frame in zip(panels.flat, (0, 5, 10, 15), strict=True):
    panel.imshow(render_image(scene, frame=frame, exposure="paper"))
    panel.set_title(f"{frame / scene.clocks.camera_hz:.1f} s")
    panel.axis("off")
plt.show()
