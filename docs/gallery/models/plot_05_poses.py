"""
Two poses for one spot
======================

Tip and axis from the outline of one spot, with noise: the better solution and its mirror, which
leans to the other side and has the same distance.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

from eyespot import optics

eye, cone = optics.Sphere(11.5), {"half_angle": np.arctan(1 / 20), "apex_offset": -5.117}
view = optics.microscope(scale=0.0067, pinhole_height=11.5, eye_radius=11.5)
place = {"eccentricity": 2.0, "azimuth": 0.0, "incidence_azimuth": 0.0, "distance": 3.0}
beam = optics.beam_at_spot(eye, incidence=np.radians(20), **place, **cone)
contour = optics.spot_contour(beam, eye, view)
contour += 0.05 * jax.random.normal(jax.random.key(1), contour.shape)
found = optics.pose_from_contour(contour, eye, view, sigma_px=0.05, **cone)
turn = np.linspace(-0.35 * np.pi, -0.65 * np.pi, 99)
plt.plot(11.5 * np.cos(turn), 11.5 * np.sin(turn), "k", lw=1)
for name, pose in (("best", found.best), ("mirror", found.mirror)):
    ends = np.array([pose.tip - 4 * pose.axis, pose.tip, pose.tip + pose.distance * pose.axis])
    (line,) = plt.plot(ends[:2, 0], ends[:2, 2], lw=4, label=f"{name}: {pose.distance:.3f} mm")
    plt.plot(ends[1:, 0], ends[1:, 2], "--", color=line.get_color())
plt.plot(*np.asarray(beam.tip)[[0, 2]], "k+", ms=12, label="true tip")
plt.gca().set(aspect="equal", xlabel="x (mm)", ylabel="z (mm)")
plt.legend()
plt.show()
