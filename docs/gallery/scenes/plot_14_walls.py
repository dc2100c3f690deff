"""
Four walls
==========

The same lens over an even wall, a printed retina, a drawn living one, and a photograph.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

figure, panels = plt.subplots(1, 4, layout="constrained", figsize=(9, 2.2))
for panel, wall in zip(panels, ("uniform", "printed paper", "retina", "photograph"), strict=True):
    changes = [
        f"phantom.wall={wall}",
        "source.lens=dome",
        "motion.start_mm=2",
        "motion.travel_mm=1",
    ]
    light = "microscope.illumination_mw_mm2=0.3"
    panel.imshow(render_image(load_scene(None, [*changes, light]), exposure="metered"))
    panel.set_title(wall)
    panel.axis("off")
plt.show()
