"""
Through a flat contact lens, and through a wide-field lens
==========================================================

The microscope looks through a lens, the cornea and the crystalline lens of Navarro's eye. The image
through a wide-field lens is inverted; `viewing.upright = true` turns it back.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

common = [
    "viewing.eye=navarro",
    "source.medium=vitreous",
    "microscope.pinhole_height_mm=200",
    "phantom.wall=retina",
    "spot.incidence_deg=10",
    "motion.start_mm=2",
    "microscope.illumination_mw_mm2=0.3",
]
flat = ["viewing.lens=flat", "viewing.pupil_mm=14", "spot.eccentricity_mm=4"]
wide = ["viewing.lens=wide-field-90", "spot.eccentricity_mm=3", "microscope.scale_mm_px=0.015"]
figure, panels = plt.subplots(1, 2, layout="constrained")
for panel, lens in zip(panels, (flat, wide), strict=True):
    panel.imshow(render_image(load_scene(None, [*common, *lens]), exposure="metered"))
    panel.axis("off")
plt.show()
