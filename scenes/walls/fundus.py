"""Drawn retina: a fundus with optic disc, macula and vessels.

The map is flat and metric: the point (x, y) lies at the arc length hypot(x, y) mm from the retinal
pole, in the direction atan2(y, x) (azimuthal-equidistant coordinates). On the sphere they are
undistorted at the pole; on a plane they are plain coordinates. +x is the eye frame's +X, +y its +Y.
The first row of an image has the largest y. So the image is a right eye's fundus photograph: the
disc lies right of the pole (nasal), the fovea left of it (temporal) and slightly lower.

| size | value | source |
|---|---|---|
| temporal artery, artery over vein | 0.105 mm, 0.68 | Guan et al. 2003; Lee et al. 2007 |
| temporal over nasal calibre | 3^(1/4.1) | flow ratio 3, flow ~ calibre^4.1 (Feke et al. 1989) |
| exponent and angle of branching | 2.59, 1.95; 78 degrees | arteries, veins; Luo et al. 2017 |
| course of the temporal arcades | a parabola from the disc | Oloumi et al. 2012 |
| macula, fovea, vessel-free zone | 5.5, 1.5, 0.5 mm | Hogan, Alvarado & Weddell 1971 |
| reflectance outside disc and vessels | `RETINA_REFLECTANCE` | Delori & Pflibsen 1989 |

Every other number is an assumption, chosen so that a surgeon finds the picture realistic.
"""

import heapq
import itertools
import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

FOVEA_MM = (-1.5, -0.2)
"""1.5 mm temporal of the pole: angle alpha, 5 degrees (Atchison & Smith 2000)."""
DISC_MM = (
    FOVEA_MM[0] + 4.76 * math.cos(math.radians(5.6)),
    FOVEA_MM[1] + 4.76 * math.sin(math.radians(5.6)),
)
"""4.76 mm from the fovea, 5.6 degrees up (Jonas et al. 2015; Rohrschneider 2004)."""
DISC_SEMI_AXES_MM = (1.77 / 2, 1.88 / 2)
"""Quigley et al. 1990."""
CUP_TO_DISC = 0.43
"""Diameter of the cup over that of the disc (Healey et al. 1997)."""


_SHADE_CALIBRE_MM = 0.05  # a vessel of this calibre has 1 - 1/e of the density of a wide one
_REFLEX_CONTRAST = 0.35  # the light streak along a vessel lowers its density by this ...
_REFLEX_WIDTH = 0.25  # ... over this fraction of its calibre
_EDGE_MM = 0.02  # sharpness of the photograph

_ARCADE_WIDTH_MM = 3.2**2 / 4.76  # the temporal arcades pass 3.2 mm above and below the fovea
_SMALLEST_CALIBRE_MM = 0.016  # finer vessels are not visible in a photograph
_STEP_MM = 0.06  # length of a piece of vessel
_CELL_MM = 0.15  # size of the cells that a vessel occupies


class _Arcade(NamedTuple):
    """The parabola w^2 = width t of a main vessel; t and w start at the disc."""

    temporal: int  # +1, or -1 for nasal
    up: int  # +1, or -1 for down
    width: float  # mm


class _Vessel(NamedTuple):
    """Start of a vessel that will grow to its next branching."""

    name: int
    relatives: frozenset[int]  # parent and sibling, which it may cross
    x: float
    y: float
    heading: float
    calibre: float
    vein: bool
    side: int  # side of its next small branch, +1: left
    arcade: _Arcade | None  # None for a side branch


def _vessels(rng: np.random.Generator) -> Iterator[tuple[bool, tuple[float, ...]]]:
    """Pieces (is a vein, (x0, y0, x1, y1, calibre)) of the vessel trees, in mm.

    The widest vessel grows first and occupies its cells; no other of its kind crosses them.
    """
    taken: dict[tuple[int, int, bool], int] = {}
    waiting = [(-vessel.calibre, vessel) for vessel in _roots(rng)]
    names = itertools.count(len(waiting))
    heapq.heapify(waiting)
    while waiting:
        _, vessel = heapq.heappop(waiting)
        path, heading, stopped = _grow(vessel, taken, rng)
        for i, (start, end) in enumerate(pairwise(path)):
            # A vessel that was stopped becomes thinner over its last 0.8 mm.
            left = (len(path) - 1 - i) * _STEP_MM / 0.8 if stopped else 1.0
            yield vessel.vein, (*start, *end, vessel.calibre * min(1.0, left))
        if not stopped:
            for child in _branches(vessel, path[-1], heading, names, rng):
                heapq.heappush(waiting, (-child.calibre, child))


