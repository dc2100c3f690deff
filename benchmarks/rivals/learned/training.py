"""`eyespot rivals train`: the network on a set, resumable after every epoch, with its losses.

An epoch shows each frame of the split `train` once, in a random order and in one of its windows,
and empty windows of a quarter of the frames. All that is random follows from the seed and the
epoch's number, so that a stopped training ends as one that was not. Single precision, in which
convolutions are twice as fast.
"""

import hashlib
import importlib.metadata
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd
from cyclopts.types import NonNegativeInt, PositiveInt

from eyespot.benchmarks.paper import VISIBLE_ENOUGH
from eyespot.benchmarks.rivals.learned.network import (
    CELLS,
    NUMBERS,
    PLACES,
    SCALED,
    Guess,
    LearnedEstimator,
    PixelSquare,
    SpotNetwork,
    blob_in,
    cut,
    evened,
    loss,
    place_of,
    targets_of,
)
from eyespot.benchmarks.sets.read import SetStack, read_set
from eyespot.benchmarks.study import claim, versions, write_json
from eyespot.estimator.run.options import OUT
from eyespot.estimator.run.progress_bar import progress
from eyespot.formats.inputs import InputError
from eyespot.formats.manifest import MANIFEST
from eyespot.formats.microscope import read_microscope
from eyespot.formats.stack import FrameLabels
from eyespot.formats.whole_files import written_whole

BATCH = 32
_EMPTY = 4  # one frame in so many also shows its empty window
_RATE, _DECAY = 1e-3, 1e-3  # of AdamW; the rate falls to 0 along a half cosine
_WARM = 0.05  # part of the steps in which the rate rises
_STEEPEST = 1.0  # norm to which gradients are clipped

_KEPT, CURVE = "checkpoint.eqx", "curve.csv"


COLUMNS = "epoch train validation size_error presence".split()
"""Of curve.csv: mean loss of the epoch's batches without its weights (`network.loss`), the same on
the split `validation`, the RMS error of the logarithm of the spot's mean radius there, and the part
of its windows that is rightly called empty or not."""


