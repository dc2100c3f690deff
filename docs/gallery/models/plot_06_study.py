"""
A study's figure
================

A study writes a report with figures and tables. This one asks what a medium other than air does to
a calibration; `eyespot study` lists the others.
"""

import subprocess
from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt

out = Path(mkdtemp()) / "medium"
subprocess.run(["eyespot", "study", "medium", "--quick", "--out", out], check=True)
picture = plt.imread(sorted(out.rglob("*.png"))[0])
plt.figure(figsize=(8, 8 * picture.shape[0] / picture.shape[1]), layout="constrained")
plt.imshow(picture)
plt.axis("off")
plt.show()
