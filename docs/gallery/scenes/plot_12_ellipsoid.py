"""
A retina that is no sphere
==========================

The eyeball may be an ellipsoid, tilted and shifted.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "phantom.stretch=[1.08, 0.95]",
        "phantom.tilt_deg=5",
        "phantom.shift_mm=[0.3, 0.0]",
        "spot.eccentricity_mm=4",
        "source.kind=cone",
        "motion.start_mm=2",
        "spot.incidence_deg=10",
        "microscope.illumination_mw_mm2=0.3",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
