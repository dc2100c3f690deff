"""
A cone of light on a drawn retina
=================================

The default scene with an ideal cone. The instrument stands in front of a part of the wall.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "source.kind=cone",
        "phantom.wall=retina",
        "motion.start_mm=2",
        "microscope.illumination_mw_mm2=0.3",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
