"""
A second tool
=============

Another tool hides a part of the wall and of the spot.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "second_tool.visible=true",
        "second_tool.tip_mm=[-0.6, 0.5, -10.5]",
        "source.kind=cone",
        "motion.start_mm=3",
        "microscope.illumination_mw_mm2=0.3",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
