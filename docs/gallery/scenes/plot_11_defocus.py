"""
Out of focus
============

With a numerical aperture the wall is blurred where it is not in focus.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "microscope.numerical_aperture=0.03",
        "microscope.focus_mm=1.5",
        "microscope.samples=64",
        "source.kind=cone",
        "motion.start_mm=2",
        "phantom.wall=retina",
        "microscope.illumination_mw_mm2=0.3",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
