"""
Images and labels as arrays
===========================

A stack exported as one HDF5 file: images and labels are arrays, for any language.
"""

import subprocess
from pathlib import Path
from tempfile import mkdtemp

import h5py
import matplotlib.pyplot as plt

from eyespot.scenes import load_scene, render_stack

folder = Path(mkdtemp())
scene = load_scene(None, ["source.kind=cone", "motion.frames=4", 'exposures.kinds=["metered"]'])
render_stack(scene, folder / "stack")
command = ["eyespot", "export", str(folder / "stack"), "--to", "hdf5"]
subprocess.run([*command, "--out", str(folder / "stack.h5")], check=True, capture_output=True)
tables = []
with h5py.File(folder / "stack.h5") as file:
    file.visititems(lambda name, node: tables.append(node) if hasattr(node, "shape") else None)
    images = next(table[:] for table in tables if len(table.shape) == 4)
    (distances,) = (table[:] for table in tables if table.name.endswith("/d_mm"))
figure, panels = plt.subplots(1, len(images), layout="constrained", figsize=(9, 2))
for panel, image, distance in zip(panels, images, distances, strict=True):
    panel.imshow(image)
    panel.set_title(f"d = {distance:.2f} mm")
    panel.axis("off")
plt.show()
