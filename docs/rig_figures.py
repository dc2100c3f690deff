"""Makes the pictures of docs/rig.md: the console in a browser, light and dark.

pip install 'eyespot[console,browser]'; apt-get install chromium
python -m docs.rig_figures
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from formats.calibration import Calibration, write_calibration

HERE = Path(__file__).parent
PORT = 8123
SCENE = """
schema = 1
seed = 5
[source]
kind = "cone"
[motion]
kind = "withdrawal"
travel_mm = 4.0
frames = 80
speed_mm_s = 0.5
[microscope]
scale_mm_px = 0.0134
width_px = 320
height_px = 240
[exposures]
kinds = ["metered"]
"""


def main() -> None:
    """Render a stack, show it in the console, and take a picture at its end."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scene.toml").write_text(SCENE)
        _eyespot("render", "scene.toml", "--out", "withdrawal", folder=folder).wait()
        cone = Calibration(
            model="exact",
            values={"k": 20.0, "b": -5.117},
            covariance=np.diag([0.01**2, 0.005**2]),
            medium="air",
            medium_index=1.0,
            fitted_on="the scene's own values",
            data_sha256="0" * 64,
            software="none",
        )
        write_calibration(folder / "cone.json", cone)
        words = ("console", "withdrawal", "--calibration", "cone.json", "--port", f"{PORT}")
        console = _eyespot(*words, folder=folder)
        try:
            _photograph()
        finally:
            console.terminate()
            console.wait()


def _eyespot(*words: str, folder: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "eyespot", *words], cwd=folder)


def _photograph() -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        time.sleep(60)  # the models are compiled, and the recording plays to its end
        for scheme in ("light", "dark"):
            page = browser.new_context(
                viewport={"width": 1280, "height": 800}, color_scheme=scheme
            ).new_page()
            page.goto(f"http://127.0.0.1:{PORT}/")
            time.sleep(3)
            page.screenshot(path=HERE / f"console_{scheme}.png")


if __name__ == "__main__":
    main()
