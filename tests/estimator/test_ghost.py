"""Ghosts of a bell of light that grows over a drawn wall, and walls that have none."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from eyespot.estimator import SubpixelSettings, TrackState, measure
from eyespot.estimator.ghost import GHOST_SIGMAS, GhostWatch, strongest_ghost
from eyespot.formats.spot import Spot
from eyespot.scenes.drawn import SHAPE
from tests.support.drawn.own_frames import camera_image, textured_wall

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


def discs(rng, *, shares, shift=(24.0, -18.0)):
    """Ghosts known after each frame of a disc that grows over a wall, and the strongest of all.

    A frame's ghost is a shifted copy of its light, without noise and out of focus, with a share.
    """
    wall, state, watch, known = textured_wall(rng), TrackState(), GhostWatch(), []
    settings = SubpixelSettings()
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    move = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    for k, share in enumerate(shares):
        outwards = np.hypot(x - 320.3, y - 240.8) - 45.0 * 1.08**k
        light = np.clip(0.5 - outwards / 3.0, 0.0, 1.0) * wall
        ghost = cv2.warpAffine(cv2.GaussianBlur(light, (0, 0), 2.0), move, light.shape[::-1])
        image = camera_image(rng, 20.0 * wall + 140.0 * (light + share * ghost))
        spot, state = measure(image, state, settings)
        assert isinstance(spot, Spot)
        watch.look(image, spot)
        known.append(watch.found)
    return known, watch.strongest


@pytest.mark.parametrize("seed", range(3))
def test_a_ghost_of_a_sharp_spot_is_found_and_an_even_wall_has_none(seed):
    rng = np.random.default_rng(seed)
    assert discs(rng, shares=[0.0] * 6) == ([None] * 6, None)
    found = discs(rng, shares=[0.15] * 6)[0][-1]
    assert found is not None
    # The grid's steps of 30 degrees and of a quarter to a third of the length.
    assert np.hypot(*np.subtract(found.shift_px, (24.0, -18.0))) < 0.5 * 30.0


def test_a_ghost_stays_until_four_frames_deny_it():
    known, _ = discs(np.random.default_rng(4), shares=[0.15] * 4 + [0.0] * 8)
    assert all(known[3:7])
    assert known[-1] is None
