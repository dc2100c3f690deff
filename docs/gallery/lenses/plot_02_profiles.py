"""
Profiles of a spot
==================

Irradiance of `paper-candidate` in air at three distances, and the radius at half of the peak. Near
the tip the light has a core, farther away it is a bell.
"""

import matplotlib.pyplot as plt
import numpy as np

import optics
from scenes.world import lens_light

light = lens_light("paper-candidate", optics.MEDIA["air"]).table
radius = np.linspace(0, 1.2, 400)
for distance in (1.0, 3.0, 5.0):
    profile = np.asarray(light(radius=radius, distance=distance)[1])
    (line,) = plt.plot(radius, profile / profile.max(), label=f"{distance:g} mm")
    half = optics.half_maximum_radius(light, distance=distance)
    plt.plot(half, 0.5, "o", color=line.get_color())
plt.xlabel("radius on the plane (mm)")
plt.ylabel("irradiance over its peak")
plt.legend(title="distance")
plt.show()
