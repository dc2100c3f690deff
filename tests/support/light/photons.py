"""Light of a drop of glue by photons, in NumPy: a referee that shares no code with `optics`.

Photons start on the core's face, even over its area and over projected solid angle (or as a
Gaussian launch says), fly straight to the cap, are refracted by Snell's law and weighted by
Fresnel's transmittance. What the cap reflects, or what meets the drop's side, is lost. On planes
perpendicular to the axis, rings count their weights: the irradiance, and with them the components
along the plane of the vector irradiance. Lengths in mm; the cap's vertex is the origin, +s leads
away from the fibre, and x is the direction of every departure from symmetry.

`counted_light` starts them at the points of a scrambled Sobol sequence, so its errors fall almost
with the number of photons, not its square root. Its rings smear sharp edges,
so photographs are counted photon by photon instead (`photon_frames`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

BATCH = 1 << 14  # photons at once, few enough to stay in the cache


@dataclass(frozen=True, kw_only=True)
class Drop:
    """A cap of glue on a core, and how the core is lit."""

    core: float  # radius of the lit core
    aperture: float  # radius of the cap's rim
    sag: float  # height of the cap over its rim
    rim: float  # height of the rim over the core's face
    aperture_na: float  # numerical aperture of the light in the core
    index: float = 1.49  # of the glue
    gaussian: bool = False
    """Whether the launch is Gaussian, with the core's radius and the aperture as 1/e² radii,
    instead of even. Both are cut off there."""
    shift: float = 0.0  # of the cap along x, relative to the core
    tilt: float = 0.0  # of the light in the glue towards x, rad

    @classmethod
    def of(cls, lens: Any) -> Drop:
        """The numbers of a `GlueLens` that is lit evenly."""
        return cls(
            core=float(lens.core_radius),
            aperture=float(lens.aperture_radius),
            sag=float(lens.sag),
            rim=float(lens.glue_length - lens.sag),
            aperture_na=float(lens.numerical_aperture),
            index=float(lens.glue_index),
        )


def photons(drop: Drop, medium: float, even: np.ndarray) -> tuple:
    """Photons that leave the cap: x and y at s = 0, slopes dx/ds and dy/ds, weights, their sum.

    A photon starts as 4 numbers say, even on (0, 1), in rows of `even`; with 3 of them all start on
    one radius and fly to one side of it, which is enough for rings. The weights of all photons
    together, also of lost ones, would be their number.
    """
    squared, sine_squared = even[:2]
    if drop.gaussian:
        # Inverse distribution of exp(-2 t) on (0, 1).
        squared, sine_squared = -0.5 * np.log(1 - even[:2] * (1 - np.exp(-2)))
    radius = drop.core * np.sqrt(squared)
    sine = drop.aperture_na / drop.index * np.sqrt(sine_squared)
    turn = 2 * np.pi * even[2]
    if len(even) == 3:
        x, y, turn = radius, np.zeros(radius.size), turn / 2
    else:
        x = radius * np.cos(2 * np.pi * even[3]) - drop.shift
        y = radius * np.sin(2 * np.pi * even[3])
    along = np.sqrt(1 - sine**2)
    way = np.stack([sine * np.cos(turn), sine * np.sin(turn), along])
    if drop.tilt:
        c, s = np.cos(drop.tilt), np.sin(drop.tilt)
        way = np.stack([c * way[0] + s * way[2], way[1], c * way[2] - s * way[0]])
    # To the rim's plane; outside of the rim a photon has met the drop's side.
    path = drop.rim / way[2]
    x, y = x + path * way[0], y + path * way[1]
    alive = x**2 + y**2 < drop.aperture**2
    x, y, way = x[alive], y[alive], way[:, alive]
    curvature = 2 * drop.sag / (drop.aperture**2 + drop.sag**2)
    # On the cap |p - c|² = R² with the centre c at s = -R. From the rim's plane at s = -h, in units
    # in which a flat end needs no special case: κ|p|² + 2 s = 0.
    s = np.full(x.shape, -drop.sag)
    a = curvature
    b = curvature * (x * way[0] + y * way[1] + s * way[2]) + way[2]
    c = curvature * (x**2 + y**2 + s**2) + 2 * s
    path = -c / (b + np.sqrt(b**2 - a * c))
    x, y, s = x + path * way[0], y + path * way[1], s + path * way[2]
    normal = np.stack([curvature * x, curvature * y, 1 + curvature * s])
    inside = np.sum(way * normal, axis=0)
    ratio = drop.index / medium
    outside_squared = 1 - ratio**2 * (1 - inside**2)
    refracted = outside_squared > 0
    outside = np.sqrt(np.where(refracted, outside_squared, 0))
    way = ratio * way + (outside - ratio * inside) * normal
    n, m = drop.index, medium
    r_s = (n * inside - m * outside) / (n * inside + m * outside)
    r_p = (m * inside - n * outside) / (m * inside + n * outside)
    weight = np.where(refracted, 1 - 0.5 * (r_s**2 + r_p**2), 0.0)
    kept = refracted & (way[2] > 0.02)  # of grazing light nothing comes near the spot
    x, y, s, way = x[kept], y[kept], s[kept], way[:, kept]
    slope_x, slope_y = way[0] / way[2], way[1] / way[2]
    return x - s * slope_x, y - s * slope_y, slope_x, slope_y, weight[kept], float(weight.sum())


@dataclass(frozen=True, eq=False)
class PhotonLight:
    """Vector irradiance per unit power in the core, counted by photons, of a symmetric drop."""

    rings: np.ndarray  # V e² in mm² / mm²: components (radial, axial) x planes x rings
    contact: float  # reach of the rings, e(s) = contact + slope s
    slope: float

    def reach(self, s):
        """Radius of the outermost ring."""
        return self.contact + self.slope * s


def counted_light(
    drop: Drop,
    medium: float,
    *,
    nearest: float,
    farthest: float,
    contact: float,
    slope: float,
    count: int = 1 << 21,
    planes: int = 96,
    rings: int = 160,
) -> PhotonLight:
    """Count photons on planes between two distances, in rings out to contact + slope s."""
    assert drop.shift == 0 and drop.tilt == 0
    s = np.geomspace(nearest, farthest, planes)
    sums = np.zeros((2, planes, rings))
    starts = qmc.Sobol(3, rng=0)
    for _ in range(count // BATCH):
        x, y, slope_x, slope_y, weight, _ = photons(drop, medium, starts.random(BATCH).T)
        # Along a ray the squared distance from the axis is a quadratic of s.
        squared, linear = x**2 + y**2, 2 * (x * slope_x + y * slope_y)
        quadratic = slope_x**2 + slope_y**2
        for k, distance in enumerate(s):
            rho = np.sqrt(squared + distance * (linear + distance * quadratic))
            ring = (rho * (rings / (contact + slope * distance))).astype(np.intp)
            np.minimum(ring, rings, out=ring)
            radial = (0.5 * linear + distance * quadratic) / rho * weight
            for part, own in enumerate((radial, weight)):
                sums[part, k] += np.bincount(ring, own, rings + 1)[:rings]
    area = np.pi * (np.arange(1, rings + 1) ** 2 - np.arange(rings) ** 2) / rings**2
    return PhotonLight(sums / area / count, contact, slope)
