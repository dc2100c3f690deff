"""Ghosts of a bell of light that grows over a drawn wall, and walls that have none."""

import numpy as np
from scipy import ndimage

from eyespot.estimator.ghost import GHOST_SIGMAS, strongest_ghost

CELLS, SIDE_PX = 26, 10
NOISE = 0.004
"""Of the logarithm of a cell's light: photons of 100 pixels of some 3,000 electrons are 0.002."""
X, Y = np.meshgrid(*2 * [(np.arange(CELLS) - (CELLS - 1) / 2) * SIDE_PX])


def bell(width_px, right=0.0, down=0.0):
    """Light of a bell whose middle is there."""
    return np.exp(-((X - right) ** 2 + (Y - down) ** 2) / (2.0 * width_px**2))


def wall(rng):
    """Log reflectance: vessels and grain, 3 to 12 % of contrast, 1 to 6 cells long."""
    texture = ndimage.gaussian_filter(rng.normal(size=X.shape), rng.uniform(0.5, 3.0))
    return rng.uniform(0.03, 0.12) * texture / texture.std()


def search(rng, *, share=0.0, shift=(0.0, 0.0), frames=3):
    """The strongest ghost in frames of a withdrawal, whose gain and place were fitted."""
    texture, ambient = wall(rng), 0.02
    lights, totals, residuals, slopes = [], [], [], []
    for k in range(frames):
        width = 40.0 * 1.12**k
        light, ghost = bell(width), share * bell(width, *shift)
        total = light + ambient
        seen = np.log(total + ghost) + texture + NOISE * rng.normal(size=X.shape)
        lights.append(light)
        totals.append(total)
        residuals.append((seen - np.log(total)).ravel())
        away = light / total / width**2
        ways = (1.0, ambient / total, X * away, Y * away, (X**2 + Y**2) * away / width)
        slopes.append(np.stack([np.broadcast_to(way, X.shape).ravel() for way in ways]))
    weight = np.full((frames, CELLS**2), NOISE**-2)
    return strongest_ghost(
        np.stack(residuals), weight, np.stack(lights), np.stack(totals), slopes, side_px=SIDE_PX
    )


def test_ghosts_of_a_tenth_and_more_are_found_in_the_third_frame():
    rng, missed = np.random.default_rng(1), 0
    for _ in range(100):
        turn, length, share = rng.uniform(0, 2 * np.pi), rng.uniform(10, 60), rng.uniform(0.1, 0.5)
        shift = (length * np.cos(turn), length * np.sin(turn))
        found = search(rng, share=share, shift=shift)
        missed += found.sigmas < GHOST_SIGMAS
        # It lies where it is seen, to the 30 degrees of the grid and as much by its linear light.
        off = np.array(found.shift_px) @ shift / np.linalg.norm(found.shift_px) / length
        assert off > np.cos(np.radians(45.0))
    assert missed == 0


def test_a_textured_wall_without_a_ghost_shows_none():
    rng = np.random.default_rng(2)
    strongest = [search(rng, frames=int(rng.integers(2, 6))).sigmas for _ in range(300)]
    # The largest of some twenty independent normal numbers, 300 times: 5 is beyond chance (1e-3).
    assert max(strongest) < GHOST_SIGMAS


def test_one_frame_says_nothing_of_ghosts():
    assert search(np.random.default_rng(3), share=0.5, shift=(30.0, 0.0), frames=1) is None
