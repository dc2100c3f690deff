"""Makes the film of README.md, docs/film.gif: `python docs/film.py`.

A withdrawal over a photograph of a fundus: each frame with the ellipse that was measured, and the
distance that was read from it against the true one.
"""

import math
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from eyespot.benchmarks.reporting import BLACK, STYLE, VERMILION
from eyespot.estimator import Ranger, SubpixelSettings, TrackState, measure
from eyespot.formats.microscope import read_microscope
from eyespot.formats.spot import Spot
from eyespot.scenes import load_scene, render_stack
from eyespot.scenes.world.true_calibration import true_calibration

_FILE = Path(__file__).with_name("film.gif")
_SCENE = [
    "source.kind=cone",
    "source.medium=vitreous",
    "phantom.wall=photograph",
    "spot.eccentricity_mm=1.5",
    "microscope.illumination_mw_mm2=0.6",
    "motion.frames=25",
    'exposures.kinds=["metered"]',
]


def main() -> None:
    """Render, measure, draw."""
    scene = load_scene(None, _SCENE)
    with TemporaryDirectory() as folder:
        stack = render_stack(scene, Path(folder) / "withdrawal")
        images = list(stack.images("metered"))
        ranger = Ranger(
            true_calibration(scene),
            read_microscope(stack.folder / "microscope.json"),
            model="exact",
        )
    true = np.array([label.d_mm for label in stack.labels])
    state, spots = TrackState(), []
    for image in images:
        spot, state, *_ = measure(image, state, SubpixelSettings())
        spots.append(spot)
    read = np.array(
        [ranger.distance(s).distance_mm if isinstance(s, Spot) else math.nan for s in spots]
    )
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 2.6), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
        picture = left.imshow(images[0])
        left.axis("off")
        outline = left.add_patch(Ellipse((0, 0), 1, 1, fill=False, color="white", lw=1.2))
        right.plot(true, true, color=BLACK, lw=0.8, label="true")
        (dots,) = right.plot([], [], "o", ms=3, color=VERMILION, label="read")
        right.set(xlabel="true distance (mm)", ylabel="distance (mm)")
        right.legend()

        def draw(number: int) -> None:
            picture.set_data(images[number])
            spot = spots[number]
            outline.set_visible(isinstance(spot, Spot))
            if isinstance(spot, Spot):
                outline.set_center((spot.x_px, spot.y_px))
                outline.set(width=2 * spot.semi_major_px, height=2 * spot.semi_minor_px)
                outline.set_angle(math.degrees(spot.angle_rad))
            dots.set_data(true[: number + 1], read[: number + 1])

        film = FuncAnimation(figure, draw, frames=len(images))
        film.save(_FILE, writer=PillowWriter(fps=6), dpi=90)
    print(f"{_FILE}  {_FILE.stat().st_size / 1e3:.0f} kB, largest error")
    print(f"{np.nanmax(np.abs(read - true)):.4f} mm, {np.isnan(read).sum()} frames without a spot")


if __name__ == "__main__":
    main()
