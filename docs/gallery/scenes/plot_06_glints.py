"""
Glints of a wet wall
====================

A film of water reflects the coaxial light and the spot like a mirror.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "phantom.coat=wet",
        "phantom.wall=retina",
        "source.kind=cone",
        "motion.start_mm=3",
        "microscope.light=ambient",
        "microscope.illumination_mw_mm2=0.3",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
