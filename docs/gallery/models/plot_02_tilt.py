"""
A spot in an eye is not quite an ellipse
========================================

The exact contour of a tilted cone on the eyeball, minus the ellipse fitted to it, a hundred times
enlarged.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt

from eyespot import optics

eye = optics.Sphere(11.5)
view = optics.microscope(scale=0.0067, pinhole_height=200.0, eye_radius=11.5)
beam = optics.beam_at_spot(
    eye,
    eccentricity=5.0,
    azimuth=0.3,
    incidence=0.7,
    incidence_azimuth=1.0,
    distance=5.0,
    half_angle=jnp.arctan(1 / 20),
    apex_offset=-5.117,
)
contour = optics.spot_contour(beam, eye, view, points=128)
ellipse = optics.ellipse_of_contour(contour)
outline = optics.ellipse_points(ellipse, jnp.linspace(0, 2 * jnp.pi, 50_000))
nearest = outline[jnp.linalg.norm(contour[:, None] - outline, axis=2).argmin(axis=1)]
plt.plot(*outline.T, lw=1, label="fitted ellipse")
plt.plot(*(nearest + 100 * (contour - nearest)).T, label="exact, difference × 100")
plt.gca().set(aspect="equal", xlabel="x (px)", ylabel="y (px)")
plt.gca().invert_yaxis()
plt.legend()
plt.show()
