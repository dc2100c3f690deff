"""
Mitsuba as a JAX function
=========================

How the image changes when the drop becomes higher: the derivative of the rendered photons, which an
optimiser in JAX can use.
"""

import matplotlib.pyplot as plt

from eyespot.scenes import load_mitsuba, load_scene

load_mitsuba()  # before anything that imports Mitsuba
from eyespot.scenes.rendering.differentiable import PhotonImage  # noqa: E402

changes = ["source.lens=dome", "motion.start_mm=2", "instrument.visible=false"]
size = ["microscope.width_px=160", "microscope.height_px=120", "microscope.scale_mm_px=0.027"]
photons = PhotonImage(load_scene(None, [*changes, *size]), free=("sag",), photons=1 << 20)
image, jacobian = photons.value_and_jacobian(photons.start)
figure, panels = plt.subplots(1, 2, layout="constrained", figsize=(8, 3))
for panel, values, title in zip(
    panels, (image, jacobian[..., 0]), ("image", "d/d sag"), strict=True
):
    green = values[..., 1]
    limit = abs(green).max()
    panel.imshow(green, cmap="RdBu_r", vmin=-limit, vmax=limit)
    panel.set_title(title)
    panel.axis("off")
plt.show()
