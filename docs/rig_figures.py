"""Makes the pictures of docs/rig.md: the console in a browser, light and dark.

pip install 'eyespot[console,browser]'; apt-get install chromium
python -m docs.rig_figures
"""

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from eyespot.formats.calibration import write_calibration
from eyespot.scenes import load_scene, render_stack
from eyespot.scenes.world.true_calibration import true_calibration

HERE = Path(__file__).parent
PORT = 8123
SCENE = [
    *("seed=5", "source.kind=cone", 'exposures.kinds=["metered"]'),
    *("motion.travel_mm=4", "motion.frames=80", "motion.speed_mm_s=0.5"),
    *("microscope.scale_mm_px=0.0134", "microscope.width_px=320", "microscope.height_px=240"),
]


def main() -> None:
    """Render a stack, show it in the console, and take a picture at its end."""
    scene = load_scene(None, SCENE)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        render_stack(scene, folder / "withdrawal")
        write_calibration(folder / "cone.json", true_calibration(scene))
        words = ("withdrawal", "--calibration", "cone.json", "--port", f"{PORT}")
        command = [sys.executable, "-m", "eyespot", "console", *words]
        console = subprocess.Popen(command, cwd=folder)
        try:
            _photograph()
        finally:
            console.terminate()
            console.wait()


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
