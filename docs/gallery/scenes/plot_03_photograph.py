"""
A photograph as the wall
========================

A part of a fundus photograph (Häggström 2014, CC0) comes with eyespot; any image file can be the
wall (wall = `image`).
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "phantom.wall=photograph",
        "source.medium=vitreous",
        "motion.start_mm=3",
        "microscope.illumination_mw_mm2=0.3",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
