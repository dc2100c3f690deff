"""
Rays through a drop
===================

Meridional rays from the fibre's core through the cap of `dome`, into air.
"""

import matplotlib.pyplot as plt
import numpy as np

from eyespot import optics

lens = optics.load_lens("dome")
height, sine = np.meshgrid(
    float(lens.face_radius) * np.linspace(-0.95, 0.95, 7),
    float(lens.sine_limit) * np.linspace(-1, 1, 5),
)
flat = np.zeros_like(height)
rays = optics.emitted_rays(
    lens,
    medium_index=1.0,
    points=np.stack([height, flat], axis=-1),
    directions=np.stack([sine, flat], axis=-1),
)
passed = np.asarray(rays.status) == optics.TRANSMITTED
start, direction = np.asarray(rays.point)[passed], np.asarray(rays.direction)[passed]
end = start + direction * (3 - start[:, 2:]) / direction[:, 2:]
plt.plot([start[:, 2], end[:, 2]], [start[:, 0], end[:, 0]], color="tab:blue", lw=0.6)
rim = np.linspace(-1, 1, 101) * float(lens.aperture_radius)
plt.fill_betweenx(rim, -float(lens.glue_length), -np.asarray(lens.sagitta(rim)), color="orange")
plt.gca().set(aspect="equal", xlabel="along the axis (mm)", ylabel="across (mm)")
plt.show()
