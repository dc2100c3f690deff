"""
Through a flat contact lens
===========================

The microscope looks through a contact lens, the cornea and the crystalline lens of Navarro's eye,
5 mm from the axis.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "viewing.eye=navarro",
        "viewing.lens=flat",
        "viewing.pupil_mm=14",
        "source.medium=vitreous",
        "microscope.pinhole_height_mm=200",
        "phantom.wall=retina",
        "spot.eccentricity_mm=4",
        "spot.incidence_deg=10",
        "motion.start_mm=2",
        "microscope.illumination_mw_mm2=0.3",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
