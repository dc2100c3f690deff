"""A fundus from a random seed: reflectance of disc, macula, vessels and choroid on a flat map.

`landmarks` defines the map's coordinates; `landmarks` and `vessels` give the sources of sizes.

| quantity | value | source |
|---|---|---|
| macula, fovea, vessel-free zone | 5.5, 1.5, 0.5 mm | Hogan, Alvarado & Weddell 1971 |
| reflectance outside disc and vessels | `RETINA_REFLECTANCE` | Delori & Pflibsen 1989 |

Every other number is an assumption, chosen so that a surgeon finds the picture realistic.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from optics import InputError
from scenes.walls.landmarks import CUP_TO_DISC, DISC_MM, DISC_SEMI_AXES_MM, FOVEA_MM
from scenes.walls.vessels import vessel_shades

# Delori & Pflibsen 1989, table I: means of ten eyes, averaged over the bands of a colour camera
# (610 to 675 nm; 505 to 560 nm; 445 to 480 nm). The light has passed the lens of the eye twice.
RETINA_REFLECTANCE = {
    "nasal fundus": (0.0834, 0.0199, 0.0120),
    "perifovea": (0.0583, 0.0144, 0.0077),
    "fovea": (0.0498, 0.0101, 0.0027),
}
PERIFOVEA_MM = 2.5 * 0.29  # 2.5 degrees from the fovea; 0.29 mm of retina per degree

# Assumption for a colour print on coated paper: these reflectances of the nasal fundus, contrast
# compressed by this exponent, and all reflectances below 0.8, that of bare paper.
PRINT_REFLECTANCE = (0.62, 0.30, 0.16)
PRINT_GAMMA = 0.6

# Assumption: reflectance of the disc, relative to the nasal fundus. Without pigment it is pale.
_RIM_RATIO = (1.2, 1.9, 1.8)
_CUP_RATIO = (1.4, 3.2, 4.8)

# Assumption: density (natural logarithm) of a wide vessel, relative to the fundus around it.
_ARTERY_DENSITY = (0.20, 0.65, 0.55)
_VEIN_DENSITY = (0.45, 0.85, 0.70)

# Assumption: pigment grains and choroidal patches are noise with Gaussian correlation. Correlation
# length in mm, and RMS of the log reflectance: 6 % in total in the retina, 3.7 % in a print.
_MOTTLING = ((0.12, 0.050), (0.70, 0.035))


def fundus(
    *,
    seed: int,
    extent_mm: float,
    pixels: int,
    palette: Literal["printed paper", "retina"] = "printed paper",
) -> NDArray[np.float32]:
    """Reflectance of the fundus of a seed.

    Fovea and disc are the same for every seed; vessels and mottling are random. They are drawn in
    millimetres, so that a seed gives the same eye at every resolution.

    Args:
        seed: random seed of vessels and mottling.
        extent_mm: width and height of the map, mm of arc, in (0, 70].
        pixels: width and height of the map, px.
        palette: "retina" (a living eye, 0.3-12 %) or "printed paper" (a print of its photograph).

    Returns:
        Linear reflectance in (0, 1), pixels x pixels x 3 (R, G, B), with the pole in the centre.

    Raises:
        InputError: the palette is unknown, or a size is out of range.
    """
    _check(seed, extent_mm, pixels, palette)
    vessel_seed, mottling_seed = np.random.SeedSequence(seed).spawn(2)
    pixel = extent_mm / pixels
    x = ((np.arange(pixels) + 0.5) * pixel - extent_mm / 2).astype(np.float32)
    y = -x

    log_ratio = _macula(x, y)
    log_ratio += _mottling(x, y, np.random.default_rng(mottling_seed))[..., None]
    _paint_disc(log_ratio, x, y)
    artery, vein = vessel_shades(
        np.random.default_rng(vessel_seed), extent_mm=extent_mm, pixels=pixels
    )
    # Where an artery and a vein cross, one hides the other. Both hide the pale disc.
    vessel = np.maximum(artery, vein)
    for channel in range(3):
        below = log_ratio[..., channel]
        below -= vessel * np.maximum(below, 0)
        below -= np.maximum(
            np.float32(_ARTERY_DENSITY[channel]) * artery,
            np.float32(_VEIN_DENSITY[channel]) * vein,
        )

    base, gamma = RETINA_REFLECTANCE["nasal fundus"], 1.0
    if palette == "printed paper":
        base, gamma = PRINT_REFLECTANCE, PRINT_GAMMA
    log_ratio *= np.float32(gamma)
    reflectance = np.exp(log_ratio, out=log_ratio)
    reflectance *= np.array(base, np.float32)
    return reflectance


def _check(seed: int, extent_mm: float, pixels: int, palette: str) -> None:
    if seed < 0:
        raise InputError(f"fundus(seed=...) must not be negative; got {seed}.")
    if palette not in ("printed paper", "retina"):
        raise InputError(
            f'fundus(palette=...) must be "printed paper" or "retina"; got {palette!r}.'
        )
    if not 0 < extent_mm <= 70:
        raise InputError(
            f"fundus(extent_mm=...) must lie in (0, 70] mm, so that the map ends on the eye, 36 mm "
            f"from the pole; got extent_mm={extent_mm:g} mm."
        )
    if pixels < 1:
        raise InputError(f"fundus(pixels=...) must be at least 1; got {pixels}.")


def _gaussian(x: NDArray[np.float32], y: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """exp(-s^2 / 2 sigma^2) on the grid of x and y; s is the distance from the fovea."""
    along_x = np.exp(-((x - FOVEA_MM[0]) ** 2) / (2 * sigma**2))
    along_y = np.exp(-((y - FOVEA_MM[1]) ** 2) / (2 * sigma**2))
    return (along_y[:, None] * along_x).astype(np.float32)


def _macula(x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    """Log reflectance of macula and fovea, relative to the nasal fundus.

    Both are Gaussian; a diameter is four standard deviations. Their depths follow from the measured
    reflectances of two sites.
    """
    widths = np.array([5.5, 1.5]) / 4
    nasal, perifovea, fovea = (np.log(rho) for rho in RETINA_REFLECTANCE.values())
    at_sites = np.exp(-(np.array([[PERIFOVEA_MM], [0.0]]) ** 2) / (2 * widths**2))
    depths = np.linalg.solve(at_sites, np.stack([perifovea - nasal, fovea - nasal]))
    log_ratio = np.zeros((len(y), len(x), 3), np.float32)
    for width, depth in zip(widths, depths, strict=True):
        shape = _gaussian(x, y, width)
        for channel in range(3):
            log_ratio[..., channel] += np.float32(depth[channel]) * shape
    return log_ratio


def _mottling(
    x: NDArray[np.float32], y: NDArray[np.float32], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Log reflectance of granular pigment and choroid.

    It is noise on a lattice with a period of 36 mm, interpolated by cubics.
    """
    pitch, nodes = 0.06, 600
    frequency = np.fft.fftfreq(nodes, pitch)
    lattice = np.zeros((nodes, nodes))
    for length, rms in _MOTTLING:
        # White noise blurred by sigma has the correlation length sqrt(2) sigma.
        blur = np.exp(-((math.pi * frequency * length) ** 2))
        spectrum = np.fft.rfft2(rng.standard_normal((nodes, nodes)))
        noise = np.fft.irfft2(spectrum * blur[:, None] * blur[: nodes // 2 + 1], (nodes, nodes))
        lattice += rms * noise / noise.std()
    rows = _interpolate(lattice.astype(np.float32), y / pitch)
    return _interpolate(np.ascontiguousarray(rows.T), x / pitch).T


def _interpolate(nodes: NDArray[np.float32], at: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows of a periodic array at fractional indices (Catmull & Rom 1974)."""
    index = np.floor(at).astype(int)
    t = (at - index).astype(np.float32)
    weights = (
        0.5 * t * (t * (2 - t) - 1),
        0.5 * (t * t * (3 * t - 5) + 2),
        0.5 * t * (t * (4 - 3 * t) + 1),
        0.5 * t * t * (t - 1),
    )
    rows = np.zeros((len(at), nodes.shape[1]), np.float32)
    for offset, weight in zip((-1, 0, 1, 2), weights, strict=True):
        rows += weight[:, None] * nodes[(index + offset) % len(nodes)]
    return rows


def _paint_disc(
    log_ratio: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32]
) -> None:
    """Paint rim and cup on the fundus, in place; the cup lies slightly temporal."""
    for ratio, scale, shift, softness in (
        (_RIM_RATIO, 1.0, 0.0, 0.07),
        (_CUP_RATIO, CUP_TO_DISC, -0.08, 0.25),
    ):
        u = (x - DISC_MM[0] - shift) / (scale * DISC_SEMI_AXES_MM[0])
        v = (y - DISC_MM[1]) / (scale * DISC_SEMI_AXES_MM[1])
        columns, rows = (np.flatnonzero(np.abs(w) < 2) for w in (u, v))
        if not (len(columns) and len(rows)):
            continue
        window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        radius = np.hypot(u[window[1]], v[window[0]][:, None])
        inside = (1 / (1 + np.exp((radius - 1) / (softness / 2))))[..., None]
        log_ratio[window] += inside * (np.log(ratio).astype(np.float32) - log_ratio[window])
