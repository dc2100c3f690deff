"""The learned estimator: its windows and numbers, its training, and what it says about renders."""

import hashlib
import json
import math
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import jax
import numpy as np
import pytest
from scipy.stats import binom

from eyespot.benchmarks.rivals.learned.network import (
    CELLS,
    WEIGHTS,
    Guess,
    LearnedEstimator,
    PixelSquare,
    blob_in,
    covariance_of,
    cut,
    ellipse_of,
    targets_of,
)
from eyespot.benchmarks.rivals.learned.training import WINDOWS, Samples, read_curve, trained
from eyespot.benchmarks.sets.spec import load_spec, named_specs, plan
from eyespot.formats.microscope import read_microscope
from eyespot.scenes import Scene, render_stack
from tests.support.drawn.drawn_sets import labels_of

_SPEC = WEIGHTS.with_name("training.toml")


def test_the_numbers_of_a_window_mean_the_ellipse_that_they_were_made_of():
    rng = np.random.default_rng(3)
    for _ in range(50):
        b = rng.uniform(20, 100)
        known = {
            "x_px": rng.uniform(0, 640),
            "y_px": rng.uniform(0, 480),
            "semi_major_px": b * rng.uniform(1.001, 1.6),
            "semi_minor_px": b,
            "angle_rad": rng.uniform(-1.5, 1.5),
        }
        labels = labels_of(0, **{f"half_max_{name}": value for name, value in known.items()})
        guess = Guess(known["x_px"] + rng.normal(0, 5), known["y_px"] - 3, b * 1.2)
        window = PixelSquare.around(guess)
        found = ellipse_of(targets_of(labels, window), window)
        assert np.allclose(found, list(known.values()), rtol=1e-9)  # rounding


def test_the_covariance_is_that_of_the_ellipses_slopes():
    numbers = np.array([0.1, -0.2, 0.05, 0.2, 0.15, 0.0])
    sigmas = np.array([0.01, 0.02, 0.005, 0.004, 0.006, 0.1])
    window, step = PixelSquare(100, 50, 240), 1e-5
    slopes = np.empty((5, 5))
    for k in range(5):
        up, down = numbers.copy(), numbers.copy()
        up[k] += step
        down[k] -= step
        slopes[:, k] = (ellipse_of(up, window) - ellipse_of(down, window)) / (2 * step)
    wanted = (slopes * sigmas[:5] ** 2) @ slopes.T
    # Central differences: the step squared times third derivatives of order 100 px.
    assert np.allclose(covariance_of(numbers, sigmas, window), wanted, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(("x", "y"), [(300.0, 200.0), (12.3, 400.7), (630.0, 5.0)])
def test_a_window_shows_its_cells_where_it_says_that_they_are(x, y):
    """The centroid of a bell, in cells and then in pixels, is where the bell is drawn."""
    v, u = np.mgrid[0:480, 0:640].astype(float)
    bell = np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 6.0**2))
    image = np.repeat((255 * bell).astype(np.uint8)[..., None], 3, axis=2)
    window = PixelSquare.around(Guess(x + 7, y - 4, 60.0))
    light = cut(image, window)[0] ** 2
    # A border that is repeated has light of its own where it cuts the bell.
    inside = np.arange(CELLS) * window.side / CELLS
    at = [window.left + inside, window.top + inside]
    light = light * ((at[0] > 0) & (at[0] < 639)) * ((at[1] > 0) & (at[1] < 479))[:, None]
    if 20 < x < 620 and 20 < y < 460:
        cells = np.arange(CELLS) + 0.5
        centroid = [float((light.sum(axis=axis) * cells).sum() / light.sum()) for axis in (0, 1)]
        pixels = [
            edge - 0.5 + cell * window.side / CELLS
            for edge, cell in zip(window[:2], centroid, strict=True)
        ]
        # Truncation to whole grey values takes light from the flanks, evenly.
        assert np.allclose(pixels, [x, y], atol=0.1)
    assert light.shape == (CELLS, CELLS)


def test_the_blob_lies_in_the_spot_and_an_even_frame_has_none():
    v, u = np.mgrid[0:480, 0:640]
    disc = np.hypot(u - 400, v - 130) < 50
    image = np.repeat(np.where(disc, 200, 40).astype(np.uint8)[..., None], 3, axis=2)
    blob = blob_in(image)
    assert blob is not None
    # Half a cell of eight pixels.
    assert np.allclose([blob.x, blob.y, blob.radius], [400, 130, 50], atol=4)
    assert blob_in(np.full((480, 640, 3), 90, np.uint8)) is None


