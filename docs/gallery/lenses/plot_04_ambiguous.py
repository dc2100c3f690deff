"""
One radius, several distances
=============================

The half-maximum radius of a drop in air is not monotonic: in the shaded ranges one radius belongs
to several distances, and only motion tells them apart.
"""

import matplotlib.pyplot as plt
import numpy as np

import optics
from scenes.world.world import lens_light

distance = np.linspace(0.05, 6, 400)
for name, colour in (("dome", "tab:blue"), ("paper-candidate", "tab:red")):
    light = lens_light(name, optics.MEDIA["air"]).table
    plt.plot(distance, optics.half_maximum_radius(light, distance=distance), colour, label=name)
    for ends in optics.ambiguous_distances(light, from_distance=0.05, to_distance=6):
        plt.axvspan(*ends, color=colour, alpha=0.15)
plt.xlabel("distance (mm)")
plt.ylabel("half-maximum radius (mm)")
plt.legend()
plt.show()
