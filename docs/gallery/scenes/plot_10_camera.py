"""
A cheap camera
==============

A Bayer filter, noise of a small full well, and JPEG as in USB video.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "camera.bayer=RGGB",
        "camera.full_well_e=1500",
        "camera.jpeg_quality=50",
        "camera.response=srgb",
        "source.kind=cone",
        "motion.start_mm=2",
        "microscope.illumination_mw_mm2=0.3",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
