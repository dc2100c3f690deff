"""
How wrong each model is
=======================

A perpendicular cone at a distance of 2 mm, seen from 200 mm above the eye. The error of each
model's distance grows with the distance c of the spot from the microscope's axis.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

from eyespot import optics

eye, cone = optics.Sphere(11.5), {"half_angle": np.arctan(1 / 20), "apex_offset": -5.117}
view = optics.microscope(scale=0.0067, pinhole_height=200.0, eye_radius=11.5)
c = np.linspace(0.0, 6.0, 25)
place = {"azimuth": 0.0, "incidence": 0.0, "incidence_azimuth": 0.0, "distance": 2.0}


@jax.vmap
def semi_minor_px(eccentricity):
    """Half of the shorter axis of the exact spot."""
    beam = optics.beam_at_spot(eye, eccentricity=eccentricity, **place, **cone)
    return optics.spot_ellipse(beam, eye, view).semi_minor


known = {"eye_radius": 11.5, "inverse_working_distance": 1 / 211.5, "k": 20.0, "b": -5.117}
for model in ("planar", "small_plane", "corrected", "stereographic"):
    read = optics.closed_form_distance(
        model, semi_minor_px=semi_minor_px(c), scale=0.0067, eccentricity=c, **known
    )
    plt.plot(c, read - 2.0, label=model)
plt.xlabel("c (mm)")
plt.ylabel("error of the distance (mm)")
plt.legend()
plt.show()
