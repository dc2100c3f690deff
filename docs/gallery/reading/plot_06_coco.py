"""
Labels in another format
========================

A stack exported as COCO, read back with its own reader.
"""

import subprocess
from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
from pycocotools.coco import COCO

from eyespot.scenes import load_scene, render_stack

folder = Path(mkdtemp())
scene = load_scene(None, ["source.kind=cone", "motion.frames=3", 'exposures.kinds=["metered"]'])
render_stack(scene, folder / "stack")
command = ["eyespot", "export", str(folder / "stack"), "--to", "coco"]
subprocess.run([*command, "--out", str(folder / "coco")], check=True, capture_output=True)
labels = COCO(next((folder / "coco").rglob("*.json")))
image = labels.loadImgs(labels.getImgIds()[1])[0]
plt.imshow(plt.imread(next(folder.rglob(Path(image["file_name"]).name))))
labels.showAnns(labels.loadAnns(labels.getAnnIds(image["id"])))
plt.axis("off")
plt.show()
