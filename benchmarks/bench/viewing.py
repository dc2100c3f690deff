"""Time of lines of sight, of exact spots and of frames through a contact lens into an eye."""

from __future__ import annotations

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import optics
from optics.viewing.camera import path_camera
from optics.viewing.eye import load_eye, load_viewing_lens
from optics.viewing.path import viewing_path
from scenes import Renderer, Scene, load_mitsuba

_WIDTH, _HEIGHT, _SCALE = 640, 480, 0.0067
_SPOTS, _BATCH = 100_000, 512
_RANGES = {
    "eccentricity": (0.0, 3.5),
    "azimuth": (0.0, 6.28),
    "distance": (0.3, 6.0),
    "incidence": (0.0, 0.5),
    "incidence_azimuth": (0.0, 6.28),
}


class Sight:
    """A phakic eye behind a flat contact lens; limits on two idle cores: 50 ms and 30 s."""

    def setup(self) -> None:
        """Every pixel's point on the retina, and ellipses of 128 contour points."""
        eye = load_eye("navarro", wavelength_nm=555.0)
        camera = path_camera(viewing_path(eye, load_viewing_lens("flat")), scale=_SCALE)
        retina = optics.Ellipsoid(eye.retina_semi_axes)
        v, u = np.mgrid[:_HEIGHT, :_WIDTH]
        self.pixels = jnp.stack([u - _WIDTH / 2, v - _HEIGHT / 2], axis=-1)
        self.seen = jax.jit(lambda pixels: retina.intersect(*camera.ray(pixels)).point)
        rng = np.random.default_rng(0)
        self.poses = {
            name: jnp.asarray(rng.uniform(*ends, _SPOTS)) for name, ends in _RANGES.items()
        }

        def one(pose: dict[str, jax.Array]) -> optics.Ellipse:
            beam = optics.beam_at_spot(retina, half_angle=0.05, apex_offset=-5.117, **pose)
            return optics.spot_ellipse(beam, retina, camera)

        self.spots = jax.jit(lambda poses: jax.lax.map(one, poses, batch_size=_BATCH))

    def time_points_of_a_frame(self) -> None:
        """640 x 480 lines of sight."""
        jax.block_until_ready(self.seen(self.pixels))

    def time_100000_spots(self) -> None:
        """Exact spots."""
        jax.block_until_ready(self.spots(self.poses))


class Frames:
    """Noise-free frames of a moving spot at c = 2 mm; the limit is 1.25 of a pinhole's time."""

    params = (["a pinhole", "the lens", "with reflexes", "each colour on its own lines"],)
    param_names = ("seen_through",)

    def setup(self, seen_through: str) -> None:
        """The renderer."""
        load_mitsuba()
        eye: dict[str, Any] = {"eye": "navarro", "lens": "flat"}
        ways = [{}, eye, eye | {"reflexes": True}, eye | {"colours": "own"}]
        scene = {
            "source": {"kind": "cone", "medium": "vitreous"},
            "spot": {"eccentricity_mm": 2.0},
            "motion": {"start_mm": 1.0, "travel_mm": 3.0, "frames": 20},
            "microscope": {"pinhole_height_mm": 200.0, "scale_mm_px": _SCALE},
            "viewing": ways[self.params[0].index(seen_through)],
        }
        self.renderer = Renderer(Scene.model_validate(scene))
        self.numbers = itertools.cycle(range(20))

    def time_frame(self, seen_through: str) -> None:
        """The next frame."""
        self.renderer.render(next(self.numbers))
