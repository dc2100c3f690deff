"""
A drop of glue as a lens
========================

The light of a drop falls off smoothly, so that its spot has no edge. Its half-maximum contour is
what the estimator measures.
"""

import matplotlib.pyplot as plt

from scenes import load_scene, render_image

scene = load_scene(
    None,
    [
        "source.lens=dome",
        "source.medium=vitreous",
        "motion.start_mm=3",
        "microscope.illumination_mw_mm2=0.3",
    ],
)
plt.imshow(render_image(scene, exposure="metered"))
plt.axis("off")
plt.show()
