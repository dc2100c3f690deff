"""
What a wall that spreads light does
===================================

Light that spreads sideways in the wall moves the place where half of a cone's light is seen
inwards, and with it the distance that is read. Three cones of light on a plane.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

from eyespot import optics

beam = {"half_angle": np.arctan(1 / 20), "apex_offset": -5.117}
wall = optics.pole_plane(eye_radius=11.5)
view = optics.microscope(scale=0.0067, pinhole_height=200.0, eye_radius=11.5)
lengths = np.linspace(0.01, 0.1, 7)
for distance in (0.5, 2.0, 5.0):
    spot = optics.beam_at_spot(
        wall,
        eccentricity=0.0,
        azimuth=0.0,
        incidence=0.0,
        incidence_azimuth=0.0,
        distance=distance,
        **beam,
    )
    one = jax.tree.map(lambda x: x[None], spot)
    sharp = float(optics.spot_ellipse(spot, wall, view).semi_minor)
    seen = [optics.spread_spots(wall, view, None, one, length) for length in lengths]
    error = [(float(found.half_max.semi_minor[0]) - sharp) * 0.0067 * 20 for found in seen]
    plt.plot(lengths * 1e3, error, label=f"{distance:g} mm")
plt.xlabel("length of the spread (µm)")
plt.ylabel("change of the distance (mm)")
plt.legend(title="distance")
plt.show()
