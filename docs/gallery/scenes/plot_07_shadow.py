"""
The instrument's shadow
=======================

With light from all sides the instrument shades the wall below it. Tracing the indirect light
takes seconds a frame.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "phantom.indirect=traced",
        "microscope.light=ambient",
        "microscope.illumination_mw_mm2=0.3",
        "source.kind=cone",
        "motion.start_mm=1",
        "microscope.scale_mm_px=0.0134",
        "microscope.width_px=320",
        "microscope.height_px=240",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