def _roots(rng: np.random.Generator) -> list[_Vessel]:
    """Vessels where they leave the cup: four arcades and four small vessels of each kind."""
    starts = []
    for vein, up in itertools.product((False, True), (1, -1)):
        temporal_calibre = 0.105 / 0.68 if vein else 0.105
        nasal_calibre = temporal_calibre / 3 ** (1 / 4.1)
        temporal = _Arcade(1, up, _ARCADE_WIDTH_MM * rng.lognormal(0, 0.1))
        nasal = _Arcade(-1, up, 3 * _ARCADE_WIDTH_MM * rng.lognormal(0, 0.2))
        dx, small = -0.12 if vein else 0.05, 0.35 * temporal_calibre
        starts += [
            (dx, 0.0, up * math.pi / 2 + rng.normal(0, 0.15), temporal_calibre, vein, temporal),
            (dx, 0.0, up * math.pi / 2 + rng.normal(0, 0.15), nasal_calibre, vein, nasal),
            (-0.1, 0.1 * up, math.pi + rng.normal(0, 0.3), small, vein, None),
            (0.1, 0.1 * up, rng.normal(0, 0.4), small, vein, None),
        ]
    return [
        _Vessel(
            name=name,
            relatives=frozenset(range(len(starts))),
            x=DISC_MM[0] + dx,
            y=DISC_MM[1] + dy,
            heading=heading,
            calibre=calibre,
            vein=vein,
            side=int(rng.choice((-1, 1))),
            arcade=arcade,
        )
        for name, (dx, dy, heading, calibre, vein, arcade) in enumerate(starts)
    ]


def _grow(
    vessel: _Vessel, taken: dict[tuple[int, int, bool], int], rng: np.random.Generator
) -> tuple[list[tuple[float, float]], float, bool]:
    """Points of a vessel up to its next branching, its last heading, and whether it was stopped."""
    x, y, heading, bend = vessel.x, vessel.y, vessel.heading, 0.0
    mean_length = 0.9 if vessel.arcade else 0.6 + 12 * vessel.calibre
    steps = 1 + int(rng.gamma(4, mean_length / 4) / _STEP_MM)
    follow = _STEP_MM / (0.5 if vessel.arcade else 2.5)
    path = [(x, y)]
    for jolt in rng.normal(0, 0.35, steps):
        heading += follow * math.sin(_course(x, y, vessel.arcade) - heading) + bend * _STEP_MM
        bend += jolt - bend * _STEP_MM / 0.4
        x += _STEP_MM * math.cos(heading)
        y += _STEP_MM * math.sin(heading)
        path.append((x, y))
        if math.dist((x, y), FOVEA_MM) < 0.25 + 5 * vessel.calibre:
            return path, heading, True
        # On and near the disc, vessels may overlap.
        if math.dist((x, y), DISC_MM) > 1.3:
            cell = math.floor(x / _CELL_MM), math.floor(y / _CELL_MM), vessel.vein
            owner = taken.setdefault(cell, vessel.name)
            if owner != vessel.name and owner not in vessel.relatives:
                return path, heading, True
    return path, heading, False


def _course(x: float, y: float, arcade: _Arcade | None) -> float:
    """Preferred direction of a vessel at a position.

    An arcade follows its parabola. A side branch between the temporal arcades turns towards the
    fovea, any other side branch away from the disc.
    """
    t, w = DISC_MM[0] - x, y - DISC_MM[1]
    if arcade is None:
        if w * w < _ARCADE_WIDTH_MM * t and t < 8:
            return math.atan2(FOVEA_MM[1] - y, FOVEA_MM[0] - x)
        return math.atan2(w, -t)
    t, w = t * arcade.temporal, w * arcade.up
    off = (w * w - arcade.width * t) / math.hypot(arcade.width, 2 * w)
    off = max(-1.0, min(1.0, off))
    along_t, along_w = 2 * w + arcade.width * off, arcade.width - 2 * w * off
    return math.atan2(along_w * arcade.up, -along_t * arcade.temporal)