def trained(
    samples: "Samples",
    validation: "Samples",
    out: Path,
    *,
    epochs: int,
    seed: int,
    show: Callable[[dict[Any, float]], None] = lambda epoch: None,
) -> SpotNetwork:
    """Train, or continue from the last epoch that `out` holds; `validation` is only reported.

    The seed is that of the first weights and of the order of the frames.
    """
    with jax.enable_x64(False):
        frames = len(samples.present)
        rule = _rule(epochs * math.ceil((frames + frames // _EMPTY) / BATCH))
        network, optimiser, done = _state(out, rule, seed)

        @eqx.filter_jit
        def step(network: SpotNetwork, optimiser: Any, batch: tuple[np.ndarray, ...]) -> Any:
            (_, lost), slopes = eqx.filter_value_and_grad(loss, has_aux=True)(network, *batch)
            changes, optimiser = rule.update(slopes, optimiser, eqx.filter(network, eqx.is_array))
            return eqx.apply_updates(network, changes), optimiser, lost

        curve = read_curve(out / CURVE)[: int(done)].to_dict("records")
        for epoch in range(int(done), epochs):
            losses = []
            for batch in _batches(samples, epoch, seed):
                network, optimiser, lost = step(network, optimiser, batch)
                losses.append(lost)
            found = epoch + 1, float(np.mean(losses)), *_judged(network, validation)
            curve.append(dict(zip(COLUMNS, found, strict=True)))
            with written_whole(out / CURVE, replace=True) as partial:
                pd.DataFrame(curve).to_csv(partial, index=False, lineterminator="\n")
            # The last to be written: a curve with an epoch too many is cut when the run goes on.
            with written_whole(out / _KEPT, replace=True) as partial:
                eqx.tree_serialise_leaves(partial, (network, optimiser, jnp.asarray(epoch + 1)))
            show(curve[-1])
        return network


def _rule(steps: int) -> Any:
    rate = optax.warmup_cosine_decay_schedule(0.0, _RATE, round(_WARM * steps), steps)
    return optax.chain(optax.clip_by_global_norm(_STEEPEST), optax.adamw(rate, weight_decay=_DECAY))


def _state(out: Path, rule: Any, seed: int) -> tuple[SpotNetwork, Any, jax.Array]:
    """Network, optimiser and number of epochs: of the last epoch, or before the first one."""
    network = SpotNetwork(key=jax.random.key(seed))
    state = network, rule.init(eqx.filter(network, eqx.is_array)), jnp.asarray(0)
    kept = out / _KEPT
    return eqx.tree_deserialise_leaves(kept, state) if kept.is_file() else state


def _batches(samples: "Samples", epoch: int, seed: int) -> Iterator[tuple[np.ndarray, ...]]:
    rng = np.random.default_rng([seed, epoch])
    frames = len(samples.present)
    empty = rng.choice(frames, frames // _EMPTY, replace=False)
    windows = np.concatenate([rng.integers(WINDOWS, size=frames), np.full(empty.size, WINDOWS)])
    shown = rng.permutation(np.stack([[*range(frames), *empty], windows], axis=1))
    # The last batch is filled with the first samples: every batch has the shape that is compiled.
    shown = np.concatenate([shown, shown[: -len(shown) % BATCH]])
    for first in range(0, len(shown), BATCH):
        frame, window = shown[first : first + BATCH].T
        seen, *others = (each[frame, window] for each in samples)
        yield evened(seen), *others


_outputs = eqx.filter_jit(lambda network, windows, places: jax.vmap(network)(windows, places))
_losses = eqx.filter_jit(loss)


def _judged(network: SpotNetwork, validation: "Samples") -> tuple[float, float, float]:
    """Loss, size error and presence on a blob's window of each frame, and on the empty one."""
    shown = (1, WINDOWS)
    windows, *others = (np.concatenate([each[:, k] for k in shown]) for each in validation)
    windows = evened(windows)
    places, targets, present = others
    said = _outputs(network, windows, places)
    off = (np.asarray(said.mean) - targets)[present == 1, 2]
    right = (np.asarray(said.presence) > 0) == (present == 1)
    _, lost = _losses(network, windows, places, targets, present)
    return float(lost), float(np.sqrt(np.mean(off**2))), float(right.mean())


def read_curve(path: Path) -> pd.DataFrame:
    """A curve.csv; empty if the file is missing."""
    return pd.read_csv(path) if path.is_file() else pd.DataFrame(columns=COLUMNS)


WINDOWS = 8  # of each frame; an epoch shows one of them
_FIRST = 2  # so many are those of the blob, as in use; the others are around the true place
_MOVED = (0.0, 0.12, 0.12, 0.12, 0.12, 0.04, 0.04, 0.04)
"""By how much each window is moved and grows: standard deviations, in radii and in logarithms. The
last ones are like those around a first ellipse."""

_ELSEWHERE = (20.0, 120.0)  # px, radii that windows without a spot are cut for
_TRIES = 100


class Samples(NamedTuple):
    """Windows of n frames, as `cut` gives them; arrays begin with (n, WINDOWS + 1).

    The last window of each frame lies where the spot's centre is not. `present` is 1 where at
    least half of the contour is in view, else 0; `targets` are 0 where there is no spot.
    """

    windows: np.ndarray
    places: np.ndarray
    targets: np.ndarray
    present: np.ndarray


def samples_of(
    stacks: Sequence[SetStack], seed: int, *, progress: Callable[[], None] = lambda: None
) -> Samples:
    """Cut the windows of all frames, in the order of the stacks."""
    shape = sum(len(entry.open().labels) for entry in stacks), WINDOWS + 1
    made = Samples(
        windows=np.zeros((*shape, 3, CELLS, CELLS), np.float16),
        places=np.zeros((*shape, PLACES), np.float32),
        targets=np.zeros((*shape, len(NUMBERS)), np.float32),
        present=np.zeros(shape, np.float32),
    )
    row = 0
    for number, entry in enumerate(stacks):
        rng = np.random.default_rng([seed, number])
        microscope = read_microscope(entry.folder / "microscope.json")
        stack = entry.open()
        for labels in stack.labels:
            image = stack.image(labels)
            visible = labels.visible_fraction >= VISIBLE_ENOUGH
            for k, window in enumerate(_windows(image, labels, rng)):
                made.windows[row, k] = cut(image, window)
                made.places[row, k] = place_of(window, microscope)
                if k < WINDOWS and visible:
                    made.targets[row, k] = targets_of(labels, window)
                    made.present[row, k] = 1.0
            row += 1
        progress()
    return made


def _windows(image: np.ndarray, labels: FrameLabels, rng: np.random.Generator) -> list[PixelSquare]:
    radius = float(np.sqrt(labels.half_max_semi_major_px * labels.half_max_semi_minor_px))
    truth = Guess(labels.half_max_x_px, labels.half_max_y_px, radius)
    blob = blob_in(image)
    # A blob far from the spot is a frame that the network should refuse, not a window to learn on.
    near = blob is not None and np.hypot(blob.x - truth.x, blob.y - truth.y) < radius
    first = blob if blob is not None and near else truth
    around = [first] * _FIRST + [truth] * (WINDOWS - _FIRST)
    moved = [_moved(guess, by, rng) for guess, by in zip(around, _MOVED, strict=True)]
    return [PixelSquare.around(guess) for guess in (*moved, _elsewhere(image, truth, rng))]


def _moved(guess: Guess, by: float, rng: np.random.Generator) -> Guess:
    dx, dy = rng.normal(0, by * guess.radius, 2)
    return Guess(guess.x + dx, guess.y + dy, guess.radius * float(np.exp(rng.normal(0, by))))


def _elsewhere(image: np.ndarray, truth: Guess, rng: np.random.Generator) -> Guess:
    """A place at least as far from the spot's centre as half a window's side."""
    height, width = image.shape[:2]
    far = Guess(0.0, 0.0, _ELSEWHERE[0])
    for _ in range(_TRIES):
        radius = float(np.exp(rng.uniform(*np.log(_ELSEWHERE))))
        guess = Guess(rng.uniform(0, width), rng.uniform(0, height), radius)
        half = PixelSquare.around(guess).half
        if max(abs(guess.x - truth.x), abs(guess.y - truth.y)) > half + truth.radius / 2:
            return guess
    return far


# Makes the weights: trains, judges on validation, and writes beside them what was done.

SCHEMA = 1
_LIBRARIES = ("equinox", "jax", "optax", "opencv-python-headless")


def train(
    folder: Path,
    /,
    *,
    out: Annotated[Path, OUT],
    epochs: PositiveInt = 40,
    seed: NonNegativeInt = 0,
) -> None:
    """Train the learned estimator on the split train, and calibrate it on validation.

    If a run was stopped, the same command continues it after its last epoch.

    Args:
        folder: Labelled set.
        out: Folder of the weights; a training that it holds is continued.
        epochs: Number of epochs, along which the learning rate falls to 0.
        seed: Random seed.
    """
    labelled = read_set(folder)
    manifest = folder / MANIFEST
    if labelled.missing or not manifest.is_file():
        raise InputError(f"{folder} is incomplete. Run `eyespot dataset` with its spec again.")
    splits = {
        split: [entry for entry in labelled.stacks if entry.split == split]
        for split in ("train", "validation")
    }
    if lacking := [split for split, stacks in splits.items() if not stacks]:
        raise InputError(f"{folder} has no split {lacking[0]}. Make a set that has one.")
    asked = {
        "set": labelled.name,
        "manifest_sha256": hashlib.sha256(manifest.read_bytes()).hexdigest(),
        "epochs": epochs,
        "seed": seed,
    }
    claim(out, asked, command="eyespot rivals train")
    with jax.enable_x64(False):
        network, _, done = _state(out, _rule(1), seed=0)
    if int(done) < epochs:
        with progress("Reading", total=sum(map(len, splits.values()))) as advance:
            samples, validation = (
                samples_of(stacks, seed, progress=advance) for stacks in splits.values()
            )
        with progress("Training", total=epochs) as advance:

            def show(epoch: dict[Any, float]) -> None:
                losses = f"loss {epoch['train']:.3f}, validation {epoch['validation']:.3f}"
                advance(note=f"{losses}, size {100 * epoch['size_error']:.2f} %")

            network = trained(samples, validation, out, epochs=epochs, seed=seed, show=show)
    trust, found = judged(network, splits["validation"])
    with written_whole(out / "weights.eqx", replace=True) as partial:
        eqx.tree_serialise_leaves(partial, network)
    about = {
        "schema": SCHEMA,
        "command": shlex.join(["eyespot", *sys.argv[1:]]),
        **asked,
        "frames": {
            split: sum(len(entry.open().labels) for entry in stacks)
            for split, stacks in splits.items()
        },
        "trust": trust,
        "validation": found,
        "weights_sha256": hashlib.sha256((out / "weights.eqx").read_bytes()).hexdigest(),
        "versions": versions() | {name: importlib.metadata.version(name) for name in _LIBRARIES},
    }
    write_json(out / "weights.json", about)
    print(f"Wrote {out / 'weights.eqx'}.")


_SHARE = 0.683  # of the errors within one sigma
_REFUSED = 0.01  # part of the visible spots that may be refused


def judged(
    network: SpotNetwork, stacks: Sequence[SetStack]
) -> tuple[dict[str, Any], dict[str, int | dict[str, float]]]:
    """Measure all frames, and choose factors with which 68.3 % of the errors lie within a sigma.

    Beside them the least presence; then the number of frames with a visible spot, RMS errors of
    `SCALED` (px and mm), and the part of the errors within two sigmas, after the factors.
    """
    estimator = LearnedEstimator(network)
    errors, sigmas, presences = [], [], []
    for entry in stacks:
        microscope = read_microscope(entry.folder / "microscope.json")
        stack = entry.open()
        for labels in stack.labels:
            if labels.visible_fraction < VISIBLE_ENOUGH:
                continue
            said = estimator.measure(stack.image(labels), microscope)
            presences.append(-np.inf if said is None else said.presence)
            truth = tuple(getattr(labels, f"half_max_{name}_px") for name in SCALED[:4])
            if said is not None and np.hypot(*(said.ellipse[:2] - truth[:2])) <= truth[2]:
                errors.append([*(said.ellipse[:4] - truth), said.distance_mm - labels.d_mm])
                variances = np.diag(said.covariance)[:4]
                sigmas.append([*np.sqrt(variances), said.sigma_distance_mm])
    z = np.abs(errors) / np.array(sigmas)
    factors = np.quantile(z, _SHARE, axis=0)
    trust = {
        "factors": dict(zip(SCALED, factors.tolist(), strict=True)),
        "least_presence": float(np.quantile(presences, _REFUSED)),
    }
    rms, within = np.sqrt(np.mean(np.square(errors), axis=0)), np.mean(z < 2 * factors, axis=0)
    return trust, {
        "frames": len(presences),
        "rms": dict(zip(SCALED, rms.tolist(), strict=True)),
        "within_2_sigma": dict(zip(SCALED, within.tolist(), strict=True)),
    }
