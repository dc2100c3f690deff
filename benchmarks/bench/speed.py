"""Speed, as asv compares it over versions: `make bench`, then `asv compare v0.2.1 HEAD`.

Each class prepares once and times what people wait for. Times of one machine compare with each
other; a second call of a program has no compilation in it, and only that one is timed.
"""

import itertools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import eyespot
from eyespot import optics
from eyespot.estimator import LiteralSettings, SubpixelSettings, track
from eyespot.optics.viewing import load_eye, load_viewing_lens, path_camera, viewing_path
from eyespot.scenes import Renderer, Scene
from eyespot.scenes.drawn import Drawing, any_truth, any_wall, frame_of

_SCALE_MM_PX = 0.0067
_SPOTS, _BATCH = 100_000, 512
_RANGES = {
    "eccentricity": (0.0, 3.5),
    "azimuth": (0.0, 6.28),
    "distance": (0.3, 6.0),
    "incidence": (0.0, 0.5),
    "incidence_azimuth": (0.0, 6.28),
}


class _Timed:
    """One call after another, the first of which compiles; fits and renders take seconds."""

    number, repeat, rounds, warmup_time, timeout = 1, (3, 10, 20.0), 1, 1e-3, 900.0


class Outlines(_Timed):
    """Thirty frames of 640 x 480 px, read one after the other by their outlines."""

    params = (["subpixel", "literal"],)
    param_names = ("mode",)

    def setup(self, mode: str) -> None:
        """Draw a spot that wanders over a printed retina."""
        rng = np.random.default_rng(0)
        truth, wall = any_truth(rng, 60.0), any_wall(rng)
        places = [truth.moved(2.0 * k, -k) for k in range(30)]
        self.frames = [frame_of(Drawing(truth=place, wall=wall), rng) for place in places]
        self.settings = SubpixelSettings() if mode == "subpixel" else LiteralSettings(threshold=100)
        self.start = (truth.x, truth.y)

    def time_thirty_frames(self, mode: str) -> None:
        """The time of a reading is a thirtieth of it."""
        for _ in track(self.frames, self.settings, start=self.start):
            pass


class Recordings(_Timed):
    """A recording rendered, fitted and read, each a call of the Python interface."""

    params = (["cone", "lens"],)
    param_names = ("beam",)

    def setup(self, beam: str) -> None:
        """Render a stack of a beam over printed paper, in the folder that asv gives each bench."""
        view = {"width_px": 160, "height_px": 120, "scale_mm_px": 0.02, "samples": 32}
        self.scene = Scene.model_validate(
            {
                "source": {"kind": beam},
                "spot": {"eccentricity_mm": 2.0},
                "motion": {"travel_mm": 4.0, "frames": 12},
                "microscope": view | ({} if beam == "cone" else {"scale_mm_px": 0.03}),
                "exposures": {"kinds": ["metered"]},
            }
        )
        self.numbers, self.folder = itertools.count(), Path(f"{beam}-of-bench").absolute()
        if not self.folder.exists():
            eyespot.render(self.scene, self.folder)
        self.beam = self.folder / "beam.json"
        if not self.beam.exists():
            eyespot.fit(self.folder).save(self.beam)

    def time_render(self, beam: str) -> None:
        """Twelve frames, with labels and masks."""
        eyespot.render(self.scene, self.folder.with_name(f"{beam}-{next(self.numbers)}"))

    def time_fit(self, beam: str) -> None:
        """A cone by its spots, a lens by all pixels."""
        eyespot.fit(self.folder)

    def time_track(self, beam: str) -> None:
        """Twelve distances: a cone's by outlines, a lens's by all pixels."""
        eyespot.track(self.folder, calibration=self.beam)


class Sight(_Timed):
    """A phakic eye behind a flat contact lens; limits on two idle cores: 50 ms and 30 s."""

    def setup(self) -> None:
        """Every pixel's point on the retina, and ellipses of 128 contour points."""
        eye = load_eye("navarro", wavelength_nm=555.0)
        path = viewing_path(eye, load_viewing_lens("flat"))
        camera = path_camera(path, scale=_SCALE_MM_PX)
        retina = optics.Ellipsoid(eye.retina_semi_axes)
        v, u = np.mgrid[-240:240, -320:320]
        self.pixels = jnp.stack([u, v], axis=-1)
        rng = np.random.default_rng(0)
        self.poses = {n: jnp.asarray(rng.uniform(*ends, _SPOTS)) for n, ends in _RANGES.items()}

        def one(pose: dict[str, jax.Array]) -> optics.Ellipse:
            beam = optics.beam_at_spot(retina, half_angle=0.05, apex_offset=-5.117, **pose)
            return optics.spot_ellipse(beam, retina, camera)

        self.seen = jax.jit(lambda pixels: retina.intersect(*camera.ray(pixels)).point)
        self.spots = jax.jit(lambda poses: jax.lax.map(one, poses, batch_size=_BATCH))

    def time_lines_of_sight(self) -> None:
        """Those of 640 x 480 pixels."""
        jax.block_until_ready(self.seen(self.pixels))

    def time_exact_spots(self) -> None:
        """100,000 of them."""
        jax.block_until_ready(self.spots(self.poses))


class Frames(_Timed):
    """Noise-free frames of a moving spot at c = 2 mm; the limit is 1.25 of a pinhole's time."""

    params = (["pinhole", "lens", "reflexes", "colours"],)
    param_names = ("viewing",)

    def setup(self, viewing: str) -> None:
        """Prepare the scene; `colours`: each on its own lines of sight."""
        eye: dict[str, Any] = {"eye": "navarro", "lens": "flat"}
        ways = {"pinhole": {}, "reflexes": eye | {"reflexes": True}, "lens": eye}
        scene = {
            "source": {"kind": "cone", "medium": "vitreous"},
            "spot": {"eccentricity_mm": 2.0},
            "motion": {"start_mm": 1.0, "travel_mm": 3.0, "frames": 20},
            "microscope": {"pinhole_height_mm": 200.0, "scale_mm_px": _SCALE_MM_PX},
            "viewing": ways.get(viewing, eye | {"colours": "own"}),
        }
        self.renderer = Renderer(Scene.model_validate(scene))
        self.numbers = itertools.cycle(range(20))

    def time_frame(self, viewing: str) -> None:
        """One frame."""
        self.renderer.render(next(self.numbers))