def _branches(
    parent: _Vessel,
    place: tuple[float, float],
    heading: float,
    names: Iterator[int],
    rng: np.random.Generator,
) -> list[_Vessel]:
    """The two vessels after a branching, without those too fine to be visible.

    calibre^n = major^n + minor^n, and the smaller branch turns by the larger angle.
    """
    n = 1.95 if parent.vein else 2.59
    minor_over_major = rng.uniform(0.3, 0.7) if parent.arcade else rng.uniform(0.45, 1.0)
    major = parent.calibre * (1 + minor_over_major**n) ** (-1 / n)
    angle = math.radians(78) * rng.normal(1, 0.1)
    minor_turn = angle / (1 + minor_over_major**2)
    side = parent.side if rng.random() < 0.8 else -parent.side
    first, second = next(names), next(names)
    children = (
        (first, heading - side * (angle - minor_turn), major, parent.arcade),
        (second, heading + side * minor_turn, minor_over_major * major, None),
    )
    x, y = place
    child = parent._replace(relatives=frozenset((parent.name, first, second)), side=-side)
    return [
        child._replace(name=name, x=x, y=y, heading=direction, calibre=calibre, arcade=arcade)
        for name, direction, calibre, arcade in children
        if calibre > _SMALLEST_CALIBRE_MM
    ]


def _draw(pieces: NDArray[np.float64], extent_mm: float, pixels: int) -> NDArray[np.float32]:
    """Shade of vessels on the map, 1 for a wide one; where they overlap, the darkest counts.

    A piece is a line, filtered with a box of a pixel's width, so its shade is the same at any
    resolution. Pieces with windows of equal size are drawn together.
    """
    pixel = extent_mm / pixels
    edge = max(pixel, _EDGE_MM)
    x0, y0, x1, y1, calibre = pieces.T
    reach = np.ceil(((_STEP_MM + calibre + edge) / 2) / pixel).astype(int)
    column = np.floor(((x0 + x1) / 2 + extent_mm / 2) / pixel).astype(int)
    row = np.floor((extent_mm / 2 - (y0 + y1) / 2) / pixel).astype(int)
    on_map = (np.abs(column - pixels / 2) < pixels / 2 + reach) & (
        np.abs(row - pixels / 2) < pixels / 2 + reach
    )
    margin = 2 * int(reach.max()) + 1
    width = pixels + 2 * margin
    body, streak = np.zeros(width * width, np.float32), np.zeros(width * width, np.float32)
    for window in np.unique(reach[on_map]):
        chosen = np.flatnonzero(on_map & (reach == window))
        offsets = np.arange(-window, window + 1)
        for few in np.array_split(chosen, 1 + len(chosen) * len(offsets) ** 2 // 1_000_000):
            columns = column[few, None, None] + offsets
            rows = row[few, None, None] + offsets[:, None]
            px = (columns + 0.5) * pixel - extent_mm / 2 - x0[few, None, None]
            py = extent_mm / 2 - (rows + 0.5) * pixel - y0[few, None, None]
            ax, ay = (x1 - x0)[few, None, None], (y1 - y0)[few, None, None]
            along = np.clip((px * ax + py * ay) / (ax * ax + ay * ay), 0, 1)
            distance = np.hypot(px - along * ax, py - along * ay)
            at = (rows + margin) * width + columns + margin
            depth = 1 - np.exp(-calibre[few, None, None] / _SHADE_CALIBRE_MM)
            for canvas, part in ((body, 1.0), (streak, _REFLEX_WIDTH)):
                half = part * calibre[few, None, None] / 2
                covered = np.minimum(distance + edge / 2, half) - np.maximum(
                    distance - edge / 2, -half
                )
                seen = covered > 0
                np.maximum.at(canvas, at[seen], (depth * covered / edge)[seen].astype(np.float32))
    body -= np.float32(_REFLEX_CONTRAST) * streak
    return body.reshape(width, width)[margin:-margin, margin:-margin]


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
        extent_mm: width and height of the map, mm of arc, in (0, 70].
        pixels: width and height of the map, px.
        palette: "retina" (a living eye, 0.3-12 %) or "printed paper" (a print of its photograph).

    Returns:
        Linear reflectance in (0, 1), pixels x pixels x 3 (R, G, B), with the pole in the centre.
    """
    vessel_seed, mottling_seed = np.random.SeedSequence(seed).spawn(2)
    pixel = extent_mm / pixels
    x = ((np.arange(pixels) + 0.5) * pixel - extent_mm / 2).astype(np.float32)
    y = -x

    log_ratio = _macula(x, y)
    log_ratio += _mottling(x, y, np.random.default_rng(mottling_seed))[..., None]
    _paint_disc(log_ratio, x, y)
    tree = list(_vessels(np.random.default_rng(vessel_seed)))
    artery, vein = (
        _draw(np.array([piece for of_vein, piece in tree if of_vein == kind]), extent_mm, pixels)
        for kind in (False, True)
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
        along_x = np.exp(-((x - FOVEA_MM[0]) ** 2) / (2 * width**2))
        along_y = np.exp(-((y - FOVEA_MM[1]) ** 2) / (2 * width**2))
        shape = (along_y[:, None] * along_x).astype(np.float32)
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
