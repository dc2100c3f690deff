"""Viewing paths traced by Optiland, an independent program, to compare `optics.viewing` with.

`python -m tests.support.light.optiland_paths FILE` writes the rays that the default run compares
with, so that it needs no Optiland.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

NM = 543.0
AIMS = np.array([0.01, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
"""Distances from the axis at which the lines aim in the plane of the cornea's vertex, mm."""
ABOVE_MM = 12.0  # of the rays' start over the cornea's vertex: above every lens

# Radius, asphericity and depth of each surface, and the index behind it: Navarro's eye at 543 nm,
# typed here from Escudero-Sanz and Navarro (1999).
_CORNEA = [(7.72, -0.26, 0.0, 1.3777), (6.50, 0.0, 0.55, 1.3391)]
_LENS = [(10.2, -3.1316, 3.60, 1.4222), (-6.0, -1.0, 7.60, 1.3377)]
POLE_MM = 23.9203
_FLAT = [(np.inf, 0.0, -3.0, 1.49)]
_BICONCAVE = [(1 / -0.16429, 0.0, -3.0, 1.49)]


def _filled(surfaces: list[tuple], index: float) -> list[tuple]:
    return [*surfaces[:-1], (*surfaces[-1][:3], index)]


PATHS: dict[str, tuple[dict[str, Any], list[tuple]]] = {
    "flat, phakic": ({"lens": "flat"}, [*_FLAT, *_CORNEA, *_LENS]),
    "flat, aphakic": ({"lens": "flat", "form": "aphakic"}, [*_FLAT, *_filled(_CORNEA, 1.3377)]),
    "flat, aphakic, silicone oil": (
        {"lens": "flat", "form": "aphakic", "fill_index": 1.404},
        [*_FLAT, *_filled(_CORNEA, 1.404)],
    ),
    "biconcave, phakic, air": (
        {"lens": "biconcave", "fill_index": 1.0},
        [*_BICONCAVE, *_CORNEA, *_filled(_LENS, 1.0)],
    ),
    "wide-field-90, phakic": ({"lens": "wide-field-90"}, [*_CORNEA, *_LENS]),
    "bare cornea, aphakic": ({"lens": None, "form": "aphakic"}, _filled(_CORNEA, 1.3377)),
}
"""Options of a path, and its surfaces for Optiland."""


def rays(lens: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Points and unit directions of lines of sight in air, from a pinhole at 200 mm, n x 3 each.

    Two thirds of them are skew: a wide pupil's rays do not meet the axis.
    """
    azimuth = np.array([0.3, 1.9, 4.0])
    aim, turn = (grid.ravel() for grid in np.meshgrid(AIMS, azimuth, indexing="ij"))
    aside = np.tile([0.0, 0.4, -0.3], len(AIMS))
    at_cornea = np.column_stack([aim * np.cos(turn), aim * np.sin(turn), 0 * aim])
    pinhole = np.column_stack([aside, -2 * aside, 0 * aside - 200.0])
    direction = at_cornea - pinhole
    start = pinhole + (200.0 - ABOVE_MM) / 200.0 * direction
    return start, direction / np.linalg.norm(direction, axis=1, keepdims=True)


def thin_lens(start: np.ndarray, direction: np.ndarray, power: float) -> tuple:
    """Rays behind an ideal thin lens one focal length above the cornea's vertex."""
    slope = direction[:, :2] / direction[:, 2:]
    at_lens = start[:, :2] + (ABOVE_MM - 1 / power) * slope
    slope = slope - power * at_lens
    unit = np.column_stack([slope, np.ones(len(slope))])
    point = np.column_stack([at_lens, np.full(len(slope), -1 / power)])
    return point, unit / np.linalg.norm(unit, axis=1, keepdims=True)


def traced(surfaces: list[tuple], start: np.ndarray, direction: np.ndarray) -> dict[str, list]:
    """Point at the pole's depth and direction of each ray, by Optiland."""
    from optiland import materials, optic
    from optiland.rays import RealRays

    system = optic.Optic()
    system.add_surface(index=0, thickness=ABOVE_MM + surfaces[0][2])
    depths = [depth for _, _, depth, _ in surfaces] + [POLE_MM]
    for k, (radius, conic, depth, index) in enumerate(surfaces):
        system.add_surface(
            index=k + 1,
            radius=radius,
            conic=conic,
            thickness=depths[k + 1] - depth,
            material=materials.IdealMaterial(n=index),
            is_stop=k == 0,
        )
    system.add_surface(index=len(surfaces) + 1, material=materials.IdealMaterial(n=surfaces[-1][3]))
    system.set_aperture("EPD", 0.01)
    system.add_wavelength(NM / 1000, is_primary=True)
    ones = np.ones(len(start))
    # Optiland puts the first surface at z = 0.
    z = start[:, 2] - surfaces[0][2]
    ray = RealRays(start[:, 0], start[:, 1], z, *direction.T, ones, NM / 1000 * ones)
    surfaces_of = getattr(system, "surfaces", None) or system.surface_group
    surfaces_of.trace(ray)
    end = np.column_stack([ray.x, ray.y])
    return {"end": end.tolist(), "direction": np.column_stack([ray.L, ray.M, ray.N]).tolist()}


def all_traced() -> dict[str, dict[str, list]]:
    found = {}
    for name, (options, surfaces) in PATHS.items():
        start, direction = rays(options["lens"])
        if (options["lens"] or "").startswith("wide"):
            start, direction = thin_lens(start, direction, 0.09)
        found[name] = traced(surfaces, start, direction)
    return found


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(all_traced(), indent=0) + "\n")