def some_samples(seed: int, frames: int = 40) -> Samples:
    rng = np.random.default_rng(seed)
    shape = frames, WINDOWS + 1
    present = np.ones(shape, np.float32)
    present[:, -1] = 0
    return Samples(
        windows=rng.uniform(size=(*shape, 3, CELLS, CELLS)).astype(np.float16),
        places=rng.normal(size=(*shape, 4)).astype(np.float32),
        targets=rng.normal(size=(*shape, 6)).astype(np.float32),
        present=present,
    )


def test_a_training_that_was_stopped_ends_with_the_same_bits(tmp_path):
    samples, others = some_samples(1), some_samples(2, 8)

    def weights(out: Path, show: Any = lambda epoch: None) -> list[np.ndarray]:
        out.mkdir(exist_ok=True)
        network = trained(samples, others, out, epochs=2, seed=5, show=show)
        return [np.asarray(leaf) for leaf in jax.tree.leaves(network) if hasattr(leaf, "shape")]

    whole = weights(tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):  # between two checkpoints
        weights(tmp_path / "parts", Mock(side_effect=KeyboardInterrupt))
    parts = weights(tmp_path / "parts")
    assert all(np.array_equal(a, b) for a, b in zip(whole, parts, strict=True))
    curve, again = (read_curve(tmp_path / name / "curve.csv") for name in ("whole", "parts"))
    assert curve.equals(again)
    assert curve.epoch.tolist() == [1, 2]


def test_the_weights_are_small_and_those_that_their_file_describes():
    about = json.loads(WEIGHTS.with_suffix(".json").read_text())
    assert WEIGHTS.stat().st_size < 2e6
    assert hashlib.sha256(WEIGHTS.read_bytes()).hexdigest() == about["weights_sha256"]
    assert about["set"] == load_spec(_SPEC).name


def test_no_wall_of_a_named_set_was_shown_in_training():
    shown = {stack.scene.phantom.texture_seed for stack in plan(load_spec(_SPEC))}
    for name in named_specs():
        walls = {stack.scene.phantom.texture_seed for stack in plan(load_spec(name))}
        assert not shown & walls, name


@pytest.mark.slow  # renders
def test_on_walls_never_shown_the_network_beats_the_blob_and_covers_what_it_states(tmp_path):
    """One frame of each of some stacks: as many independent walls, places and distances."""
    estimator, rng = LearnedEstimator.load(), np.random.default_rng(987)
    errors, sigmas, blobs, ranges = [], [], [], []
    for number in range(14):
        scene = {
            "schema": 1,
            "seed": 900_000 + number,
            "phantom": {
                "wall": ("retina", "printed paper")[number % 2],
                "texture_seed": 900_000 + number,
            },
            "source": {"kind": ("cone", "lens")[number // 2 % 2]},
            "microscope": {"pinhole_height_mm": 200.0},
            "spot": {
                "eccentricity_mm": rng.uniform(0, 3),
                "azimuth_deg": rng.uniform(0, 360),
                "incidence_deg": rng.uniform(15, 35),
                "incidence_azimuth_deg": rng.uniform(0, 360),
            },
            "motion": {"start_mm": rng.uniform(0.8, 5), "travel_mm": 0.1, "frames": 1},
            "exposures": {"kinds": ["metered"], "sensitivity_mm2_sr_mj": 2000.0},
        }
        stack = render_stack(Scene.model_validate(scene), tmp_path / f"{number}")
        labels = stack.labels[0]
        if labels.visible_fraction < 0.5:
            continue
        image = stack.image(labels)
        blob = blob_in(image)
        said = estimator.measure(image, read_microscope(stack.folder / "microscope.json"))
        assert said is not None and blob is not None
        errors.append(said.ellipse[3] - labels.half_max_semi_minor_px)
        sigmas.append(math.sqrt(said.covariance[3, 3]))
        blobs.append(blob.radius - labels.half_max_semi_minor_px)
        ranges.append((said.distance_mm - labels.d_mm, said.sigma_distance_mm, labels.d_mm))
    n = len(errors)
    assert n >= 10
    assert np.sqrt(np.mean(np.square(errors))) < np.sqrt(np.mean(np.square(blobs))) / 2
    d_errors, d_sigmas, truths = np.array(ranges).T
    assert np.sqrt(np.mean(d_errors**2)) < np.std(truths) / 2  # chance knows the mean distance
    for off, sigma in ((np.array(errors), np.array(sigmas)), (d_errors, d_sigmas)):
        # Fewer come from a coverage of 68 and 95 % once in a thousand times.
        assert np.sum(np.abs(off) < sigma) >= binom.ppf(1e-3, n, 0.683)
        assert np.sum(np.abs(off) < 2 * sigma) >= binom.ppf(1e-3, n, 0.954)
