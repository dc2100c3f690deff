"""Kinds of drawn frames: sizes, blurs, exposures, profiles, saturation and what hides a spot."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from scenes.drawn import (
    Drawing,
    Profile,
    any_truth,
    any_wall,
    bell,
    domed_edge,
    erf_edge,
    flank,
    lens_profile,
    with_glints,
    with_quarter_in_shadow,
    with_shaft,
)

Make = Callable[[np.random.Generator], Drawing]

_SHAFT_PX = 75.0
_LENS = "dome"


def frame_kinds() -> dict[str, Make]:
    """What draws a frame of each kind. b is the semi-minor axis (default 60 px; default blur 2 px).

    "Retina" is a wall with a printed fundus; "even" is a wall without texture.
    """
    made: dict[str, Make] = {}
    for b in (20, 40, 60, 100, 150):
        made |= _on_both(f"b {b}", b)
    for sigma in (1, 4, 8):
        made |= _on_both(f"blur {sigma} px", profile=erf_edge(sigma))
    for change, factor in (("-50 %", 0.5), ("+50 %", 1.5)):
        made |= _on_both(f"exposure {change}", amplitude=130.0 * factor, ambient=12.0 * factor)
    for drop in (0.2, 0.4):
        made |= _on_both(f"dome {drop:.0%}", profile=domed_edge(2, drop))
    for name, profile in _bells().items():
        made[f"even, {name}"] = _even(60, profile=profile)
        made[f"retina, {name}"] = _retina(60, profile=profile, amplitude=150.0)
    return made | _saturated() | _adverse()


def _on_both(name: str, semi_minor: float = 60, **changes: object) -> dict[str, Make]:
    walls = {"even": _even, "retina": _retina}
    return {f"{wall}, {name}": make(semi_minor, **changes) for wall, make in walls.items()}


def _even(semi_minor: float, **changes: object) -> Make:
    return lambda rng: replace(Drawing(truth=any_truth(rng, semi_minor)), **changes)  # type: ignore[arg-type]


def _retina(semi_minor: float, **changes: object) -> Make:
    return lambda rng: replace(_even(semi_minor, **changes)(rng), wall=any_wall(rng))


def _bells() -> dict[str, Profile]:
    return {
        "Gaussian": bell,
        "lens in air, d 3": lens_profile(_LENS, 1.0, 3.0),
        "lens in vitreous, d 3": lens_profile(_LENS, 1.336, 3.0),
        "flank of 0.7 b": flank(0.7),
    }


def _saturated() -> dict[str, Make]:
    def coloured(rng: np.random.Generator) -> Drawing:
        wall = np.broadcast_to(np.array([1.0, 0.6, 0.5]), (480, 640, 3))
        return replace(_even(60, amplitude=1.7 * 255 - 15)(rng), wall=wall)

    return {
        **{
            f"even, peak {times} x full scale": _even(60, amplitude=times * 255 - 15)
            for times in (1.2, 1.5, 1.8, 2.5, 4.0)
        },
        "even, red 1.7 x, blue not": coloured,
        "retina, red 1.8 x": _retina(60, amplitude=1.8 * 255),
    }


def _adverse() -> dict[str, Make]:
    def shafted(reach: float) -> Make:
        return lambda rng: with_shaft(_retina(80)(rng), rng, reach, _SHAFT_PX)

    def glinting(on_edge: bool) -> Make:
        return lambda rng: with_glints(_retina(60)(rng), rng, on_edge=on_edge)

    def clipped(rng: np.random.Generator) -> Drawing:
        scene = _retina(60)(rng)
        return replace(scene, truth=replace(scene.truth, x=0.4 * scene.truth.semi_minor))

    return {
        "retina, b 80, shaft's tip in the spot": shafted(0.6),
        "retina, b 80, shaft past its middle": shafted(-0.3),
        "retina, b 80, shaft across": shafted(-3.0),
        "retina, a quarter in shadow": lambda rng: with_quarter_in_shadow(_retina(60)(rng), rng),
        "retina, glints on the edge": glinting(True),
        "retina, glints anywhere": glinting(False),
        "retina, clipped by the border": clipped,
        "even, moved by half a diameter": _moving(_even(60)),
        "retina, moved by half a diameter": _moving(_retina(60)),
    }


def _moving(make: Make) -> Make:
    def moving(rng: np.random.Generator) -> Drawing:
        scene, heading = make(rng), rng.uniform(0, 2 * math.pi)
        length = scene.truth.semi_minor
        return replace(scene, path_px=(length * math.cos(heading), length * math.sin(heading)))

    return moving
