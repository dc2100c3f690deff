"""Records the fit of a lens that docs/tutorials/beam.md shows: `python -m docs.lens_recording`.

A page that fits a lens would take minutes to build. So the commands are run here, in an empty
folder, and what they print is kept in docs/tutorials/recorded/lens.txt.
"""

import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

HOME = Path(__file__).resolve().parents[1]
RECORDED = HOME / "docs" / "tutorials" / "recorded" / "lens.txt"

STEPS = r"""
eyespot scene init scene.toml
eyespot render scene.toml --out table --set source.lens=dome --set source.medium=vitreous \
    --set phantom.kind=plane --set spot.eccentricity_mm=1 \
    --set motion.frames=25 --set microscope.width_px=320 \
    --set microscope.height_px=240 --set microscope.scale_mm_px=0.0134 \
    --set 'exposures.kinds=["metered"]'

eyespot fit table --out lens.json

eyespot render scene.toml --out reading --set source.lens=dome --set source.medium=vitreous \
    --set phantom.wall=retina --set spot.eccentricity_mm=2 --set motion.frames=9 --set seed=3 \
    --set 'exposures.kinds=["metered"]'
eyespot track reading --calibration lens.json --out spots.csv

eyespot budget reading --calibration lens.json --frame 5
"""
"""Commands; those without an empty line between them are timed together."""


def main() -> None:
    """Run the commands and write the transcript."""
    today = datetime.now(UTC).date().isoformat()
    python = platform.python_version()
    lines = [f"# Recorded by `python -m docs.lens_recording` on {today}, Python {python}."]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "COLUMNS": "92"}
    with tempfile.TemporaryDirectory() as folder:
        for step in STEPS.strip().split("\n\n"):
            began = time.monotonic()
            for command in re.split(r"\n(?=\S)", step):
                done = subprocess.run(
                    ["bash", "-c", command],
                    cwd=folder,
                    env=environment,
                    capture_output=True,
                    text=True,
                    check=True,
                )
                lines += [f"$ {command}", *done.stdout.rstrip().splitlines()]
            load = os.getloadavg()[0] / (os.cpu_count() or 1)
            lines.append(f"# {time.monotonic() - began:.0f} s, at a load of {load:.1f} a core")
    RECORDED.write_text("\n".join(filter(None, lines)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
