"""
One radius, several distances
=============================

The half-maximum radius of `dome` in air is not monotonic: in the shaded ranges one radius belongs
to several distances, which the outline alone does not distinguish.
"""

import matplotlib.pyplot as plt
import numpy as np

from eyespot import optics
from eyespot.scenes.world.world import lens_light

distance = np.linspace(0.05, 6, 400)
light = lens_light("dome", optics.MEDIA["air"]).table
plt.plot(distance, optics.half_maximum_radius(light, distance=distance))
for ends in optics.ambiguous_distances(light, from_distance=0.05, to_distance=6):
    plt.axvspan(*ends, alpha=0.15)
plt.xlabel("distance (mm)")
plt.ylabel("half-maximum radius (mm)")
plt.show()
