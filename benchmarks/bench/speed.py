"""Time of a frame in sub-pixel and literal mode, and of frames and exact spots through a lens."""

import itertools
import time
from collections.abc import Callable
from typing import Any

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

import optics
from estimator import LiteralSettings, SubpixelSettings, TrackState, measure
from optics.viewing import load_eye, load_viewing_lens, path_camera, viewing_path
from scenes import Renderer, Scene, load_mitsuba
from scenes.drawn import SHAPE, Drawing, Truth, any_wall, frame_of

_WARM, _FRAMES = 20, 400
_JUMP_EVERY = 50  # frames; a jump loses the spot, which is then found again
_JUMP_PX = 150.0
_STEPS_PX = [(1.6 * k, 1.2 * k) for k in range(6)]  # 2 px per frame, there and back
_MODES: tuple[SubpixelSettings | LiteralSettings, ...] = (
    SubpixelSettings(),
    LiteralSettings(threshold=90),
)  # these frames are darker than the paper


def detector(full: bool = False) -> pd.DataFrame:
    """A spot that moves slowly and jumps out of the search region every 50 frames; one thread.

    The modes alternate frame by frame, so that other work affects both equally.
    """
    cv2.setNumThreads(1)
    rows = []
    for shape, wall in itertools.product((SHAPE, (1080, 1920)), ("even", "retina")):
        rng = np.random.default_rng(0)
        texture = any_wall(rng, shape) if wall == "retina" else None
        here = Truth(x=230, y=230, semi_major=66, semi_minor=60, angle=0.5)
        ways = []
        for start in (here, here.moved(_JUMP_PX, 0)):
            drawings = [Drawing(truth=start.moved(*step), wall=texture) for step in _STEPS_PX]
            frames = [frame_of(drawing, rng, shape) for drawing in drawings]
            ways.append(frames + frames[-2:0:-1])
        states = [TrackState(at_px=(230, 230)), TrackState(at_px=(230, 230))]
        seconds = []
        for k in range(_WARM + _FRAMES * (10 if full else 1)):
            way = ways[k // _JUMP_EVERY % 2]
            for mode, settings in enumerate(_MODES):
                began = time.perf_counter()
                _, states[mode] = measure(way[k % len(way)], states[mode], settings)
                seconds.append(time.perf_counter() - began)
        ms = 1e3 * np.reshape(seconds, (-1, 2))[_WARM:]
        (subpixel, literal), (late, _) = np.median(ms, axis=0), np.percentile(ms, 99, axis=0)
        rows.append((shape, wall, subpixel, late, literal, literal / subpixel))
    columns = "shape wall subpixel_median_ms subpixel_99_percent_ms literal_median_ms"
    columns += " literal_over_subpixel"
    return pd.DataFrame(rows, columns=columns.split()).set_index(["shape", "wall"])


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
    load_mitsuba()
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
