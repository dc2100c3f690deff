"""
How far a pupil lets one see
============================

The largest c that a microscope sees through each viewing lens, against the pupil's diameter.
"""

import matplotlib.pyplot as plt
import numpy as np

from eyespot import optics
from eyespot.optics import viewing

pupils = np.linspace(4.0, 9.0, 11)
for lens in ("flat", "wide-field-90", "wide-field-130"):
    field = []
    for pupil in pupils:
        path = viewing.viewing_path(
            viewing.load_eye("navarro", wavelength_nm=555.0),
            viewing.load_viewing_lens(lens),
            form="phakic",
            pupil_radius=pupil / 2,
            pinhole_distance=200.0,
        )
        camera = viewing.path_camera(path, scale=0.0067)
        field.append(float(camera.field(optics.Sphere(float(path.retina_semi_axes[2])))))
    plt.plot(pupils, field, "o-", label=lens)
plt.xlabel("pupil (mm)")
plt.ylabel("largest c that is seen (mm)")
plt.legend()
plt.show()
