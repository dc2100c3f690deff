"""The kinds of drawn frames, with the limits of the estimator's errors on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

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
    frame_of,
    lens_profile,
    with_glints,
    with_quarter_in_shadow,
    with_shaft,
)

Make = Callable[[np.random.Generator], Drawing]

SIZES = (20, 40, 60, 100, 150)
_SHAFT_PX = 75.0
_REFERENCES = 8  # frames without the spot, averaged into a reference
_LENS = "dome"

CLEAN = {"bias": 0.02, "std": 0.03}
BIAS = {"bias": 0.1}
SATURATED = {"rmse": 0.3, "missed": 0}
ADVERSE = {"rmse": 0.15, "missed": 0, "silent_wrong": 0}


@dataclass(frozen=True, kw_only=True)
class FrameKind:
    """A kind of frame.

    Attributes:
        make: draws one such frame.
        limits: largest absolute values of `accuracy.Figures`, by name.
        reference: whether a reference frame is given.
        blur_px: blur of the edge if the Cramér-Rao bound is known, else None.
    """

    make: Make
    limits: dict[str, float] = field(default_factory=dict)
    reference: bool = False
    blur_px: float | None = None

    def reference_of(self, scene: Drawing, rng: np.random.Generator) -> np.ndarray | None:
        """Mean of some frames without the spot, or None."""
        if not self.reference:
            return None
        dark = replace(scene, amplitude=0.0)
        mean = np.mean([frame_of(dark, rng) for _ in range(_REFERENCES)], axis=0)
        return np.rint(mean).astype(np.uint8)


def cramer_rao_bound(semi_minor: float, blur_px: float, scene: Drawing) -> float:
    """Smallest standard deviation (px) of the semi-minor axis of a near-circle on an even wall.

    (s / D) sqrt(3 w / (sqrt(pi) B)) with the noise s of the grey value, the step D, the blur w of
    the edge and the radius B, for all pixels of the edge and five parameters.
    """
    grey_noise = scene.noise * math.hypot(0.299, 0.587, 0.114)
    spread = math.sqrt(3 * blur_px / (math.sqrt(math.pi) * semi_minor))
    return grey_noise / scene.amplitude * spread


def frame_kinds() -> dict[str, FrameKind]:
    """All kinds of frames by name. b is the semi-minor axis (default 60 px; default blur 2 px).

    "Retina" is a wall with a printed fundus; "even" is a wall without texture.
    """
    made = {f"even, b {b}": FrameKind(make=_even(b), limits=CLEAN, blur_px=2.0) for b in SIZES}
    at_60 = made["even, b 60"]
    bound = cramer_rao_bound(60, 2.0, at_60.make(np.random.default_rng(0)))
    made["even, b 60"] = replace(at_60, limits={**CLEAN, "std": 2 * bound})
    made |= {f"retina, b {b}": FrameKind(make=_retina(b), limits=CLEAN) for b in SIZES}
    for sigma in (1, 4, 8):
        profile = erf_edge(sigma)
        made[f"even, blur {sigma} px"] = FrameKind(
            make=_even(60, profile=profile), limits=BIAS, blur_px=sigma
        )
        made[f"retina, blur {sigma} px"] = FrameKind(make=_retina(60, profile=profile), limits=BIAS)
    for change, factor in (("-50 %", 0.5), ("+50 %", 1.5)):
        exposed = {"amplitude": 130.0 * factor, "ambient": 12.0 * factor}
        made[f"even, exposure {change}"] = FrameKind(
            make=_even(60, **exposed), limits=BIAS, blur_px=2.0
        )
        made[f"retina, exposure {change}"] = FrameKind(make=_retina(60, **exposed), limits=BIAS)
    for drop in (0.2, 0.4):
        profile = domed_edge(2, drop)
        made[f"even, dome {drop:.0%}"] = FrameKind(make=_even(60, profile=profile), limits=BIAS)
        made[f"retina, dome {drop:.0%}"] = FrameKind(make=_retina(60, profile=profile), limits=BIAS)
    for name, profile in _bells().items():
        made |= _bell_kinds(name, profile)
    return made | _saturated() | _adverse()


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


def _bell_kinds(name: str, profile: Profile) -> dict[str, FrameKind]:
    precise, rough = {"rmse": 0.003 * 60}, {"rmse": 0.01 * 60}
    retina = _retina(60, profile=profile, amplitude=150.0)
    return {
        f"even, {name}": FrameKind(make=_even(60, profile=profile), limits=precise),
        f"retina, {name}": FrameKind(make=retina, limits=rough),
        f"retina, {name}, reference": FrameKind(make=retina, limits=precise, reference=True),
    }


def _saturated() -> dict[str, FrameKind]:
    def coloured(rng: np.random.Generator) -> Drawing:
        wall = np.broadcast_to(np.array([1.0, 0.6, 0.5]), (480, 640, 3))
        return replace(_even(60, amplitude=1.7 * 255 - 15)(rng), wall=wall)

    made = {
        f"even, peak {times} x full scale": FrameKind(
            make=_even(60, amplitude=times * 255 - 15), limits=SATURATED
        )
        for times in (1.2, 1.5, 1.8)
    }
    made["even, red 1.7 x, blue not"] = FrameKind(make=coloured, limits=SATURATED)
    made["retina, red 1.8 x"] = FrameKind(make=_retina(60, amplitude=1.8 * 255), limits=SATURATED)
    for times in (2.5, 4.0):
        made[f"even, peak {times} x full scale"] = FrameKind(
            make=_even(60, amplitude=times * 255 - 15), limits={"silent": 0}
        )
    return made


def _adverse() -> dict[str, FrameKind]:
    def shafted(reach: float) -> Make:
        return lambda rng: with_shaft(_retina(80)(rng), rng, reach, _SHAFT_PX)

    def shadowed(rng: np.random.Generator) -> Drawing:
        return with_quarter_in_shadow(_retina(60)(rng), rng)

    def glinting(on_edge: bool) -> Make:
        return lambda rng: with_glints(_retina(60)(rng), rng, on_edge=on_edge)

    def clipped(rng: np.random.Generator) -> Drawing:
        scene = _retina(60)(rng)
        return replace(scene, truth=replace(scene.truth, x=0.4 * scene.truth.semi_minor))

    made = {
        "b 80, shaft's tip in the spot": shafted(0.6),
        "b 80, shaft past its middle": shafted(-0.3),
        "b 80, shaft across": shafted(-3.0),
        "a quarter in shadow": shadowed,
        "glints on the edge": glinting(True),
        "glints anywhere": glinting(False),
        "clipped by the border": clipped,
    }
    found = {f"retina, {name}": FrameKind(make=make, limits=ADVERSE) for name, make in made.items()}
    for wall, at_rest in (("even", _even(60)), ("retina", _retina(60))):
        found[f"{wall}, moved by half a diameter"] = FrameKind(
            make=_moving(at_rest), limits=ADVERSE
        )
    return found


def _moving(make: Make) -> Make:
    def moving(rng: np.random.Generator) -> Drawing:
        scene, heading = make(rng), rng.uniform(0, 2 * math.pi)
        length = scene.truth.semi_minor
        return replace(scene, path_px=(length * math.cos(heading), length * math.sin(heading)))

    return moving
