"""
Measure a spot
==============

The sub-pixel estimator on one image: the ellipse at half of the spot's peak, with its standard
error.
"""

import matplotlib.pyplot as plt
from matplotlib.patches import Ellipse

from estimator import Spot, SubpixelSettings, TrackState, measure
from scenes import load_scene, render_image

image = render_image(
    load_scene(None, ["source.lens=dome", "motion.start_mm=2", "motion.travel_mm=1"]),
    exposure="metered",
)
spot, *_ = measure(image, TrackState(), SubpixelSettings())
assert isinstance(spot, Spot)
plt.imshow(image)
outline = Ellipse(
    (spot.x_px, spot.y_px),
    2 * spot.semi_major_px,
    2 * spot.semi_minor_px,
    angle=spot.angle_rad * 180 / 3.14159265,
    fill=False,
    color="w",
)
plt.gca().add_patch(outline)
plt.title(f"semi-minor axis {spot.semi_minor_px:.2f} ± {spot.sigma_semi_minor_px:.2f} px")
plt.axis("off")
plt.show()
