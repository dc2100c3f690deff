"""Irradiance of a glue lens by brute force, in NumPy: the referee of `optics.vector_irradiance`.

Every point of an even grid on the cap is traced backwards to the core's face with Snell's law, and
counts if the ray stays inside of the glue, starts on the core and lies within its cone. Cells that
the edge of the lit part crosses count by the share that lies on the lit side, so the error falls
with the square of the grid's step. The grid covers the lit part only, found by a coarser one.
"""

from functools import partial

import numpy as np

_LOOK = 240  # cells per side of the coarse grid
_MARGIN = 3  # of these, added around the lit ones


def transmittance(sine, n1, n2):
    """Fresnel's equations as in a textbook, for a sine of incidence in the first medium."""
    cos1, cos2 = np.sqrt(1 - sine**2), np.sqrt(1 - (n1 / n2 * sine) ** 2)
    s = (n1 * cos1 - n2 * cos2) / (n1 * cos1 + n2 * cos2)
    p = (n2 * cos1 - n1 * cos2) / (n2 * cos1 + n1 * cos2)
    return 1 - (s**2 + p**2) / 2


def irradiance(lens, medium, radius, distance, *, steps=500):
    """E on a plane perpendicular to the axis, 1/mm² per unit power, at one radius and distance."""
    cells = partial(_cells, lens, medium, radius, distance)
    whole = 0.0, 1.0, 0.0, np.pi  # half of the cap, which the other half mirrors
    _, excess, _ = cells(whole, _LOOK)
    near = np.argwhere(excess < 0)
    if not near.size:
        near = np.argwhere(excess == excess.min())
    first = np.maximum(near.min(axis=0) - _MARGIN, 0) / _LOOK
    last = np.minimum(near.max(axis=0) + 1 + _MARGIN, _LOOK) / _LOOK
    low, width = np.array(whole[::2]), np.diff(np.reshape(whole, (2, 2)))[:, 0]
    box = np.stack([low + first * width, low + last * width], axis=1).ravel()
    light, excess, steepness = cells(box, steps)
    return 2 * float(np.sum(light * np.clip(0.5 - excess / np.maximum(steepness, 1e-300), 0, 1)))


def _cells(lens, medium, radius, distance, box, steps):
    """Light of each cell of a grid on the cap, the ray's excess, and its change over the cell."""
    core, length, aperture = map(float, (lens.core_radius, lens.glue_length, lens.aperture_radius))
    sag, index, na = map(float, (lens.sag, lens.glue_index, lens.numerical_aperture))
    curvature = 2 * sag / (aperture**2 + sag**2)
    middle = (np.arange(steps) + 0.5) / steps
    ring = (box[0] + (box[1] - box[0]) * middle)[:, None] * aperture
    turn = (box[2] + (box[3] - box[2]) * middle)[None, :]
    axial = np.sqrt(np.maximum(1 - (curvature * ring) ** 2, 0))
    normal = np.stack(
        np.broadcast_arrays(
            curvature * ring * np.cos(turn), curvature * ring * np.sin(turn), axial + 0 * turn
        )
    )
    depth = curvature * ring**2 / (1 + axial)
    across = ring * np.cos(turn), ring * np.sin(turn)
    point = np.stack(np.broadcast_arrays(*across, -depth + 0 * turn))
    way = np.array([radius, 0.0, distance])[:, None, None] - point
    far = np.sqrt(np.sum(way**2, axis=0))
    way /= far
    cos_out = np.sum(way * normal, axis=0)
    ratio = medium / index
    cos_in = np.sqrt(np.maximum(1 - ratio**2 * (1 - cos_out**2), 0))
    inside = ratio * way + (cos_in - ratio * cos_out) * normal

    def height_squared(below):
        path = (below - depth) / inside[2]
        return sum((point[i] - path * inside[i]) ** 2 for i in (0, 1))

    with np.errstate(invalid="ignore", divide="ignore"):
        excess = np.maximum.reduce(
            [
                (1 - inside[2] ** 2) / (na / index) ** 2 - 1,
                height_squared(length) / core**2 - 1,
                height_squared(sag) / aperture**2 - 1,
                -cos_out,
            ]
        )
    s = (medium * cos_out - index * cos_in) / (medium * cos_out + index * cos_in)
    p = (index * cos_out - medium * cos_in) / (index * cos_out + medium * cos_in)
    radiance = 1 / (np.pi * core**2 * np.pi * (na / index) ** 2) * ratio**2
    light = radiance * (1 - (s**2 + p**2) / 2) * np.maximum(cos_out, 0) * way[2] / far**2
    steepness = np.abs(np.gradient(excess, axis=0)) + np.abs(np.gradient(excess, axis=1))
    cell = (box[1] - box[0]) * aperture / steps * (box[3] - box[2]) / steps
    return ring * cell / np.maximum(axial, 1e-12) * light, excess, steepness
