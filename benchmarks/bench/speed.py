"""Times of frames and of exact spots through a lens.

`eyespot score` and `eyespot rivals run` say how long each mode takes for a frame.
"""

import itertools
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from eyespot import optics
from eyespot.optics.viewing import load_eye, load_viewing_lens, path_camera, viewing_path
from eyespot.scenes import Renderer, Scene


def _timed(call: Callable[[], Any]) -> dict[str, float]:
    """Median wall and processor time after one call that compiles."""
    call()
    wall: list[float] = []
    worked: list[float] = []
    while sum(wall) <= 10 and len(wall) < 20:
        began = time.perf_counter(), time.process_time()
        call()
        wall.append(time.perf_counter() - began[0])
        worked.append(time.process_time() - began[1])
    return {"ms": 1e3 * np.median(wall), "cpu_ms": 1e3 * np.median(worked)}


_SCALE_MM_PX = 0.0067
_SPOTS, _BATCH = 100_000, 512
_RANGES = {
    "eccentricity": (0.0, 3.5),
    "azimuth": (0.0, 6.28),
    "distance": (0.3, 6.0),
    "incidence": (0.0, 0.5),
    "incidence_azimuth": (0.0, 6.28),
}


def sight(full: bool = False) -> pd.DataFrame:
    """A phakic eye behind a flat contact lens; limits on two idle cores: 50 ms and 30 s.

    Every pixel's point on the retina, and ellipses of 128 contour points.
    """
    eye = load_eye("navarro", wavelength_nm=555.0)
    path = viewing_path(eye, load_viewing_lens("flat"))
    camera = path_camera(path, scale=_SCALE_MM_PX)
    retina = optics.Ellipsoid(eye.retina_semi_axes)
    v, u = np.mgrid[-240:240, -320:320]
    pixels = jnp.stack([u, v], axis=-1)
    rng = np.random.default_rng(0)
    poses = {name: jnp.asarray(rng.uniform(*ends, _SPOTS)) for name, ends in _RANGES.items()}

    def one(pose: dict[str, jax.Array]) -> optics.Ellipse:
        beam = optics.beam_at_spot(retina, half_angle=0.05, apex_offset=-5.117, **pose)
        return optics.spot_ellipse(beam, retina, camera)

    seen = jax.jit(lambda pixels: retina.intersect(*camera.ray(pixels)).point)
    spots = jax.jit(lambda poses: jax.lax.map(one, poses, batch_size=_BATCH))
    calls = {
        "640 x 480 lines of sight": lambda: jax.block_until_ready(seen(pixels)),
        "100,000 exact spots": lambda: jax.block_until_ready(spots(poses)),
    }
    return pd.DataFrame({name: _timed(call) for name, call in calls.items()}).T


def frames(full: bool = False) -> pd.DataFrame:
    """Noise-free frames of a moving spot at c = 2 mm; the limit is 1.25 of a pinhole's time."""
    eye: dict[str, Any] = {"eye": "navarro", "lens": "flat"}
    ways = {
        "a pinhole": {},
        "the lens": eye,
        "with reflexes": eye | {"reflexes": True},
        "each colour on its own lines": eye | {"colours": "own"},
    }
    rows = {}
    for name, viewing in ways.items():
        scene = {
            "source": {"kind": "cone", "medium": "vitreous"},
            "spot": {"eccentricity_mm": 2.0},
            "motion": {"start_mm": 1.0, "travel_mm": 3.0, "frames": 20},
            "microscope": {"pinhole_height_mm": 200.0, "scale_mm_px": _SCALE_MM_PX},
            "viewing": viewing,
        }
        renderer, numbers = Renderer(Scene.model_validate(scene)), itertools.cycle(range(20))
        rows[name] = _timed(lambda r=renderer, n=numbers: r.render(next(n)))  # type: ignore[misc]
    return pd.DataFrame(rows).T
