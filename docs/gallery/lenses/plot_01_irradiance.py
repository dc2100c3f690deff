"""
Where the light of a drop goes
==============================

Irradiance on planes behind the lens `dome`. Vitreous has nearly the index of the glue, so that the
drop hardly focuses there.
"""

import matplotlib.pyplot as plt
import numpy as np

from eyespot import optics
from eyespot.scenes.world.world import lens_light

distance, radius = np.meshgrid(np.linspace(0.02, 6, 300), np.linspace(-1.2, 1.2, 241))
figure, panels = plt.subplots(2, sharex=True, layout="constrained")
for panel, medium in zip(panels, ("air", "vitreous"), strict=True):
    light = lens_light("dome", optics.MEDIA[medium]).table
    irradiance = light(radius=np.abs(radius), distance=distance)[1]
    level = np.log10(np.maximum(irradiance, 1e-3))
    image = panel.pcolormesh(distance, radius, level, cmap="magma", vmin=-2, vmax=2)
    panel.set(title=medium, ylabel="from the axis (mm)")
panels[-1].set_xlabel("distance from the tip (mm)")
figure.colorbar(image, ax=panels, label="log10 of irradiance for 1 mW (mW/mm²)")
plt.show()
