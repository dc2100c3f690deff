"""An evenly lit disc on a wall that spreads light, summed ring by ring, without `optics`."""

import functools

import numpy as np
from scipy.special import gammaincinv


@functools.cache
def radii(length, count=20_000):
    """Equal shares of a point's light leave the wall at these distances; a Gamma distribution."""
    return length * gammaincinv(2.0, (np.arange(count) + 0.5) / count)


def lit_by_disc(x, disc, length):
    """Light at a distance x from the middle of an evenly lit disc: ring by ring, over lit arcs."""
    ring = radii(length)
    cosine = (x * x + ring * ring - disc * disc) / (2 * x * ring)
    return np.mean(np.arccos(np.clip(cosine, -1.0, 1.0)) / np.pi)
