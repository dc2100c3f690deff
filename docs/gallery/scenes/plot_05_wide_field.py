"""
Through a wide-field lens
=========================

The image through a wide-field lens is inverted; `viewing.upright = true` turns it back, as a
stereo inverter does.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "viewing.eye=navarro",
        "viewing.lens=wide-field-90",
        "source.medium=vitreous",
        "microscope.pinhole_height_mm=200",
        "phantom.wall=retina",
        "spot.eccentricity_mm=3",
        "spot.incidence_deg=10",
        "motion.start_mm=3",
        "microscope.scale_mm_px=0.015",
        "microscope.illumination_mw_mm2=0.3",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
