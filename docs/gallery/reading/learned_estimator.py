"""
A learned estimator
===================

A labelled set, an equinox network, a score. Copy the file and change it; it is not run for this
page, because the training takes a while::

    eyespot dataset static-v2 --out out/static-v2
    python learned_estimator.py out/static-v2 test out/entries/network
    eyespot score out/static-v2 --split test --entries out/entries --out out/ranked

The network says where the ellipse lies in a square: first around the brightest blob, then around
the ellipse that it has found.
"""

import json
import shlex
import sys
from pathlib import Path

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd

CELLS, REACH = 64, 1.9  # along a square's side, and half that side over the spot's mean radius
STEPS, BATCH, RATE = 7000, 32, 1e-3
MOVED = (0.0, 0.04, 0.12, 0.12)  # each frame has so many squares, moved by so many radii
ELLIPSE = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad")

# %%
# The set: labels are lines of metadata.jsonl, and images are files beside it.


def frames_of(folder, split):
    """File name within the set, image, and true ellipse of every frame with a visible spot."""
    labels = pd.read_json(folder / split / "metadata.jsonl", lines=True)
    for row in labels[labels.visible_fraction >= 0.5].itertuples():
        name = f"{split}/{row.file_name}"
        image = np.asarray(cv2.imread(str(folder / name)))[..., ::-1]  # BGR
        yield name, image, np.array([getattr(row, f"half_max_{key}") for key in ELLIPSE])


def brightest_blob(image):
    """Centre and radius of the brightest blurred blob, px."""
    cells = cv2.resize(image.max(axis=2), None, fx=1 / 8, fy=1 / 8, interpolation=cv2.INTER_AREA)
    cells = cv2.GaussianBlur(cells.astype(np.float32), (0, 0), 1.5)
    above = (cells > (np.median(cells) + cells.max()) / 2).astype(np.uint8)
    _, labels, stats, centres = cv2.connectedComponentsWithStats(above)
    label = labels[np.unravel_index(np.argmax(cells), cells.shape)]
    x, y = 8 * centres[label] + 3.5
    return x, y, 8 * np.sqrt(stats[label, cv2.CC_STAT_AREA] / np.pi)


def square_around(x, y, radius):
    """Centre and half side, px, of a square of whole pixels."""
    return round(x) - 0.5, round(y) - 0.5, round(max(REACH * radius, 24.0))


def pixels_of(image, x, y, half):
    """A square's pixels, 3 x 64 x 64, with mean 0 and standard deviation 1."""
    steps = np.arange(-half, half) + 0.5
    rows = (y + steps).astype(int).clip(0, image.shape[0] - 1)
    columns = (x + steps).astype(int).clip(0, image.shape[1] - 1)
    inside = image[np.ix_(rows, columns)].astype(np.float32)
    seen = np.sqrt(cv2.resize(inside, (CELLS, CELLS), interpolation=cv2.INTER_AREA))
    return ((seen - seen.mean()) / max(seen.std(), 1e-6)).transpose(2, 0, 1)


# %%
# The network: the ellipse relative to the square. A circle has no angle, so that the logarithm of
# the axes' ratio is a vector whose direction is twice the angle.


def numbers_of(ellipse, square):
    (x, y, a, b, angle), (middle_x, middle_y, half) = ellipse, square
    ratio = np.log(a / b)
    shape = np.log(np.sqrt(a * b) / half), ratio * np.cos(2 * angle), ratio * np.sin(2 * angle)
    return np.array([(x - middle_x) / half, (y - middle_y) / half, *shape])


def ellipse_of(numbers, square):
    (x, y, log_size, along, across), (middle_x, middle_y, half) = numbers, square
    size, stretch = half * np.exp(log_size), np.exp(np.hypot(along, across) / 2)
    shape = size * stretch, size / stretch, np.arctan2(across, along) / 2
    return np.array([middle_x + half * x, middle_y + half * y, *shape])


def network_of(key):
    *keys, last = jax.random.split(key, 6)
    channels = (3, 16, 24, 32, 48, 64)
    layers: list = []
    for key, before, after in zip(keys, channels[:-1], channels[1:], strict=True):
        layers += [eqx.nn.Conv2d(before, after, 3, 2, 1, key=key), eqx.nn.Lambda(jax.nn.relu)]
    dense = eqx.nn.MLP(channels[-1] * (CELLS // 32) ** 2, 5, 96, depth=1, key=last)
    return eqx.nn.Sequential([*layers, eqx.nn.Lambda(jnp.ravel), dense])


@eqx.filter_grad
def slopes_of_loss(network, seen, truth):
    return jnp.mean(jnp.abs(jax.vmap(network)(seen) - truth))


def trained(folder, steps):
    rng, seen, truth = np.random.default_rng(0), [], []
    for _, image, ellipse in frames_of(folder, "train"):
        radius = np.sqrt(ellipse[2] * ellipse[3])
        for moved in MOVED:
            x, y = ellipse[:2] + rng.normal(0, moved * radius, 2)
            square = square_around(x, y, radius * np.exp(rng.normal(0, moved)))
            seen.append(pixels_of(image, *square))
            truth.append(numbers_of(ellipse, square))
    windows, numbers = np.array(seen), np.array(truth, np.float32)
    rule = optax.adam(optax.cosine_decay_schedule(RATE, steps))
    network = network_of(jax.random.key(0))
    state = rule.init(eqx.filter(network, eqx.is_array))

    @eqx.filter_jit
    def step(network, state, seen, truth):
        changes, state = rule.update(slopes_of_loss(network, seen, truth), state)
        return eqx.apply_updates(network, changes), state

    for batch in (rng.integers(len(windows), size=BATCH) for _ in range(steps)):
        network, state = step(network, state, windows[batch], numbers[batch])
    return network


# %%
# The score: a CSV file with a line for each image, beside a description of the entry.


def main(folder, split, out, steps=STEPS):
    forward, rows = eqx.filter_jit(trained(folder, steps)), []
    for name, image, _ in frames_of(folder, split):
        place = brightest_blob(image)
        for _ in range(2):
            square = square_around(*place)
            ellipse = ellipse_of(np.asarray(forward(pixels_of(image, *square))), square)
            place = *ellipse[:2], np.sqrt(ellipse[2] * ellipse[3])
        rows.append([name, *ellipse])
    out.mkdir(parents=True)
    pd.DataFrame(rows, columns=["file_name", *ELLIPSE]).to_csv(out / "spots.csv", index=False)
    (out / "entry.json").write_text(json.dumps({"command": shlex.join(sys.argv), "seed": 0}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]), *map(int, sys.argv[4:]))
